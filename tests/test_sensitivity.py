"""Linear answers along a course: exact for linear equations, and the limit of what true runs do."""

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from test_prediction import FRICTION, HYSTERESIS, UNIVERSE, bench_of, course_of, nominal_variant, small_session

from valvesim.errors import SolveError
from valvesim.identification import linearised_record, tangent_linear
from valvesim.identification.between_samples import InputShift, Wave
from valvesim.identification.candidates import Candidate
from valvesim.identification.linearised_record import linearise_record
from valvesim.identification.options import DEFAULT_IDENTIFICATION as IDENTIFICATION
from valvesim.identification.predictor import (
    MEASURED_SIGNALS,
    ModelVariant,
    at_rest_together,
    coefficient_course,
    prepare_record,
)
from valvesim.identification.tangent_linear import (
    ChangedCoefficients,
    Course,
    Forcing,
    ScaledForcing,
    TangentLinear,
    first_order_response,
    linearise_along,
    memory_response,
    propagators_of,
    relaxation_recursion,
    sampled_at,
)
from valvesim.solver import linear_response
from valvesim.solver.partial_derivatives import CoefficientCourse, compile_derivatives
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import Model
from valvesim.valve.laws import lagged
from valvesim.valve.thermal_network import ThermalNetwork

LAG = CATALOGUE["eddy_current_lag"](share=0.3, time_constant=2e-4)
STEP = 1e-3
SYSTEMS = {
    "soft": np.array([[0.0, 1.0, 0.0], [-400.0, -3.0, 5.0], [1.0, 0.0, -2.0]]),
    "stiff": np.array([[0.0, 1.0, 2e6], [-400.0, -3.0, 5e3], [0.5, 0.0, -1e6]]),
    "springy": np.array([[0.0, 1e4, 0.0], [-1e4, -20.0, 1.0], [0.0, 0.0, -5.0]]),
}


def system(A, count=80):
    """A linear system whose matrix stays."""
    n = len(A)
    matrices = np.ascontiguousarray(np.broadcast_to(A, (count, n, n)))
    slopes = {"first": np.tile([2.0, 0.0, 0.0], (count, 1)), "sum": np.ones((count, n))}
    steps = np.full(count - 1, STEP)
    return TangentLinear(np.arange(n), np.ones(n), matrices, *propagators_of(matrices, steps), slopes, steps)


def exact(A, g):
    """Answers (n, s) to a forcing (n, s) that is straight over each step, by the matrix exponential of both."""
    s = len(A)
    d = np.empty_like(g)
    d[0] = -np.linalg.solve(A, g[0]) if g[0].any() else 0.0
    whole = np.zeros((3 * s, 3 * s))  # d, g, g'
    whole[:s, :s], whole[:s, s : 2 * s], whole[s : 2 * s, 2 * s :] = A, np.eye(s), np.eye(s)
    over = expm(whole * STEP)
    for k in range(len(g) - 1):
        d[k + 1] = (over @ np.concatenate([d[k], g[k], (g[k + 1] - g[k]) / STEP]))[:s]
    return d


