"""The integrator in pure Python on small problems with known solutions: order, stability, breaks, output, statuses.

What Rodas5P should do: G. Steinebach, BIT 63 (2023): order 5, L-stable, stiffly accurate, dense output of order 4.
"""

import numpy as np
import pytest
from elimination import plain_problem
from hypothesis import given
from hypothesis import strategies as st

from valvesim.inputs import Constant, Pulse, Ramp, Sine, Step, Sum, Table, merge
from valvesim.solver import rodas5p as rosenbrock
from valvesim.solver.rodas5p import DONE, STEP_TOO_SMALL, TOO_MANY_STEPS

NO_KNOTS = (np.array([0.0]), np.zeros((1, 1)))
STILL = (Constant(),)


class Run:
    """One call of `rosenbrock.integrate`, or several in slices, with everything it returns."""

    def __init__(self, derivative, jacobian, y, *, commands=STILL, end=1.0, knots=NO_KNOTS, t_out=(), rtol=1e-6,
                 atol=1e-9, step=1e-3, max_steps=100_000, breaks=None, slices=()):  # fmt: skip
        starts, intervals = merge(list(commands), end)
        rows = intervals.rows
        if breaks is not None:
            starts, rows = breaks, np.repeat(rows[:1], len(breaks), axis=0)
        states, self.t_out = np.array(y, dtype=float)[:, None], np.array(t_out, dtype=float)
        out = np.full((len(self.t_out), *states.shape), np.nan)
        self.y, self.out = states[:, 0], out[:, :, 0]
        self.clock, self.count = np.array([0.0, step, 0.0, 0.0]), np.zeros(2, np.int64)
        self.calls = 0

        def counted(*arguments):
            self.calls += 1
            derivative(*arguments)

        functions = plain_problem(len(self.y), counted, jacobian, derivative)
        knot_times, coefficients = knots
        for stop in (*slices, end):
            self.status = rosenbrock.integrate(
                *functions, coefficients.shape[1], True, states, self.clock, stop, starts, rows, knot_times,
                coefficients[:, :, None], self.t_out, out, rtol, np.full(len(self.y), atol), np.zeros(states.shape),
                max_steps, self.count,
            )  # fmt: skip


def fixed_steps(derivative, jacobian, y, n, *, end, **options):
    """The solution with `n` equal steps: breaks at every step, and no error control to speak of."""
    run = Run(
        derivative, jacobian, y, end=end, breaks=np.arange(n) * end / n, rtol=1e30, atol=1e30, step=10 * end, **options
    )
    assert run.status == DONE and run.count.tolist() == [n, 0]
    return run.y


