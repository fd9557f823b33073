"""The thermal network against closed forms of one node, balances of the whole and the time constants of model.md 5."""

import dataclasses
from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from valvesim.errors import InputError
from valvesim.inputs import Constant, Pulse, Ramp, Sine, Step, Table
from valvesim.simulation.scenario import Scenario
from valvesim.units import quantities
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import PART_NAMES
from valvesim.valve.fluid import MIL_PRF_5606
from valvesim.valve.thermal_network import (
    THERMAL_NODES,
    ThermalNetwork,
    _mean_of_exponential,
    _mean_of_ramp,
    temperature_path,
    throttling_rise,
)

NETWORK = ThermalNetwork()
SEALED = ThermalNetwork(torque_motor_to_ambient=0.0, body_to_ambient=0.0)  # nothing lost to the air
LINKS = [name for name in quantities(NETWORK) if "_to_" in name]
LAUNCH = Ramp(start_value=20.0, end_value=270.0, rate=3.0)  # model.md 5: 3 °C/s from 20 to 270 °C


def lone(part):
    """A network in which one part hears the oil alone, and its time constant C/G."""
    network = dataclasses.replace(NETWORK, **{name: 0.0 for name in LINKS if name != f"oil_to_{part}"})
    return network, getattr(NETWORK, f"{part}_capacity") / getattr(NETWORK, f"oil_to_{part}")


def capacities(network):
    return np.array([getattr(network, f"{name}_capacity") for name in THERMAL_NODES])


def values(path):
    """Temperatures of the nodes, (knots, nodes)."""
    return np.column_stack([getattr(path.parts, name) for name in THERMAL_NODES])


def at_the_end(path):
    return {name: float(getattr(path.parts, name)[-1]) for name in PART_NAMES}


@pytest.mark.parametrize("part", ["pilot_metal", "spool", "sleeve", "body", "spring_tube", "feedback_rod"])
@pytest.mark.parametrize("duration", [0.3, 7.0, 80.0])
def test_a_lone_part_trails_a_ramp_by_the_closed_form_of_a_first_order_lag(part, duration):
    network, tau = lone(part)
    path = temperature_path(LAUNCH, duration, network=network)
    end = at_the_end(path)
    lag = 3.0 * tau * (1.0 - np.exp(-duration / tau))  # field.md 2
    assert end["oil"] - end[part] == pytest.approx(lag, rel=1e-10)


@pytest.mark.parametrize("part", ["pilot_metal", "spool", "body"])
def test_a_lone_part_follows_a_step_of_the_oil_exponentially(part):
    network, tau = lone(part)
    path = temperature_path(Step(before=20.0, after=120.0, time=3.0), 3.0 + tau, network=network)
    before = path.times < 3.0
    assert np.ptp(getattr(path.parts, part)[before]) < 1e-9
    assert at_the_end(path)[part] == pytest.approx(20.0 + 100.0 * (1.0 - np.exp(-1.0)), rel=1e-10)


# model.md 5: oil -> pilot metal about 1 s, spool 2-8 s, sleeve 1-20 s, body 12-90 s
@pytest.mark.parametrize(
    "part, low, high", [("pilot_metal", 0.5, 2.0), ("spool", 2.0, 8.0), ("sleeve", 1.0, 20.0), ("body", 12.0, 90.0)]
)
def test_a_part_alone_against_the_oil_takes_the_time_of_its_estimate(part, low, high):
    network, tau = lone(part)
    assert low <= tau <= high
    path = temperature_path(Step(before=0.0, after=1.0, time=0.0), tau, network=network, initial=0.0)
    assert at_the_end(path)[part] == pytest.approx(1.0 - np.exp(-1.0), rel=1e-10)


def test_the_torque_motor_follows_the_body_within_the_time_of_its_estimate():
    # model.md 5: body -> torque motor +10-40 s
    assert 10.0 <= NETWORK.torque_motor_capacity / NETWORK.body_to_torque_motor <= 40.0