@pytest.mark.parametrize("A", SYSTEMS.values(), ids=SYSTEMS)
def test_a_linear_system_is_solved_exactly_however_stiff(A):
    g = np.cumsum(np.random.default_rng(0).normal(size=(80, 3, 2)), axis=0)
    answers = system(A).response(g)
    assert answers.shape == g.shape
    for k in range(2):
        expected = exact(A, g[:, :, k])
        assert np.abs(answers[:, :, k] - expected).max(axis=0) == pytest.approx(0.0, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("A", SYSTEMS.values(), ids=SYSTEMS)
def test_an_answer_starts_at_rest_and_stays_there_while_nothing_changes(A):
    g = np.tile(np.array([1.0, -2.0, 3.0])[:, None], (80, 1, 1))
    rest = -np.linalg.solve(A, g[0])
    answers = system(A).response(g)
    assert answers == pytest.approx(np.broadcast_to(rest, answers.shape), rel=1e-6, abs=1e-9 * np.abs(rest).max())


def test_a_memory_that_rests_does_no_harm():
    """Its row is zero, so that nothing can be divided by the matrix: it adds up what is forced on it."""
    A = np.array([[-50.0, 3.0, 7.0], [0.0, -2e5, 1.0], [0.0, 0.0, 0.0]])
    g = np.cumsum(np.random.default_rng(5).normal(size=(80, 3, 1)), axis=0)
    g[0] = 0.0
    answers, expected = system(A).response(g)[:, :, 0], exact(A, g[:, :, 0])
    held = np.concatenate([[0.0], np.cumsum((g[1:, 2, 0] + g[:-1, 2, 0]) / 2.0 * STEP)])
    assert answers[:, 2] == pytest.approx(held, abs=1e-12)
    assert np.abs(answers - expected).max(axis=0) == pytest.approx(0.0, abs=1e-7 * np.abs(expected).max())


def test_an_answer_that_grows_without_end_is_none_and_the_others_stay():
    A = np.diag([800.0 / (79 * STEP), -50.0, -5.0])  # to e^800: beyond all numbers
    g = np.zeros((80, 3, 3))
    g[1:, 0, 0] = g[1:, 1, 1] = g[1:, 2, 2] = 1.0
    answers = system(A).response(g)
    assert np.isfinite(answers).all() and not answers[:, :, 0].any()
    tame = np.diag([-1.0, -50.0, -5.0])
    assert answers[:, :, 1:] == pytest.approx(np.stack([exact(tame, g[:, :, k]) for k in (1, 2)], axis=2))


def test_answers_add_up():
    tangent, rng = system(SYSTEMS["soft"]), np.random.default_rng(1)
    f, g = rng.normal(size=(2, 80, 3, 1))
    assert tangent.response(f - 3.0 * g) == pytest.approx(tangent.response(f) - 3.0 * tangent.response(g), abs=1e-12)


def test_compiled_and_plain_march_are_the_same():
    tangent, g = system(SYSTEMS["springy"]), np.random.default_rng(3).normal(size=(80, 3, 2))
    plain = np.zeros_like(g)
    plain[0] = -np.linalg.solve(tangent.A[0], g[0])
    linear_response.propagate(tangent.E, tangent.early, tangent.late, g, plain)
    assert tangent.response(g) == pytest.approx(plain, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("A", SYSTEMS.values(), ids=SYSTEMS)
def test_compiled_and_plain_propagators_are_the_same(A):
    matrices = np.random.default_rng(6).uniform(0.5, 1.5, (11, 1, 1)) * A
    plain, steps = [np.empty((10, 3, 3)) for _ in range(3)], STEP * np.random.default_rng(7).uniform(0.1, 1.0, 10)
    linear_response.propagators(linear_response.product, matrices, steps, *plain)
    for own, expected in zip(propagators_of(matrices, steps), plain, strict=True):
        assert own == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())


def forcings_of(g, direct):
    """The columns of a forcing (n, s, k) and of what it adds to channels (n, k) by name, each from its first point on.
    """
    return [Forcing(0, g[:, :, k], {name: part[:, k] for name, part in direct.items()}) for k in range(g.shape[2])]


@pytest.mark.parametrize("count", [1, 8, 11])
def test_answers_as_they_are_read_are_those_of_the_states_on_the_grid(count):
    """With a lag and late clocks, by the lag's own law and straight cubics; more answers than lanes, and fewer."""
    tangent, rng = system(SYSTEMS["soft"]), np.random.default_rng(7)
    g = np.cumsum(rng.normal(size=(80, 3, count)), axis=0)
    direct = {"sum": np.cumsum(rng.normal(size=(80, count)), axis=0)}
    times, at = STEP * np.arange(80), STEP * np.linspace(0.3, 78.9, 40)
    reads = {"sum": sampled_at(times, at, 3e-3), "first": sampled_at(times, times)}
    found = tangent.read_responses(reads, forcings_of(g, direct))
    states = tangent.response(g)
    assert found["first"] == pytest.approx(2.0 * states[:, 0], rel=1e-9, abs=1e-9)
    late = lagged(times, states.sum(axis=1) + direct["sum"], 3e-3)
    weights = reads["sum"].weights
    expected = sum(weights[:, j, None] * late[reads["sum"].first + j] for j in range(4))
    assert found["sum"] == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_compiled_and_plain_responses_are_the_same(monkeypatch):
    """Changes of coefficients between knots, in blocks of other coefficients each, beside forcings and a lag."""
    model, rng = Model(), np.random.default_rng(9)
    compiled = compile_derivatives(model, MEASURED_SIGNALS)
    n, coefficients = 20, len(model.coefficient_names)
    moved = rng.choice(coefficients, 11)
    changes = np.zeros((3, coefficients, 11))
    changes[:, moved, np.arange(11)] = rng.normal(size=(3, 11))
    course = CoefficientCourse(np.zeros((3, coefficients)), np.repeat([0, 1], 10), rng.uniform(0.0, 1.0, n))
    changed = ChangedCoefficients(changes, course, compiled, rng.normal(size=(len(compiled.targets), n)))
    matrices = rng.normal(size=(n, 6, 6)) - 5.0 * np.eye(6)
    slopes = {"load_flow": rng.normal(size=(n, 6)), "spool_position": rng.normal(size=(n, 6))}
    steps = 0.01 * rng.uniform(0.5, 1.5, n - 1)
    tangent = TangentLinear(np.arange(6), np.full(6, 2.0), matrices, *propagators_of(matrices, steps), slopes, steps)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    reads = {"load_flow": sampled_at(times, times, 0.02), "spool_position": sampled_at(times, times[2:15] + 0.004)}
    forcings = [Forcing(5, rng.normal(size=(9, 6)), {"load_flow": rng.normal(size=9)})]
    scaled = ScaledForcing(Forcing(0, rng.normal(size=(n, 6)), {}), rng.normal(size=(n, 3)))
    found = tangent.read_responses(reads, forcings, changed, scaled)
    functions = [getattr(linear_response, name) for name in linear_response.CALLED_IN_A_BLOCK]
    in_python = SimpleNamespace(read_responses=functools.partial(linear_response.read_responses, *functions))
    monkeypatch.setattr(tangent_linear, "compile_response", lambda states: in_python)
    for name, plain in tangent.read_responses(reads, forcings, changed, scaled).items():
        assert found[name] == pytest.approx(plain, rel=1e-9, abs=1e-9 * np.abs(plain).max()), name
        assert plain.any(axis=0).sum() > 8  # some coefficients are of another drive


def test_a_cubic_is_read_exactly_at_any_time():
    times, at = STEP * np.delete(np.arange(12.0), [3, 4, 7]), STEP * np.array([0.0, 0.4, 1.0, 5.5, 10.2, 11.0])
    first, weights, _ = sampled_at(times, at)
    cubic = np.polynomial.Polynomial([1.0, 200.0, -3e4, 4e6])
    assert [w @ cubic(times[k : k + 4]) for k, w in zip(first, weights, strict=True)] == pytest.approx(cubic(at))


def test_a_forcing_that_begins_late_answers_as_one_of_zeros_before():
    tangent, g = system(SYSTEMS["soft"]), np.random.default_rng(8).normal(size=(20, 3))
    whole = np.zeros((80, 3))
    whole[31:51] = g
    direct = np.concatenate([np.zeros(31), np.arange(20.0), np.zeros(29)])
    reads = {"sum": sampled_at(STEP * np.arange(80), STEP * np.arange(80))}
    forcings = [Forcing(31, g, {"sum": np.arange(20.0)}), Forcing(0, whole, {"sum": direct})]
    found = tangent.read_responses(reads, forcings)["sum"]
    assert found[:, 0] == pytest.approx(found[:, 1], rel=1e-12)
    assert found[40:, 0].any() and np.abs(found[:31]).max() < 1e-12


@pytest.mark.parametrize("count", [1, 8, 11])
def test_a_scaled_forcing_answers_as_each_share_of_it_by_itself(count):
    """Beside two other forcings, which leave lanes over."""
    tangent, rng = system(SYSTEMS["soft"]), np.random.default_rng(count)
    times = STEP * np.arange(80)
    reads = {"sum": sampled_at(times, times, 3e-3), "first": sampled_at(times, times[5:] - 0.3 * STEP)}
    whole = Forcing(0, rng.normal(size=(80, 3)), {"sum": rng.normal(size=80)})
    shares, others = rng.normal(size=(80, count)), forcings_of(rng.normal(size=(80, 3, 2)), {})
    found = tangent.read_responses(reads, others, scaled=ScaledForcing(whole, shares))
    each = [Forcing(0, whole.rates * own[:, None], {"sum": whole.direct["sum"] * own}) for own in shares.T]
    for name, expected in tangent.read_responses(reads, [*others, *each]).items():
        assert found[name] == pytest.approx(expected, rel=1e-9, abs=1e-12), name
        assert found[name].shape == (len(reads[name].first), 2 + count) and expected.any(axis=0).all()


def test_an_answer_that_is_read_and_grows_without_end_is_none():
    A = np.diag([800.0 / (79 * STEP), -50.0, -5.0])
    g = np.zeros((80, 3, 2))
    g[1:, 0, 0] = g[1:, 1, 1] = 1.0
    times = STEP * np.arange(80)
    found = system(A).read_responses({"sum": sampled_at(times, times)}, forcings_of(g, {}))
    assert not found["sum"][:, 0].any() and found["sum"][:, 1].any()


# ---------------------------------------------------------------- memories


def test_a_memory_of_constant_figures_relaxes_as_the_exponential():
    a, b = np.full(50, 6.0), np.full(50, 2.0)
    assert first_order_response(a, b, 0.1) == pytest.approx(3.0)  # at rest it stays
    a[1:] = 10.0
    assert first_order_response(a, b, 0.1) == pytest.approx(5.0 - 2.0 * np.exp(-0.2 * np.arange(50)))


def test_a_memory_is_exact_for_figures_that_change_from_step_to_step():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=30), 10.0 ** rng.uniform(-2.0, 6.0, size=30)
    expected = [a[0] / b[0]]
    for rate, decay in zip(a[1:], b[1:], strict=True):
        goal = rate / decay
        expected.append(goal + (expected[-1] - goal) * np.exp(-decay * STEP))
    assert first_order_response(a, b, STEP) == pytest.approx(np.array(expected), rel=1e-9)