def orders(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


# ---------------------------------------------------------------- problems


def pendulum(y, u, c, out):
    out[0], out[1] = y[1], -np.sin(y[0]) - 0.1 * y[1]


def pendulum_jacobian(y, u, c, out):
    out[:] = [[0.0, 1.0], [-np.cos(y[0]), -0.1]]


def riccati(y, u, c, out):
    out[0] = u[0] - y[0] ** 2


def riccati_jacobian(y, u, c, out):
    out[0, 0] = -2 * y[0]


def lag(time_constant):
    def derivative(y, u, c, out):
        out[0] = (u[0] - y[0]) / time_constant

    def jacobian(y, u, c, out):
        out[0, 0] = -1.0 / time_constant

    return derivative, jacobian


def fading(y, u, c, out):
    out[0] = -c[0] * y[0]


def fading_jacobian(y, u, c, out):
    out[0, 0] = -c[0]


def oscillator(frequency):
    def derivative(y, u, c, out):
        out[0], out[1] = frequency * y[1], -frequency * y[0]

    def jacobian(y, u, c, out):
        out[:] = [[0.0, frequency], [-frequency, 0.0]]

    return derivative, jacobian


# ---------------------------------------------------------------- order and stability


def test_error_falls_with_the_fifth_power_of_the_step():
    exact = fixed_steps(pendulum, pendulum_jacobian, [1.0, 0.0], 256, end=4.0)
    errors = [
        np.abs(fixed_steps(pendulum, pendulum_jacobian, [1.0, 0.0], n, end=4.0) - exact).max() for n in (8, 16, 32, 64)
    ]
    assert orders(errors) == pytest.approx([5.0] * 3, abs=0.2)
    assert errors[-1] < 1e-9


def test_pendulum_agrees_with_an_independent_integrator():
    y, h = np.array([1.0, 0.0]), 1e-3

    def f(y):
        return np.array([y[1], -np.sin(y[0]) - 0.1 * y[1]])

    for _ in range(4000):  # classical Runge-Kutta method, error about 1e-13
        k1 = f(y)
        k2 = f(y + h / 2 * k1)
        k3 = f(y + h / 2 * k2)
        k4 = f(y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    assert fixed_steps(pendulum, pendulum_jacobian, [1.0, 0.0], 128, end=4.0) == pytest.approx(y, abs=1e-10)


def test_order_holds_under_a_command_that_varies_in_time():
    sine = (Sine(amplitude=1.0, frequency=0.3),)
    exact = fixed_steps(riccati, riccati_jacobian, [1.0], 512, end=4.0, commands=sine)
    errors = [
        abs(fixed_steps(riccati, riccati_jacobian, [1.0], n, end=4.0, commands=sine) - exact)[0]
        for n in (16, 32, 64, 128)
    ]
    assert orders(errors) == pytest.approx([5.3] * 3, abs=0.5)


def test_order_holds_under_coefficients_that_vary_in_time():
    knots = np.array([0.0, 4.0]), np.array([[0.0], [3.0]])
    errors = [
        abs(fixed_steps(fading, fading_jacobian, [1.0], n, end=2.0, knots=knots)[0] - np.exp(-1.5))  # c = 3 t/4
        for n in (4, 8, 16, 32)
    ]
    assert orders(errors) == pytest.approx([5.3] * 3, abs=0.4)


def test_order_stays_three_or_more_on_the_stiff_prothero_robinson_problem():
    # y' = -1e4 (y - sin) + cos: where most Rosenbrock methods fall to order 1 (Steinebach 2023)
    def derivative(y, u, c, out):
        out[0] = -1e4 * (y[0] - u[0]) + u[1]

    def jacobian(y, u, c, out):
        out[0, 0] = -1e4

    sine = (Sine(amplitude=1.0, frequency=0.3),)
    errors = [
        abs(fixed_steps(derivative, jacobian, [0.0], n, end=1.0, commands=sine)[0] - np.sin(0.6 * np.pi))
        for n in (4, 8, 16, 32)
    ]
    assert np.all(orders(errors) > 2.9)
    assert errors[0] < 1e-6


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8, 1e12])
def test_one_step_damps_a_stiff_mode_in_proportion_to_its_stiffness(stiffness):
    derivative, jacobian = lag(1.0 / stiffness)
    (y,) = fixed_steps(derivative, jacobian, [1.0], 1, end=1.0)
    assert 0.0 < abs(y) * stiffness < 20.0  # L-stable: the share left falls as 1/(h lambda)


@given(st.floats(1e-2, 1e6))
def test_no_step_amplifies_an_undamped_oscillation(angle):
    end = fixed_steps(*oscillator(angle), [1.0, 0.0], 1, end=1.0)
    assert np.hypot(*end) < 1.0 + 1e-9  # A-stable on the imaginary axis


@given(st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6))
def test_step_on_a_linear_problem_solves_its_taylor_series_to_fifth_order(entries):
    # dense 2x2 system with a forcing: exact solution by the matrix exponential
    from scipy.linalg import expm

    M = np.array(entries[:4]).reshape(2, 2)
    force = np.array(entries[4:])

    def derivative(y, u, c, out):
        out[:] = M @ y + force

    def jacobian(y, u, c, out):
        out[:] = M

    big = np.zeros((3, 3))
    big[:2, :2], big[:2, 2] = M, force
    exact = (expm(big * 0.05) @ [1.0, -1.0, 1.0])[:2]
    assert fixed_steps(derivative, jacobian, [1.0, -1.0], 1, end=0.05) == pytest.approx(exact, abs=2e-5)
    assert fixed_steps(derivative, jacobian, [1.0, -1.0], 8, end=0.05) == pytest.approx(exact, abs=2e-5 / 8**5 * 4)


# ---------------------------------------------------------------- error control


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-7])
def test_error_stays_near_the_tolerance_within_a_budget_of_calls(rtol):
    exact = fixed_steps(pendulum, pendulum_jacobian, [1.0, 0.0], 512, end=10.0)
    run = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=10.0, rtol=rtol, atol=rtol)
    assert run.status == DONE
    assert np.abs(run.y - exact).max() < 10 * rtol
    assert run.calls < 60 * rtol**-0.2 * 10  # 10 calls a step, order 5


def test_error_falls_with_the_tolerance():
    exact = fixed_steps(pendulum, pendulum_jacobian, [1.0, 0.0], 512, end=10.0)
    loose, tight = (
        np.abs(Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=10.0, rtol=r, atol=r).y - exact).max()
        for r in (1e-4, 1e-8)
    )
    assert tight < 1e-3 * loose


def test_step_that_is_too_long_at_first_is_rejected_and_made_shorter():
    run = Run(*lag(1e-2), [1.0], end=0.1, step=0.1, rtol=1e-8, atol=1e-10)
    assert run.count[1] > 0
    assert run.y[0] == pytest.approx(np.exp(-10.0), abs=1e-9)