def test_in_a_launch_the_spool_leads_the_sleeve_the_sleeve_the_body_and_the_body_the_torque_motor():
    end = at_the_end(temperature_path(LAUNCH, 83.0, network=NETWORK))
    order = ("oil", "pilot_metal", "spool", "sleeve", "body", "torque_motor")
    falling = [end[name] for name in order]
    assert falling == sorted(falling, reverse=True)
    assert 6.0 <= end["oil"] - end["spool"] <= 24.0  # field.md 2: the spool trails by 6-24 K after 83 s
    assert 45.0 <= end["oil"] - end["body"] <= 165.0  # the body by 45-165 K
    assert end["body"] - end["torque_motor"] > 10.0  # the torque motor by more
    assert end["spool"] - end["sleeve"] > 10.0  # so the spool leads the sleeve by tens of K


def test_without_loss_to_the_air_every_part_ends_at_the_oil():
    path = temperature_path(Constant(value=150.0), 2000.0, network=SEALED, initial=20.0, ambient=-50.0, spacing=50.0)
    assert values(path)[-1] == pytest.approx(np.full(len(THERMAL_NODES), 150.0), rel=1e-9)


def test_with_loss_to_the_air_the_steady_temperatures_balance_every_part():
    path = temperature_path(Constant(value=150.0), 2000.0, network=NETWORK, ambient=20.0, spacing=50.0)
    T = dict(zip(THERMAL_NODES, values(path)[-1], strict=True), oil=150.0, ambient=20.0)
    for node in THERMAL_NODES:
        flows = [0.0]
        for link in LINKS:
            one, _, other = link.partition("_to_")
            if node in (one, other):
                flows.append(getattr(NETWORK, link) * (T[one] - T[other]) * (1.0 if node == other else -1.0))
        assert sum(flows) == pytest.approx(0.0, abs=1e-9 * sum(np.abs(flows)) + 1e-9), node
    assert 20.0 < T["torque_motor"] < T["body"] < 150.0


def test_the_steady_temperatures_do_not_depend_on_the_start():
    # field.md 2, after a published valve model: steady temperature independent of initial temperature
    ends = [
        values(temperature_path(Constant(value=90.0), 3000.0, network=NETWORK, initial=start, spacing=50.0))[-1]
        for start in (-40.0, 200.0)
    ]
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


@pytest.mark.parametrize("measured", [("body",), ("torque_motor", "spool"), THERMAL_NODES])
def test_parts_prescribed_at_what_the_network_gives_leave_the_others_as_they_were(measured):
    oil = Pulse(base=20.0, height=60.0, time=2.0, width=5.0)
    free = temperature_path(oil, 20.0, network=NETWORK, spacing=0.002)
    courses = {
        name: Table(
            times=tuple(np.unique(free.times)),
            values=tuple(getattr(free.parts, name)[np.diff(free.times, prepend=-1.0) > 0.0]),
        )
        for name in measured
    }
    other = dataclasses.replace(NETWORK, **{f"{name}_capacity": 1e3 for name in measured})  # it says nothing of them
    path = temperature_path(oil, 20.0, network=other, prescribed=courses, knots=free.times)
    assert values(path) == pytest.approx(values(free), abs=1e-4)


def test_a_prescribed_part_is_where_it_is_measured_even_without_a_network_or_behind_a_lag():
    course = Ramp(start_value=20.0, end_value=50.0, rate=1.0)
    path = temperature_path(LAUNCH, 20.0, network=None, prescribed={"body": course})
    assert path.parts.body == pytest.approx(20.0 + path.times) and np.all(path.parts.spool == path.parts.oil)
    late = CATALOGUE["thermal_lag"](time_constant=5.0)
    scenario = Scenario(duration=20.0, oil_temperature=LAUNCH, part_temperatures={"body": course}, effects=(late,))
    parts = scenario.temperatures().parts
    assert parts.body == pytest.approx(20.0 + scenario.temperatures().times)
    assert parts.spool[-1] < dataclasses.replace(scenario, effects=()).temperatures().parts.spool[-1] - 1.0