def test_memories_of_each_other_answer_as_their_equations_do():
    """A current loop of second order, from rest; an oracle by small steps, and one by one where none is of another."""
    tau, zeta, step = 2e-3, 0.3, np.full(60, 5e-4)
    B = np.broadcast_to(np.array([[0.0, -1.0], [1.0, 2.0 * zeta]]) / tau, (61, 2, 2))
    a = np.zeros((61, 2))
    a[:, 1] = np.where(np.arange(61) < 20, 1.0, -2.0) / tau
    z, parts = np.array([1.0, 0.0]), 400
    expected = [z]
    for k in range(60):
        for _ in range(parts):
            z = z + step[k] / parts * (a[k + 1] - B[k] @ z)
        expected.append(z)
    assert memory_response(a, B, step) == pytest.approx(np.array(expected), abs=5e-3)
    alone = np.stack([np.diag([3.0, 700.0])] * 61)
    found = memory_response(a + 1.0, alone, step)
    for k in range(2):
        assert np.array_equal(found[:, k], first_order_response(a[:, k] + 1.0, alone[:, k, k], step))


def test_a_memory_that_does_not_decay_adds_up():
    summed = [0.0, 0.5, -0.5, 1.0]
    assert first_order_response(np.array([5.0, 1.0, -2.0, 3.0]), np.zeros(4), 0.5) == pytest.approx(summed)
    assert first_order_response(np.array([0.0, 1.0, -2.0, 3.0]), np.full(4, 1e-10), 0.5) == pytest.approx(
        summed, rel=1e-6
    )


