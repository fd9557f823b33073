"""A valve whose command is held, under oil and pressures that move: right at every sample, not at the ends alone.

Each case runs at the default tolerance beside one that is thousands of times tighter and stopped at breaks of its own
drawing. A quiet valve takes long steps; whatever drives it must not be stepped over.
"""

import dataclasses

import numpy as np
import pytest

import valvesim as vs

HELD = vs.Constant(value=5e-3)
ISOTHERMAL = vs.Thermal(network=None)
TABLE = vs.Table(times=(0.0, 0.31, 0.35, 0.6, 0.61, 1.0), values=(20.0, 20.0, 70.0, 70.0, 40.0, 35.0))
CASES = {
    "step of the oil, isothermal": {
        "thermal": ISOTHERMAL, "oil_temperature": vs.Step(before=20.0, after=100.0, time=0.5)},
    "pulse of the oil, isothermal": {
        "thermal": ISOTHERMAL, "oil_temperature": vs.Pulse(base=20.0, height=80.0, width=0.05, time=0.5)},
    "step of the oil": {"oil_temperature": vs.Step(before=20.0, after=100.0, time=0.5)},
    "ramp of the oil": {"oil_temperature": vs.Ramp(start_value=20.0, end_value=100.0, rate=100.0, time=0.1)},
    "table of the oil": {"oil_temperature": TABLE},
    "cold start": {
        "command": vs.Step(after=5e-3, time=0.1),
        "oil_temperature": vs.Ramp(start_value=-30.0, end_value=20.0, rate=100.0, time=0.1)},
    "late step": {"command": vs.Step(after=5e-3, time=0.9)},
    "late ramp": {"command": vs.Ramp(end_value=5e-3, rate=0.05, time=0.9)},
    "step of the supply": {"supply_pressure": vs.Step(before=21e6, after=15e6, time=0.9)},
}  # fmt: skip
POSITIONS_AND_PRESSURES = ("spool_position", "nozzle_pressure_1", "nozzle_pressure_2", "load_flow")


def with_idle_breaks(command, duration):
    """The command plus nothing: a table of zeros whose points end steps at times of their own."""
    times = np.sort(np.random.default_rng(0).uniform(0.0, duration, 997))
    return vs.Sum((command, vs.Table(times=tuple(times), values=(0.0,) * len(times))))


def error(result, reference, name):
    """Largest error of a channel as a share of its span, or of its size where it hardly moves."""
    values = reference.values[name]
    return np.max(np.abs(result.values[name] - values)) / max(np.ptp(values), 1e-3 * np.max(np.abs(values)))


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_a_quiet_valve_feels_what_drives_it_at_every_sample(case):
    scenario = vs.Scenario(**({"command": HELD, "output_rate": 2000.0} | case))
    result = vs.simulate(scenario)
    tight = dataclasses.replace(scenario, tolerance=1e-8, command=with_idle_breaks(scenario.command, scenario.duration))
    reference = vs.simulate(tight)
    for name in POSITIONS_AND_PRESSURES:
        assert error(result, reference, name) < 5e-4, name
    assert error(result, reference, "armature_angle") < 1e-3


def test_between_two_jumps_of_the_oil_the_valve_rests_on_the_static_solution():
    oil = vs.Pulse(base=20.0, height=80.0, width=0.2, time=0.5)
    result = vs.simulate(vs.Scenario(command=HELD, thermal=ISOTHERMAL, oil_temperature=oil))
    cold, hot = (vs.static_solution(vs.reference_valve(), current=5e-3, temperature=t) for t in (20.0, 100.0))
    for time, rest in ((0.499, cold), (0.699, hot), (0.999, cold)):
        sample = np.argmin(np.abs(result.time - time))
        for name in ("armature_angle", "spool_position"):
            assert result.values[name][sample] == pytest.approx(float(getattr(rest, name)), rel=1e-6)