@pytest.mark.parametrize(
    ("course", "told"), [({"lid": 20.0}, "lid"), ({"body": Constant(value=900.0)}, "part_temperatures.body")]
)
def test_prescribed_parts_that_make_no_sense_are_refused(course, told):
    with pytest.raises(InputError, match=told):
        Scenario(part_temperatures=course)


def test_the_heat_stored_is_the_heat_that_came_in():
    path = temperature_path(LAUNCH, 60.0, network=NETWORK, ambient=-10.0, spacing=0.01)
    T, C = values(path), capacities(NETWORK)
    temperature = {name: T[:, k] for k, name in enumerate(THERMAL_NODES)} | {"oil": path.parts.oil, "ambient": -10.0}
    power = np.zeros(len(path.times))
    for link in LINKS:
        one, _, other = link.partition("_to_")
        flow = getattr(NETWORK, link) * (temperature[one] - temperature[other])
        power += flow * (one not in THERMAL_NODES) - flow * (other not in THERMAL_NODES)
    heat = np.trapezoid(power, path.times)
    assert C @ (T[-1] - T[0]) == pytest.approx(heat, rel=1e-5)  # the trapezoidal rule's own error is 2e-6


def test_heat_between_two_parts_is_lost_by_the_one_and_gained_by_the_other():
    no_outside = {name: 0.0 for name in LINKS if name.startswith("oil") or name.endswith("ambient")}
    M, N = dataclasses.replace(NETWORK, **no_outside).matrices()
    assert np.count_nonzero(N) == 0 and np.count_nonzero(M) == 10  # 3 links between 4 of the parts, both ways
    assert capacities(NETWORK) @ M == pytest.approx(np.zeros(len(THERMAL_NODES)), abs=1e-12)


OILS = {
    "ramp that ends": Ramp(start_value=20.0, end_value=80.0, rate=20.0, time=1.0),
    "pulse": Pulse(base=20.0, height=180.0, width=0.05, time=1.013),
    "table": Table(times=(0.0, 0.31, 2.77, 6.0), values=(20.0, 90.0, -10.0, 40.0)),
}


@pytest.mark.parametrize("oil", OILS.values(), ids=OILS.keys())
def test_the_temperatures_do_not_depend_on_the_spacing_of_the_knots(oil):
    coarse, fine = (
        temperature_path(oil, 6.0, network=NETWORK, initial=0.0, spacing=spacing) for spacing in (6.0, 0.003)
    )
    assert values(coarse)[-1] == pytest.approx(values(fine)[-1], rel=1e-10)
    assert len(coarse.times) < 20 < len(fine.times)


@pytest.mark.parametrize("oil", OILS.values(), ids=OILS.keys())
def test_the_temperatures_are_those_of_an_ordinary_integration(oil):
    M, N = NETWORK.matrices()
    breaks = [0.0, *(t for t in oil.pieces(6.0)[:, 0] if 0.0 < t < 6.0), 6.0]
    T = np.zeros(len(THERMAL_NODES))
    for a, b in zip(breaks[:-1], breaks[1:], strict=True):
        row = [r for r in oil.pieces(6.0) if r[0] <= a][-1]

        def rate(t, T, row=row):
            return M @ T + N @ [row[1] + row[2] * (t - row[0]), 20.0]

        T = solve_ivp(rate, (a, b), T, rtol=1e-10, atol=1e-10).y[:, -1]
    path = temperature_path(oil, 6.0, network=NETWORK, initial=0.0)
    assert values(path)[-1] == pytest.approx(T, rel=1e-8)