def test_relaxing_leaves_its_arguments_alone():
    a, b = np.arange(5.0), np.ones(5)
    first_order_response(a, b, 0.1)
    assert np.array_equal(a, np.arange(5.0)) and np.array_equal(b, np.ones(5))
    z = np.array([1.0, 0.0, 0.0])
    relaxation_recursion(np.array([2.0, 4.0]), np.array([0.5, 0.25]), np.array([1.0, 0.5]), z)
    assert z == pytest.approx([1.0, 2.5, 2.625])


# ---------------------------------------------------------------- along a valve's course


def linear(name="fast"):
    return linearise_record(bench_of(name), nominal_variant())


def moved_valve(**shares):
    valve = nominal_variant().valve
    return ModelVariant(
        replace(valve, **{name: getattr(valve, name) * (1.0 + share) for name, share in shares.items()})
    )


def central(name, high, low):
    """Half the difference of two true runs, by channel."""
    predictor = bench_of(name)
    up, down = (predictor.readings(predictor.run(variant), variant) for variant in (high, low))
    return {channel: (up[channel] - down[channel]) / 2.0 for channel in up}


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_networks_and_oil_beside_a_late_temperature_answer_as_true_runs_do():
    """On the knots that are known; what no run shows, for its knots err by more, they hardly show either."""
    session, record = small_session(), bench_of("slow").record
    warming = {**record.values, "oil_temperature": 40.0 + 30.0 * record.time}
    exact = replace(IDENTIFICATION, predictor=replace(IDENTIFICATION.predictor, tolerance=1e-8))
    predictor = prepare_record(session, replace(record, values=warming), UNIVERSE, options=exact)
    late = CATALOGUE["thermal_lag"](time_constant=0.1)
    about = replace(nominal_variant(), network=ThermalNetwork()).with_effect(late)
    seen = linearise_record(predictor, about)
    assert predictor.has_own_knots(about) and len(seen.trajectory.path.times) > 1

    def moved(by):
        networks = [replace(about, network=replace(about.network, **{name: getattr(about.network, name) * (1.0 + by)}))
                    for name in ("oil_to_pilot_metal", "spool_capacity", "oil_to_sleeve")]  # fmt: skip
        return [*networks, replace(about, deviations=((InputShift(record.name, "oil_temperature"), 10.0 * by),))]

    little, up, down = moved(1e-3), moved(0.2), moved(-0.2)
    assert set(seen._changes_by_temperature(little)) == set(range(len(little)))
    answers, shown = seen.small_difference(little), 0
    for k, (high, low) in enumerate(zip(up[:3], down[:3], strict=True)):
        above, below = (predictor.readings(predictor.run(variant), variant) for variant in (high, low))
        for channel, read in seen.readings.items():
            truth = (above[channel] - below[channel]) / 400.0
            sure = 1e-7 * rms(read)  # by as much may a run's knots err
            shown += rms(truth) > sure
            assert rms(answers[channel][:, k] - truth) < 0.05 * rms(truth) + 0.02 * sure, (k, channel)
    assert shown >= 3
    sought = seen.linear_difference(little[3:])  # a grid as coarse as this errs by more of the oil: as on other knots
    for channel, (column,) in zip(sought, (each.T for each in sought.values()), strict=True):
        assert rms(answers[channel][:, 3] - column) < 0.03 * rms(column) + 1e-8 * rms(seen.readings[channel]), channel


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_answers_to_parameters_are_the_central_differences_of_true_runs(name):
    parameters = ("feedback_rod_stiffness", "null_gap", "polarization_mmf", "spool_area", "port_width", "null_opening")
    share = 2e-3
    answers = linear(name).linear_difference([moved_valve(**{p: share}) for p in parameters])
    for k, p in enumerate(parameters):
        truth = central(name, moved_valve(**{p: share}), moved_valve(**{p: -share}))
        sizes = {channel: rms(values) / np.ptp(seen_readings(name)[channel]) for channel, values in truth.items()}
        assert max(sizes.values()) > 1e-5, p
        for channel, size in sizes.items():
            if size > 1e-5:  # what the integrator's own errors do not drown
                assert rms(answers[channel][:, k] - truth[channel]) < 0.03 * rms(truth[channel]), (p, channel)