def test_stiff_lag_needs_few_steps_once_it_has_settled():
    run = Run(*lag(1e-7), [1.0], end=10.0, commands=(Constant(value=2.0),))
    assert run.y[0] == pytest.approx(2.0, rel=1e-6)
    assert run.count.sum() < 100


# ---------------------------------------------------------------- breaks


def test_a_step_that_a_break_has_shortened_says_nothing_of_longer_ones():
    """Grown by its own small error, the step after every corner of a table was tried too long, and failed."""
    times = np.arange(41) * 1e-3
    zigzag = Table(times=tuple(times), values=tuple(np.where(np.arange(41) % 2, 1.0, -1.0)))
    run = Run(*lag(8e-4), [-1.0], commands=[zigzag], end=0.04, rtol=1e-3, atol=1e-5)
    assert run.status == DONE and run.count[0] == pytest.approx(80, abs=5) and run.count[1] < 5


def test_jump_of_a_command_is_not_stepped_over():
    # a 1 ms pulse in ten seconds of rest, into a lag of 20 ms: style.md section 5.2, true peak 0.0488
    pulse = (Pulse(height=1.0, width=1e-3, time=5.0),)
    run = Run(*lag(20e-3), [0.0], commands=pulse, end=10.0, t_out=[5.0, 5.001, 5.021])
    peak = 1 - np.exp(-1e-3 / 20e-3)
    assert run.out[:, 0] == pytest.approx([0.0, peak, peak * np.exp(-1.0)], abs=1e-6)
    assert peak == pytest.approx(0.0488, abs=5e-5)


@pytest.mark.parametrize("jump", [1e-9, 0.3, 0.5, 1 - 1e-9])
def test_step_of_a_command_acts_from_its_time_on(jump):
    commands = (Step(before=1.0, after=3.0, time=jump),)
    run = Run(lambda y, u, c, out: out.fill(u[0]), lambda y, u, c, out: out.fill(0.0), [0.0], commands=commands)
    assert run.y[0] == pytest.approx(jump + 3 * (1 - jump), rel=1e-12)


def test_kink_of_a_ramp_is_met():
    commands = (Ramp(start_value=0.0, end_value=1.0, rate=10.0, time=0.25),)
    run = Run(lambda y, u, c, out: out.fill(u[0]), lambda y, u, c, out: out.fill(0.0), [0.0], commands=commands)
    assert run.y[0] == pytest.approx(0.05 + 0.65, rel=1e-12)


def test_rate_of_the_command_is_its_second_input():
    sine = (Sine(amplitude=2.0, frequency=1.0), Constant(value=7.0))
    seen = []

    def derivative(y, u, c, out):
        seen.append((u[0], u[1], u[2]))
        out[0] = u[1]

    run = Run(derivative, lambda y, u, c, out: out.fill(0.0), [0.0], commands=sine, end=0.25, rtol=1e-9)
    assert run.y[0] == pytest.approx(2.0, rel=1e-8)  # the rate integrates to the sine at a quarter turn
    for value, rate, pressure in seen:  # also 1e-6 s along the tangent, by `elimination.plain_problem`
        assert value**2 + (rate / (2 * np.pi)) ** 2 == pytest.approx(4.0, rel=1e-10)
        assert pressure == 7.0


def test_jump_of_coefficients_is_not_stepped_over():
    knots = np.array([0.0, 0.5, 0.5, 0.501, 0.501, 1.0]), np.array([[0.0], [0.0], [100.0], [100.0], [0.0], [0.0]])
    run = Run(fading, fading_jacobian, [1.0], knots=knots, step=0.3, rtol=1e-8, atol=1e-10)
    assert run.y[0] == pytest.approx(np.exp(-0.1), rel=1e-7)


def test_coefficients_are_straight_between_their_knots():
    knots = np.array([0.0, 0.3, 1.0]), np.array([[1.0], [2.0], [0.5]])
    run = Run(fading, fading_jacobian, [1.0], knots=knots, rtol=1e-9, atol=1e-12)
    assert run.y[0] == pytest.approx(np.exp(-(0.3 * 1.5 + 0.7 * 1.25)), rel=1e-7)


def test_single_knot_holds_its_coefficients():
    run = Run(fading, fading_jacobian, [1.0], knots=(np.array([0.0]), np.array([[2.0]])), rtol=1e-9, atol=1e-12)
    assert run.y[0] == pytest.approx(np.exp(-2.0), rel=1e-8)