def test_a_step_of_the_oil_stands_at_a_pair_of_equal_times():
    path = temperature_path(Step(before=20.0, after=120.0, time=0.35), 1.0, network=None)
    (k,) = np.flatnonzero(np.diff(path.times) == 0.0)
    assert path.times[k] == 0.35
    assert path.parts.oil[k : k + 2] == pytest.approx([20.0, 120.0], rel=1e-12)


def test_a_part_does_not_jump_with_the_oil():
    path = temperature_path(Step(before=20.0, after=120.0, time=0.35), 1.0, network=NETWORK)
    (k,) = np.flatnonzero(np.diff(path.times) == 0.0)
    assert values(path)[k] == pytest.approx(values(path)[k + 1], rel=1e-12)
    assert path.parts.pilot_metal[-1] > 21.0


def test_a_knot_stands_between_any_two_breaks():
    # so that the curvature of what follows from the temperatures can be told on every stretch
    path = temperature_path(Ramp(start_value=20.0, end_value=270.0, rate=2500.0), 1.0, network=None, spacing=10.0)
    assert path.times == pytest.approx([0.0, 0.05, 0.1, 0.1, 0.55, 1.0], rel=1e-12)


@pytest.mark.parametrize("frequency", [0.9, 1.0, 2.0, 50.0])
def test_a_wave_of_the_oil_is_never_missed_between_knots(frequency):
    # at 1 and 2 Hz knots of 0.5 s all fall on the mean
    oil = Sine(amplitude=10.0, frequency=frequency, offset=60.0)
    path = temperature_path(oil, 4.0, network=None, spacing=0.5)
    assert np.ptp(path.parts.oil) == pytest.approx(20.0, rel=0.02)
    assert np.max(np.diff(path.times)) <= 0.05 / frequency * (1 + 1e-9)


def test_a_long_table_is_laid_out_once_and_not_for_each_of_its_rows():
    class Counted(Table):
        calls = []

        def pieces(self, end):
            self.calls.append(end)
            return super().pieces(end)

    times = np.linspace(0.0, 10.0, 2001)
    path = temperature_path(Counted(times=tuple(times), values=tuple(np.sin(times))), 10.0, network=NETWORK)
    assert len(Counted.calls) <= 3 and len(path.times) >= 2001


def test_a_lone_part_damps_a_wave_of_the_oil_as_a_first_order_lag():
    network, tau = lone("pilot_metal")
    frequency = 2.0
    path = temperature_path(Sine(amplitude=10.0, frequency=frequency), 20.0, network=network, spacing=0.005)
    late = path.times > 10.0
    gain = 1.0 / np.hypot(1.0, 2 * np.pi * frequency * tau)
    assert np.ptp(path.parts.pilot_metal[late]) == pytest.approx(20.0 * gain, rel=1e-3)


def test_all_parts_start_with_the_oil_or_at_the_initial_temperature():
    oil = Constant(value=60.0)
    warm = temperature_path(oil, 1.0, network=NETWORK)
    assert values(warm)[0] == pytest.approx(np.full(len(THERMAL_NODES), 60.0), rel=1e-12)
    cold = temperature_path(oil, 1.0, network=NETWORK, initial=-40.0)
    assert values(cold)[0] == pytest.approx(np.full(len(THERMAL_NODES), -40.0), rel=1e-12)
    assert cold.parts.oil[0] == 60.0


def test_isothermal_every_part_is_at_the_oil():
    path = temperature_path(LAUNCH, 50.0, network=None, initial=-40.0)
    for name in PART_NAMES:
        assert np.array_equal(getattr(path.parts, name), 20.0 + 3.0 * path.times), name