def seen_readings(name):
    return bench_of(name).readings(course_of(name, nominal_variant()), nominal_variant())


def test_answers_to_an_effect_on_coefficients_are_the_differences_of_true_runs():
    sides = [CATALOGUE["null_gap_asymmetry"](difference=d) for d in (2e-8, -2e-8)]
    truth = central("fast", *(nominal_variant().with_effect(side) for side in sides))
    answer = linear().linear_difference([nominal_variant().with_effect(sides[0])])
    for channel in ("spool_position", "armature_angle", "nozzle_pressure_1", "load_flow"):
        assert rms(answer[channel][:, 0] - truth[channel]) < 0.03 * rms(truth[channel]), channel


def test_answers_are_proportional_to_a_small_change():
    answers = linear().linear_difference([moved_valve(spool_area=1e-4), moved_valve(spool_area=2e-4)])
    for channel, columns in answers.items():
        assert columns[:, 1] == pytest.approx(2.0 * columns[:, 0], abs=2e-3 * np.abs(columns).max()), channel


def test_an_effect_that_does_nothing_adds_nothing():
    """To the last digit: which balance it acts in is not asked of rounding."""
    still = CATALOGUE["spool_coulomb_friction"](friction_force=0.0)
    forcing = linear().forcing(nominal_variant().with_effect(still))
    assert not forcing.rates.any() and not any(np.any(part) for part in forcing.direct.values())


def test_no_change_has_no_answer():
    for channel, columns in linear().linear_difference([nominal_variant()]).items():
        assert not columns.any(), channel


def test_the_equations_hold_the_states_of_the_variant_alone():
    predictor, plain = bench_of("fast"), linear().tangent
    assert plain.active.tolist() == [0, 1, 2, 3, 4, 5] and plain.A.shape == (len(linear().course.times), 6, 6)
    variant = nominal_variant().with_effect(FRICTION)
    trajectory = course_of("fast", variant)
    _, own = predictor.reduced(trajectory.model, variant)
    compiled = compile_derivatives(trajectory.model, MEASURED_SIGNALS)
    course = coefficient_course(trajectory.path, trajectory.knots, predictor.times)
    partials = compiled.derivatives(trajectory.states, predictor.inputs, course)
    points = Course(predictor.times, predictor.inputs, trajectory.states, predictor.times, np.arange(0))
    tangent = linearise_along(predictor, trajectory, points, own, compiled, partials)
    assert tangent.active.tolist() == [0, 1, 2, 3, 4, 5, 6] and tangent.E.shape == (len(predictor.times) - 1, 7, 7)