def test_run_in_slices_goes_on_as_the_whole():
    t_out = np.linspace(0.0, 4.0, 41)
    knots = np.array([0.0, 2.5, 2.5, 4.0]), np.array([[0.1], [0.2], [0.0], [0.3]])
    commands = (Sum((Step(before=0.3, after=-0.2, time=1.5), Pulse(height=0.5, width=0.2, time=2.0))),)

    def derivative(y, u, c, out):
        out[0], out[1] = y[1], -np.sin(y[0]) - c[0] * y[1] + u[0]

    def jacobian(y, u, c, out):
        out[:] = [[0.0, 1.0], [-np.cos(y[0]), -c[0]]]

    options = dict(commands=commands, knots=knots, end=4.0, t_out=t_out, rtol=1e-9, atol=1e-11)
    whole = Run(derivative, jacobian, [1.0, 0.0], **options)
    parts = Run(derivative, jacobian, [1.0, 0.0], slices=(0.1, 1.5, 1.7, 2.5, 3.95), **options)
    assert parts.status == DONE and parts.clock[0] == 4.0 and parts.clock[2] == 41
    assert parts.out == pytest.approx(whole.out, abs=1e-7)
    assert np.all(np.isfinite(parts.out))


# ---------------------------------------------------------------- output


def test_output_begins_at_the_start_and_ends_at_the_end():
    run = Run(pendulum, pendulum_jacobian, [1.0, 0.5], t_out=[0.0, 1.0])
    assert run.out[0].tolist() == [1.0, 0.5]
    assert run.out[1] == pytest.approx(run.y, rel=1e-12)


def test_output_within_a_step_is_as_good_as_the_step():
    t_out = np.linspace(0.0, 4.0, 400)
    exact = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=4.0, t_out=t_out, rtol=1e-12, atol=1e-13).out
    run = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=4.0, t_out=t_out, rtol=1e-6, atol=1e-6)
    assert run.count[0] < 40  # ten output times a step: most lie within
    assert np.abs(run.out - exact).max() < 1e-5


def test_output_error_falls_with_the_fifth_power_of_the_step():
    # order 4 at a fixed share of a step: local error of order 5
    def worst(n):
        t_out = (np.arange(10) + 0.5) / 10 * (1.0 / n)  # within the first step
        run = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=1.0, breaks=np.arange(n) / n, t_out=t_out, rtol=1e30,
                  atol=1e30, step=10.0)  # fmt: skip
        exact = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=1.0, t_out=t_out, rtol=1e-13, atol=1e-14).out
        return np.abs(run.out - exact).max()

    assert orders([worst(n) for n in (2, 4, 8)]) == pytest.approx([5.0, 5.0], abs=0.6)


def test_output_is_continuous_across_steps():
    n = 8
    edges = np.arange(1, n) / n
    t_out = np.sort(np.concatenate([edges - 1e-9, edges + 1e-9]))
    run = Run(pendulum, pendulum_jacobian, [1.0, 0.0], breaks=np.arange(n) / n, t_out=t_out, rtol=1e30, atol=1e30,
              step=10.0)  # fmt: skip
    assert run.count[0] == n
    assert run.out[0::2] == pytest.approx(run.out[1::2], abs=1e-8)


# ---------------------------------------------------------------- statuses


def test_too_many_steps_stop_the_run_where_it_stands():
    run = Run(pendulum, pendulum_jacobian, [1.0, 0.0], end=100.0, max_steps=5, rtol=1e-8)
    assert run.status == TOO_MANY_STEPS
    assert run.count.sum() == 5
    assert 0.0 < run.clock[0] < 100.0
    assert np.all(np.isfinite(run.y))


def test_solution_that_blows_up_stops_with_too_small_steps():
    def derivative(y, u, c, out):
        out[0] = y[0] ** 2  # y = 1/(1 - t)

    def jacobian(y, u, c, out):
        out[0, 0] = 2 * y[0]

    run = Run(derivative, jacobian, [1.0], end=2.0)
    assert run.status == STEP_TOO_SMALL
    assert run.clock[0] == pytest.approx(1.0, abs=1e-3)
    assert np.isfinite(run.y[0])


def test_jacobian_that_is_not_finite_stops_with_too_small_steps():
    run = Run(lambda y, u, c, out: out.fill(1.0), lambda y, u, c, out: out.fill(np.inf), [0.0])
    assert run.status == STEP_TOO_SMALL
    assert run.clock[0] == 0.0 and run.y[0] == 0.0


@pytest.mark.parametrize("bad", [0, 1], ids=["first state", "last state"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_derivative_that_is_not_finite_never_gets_into_the_solution(bad, value):
    def derivative(y, u, c, out):
        out[1 - bad] = 1.0
        out[bad] = value if y[1 - bad] > 0.5 else 0.0

    with np.errstate(invalid="ignore"):  # 0 inf: of no concern to compiled code
        run = Run(derivative, lambda y, u, c, out: out.fill(0.0), [0.0, 0.0], t_out=np.linspace(0, 1, 11), step=0.1)
    assert run.status == STEP_TOO_SMALL
    assert run.clock[0] == pytest.approx(0.5, abs=1e-6)
    assert np.all(np.isfinite(run.y))
    assert np.all(np.isfinite(run.out[: int(run.clock[2])]))