@pytest.mark.parametrize("temperature", [20.0, 250.0])
def test_throttling_heats_the_oil_by_half_of_the_whole_rise(temperature):
    # dp (1 - alpha T)/(rho cp), field.md 2, with its section 3: 8.3e-4/K, 866 kg/m^3, 2010 + 3.7 (T - 60) J/(kg K)
    density = 866.0 * np.exp(-8.3e-4 * (temperature - 20.0))
    whole = 21e6 * (1.0 - 8.3e-4 * (temperature + 273.15)) / (density * (2010.0 + 3.7 * (temperature - 60.0)))
    assert throttling_rise(MIL_PRF_5606, 21e6)(temperature) == pytest.approx(0.5 * whole, rel=1e-3)


def test_throttling_from_21_mpa_at_20_degrees_is_half_of_the_published_figure():
    # field.md 2: 9.5 K for the whole drop; the specific heat behind it is known to some 5 %
    assert throttling_rise(MIL_PRF_5606, 21e6)(20.0) == pytest.approx(9.5 / 2, rel=0.05)


def test_throttling_heat_is_added_to_the_oil_and_warms_the_parts():
    rise = throttling_rise(MIL_PRF_5606, 20.5e6)
    plain, heated = (temperature_path(LAUNCH, 10.0, network=SEALED, throttling=heat) for heat in (None, rise))
    assert heated.parts.oil == pytest.approx(plain.parts.oil + rise(plain.parts.oil), rel=1e-12)
    assert np.all(values(heated) > values(plain))


@pytest.mark.parametrize(
    "name, value, text",
    [
        ("body_capacity", -1.0, r"thermalnetwork\.body_capacity = -1 J/K is outside \(0, 100000\] J/K"),
        ("body_capacity", 0.0, r"thermalnetwork\.body_capacity = 0 J/K is outside"),
        ("oil_to_body", -1.0, r"thermalnetwork\.oil_to_body = -1 W/K is outside \[0, 100000\] W/K"),
        ("oil_to_body", np.nan, r"thermalnetwork\.oil_to_body = nan W/K is outside"),
    ],
)
def test_a_network_figure_out_of_bounds_is_refused(name, value, text):
    with pytest.raises(InputError, match=text):
        ThermalNetwork(**{name: value})


def test_every_network_figure_is_an_estimate_with_half_its_size_as_tolerance():
    # model.md 5: estimates, every figure exposed with a +-50 % range
    assert {field.metadata["tolerance"] for field in quantities(NETWORK).values()} == {0.5}


@given(st.lists(st.floats(0.5, 1.5), min_size=len(quantities(NETWORK)), max_size=len(quantities(NETWORK))))
def test_within_the_tolerances_no_part_ever_leaves_the_range_of_oil_and_air(factors):
    figures = {name: getattr(NETWORK, name) * f for name, f in zip(quantities(NETWORK), factors, strict=True)}
    oil = Pulse(base=20.0, height=180.0, width=5.0, time=1.0)
    path = temperature_path(oil, 20.0, network=ThermalNetwork(**figures), ambient=-30.0, initial=50.0, spacing=1.0)
    assert np.min(values(path)) >= -30.0 and np.max(values(path)) <= 200.0
    assert np.min(np.ptp(values(path), axis=0)) > 0.1


def test_parts_with_starts_of_their_own_follow_the_network():
    start = {"body": 60.0, "spool": -20.0, "torque_motor": 5.0}
    path = temperature_path(LAUNCH, 30.0, network=NETWORK, initial=start, ambient=10.0)
    M, N = NETWORK.matrices()
    first = [start.get(name, 20.0) for name in THERMAL_NODES]  # those left out start with the oil
    run = solve_ivp(
        lambda t, T: M @ T + N @ [20.0 + 3.0 * t, 10.0], (0.0, 30.0), first, method="LSODA", rtol=1e-11, atol=1e-11
    )
    assert values(path)[0].tolist() == first
    assert values(path)[-1] == pytest.approx(run.y[:, -1], abs=1e-7)


def test_one_start_for_all_is_that_of_each_part():
    one = temperature_path(LAUNCH, 5.0, network=NETWORK, initial=-40.0)
    each = temperature_path(LAUNCH, 5.0, network=NETWORK, initial=dict.fromkeys(THERMAL_NODES, -40.0))
    assert (values(one) == values(each)).all()