def test_slopes_of_channels_are_those_over_the_states():
    tangent = linear().tangent
    spool = tangent.slopes["spool_position"]
    assert np.array_equal(spool, np.tile(tangent.scale * (np.arange(6) == 4), (len(spool), 1)))
    flow = tangent.slopes["load_flow"]
    assert (flow[:, 4] > 0.0).all()  # the spool opens supply to port A
    assert np.abs(flow[:, [0, 1, 2, 3, 5]]).max() < 1e-3 * np.abs(flow[:, 4]).max()


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_answers_to_small_changes_are_those_to_their_forcings(name):
    """By derivatives of the equations and by what they add to the rates: to first order the same, in any order."""
    parameters = ("feedback_rod_stiffness", "null_gap", "polarization_mmf", "land_length", "null_opening")
    valves = [moved_valve(**{p: 1e-6}) for p in parameters]
    variants = [nominal_variant().with_effect(CATALOGUE["null_gap_asymmetry"](difference=1e-11)), nominal_variant()]
    moved = {p: np.array([[getattr(one.valve, p)] for one in valves]) for p in parameters}
    changes = linear(name).changes_of_valves(replace(nominal_variant().valve, **moved), len(valves))
    small, finite = linear(name).small_difference(variants, changes), linear(name).linear_difference(valves + variants)
    for channel, columns in small.items():
        assert columns == pytest.approx(finite[channel], rel=1e-4, abs=1e-4 * np.abs(finite[channel]).max()), channel
        assert not columns[:, -1].any()


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_forcings_by_a_situation_that_is_known_are_those_by_the_whole_equations(name):
    """Inputs with nothing added to them ask for these."""
    seen, unchanged = linear(name), np.zeros_like(linear(name).course.inputs)
    effects = [effect for effect in CATALOGUE.values() if effect.balance is not None]
    assert any(effect.memory for effect in effects) and len(effects) > 10
    for effect in effects:
        active = Candidate(effect.name, effect).active(effect.amplitude.typical)
        variant = nominal_variant().with_effect(active)
        known, whole = (seen._forcing_of_effects(variant, [active], added) for added in (None, unchanged))
        assert np.array_equal(known.rates, whole.rates) and known.direct.keys() == whole.direct.keys(), effect.name
        assert all(np.array_equal(known.direct[k], whole.direct[k]) for k in known.direct), effect.name


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_answers_to_small_changes_of_inputs_are_those_to_their_forcings_and_of_true_runs(name):
    record = bench_of(name).record
    changes = [
        (InputShift(record.name, "supply_pressure"), 1e4),
        (InputShift(record.name, "supply_pressure", growing=True), 1e4),
        (InputShift(record.name, record.command), 1e-6),
        (Wave(record.name, record.command, 0.05 * record.rate, 0.4), 1e-6),
        (Wave(record.name, "load_pressure", 0.03 * record.rate, 1.0), 1e4),
        (InputShift(record.name, "oil_temperature"), 1e-3),
        (InputShift("another record", "supply_pressure"), 1e5),
    ]
    up, down, little = (
        [replace(nominal_variant(), deviations=((one, share * by),)) for one, by in changes]
        for share in (1.0, -1.0, 0.01)
    )
    small, forced = (
        {channel: 100.0 * columns for channel, columns in answers.items()}
        for answers in (linear(name).small_difference(little), linear(name).linear_difference(little))
    )
    for k, (high, low) in enumerate(zip(up, down, strict=True)):
        for channel, truth in central(name, high, low).items():
            size = np.abs(forced[channel][:, k]).max()
            assert small[channel][:, k] == pytest.approx(forced[channel][:, k], abs=2e-3 * size), (k, channel)
            seen = rms(truth) > 1e-4 * np.ptp(seen_readings(name)[channel])  # by more than the integrator errs
            if seen and channel not in ("load_flow", "internal_leakage"):  # they bend where lands pass null
                assert rms(small[channel][:, k] - truth) < 0.05 * rms(truth), (k, channel)
        assert small["spool_position"][:, k].any() == (changes[k][0].record == record.name), k


def test_a_run_rests_near_another_where_its_balances_alone_tell():
    """A hysteresis rests where the way from zero current has left it: near another valve it would be off."""
    for effects in ((), (FRICTION,), (HYSTERESIS,)):
        one, other = (replace(moved_valve(null_gap=by), effects=effects) for by in (0.0, 0.02))
        posed, trajectory = bench_of("fast").posed(other), bench_of("fast").run(one)
        assert posed.rests_near(trajectory) == (not effects)
        assert not posed.rests_near(course_of("fast", nominal_variant().with_effect(LAG)))  # of another model
        assert at_rest_together([posed], [trajectory])[0] == pytest.approx(posed.at_rest(), rel=1e-9, abs=1e-12)
        assert posed.at_rest_near(trajectory) == pytest.approx(posed.at_rest(), rel=1e-9, abs=1e-12)


def test_inputs_that_a_trajectory_ran_under_are_not_worked_out_again():
    predictor = bench_of("fast")
    wave = Wave(predictor.record.name, "supply_pressure", 60.0, 0.0)
    some, others = (((wave, by),) for by in (1e5, 2e5))
    trajectory = predictor.run(replace(nominal_variant(), deviations=some))
    assert predictor.under_inputs_of(trajectory, some) is trajectory.under
    for own in (predictor, replace(predictor, options=replace(predictor.options)), predictor.without_oversampling()):
        for deviations in (some, others, ()):
            found, expected = own.under_inputs_of(trajectory, deviations), own.under(deviations)
            assert np.array_equal(found.inputs, expected.inputs) and found.options is own.options
            assert np.array_equal(found.rows, expected.rows) and np.array_equal(found.fine_inputs, expected.fine_inputs)


