"""A scenario that is written as TOML and read back is the same scenario, whatever it holds."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import valvesim as vs
from valvesim.errors import InputError
from valvesim.inputs import COMMANDS, VALUE, Scaled
from valvesim.simulation.scenario_toml import scenario_to_toml
from valvesim.units import POSITIVE, quantities
from valvesim.valve.flow_coefficients import FLOW_LAWS
from valvesim.valve.oils import OILS, read_oil
from valvesim.valve.thermal_network import THERMAL_NODES

LONGEST = 3.0  # s, of a run that is drawn


def reread(scenario, folder):
    """What its text says."""
    path = folder / "written.toml"
    path.write_text(scenario_to_toml(scenario), encoding="utf-8")
    return vs.load_scenario(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("written")


# --- what is drawn ---------------------------------------------------------------------------------------------------


def floats(low, high):
    low, high = (math.nextafter(0.0, 1.0) if low == POSITIVE else low), high
    return st.floats(low, high, allow_nan=False, allow_infinity=False, allow_subnormal=False)


def near(value, bounds):
    """Values near one, within bounds, with all their digits."""
    low, high = max(bounds[0], value - 0.2 * abs(value)), min(bounds[1], value + 0.2 * abs(value))
    return floats(low, high) if low < high else st.just(value)


def changed(instance):
    """An instance with some of its quantities a little off."""
    names = list(quantities(instance))
    return st.lists(st.sampled_from(names), unique=True, max_size=4).flatmap(
        lambda chosen: st.fixed_dictionaries(
            {name: near(getattr(instance, name), quantities(instance)[name].metadata["bounds"]) for name in chosen}
        )
    ).map(lambda new: replace(instance, **new))  # fmt: skip


LEVELS = {  # what a level and a difference may be, so that no sum of three leaves the ranges of a scenario
    "A": (st.floats(-5e-3, 5e-3), st.floats(-1e-3, 1e-3)), "V": (st.floats(-8.0, 8.0), st.floats(-1.0, 1.0)),
    "degC": (st.floats(-15.0, 60.0), st.floats(-15.0, 15.0)), "Pa": (st.floats(0.0, 1e5), st.floats(-3e4, 3e4)),
}  # fmt: skip


def figure(field, unit):
    """A figure of a command in its own range, and such that a run of `LONGEST` has few pieces and few waves."""
    level, difference = LEVELS[unit]
    if "unit" not in field.metadata:
        return st.booleans()
    if field.metadata["unit"] == VALUE:
        return level
    if field.metadata["unit"] == f"{VALUE}_difference":
        return difference
    return {
        "rate": st.floats(1e-3, 1e3), "frequency": st.floats(1e-3, 50.0), "start_frequency": st.floats(1e-3, 50.0),
        "end_frequency": st.floats(1e-3, 50.0), "phase": st.floats(-10.0, 10.0), "time": st.floats(0.0, 5.0),
        "duration": st.floats(1e-3, 5.0), "width": st.floats(1e-3, 0.5), "period": st.floats(0.51, 9.0),
        "steps": st.integers(1, 20).map(float), "hold": st.floats(1e-3, 1.0),
    }[field.name]  # fmt: skip


def one_command(unit):
    def of(kind):
        drawn = {field.name: figure(field, unit) for field in fields(kind)}
        return st.fixed_dictionaries({}, optional=drawn).map(lambda figures: kind(**figures))

    points = st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=6, unique=True).map(sorted)
    table = points.flatmap(
        lambda times: st.tuples(*(LEVELS[unit][0] for _ in times)).map(
            lambda values: vs.Table(times=tuple(times), values=values)
        )
    )
    return st.one_of(*map(of, COMMANDS.values()), table)


def commands(unit):
    alone = one_command(unit)
    few = st.lists(alone, min_size=1, max_size=3).map(lambda terms: vs.Sum(tuple(terms)))
    nested = st.tuples(st.lists(alone, min_size=2, max_size=2).map(lambda t: vs.Sum(tuple(t))), alone).map(vs.Sum)
    return st.one_of(alone, few, nested)


@st.composite
def effects(draw):
    active = []
    for name in draw(st.lists(st.sampled_from(sorted(vs.CATALOGUE)), max_size=5)):
        effect = vs.effect(name)
        if effect.reading is not None:
            effect = effect.on(draw(st.sampled_from(["spool_position", "load_flow", "body_temperature"])))
        elif any(effect.name == other.effect.name for other in active):
            continue  # it may act once in a place
        chosen = [p for p in effect.parameters if p is effect.amplitude or draw(st.booleans())]
        numbers = {p.name: p.default if p.name == "side" else draw(floats(*p.bounds)) for p in chosen}
        active.append(effect(**numbers))
    return tuple(active)


def oils():
    rows = st.lists(st.floats(-40.0, 150.0), min_size=2, max_size=5, unique_by=lambda t: round(t / 15.0)).map(sorted)
    own = rows.map(
        lambda t: read_oil(
            {
                "name": "mine", "like": "jet_a", "rated_low": "-54 degC",
                "temperature": ", ".join(map(repr, t)) + " degC",
                "viscosity": ", ".join(repr(40.0 * math.exp(-x / 40.0) + 1.0) for x in t) + " mm^2/s",
                "density": ", ".join(repr(880.0 - 0.7 * x) for x in t) + " kg/m^3",
            }
        )
    )  # fmt: skip
    return st.one_of(st.sampled_from(list(OILS.values())).flatmap(changed), own, own.flatmap(changed))


def thermals():
    temperature = st.floats(-50.0, 150.0)
    by_part = st.dictionaries(st.sampled_from(THERMAL_NODES), temperature, min_size=1)
    initial = st.one_of(st.none(), temperature, by_part)
    routes = st.sets(st.sampled_from(vs.ROUTES)).map(lambda chosen: tuple(r for r in vs.ROUTES if r in chosen))
    network = st.one_of(st.none(), changed(vs.ThermalNetwork()))
    return st.builds(
        vs.Thermal, network=network, routes=routes, throttling_heat=st.booleans(), ambient_temperature=temperature,
        initial_temperature=initial,
    )  # fmt: skip


@st.composite
def scenarios(draw):
    drive = draw(st.sampled_from([vs.CurrentDrive(), vs.VoltageDrive()]))
    valve = replace(draw(changed(vs.Valve())), flow_coefficients=draw(st.sampled_from(list(FLOW_LAWS.values()))))
    base = vs.Constant(value=2e7)
    supply = draw(st.one_of(st.none(), commands("Pa").map(lambda c: vs.Sum((base, c)))))
    return vs.Scenario(
        title=draw(st.text(st.characters(categories=["L", "N", "P", "S", "Zs"]), max_size=30).filter(str.isprintable)),
        duration=draw(st.floats(1e-3, LONGEST)), valve=valve, oil=draw(oils()), thermal=draw(thermals()),
        oil_temperature=draw(commands("degC")), drive=drive, command=draw(commands(drive.command_unit)),
        part_temperatures=draw(st.dictionaries(st.sampled_from(THERMAL_NODES), commands("degC"), max_size=2)),
        supply_pressure=supply, load_pressure=draw(st.one_of(st.none(), commands("Pa"))), effects=draw(effects()),
        output_rate=draw(st.floats(1.0, 1e5)), tolerance=draw(st.floats(1e-10, 1e-2)),
        channels=tuple(draw(st.lists(st.sampled_from(["spool_position", "current"]), unique=True))),
    )  # fmt: skip


# --- there and back --------------------------------------------------------------------------------------------------


@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much])
@given(data=st.data())
def test_any_scenario_comes_back_as_it_is(folder, data):
    try:
        scenario = data.draw(scenarios())
    except InputError:
        return  # what was drawn does not go together, such as lengths of the torque motor
    assert reread(scenario, folder) == scenario


@settings(max_examples=100)
@given(data=st.data(), unit=st.sampled_from(["A", "degC", "Pa"]))
def test_any_command_comes_back_as_it_is(folder, data, unit):
    command, drawn = data.draw(commands(unit)), {"A": "command", "degC": "oil_temperature", "Pa": "load_pressure"}
    scenario = vs.Scenario(**{drawn[unit]: command})
    assert reread(scenario, folder) == scenario


@settings(max_examples=60)
@given(active=effects())
def test_any_effects_come_back_in_their_order(folder, active):
    scenario = vs.Scenario(effects=active)
    assert reread(scenario, folder).effects == active


@given(oil=oils())
def test_any_oil_comes_back_as_it_is(folder, oil):
    assert reread(vs.Scenario(oil=oil), folder).oil == oil


def test_a_command_at_the_end_of_what_a_number_can_be_comes_back(folder):
    scenario = vs.Scenario(command=vs.Constant(value=1.7e308), load_pressure=vs.Constant(value=5e-324))
    assert reread(scenario, folder) == scenario


# --- how it reads ----------------------------------------------------------------------------------------------------


def test_the_text_is_one_that_people_write():
    scenario = vs.Scenario(
        title="T", valve=replace(vs.Valve(), null_gap=3e-5),
        command=vs.Sum((vs.Constant(value=1e-3), vs.Sine(amplitude=2e-3, frequency=10.0))),
        oil_temperature=vs.Ramp(start_value=20.0, end_value=80.0, rate=3.0),
        effects=(vs.effect("spool_coulomb_friction")(friction_force=2.0),),
    )  # fmt: skip
    text = scenario_to_toml(scenario)
    for line in (
        'title = "T"', 'null_gap = "0.03 mm" # -14.3 %', 'constant = {value = "1 mA"}',
        'sine = {amplitude = "2 mA", frequency = "10 Hz", offset = "0 mA"}',
        'ramp = {start_value = "20 degC", end_value = "80 degC", rate = "3 K/s"}', "[command.current]",
    ):  # fmt: skip
        assert line in text.splitlines()
    assert "\n\n\n" not in text


# --- what no file can say --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change, key",
    [
        ({"command": Scaled(vs.Constant(value=1e-3), 2.0)}, "command.current"),
        (
            {"supply_pressure": vs.Sum((vs.Constant(value=1e7), Scaled(vs.Constant(value=1e5), 2.0)))},
            "pressures.supply",
        ),
        ({"valve": replace(vs.Valve(), flow_coefficients=lambda *a: (0.6, 0.7))}, "valve.flow_law"),
        ({"valve": replace(vs.Valve(), null_gap=np.array([3e-5, 4e-5]))}, "valve.null_gap"),
        ({"oil": replace(vs.MIL_PRF_5606, name="mine", viscosity_law=lambda t: 1e-5 + 0.0 * t)}, "oil.name"),
        ({"oil": replace(vs.MIL_PRF_5606, density_law=lambda t: 1.0 - 1e-4 * t)}, "oil.name"),
        ({"effects": (replace(vs.effect("spool_lap"), name="mine")(overlap=1e-6),)}, "effects.mine"),
        ({"effects": (replace(vs.effect("spool_lap"), doc="mine")(overlap=1e-6),)}, "effects.spool_lap"),
    ],
)
def test_what_no_file_can_say_is_refused_with_its_key(change, key):
    with pytest.raises(InputError) as told:
        scenario_to_toml(vs.Scenario(**change))
    assert told.value.key == key


def test_more_text_than_is_read_is_refused():
    times = tuple(np.arange(60_000) / 1e3)
    with pytest.raises(InputError, match="more than the 500000 bytes"):
        scenario_to_toml(vs.Scenario(command=vs.Table(times=times, values=times)))


# --- lists of effects and sums, as a file has them -------------------------------------------------------------------

BASE = 'duration = "20 ms"\n[command.current]\n'


@pytest.mark.parametrize(
    "text, told",
    [
        ("sum = [{ sin = {} }]", "line 3: command.current.sum.1: unknown command 'sin'; did you mean 'sine'?"),
        ('sum = "1 mA"', "line 3: command.current.sum: expected a list of commands"),
        ("sum = []", "line 3: command.current.sum: expected a list of commands"),
        ('constant = "1 mA"\n[[effects]]\noverlap = "1 um"', "line 4: effects.1: expected a table with the name"),
        (
            'constant = "1 mA"\n[[effects]]\nname = "spool_lap"\noverlap = "1 um"\n[[effects]]\nname = "spool_lop"\n',
            "line 8: effects.2.name: unknown effect 'spool_lop'; did you mean 'spool_lap'?",
        ),
        (
            'constant = "1 mA"\n[[effects.sensor_bias]]\nchannel = "load_flow"\nbias = "1 L/min"\n'
            '[[effects.sensor_bias]]\nchannel = "spool_position"\nbias = "1 bar"\n',
            "line 9: effects.sensor_bias.2.bias: 'bar' has the wrong dimension",
        ),
        (
            'constant = "1 mA"\n[thermal.oil_temperature]\n'
            'sum = [{ constant = "20 degC" }, { step = { after = "80 K" } }]',
            "line 5: thermal.oil_temperature.sum.2.step.after: '80 K' in a sum",
        ),
    ],
)
def test_a_list_that_makes_no_sense_is_refused_with_its_entry_and_line(tmp_path, text, told):
    path = tmp_path / "case.toml"
    path.write_text(BASE + text, encoding="utf-8")
    with pytest.raises(InputError) as error:
        vs.load_scenario(path)
    assert told in str(error.value)