@given(st.lists(st.floats(0.3, 3.0), min_size=1, max_size=4))
def test_parts_of_several_networks_together_are_those_of_each_alone(factors):
    networks = [dataclasses.replace(NETWORK, oil_to_spool=NETWORK.oil_to_spool * factor) for factor in factors]
    oil, body = Step(before=20.0, after=90.0, time=0.7), Constant(value=30.0)
    shared = {"initial": -10.0, "prescribed": {"body": body}, "spacing": 0.05}
    together = temperature_path(oil, 3.0, network=networks, **shared)
    for k, network in enumerate(networks):
        alone = temperature_path(oil, 3.0, network=network, **shared)
        for part in THERMAL_NODES:
            found = np.broadcast_to(getattr(together.parts, part), (len(networks), len(alone.times)))[k]
            assert found == pytest.approx(getattr(alone.parts, part), rel=1e-12), part


@pytest.mark.parametrize("decades, least", [(1.0, 1e-9), (3.0, 1e-6)])
@given(
    st.lists(st.floats(-1.0, 4.0 / 3.0), min_size=len(quantities(NETWORK)), max_size=len(quantities(NETWORK))),
    st.sets(st.sampled_from(LINKS), max_size=len(LINKS)),
    st.lists(st.floats(-9.0, 3.0), min_size=1, max_size=40),
)
def test_the_parts_follow_any_network_as_its_matrix_exponential_has_it(decades, least, powers, cut, spacings):
    from scipy.linalg import expm

    factors = dict(zip(quantities(NETWORK), 10.0 ** (decades * np.array(powers)), strict=True))
    figures = {name: getattr(NETWORK, name) * factor for name, factor in factors.items()}
    network = ThermalNetwork(**{name: 0.0 if name in cut else min(value, 1e5) for name, value in figures.items()})
    times = np.cumsum([0.0, *(10.0**np.array(spacings))])
    oil = Table(times=(0.0, 0.3, 4.0), values=(20.0, 150.0, -30.0))
    path = temperature_path(oil, times[-1], network=network, initial=60.0, ambient=-20.0, knots=times)
    (M, N), n = network.matrices(), len(THERMAL_NODES)
    T, block = np.full(n, 60.0), np.zeros((n + 4, n + 4))
    for k, h in enumerate(np.diff(times)):
        u = np.array([[path.parts.oil[k], -20.0], [path.parts.oil[k + 1], -20.0]])
        block[:n, :n], block[:n, n : n + 2] = M * h, N * h
        block[n : n + 2, n + 2 :] = np.eye(2)
        T = (expm(block) @ [*T, *u[0], *(u[1] - u[0])])[:n]
        assert values(path)[k + 1] == pytest.approx(T, rel=0.1 * least, abs=least)


@pytest.mark.parametrize("z", [0.0, -1e-300, -1e-12, -1e-5, -1e-3, -0.49, -0.5, -0.51, -3.0, -50.0, -1e6])
def test_means_over_a_step_are_those_of_sixty_digits(z):
    with localcontext() as digits:
        digits.prec = 60
        exact = Decimal(z)
        e = exact.exp()
        mean, ramp = ((e - 1) / exact, (e - 1 - exact) / exact**2) if z < -1e-20 else (1, Decimal("0.5"))
    found = (float(mean_of(np.array([z]))[0]) for mean_of in (_mean_of_exponential, _mean_of_ramp))
    assert tuple(found) == pytest.approx((float(mean), float(ramp)), rel=1e-14)


def test_one_knot_is_the_start_alone():
    path = temperature_path(Constant(value=50.0), 6.0, network=NETWORK, initial=0.0, knots=np.zeros(1))
    assert path.parts.oil.tolist() == [50.0] and path.parts.body.tolist() == [0.0]