def test_records_that_rest_together_rest_as_they_do_alone():
    posed = [bench_of(name).posed(moved_valve(spool_area=1e-2).with_effect(FRICTION)) for name in ("fast", "slow")]
    for together, one in zip(at_rest_together(posed), posed, strict=True):
        assert together == pytest.approx(one.at_rest(), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    "active", [pytest.param(FRICTION, id="friction"), pytest.param(HYSTERESIS, id="hysteresis", marks=pytest.mark.slow)]
)
def test_a_valve_with_memory_is_linear_about_its_course_too(active):
    """The record begins with a hold, where a memory of a path rests."""
    variant = nominal_variant().with_effect(active)
    own = linearise_record(bench_of("fast"), variant)
    share = 2e-3
    sides = [replace(moved_valve(feedback_rod_stiffness=by), effects=variant.effects) for by in (share, -share)]
    truth, answer = central("fast", *sides), own.linear_difference(sides[:1])
    for channel in ("spool_position", "load_flow"):
        assert np.isfinite(answer[channel]).all()
        assert rms(answer[channel][:, 0] - truth[channel]) < 0.05 * rms(truth[channel]), channel


# ---------------------------------------------------------------- where the equations change within a step


def staircase(seed):
    """Currents (151,) that jump at random, so far that the flapper touches its nozzles."""
    return np.repeat(np.random.default_rng(seed).uniform(-9e-3, 9e-3, 151), 26)[:151]


@functools.cache
def stepped(current=None):
    """The fast record under a current (a tuple) that jumps so far that the flapper touches a nozzle, and back."""
    session, fast = small_session(), bench_of("fast").record
    given = np.where(np.arange(len(fast.time)) // 25 % 2, 9e-3, -9e-3) if current is None else np.array(current)
    return prepare_record(
        session, replace(fast, values={**fast.values, "current": given}), UNIVERSE, options=IDENTIFICATION
    )


def with_divided(predictor, share):
    sensitivity = replace(IDENTIFICATION.sensitivity, most_divided=share)
    return replace(predictor, options=replace(IDENTIFICATION, sensitivity=sensitivity))


@pytest.mark.parametrize(
    ("current", "most"), [(None, 0.05), *((tuple(staircase(seed)), 0.05 if seed == 0 else 0.3) for seed in range(4))]
)
def test_steps_in_which_a_flapper_touches_are_divided_and_answers_hold_there(current, most):
    """By central differences of true runs: without the divisions the answers err by far more. Where the flapper bounces
    out and back within a step, they err by up to a quarter still.
    """
    plain, up, down = nominal_variant(), moved_valve(null_gap=1e-3), moved_valve(null_gap=-1e-3)
    off = {}
    for share in (0.0, 0.1):
        predictor = with_divided(stepped(current), share)
        seen = linearise_record(predictor, plain)
        assert (seen.course.steps.min() < 0.9 * predictor.times[1]) == (share > 0.0)
        answers = seen.small_difference([], seen.changes_of_valves(up.valve))
        high, low = (predictor.readings(predictor.run(variant), variant) for variant in (up, down))
        off[share] = {
            name: rms(answers[name][:, 0] - (high[name] - low[name]) / 2.0) / rms((high[name] - low[name]) / 2.0)
            for name in ("spool_position", "armature_angle")
        }
    assert max(off[0.1].values()) < most and min(off[0.0].values()) > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_an_inertia_answers_as_true_runs_do(seed):
    """To a command that is new at each sample; by what it adds to the rates, answers err by more than twice as much."""
    plain, up, down = nominal_variant(), moved_valve(armature_inertia=0.02), moved_valve(armature_inertia=-0.02)
    predictor = stepped(tuple(np.random.default_rng(seed).uniform(-3e-3, 3e-3, 151)))
    seen = linearise_record(predictor, plain)
    high, low = (predictor.readings(predictor.run(variant), variant) for variant in (up, down))
    small = seen.small_difference([], seen.changes_of_valves(up.valve))
    forced = seen.forced_response([seen.forcing(up)])
    for name in ("spool_position", "armature_angle"):
        truth = (high[name] - low[name]) / 2.0
        near, far = (rms(answers[name][:, 0] - truth) / rms(truth) for answers in (small, forced))
        assert near < 0.03 and far > 2.0 * near, name


def of_grid(course):
    """The places on the course of the grid's points that it has, and which these are."""
    kept = np.isin(course.grid, course.times)
    return np.searchsorted(course.times, course.grid[kept]), np.flatnonzero(kept)


def test_a_divided_course_holds_the_grid_and_what_a_whole_run_has_between():
    predictor, variant = stepped(), nominal_variant()
    trajectory = predictor.run(variant)
    course = linearise_record(predictor, variant, trajectory).course
    places, kept = of_grid(course)
    assert np.array_equal(course.grid, predictor.times) and (course.steps > 0.0).all()
    assert course.times[course.samples] == pytest.approx(predictor.record.time, abs=1e-12)
    assert np.array_equal(course.states[places], trajectory.states[kept])
    assert np.array_equal(course.inputs[places], predictor.inputs[kept])
    between = np.delete(np.arange(len(course.times)), places)
    finer = replace(IDENTIFICATION.predictor, grid_spacing=6.25e-6, sensor_spacing=6.25e-6, most_points=10**6)
    whole = prepare_record(
        small_session(), predictor.record, UNIVERSE, options=replace(IDENTIFICATION, predictor=finer)
    )
    fine = whole.run(variant).states[np.searchsorted(whole.times, course.times[between] - 1e-9)]
    assert (np.abs(course.states[between] - fine) / np.ptp(trajectory.states, axis=0)).max() < 1e-3


def test_on_the_way_to_a_fit_the_course_is_the_grid():
    seen = linearise_record(stepped().without_oversampling(), nominal_variant())
    assert np.array_equal(seen.course.times, seen.predictor.times)
    assert seen.course.between(seen.predictor.inputs) is seen.predictor.inputs


def test_where_motion_is_smooth_no_step_is_divided_and_every_second_point_left_out():
    """Between samples alone, and not in the intervals in which something moves fast, or just before or after."""
    predictor = bench_of("fast")
    course, every = linearise_record(predictor, nominal_variant()).course, predictor.oversampling
    left_out = np.flatnonzero(~np.isin(course.grid, course.times))
    assert every > 2 and 0.15 * len(course.grid) < len(left_out) == len(course.grid) - len(course.times)
    assert (left_out % every % 2 == 1).all()
    struck = stepped()
    course, trajectory = linearise_record(struck, nominal_variant()).course, struck.run(nominal_variant())
    fast = np.flatnonzero(np.abs(np.diff(trajectory.states[:, 1])) > 0.05 * np.ptp(trajectory.states[:, 1]))
    assert len(fast) > 10 and np.isin(course.grid[[fast, fast + 1]], course.times).all()


def test_no_point_is_left_out_of_a_grid_that_is_coarser_than_asked_for():
    """As that of a long record is: every point counts there."""
    options = replace(IDENTIFICATION, predictor=replace(IDENTIFICATION.predictor, most_points=1200))
    predictor = prepare_record(small_session(), bench_of("fast").record, UNIVERSE, options=options)
    course = linearise_record(predictor, nominal_variant()).course
    assert predictor.oversampling > 2 and predictor.times[1] > 1.1 * options.predictor.grid_spacing
    assert np.isin(course.grid, course.times).all()


def test_of_many_fast_steps_the_fastest_are_divided():
    few = with_divided(stepped(), 0.01)
    course, steps = linearise_record(few, nominal_variant()).course, len(few.times) - 1
    places, kept = of_grid(course)
    contacts = np.diff(places)[np.diff(places) > np.diff(kept)]
    assert 0 < len(contacts) <= 0.01 * steps
    turns = np.diff(of_grid(linearise_record(bench_of("fast"), nominal_variant().with_effect(FRICTION)).course)[0])
    assert contacts.max() == IDENTIFICATION.sensitivity.most_parts > turns.max() > 1  # the faster, the more


def test_a_part_that_cannot_be_integrated_says_so():
    few = replace(stepped(), options=replace(
        IDENTIFICATION, predictor=replace(IDENTIFICATION.predictor, most_steps=1, steps_per_point=0)
    ))  # fmt: skip
    with pytest.raises(SolveError, match="record fast: the simulation failed.*more than 1 steps"):
        linearise_record(few, nominal_variant(), stepped().run(nominal_variant()))


@pytest.mark.parametrize("rate", [730.0, 1000.0, 3000.0, 3400.0, 5000.0, 10_000.0])
def test_at_any_rate_the_course_has_the_samples_and_answers_as_the_whole_grid_does(rate, monkeypatch):
    """Between two samples lie any number of points of the grid, an odd or an even one, or none."""
    record = bench_of("fast").record
    time = np.arange(int(record.time[-1] * rate) + 1) / rate
    values = {name: np.interp(time, record.time, column) for name, column in record.values.items()}
    usable = {name: np.ones(len(time), dtype=bool) for name in record.usable}
    other = replace(record, time=time, values=values, usable=usable)
    predictor = prepare_record(small_session(), other, UNIVERSE, options=IDENTIFICATION)
    variant, moved = nominal_variant(), moved_valve(null_gap=1e-6, feedback_rod_stiffness=1e-6)
    seen = linearise_record(predictor, variant)
    assert seen.course.times[seen.course.samples] == pytest.approx(time, abs=1e-12)
    assert (seen.course.steps > 0.0).all() and seen.course.steps.max() < 2.01 * predictor.times[1]
    fewer = seen.small_difference([], seen.changes_of_valves(moved.valve))
    monkeypatch.setattr(linearised_record, "_smooth_between_samples", lambda *_: np.zeros(len(predictor.times), bool))
    whole = linearise_record(predictor, variant)
    assert len(whole.course.times) >= len(predictor.times)
    for name, columns in whole.small_difference([], whole.changes_of_valves(moved.valve)).items():
        assert rms(fewer[name] - columns) < 0.01 * rms(columns), name
