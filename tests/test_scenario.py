"""Scenario files: what loads, in which units, and what every wrong line is answered with."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import valvesim as vs
from valvesim.errors import InputError
from valvesim.inputs import evaluate, largest
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario_toml import read_tables
from valvesim.units import quantities
from valvesim.valve.thermal_network import ThermalNetwork

SHIPPED = Path(__file__).parent.parent / "scenarios"
BASE = 'duration = "20 ms"\n[command.current]\nconstant = "1 mA"\n'  # 3 lines; what a test adds starts in line 4


@pytest.fixture
def load(tmp_path):
    """Load a scenario from its text."""

    def load(text, *settings):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return vs.load_scenario(path, settings=settings)

    return load


@pytest.fixture
def refused(load, tmp_path):
    """The message with which a text is refused, with paths from the file's folder on."""

    def refused(text, *settings):
        with pytest.raises(InputError) as caught:
            load(text, *settings)
        return str(caught.value).replace(f"{tmp_path}/", "")

    return refused


# --- what is shipped -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_file_loads_and_says_what_it_is(path):
    scenario = vs.load_scenario(path)
    assert path.read_text(encoding="utf-8").startswith("# ")
    assert scenario.title != "valve" and scenario.duration > 0.0
    assert 0.0 < largest(scenario.command, scenario.duration) <= scenario.valve.rated_current


def test_a_scenario_is_shipped_for_each_kind_of_run():
    names = {"cold_start", "launch_shock", "sine_sweep", "static_map", "step"}
    assert names <= {path.stem for path in SHIPPED.glob("*.toml")}


def test_the_launch_is_the_ramp_of_the_literature():
    # Machines 2022, 10(6), 423: 3 °C/s; 20 -> 270 °C takes 83 s (model.md 5)
    scenario = vs.load_scenario(SHIPPED / "launch_shock.toml")
    oil = evaluate(scenario.oil_temperature, [0.0, 10.0, 250.0 / 3.0, 90.0])
    assert oil == pytest.approx([20.0, 50.0, 270.0, 270.0], rel=1e-12)
    assert scenario.duration == 90.0


def test_a_file_that_says_nothing_else_is_the_reference_valve_at_20_degrees(load):
    scenario = load(BASE)
    assert scenario == vs.Scenario(duration=0.02, command=vs.Constant(value=1e-3))
    assert scenario.valve == vs.reference_valve() and scenario.oil == vs.MIL_PRF_5606
    assert evaluate(scenario.oil_temperature, 5.0) == 20.0
    assert evaluate(scenario.pressures()[0], 1.0) == 21e6  # the valve's own
    assert scenario.thermal.routes == vs.ROUTES


# --- units -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["21 MPa", "210 bar", "210bar", "2.1e7 Pa", "3045.8 psi", "21e6 N/m^2"])
def test_one_pressure_may_be_written_in_any_unit_of_pressure(load, text):
    # 1 psi = 6894.757 Pa, so 3045.8 psi is 21.0000 MPa to 5 digits
    scenario = load(BASE + f'[valve]\nsupply_pressure = "{text}"\n')
    assert scenario.valve.supply_pressure == pytest.approx(21e6, rel=1e-5)


@pytest.mark.parametrize("text", ["20 degC", "293.15 K", "68 degF", "20 °C"])
def test_one_temperature_may_be_written_on_any_scale(load, text):
    scenario = load(BASE + f'[thermal]\noil_temperature = "{text}"\ninitial_temperature = "{text}"\n')
    assert evaluate(scenario.oil_temperature, 0.0) == pytest.approx(20.0, abs=1e-9)
    assert scenario.thermal.initial_temperature == pytest.approx(20.0, abs=1e-9)


@pytest.mark.parametrize("rate", ["3 degC/s", "3 K/s", "180 K/min", "5.4 degF/s"])
def test_a_rate_of_temperature_has_no_offset(load, rate):
    oil = f'[thermal.oil_temperature]\nramp = {{ start_value = "20 degC", end_value = "50 degC", rate = "{rate}" }}\n'
    assert evaluate(load(BASE + oil).oil_temperature, 4.0) == pytest.approx(32.0, rel=1e-9)


@pytest.mark.parametrize("amplitude", ["9 K", "9 delta_degC", "16.2 delta_degF"])
def test_an_amplitude_of_temperature_has_no_offset(load, amplitude):
    sine = f'sine = {{ amplitude = "{amplitude}", offset = "50 degC", frequency = "0.25 Hz" }}\n'
    oil = "[thermal.oil_temperature]\n" + sine
    assert evaluate(load(BASE + oil).oil_temperature, 1.0) == pytest.approx(59.0, rel=1e-9)


OTHER_UNITS = {
    "m": ("mm", 1e3), "m^2": ("mm^2", 1e6), "m^3": ("cm^3", 1e6), "kg": ("g", 1e3), "Pa": ("bar", 1e-5),
    "A": ("mA", 1e3), "N/m": ("N/mm", 1e-3), "H": ("mH", 1e3), "ohm": ("kohm", 1e-3), "1/K": ("1/mK", 1e-3),
    "A/Wb": ("mA/Wb", 1e3), "A/K": ("mA/K", 1e3), "N*m/rad": ("N*mm/rad", 1e3), "kg*m^2": ("g*mm^2", 1e9),
    "N*m*s/rad": ("N*mm*s/rad", 1e3), "N*s/m": ("N*s/mm", 1e-3), "s/m": ("ms/m", 1e3), "1": ("%", 100.0),
    "degC": ("K", 1.0), "kg/m^3": ("g/cm^3", 1e-3), "J/(kg*K)": ("J/(g*K)", 1e-3), "J/(kg*K^2)": ("J/(g*K^2)", 1e-3),
    "K": ("kK", 1e-3), "1/Pa": ("1/MPa", 1e6), "J/K": ("kJ/K", 1e-3), "W/K": ("mW/K", 1e3),
}  # fmt: skip
DECLARED = [
    (section, name, field)
    for section, instance in (("valve", vs.Valve()), ("oil", vs.MIL_PRF_5606), ("thermal", ThermalNetwork()))
    for name, field in quantities(instance).items()
]


@pytest.mark.parametrize("section, name, field", DECLARED, ids=[f"{s}.{n}" for s, n, _ in DECLARED])
def test_every_figure_is_read_in_its_own_and_in_another_unit(load, section, name, field):
    unit = field.metadata["unit"]
    other, factor = OTHER_UNITS[unit]
    offset = 273.15 if unit == "degC" else 0.0
    value = field.default * 0.99  # inside every range, and not the default
    for text in (f"{value!r} {unit if unit != '1' else ''}", f"{value * factor + offset!r} {other}"):
        scenario = load(BASE + f'[{section}]\n{name} = "{text}"\n')
        target = scenario.thermal.network if section == "thermal" else getattr(scenario, section)
        assert getattr(target, name) == pytest.approx(value, rel=1e-9)


def test_a_plain_number_is_read_where_a_quantity_has_no_dimension(load):
    scenario = load(BASE + "[valve]\nflux_share = 0.25\n[solver]\ntolerance = 1e-6\n")
    assert scenario.valve.flux_share == 0.25 and scenario.tolerance == 1e-6


# --- sections --------------------------------------------------------------------------------------------------------


def test_every_section_arrives_in_the_scenario(load):
    scenario = load(
        'title = "T"\nduration = "2 s"\n'
        '[command.voltage]\nstep = { before = "0 V", after = "3 V", time = "10 ms" }\n'
        '[oil]\nname = "yh12_paper"\ndensity_at_20 = "850 kg/m^3"\n'
        '[thermal]\nroutes = ["mmf", "flow"]\nthrottling_heat = true\nambient_temperature = "-10 degC"\n'
        '[pressures]\nsupply = "15 MPa"\nreturn = "0.2 MPa"\n'
        'load = { sine = { amplitude = "1 MPa", frequency = "3 Hz" } }\n'
        '[effects.spool_stribeck_friction]\nbreakaway_force = "2 N"\nkinetic_share = 0.5\n'
        '[effects.entrained_air]\nair_fraction = "2 %"\n'
        '[outputs]\nrate = "2 kHz"\nchannels = ["spool_position", "current"]\n'
    )
    assert scenario.title == "T" and scenario.duration == 2.0 and isinstance(scenario.drive, vs.VoltageDrive)
    assert evaluate(scenario.command, [0.005, 0.02]) == pytest.approx([0.0, 3.0])
    assert (scenario.oil.name, scenario.oil.density_at_20) == ("yh12_paper", 850.0)
    assert scenario.thermal.routes == ("flow", "mmf") and scenario.thermal.throttling_heat
    assert scenario.thermal.ambient_temperature == -10.0 and scenario.thermal.initial_temperature is None
    values = [evaluate(each, 1.0 / 12.0) for each in scenario.pressures()]
    assert values == pytest.approx([15e6, 0.2e6, 1e6])
    friction, air = scenario.effects
    assert friction == vs.effect("spool_stribeck_friction")(breakaway_force=2.0, kinetic_share=0.5)
    assert air == vs.effect("entrained_air")(air_fraction=0.02)
    assert scenario.output_rate == 2000.0 and scenario.channels == ("spool_position", "current")


def test_isothermal_leaves_no_network_and_no_routes_is_no_route(load):
    thermal = load(BASE + "[thermal]\nisothermal = true\nroutes = []\n").thermal
    assert thermal.network is None and thermal.routes == ()


def test_a_sensor_effect_is_given_once_for_each_channel(load):
    effects = load(
        BASE
        + '[[effects.sensor_bias]]\nchannel = "spool_position"\nbias = "5 um"\n'
        + '[[effects.sensor_bias]]\nchannel = "load_flow"\nbias = "0.6 L/min"\n'
        + '[effects.sensor_temperature_drift]\nchannel = "nozzle_pressure_1"\ndrift = "0.1 bar/K"\n'
        + '[effects.thermal_lag]\ntime_constant = "5 s"\n'
    ).effects
    told = [(active.effect.name, active.effect.channel) for active in effects]
    assert told == [
        ("sensor_bias", "spool_position"), ("sensor_bias", "load_flow"),
        ("sensor_temperature_drift", "nozzle_pressure_1"), ("thermal_lag", ""),
    ]  # fmt: skip
    assert [active.numbers[0] for active in effects] == pytest.approx([5e-6, 1e-5, 1e4, 5.0])


@pytest.mark.parametrize(
    "name, text",
    [
        ("coil_resistance_drift", 'share = "5 %"'), ("spool_lap", 'overlap = "-3 um"'),
        ("supply_pressure_droop", 'resistance = "2 bar/(L/min)"\ntime_constant = "5 ms"'),
        ("spool_thermal_pinch", 'friction_per_clearance = "4 N/um"'), ("oil_viscosity_grade", "viscosity_factor = 2"),
        ("thermal_gradient_null_drift", 'drift = "0.05 um/K"'),
    ],
)  # fmt: skip
def test_effects_are_read_in_the_units_of_the_field(load, name, text):
    (active,) = load(BASE + f"[effects.{name}]\n{text}\n").effects
    expected = {
        "coil_resistance_drift": (0.05,), "spool_lap": (-3e-6,), "supply_pressure_droop": (1.2e10, 5e-3),
        "spool_thermal_pinch": (4e6, 3e-6, 0.5e-6), "oil_viscosity_grade": (2.0,),
        "thermal_gradient_null_drift": (5e-8,),
    }  # fmt: skip
    assert active.effect is vs.effect(name) and active.numbers == pytest.approx(expected[name])


def test_only_effects_with_a_balance_are_integrated(load):
    scenario = load(
        BASE
        + '[effects.spool_lap]\noverlap = "1 um"\n[effects.eddy_current_lag]\nshare = 0.1\n'
        + '[effects.thermal_lag]\ntime_constant = "1 s"\n'
        + '[effects.sensor_lag]\nchannel = "current"\ntime_constant = "1 ms"\n'
    )
    assert len(scenario.effects) == 4
    assert [effect.name for effect in scenario.model.effects] == ["eddy_current_lag"]


COMMANDS = {
    "constant": ('constant = "2 mA"', 2e-3),
    "constant as a table": ('constant = { value = "2 mA" }', 2e-3),
    "step": ('step = { before = "1 mA", after = "2 mA", time = "5 ms" }', 2e-3),
    "ramp": ('ramp = { start_value = "0 mA", end_value = "5 mA", rate = "200 mA/s" }', 2e-3),
    "sine": ('sine = { amplitude = "2 mA", frequency = "25 Hz" }', 2e-3),
    "sine in degrees": ('sine = { amplitude = "2 mA", frequency = "50 Hz", phase = "-90 deg" }', 2e-3),
    "chirp": ('chirp = { amplitude = "2 mA", start_frequency = "25 Hz", end_frequency = "25 Hz" }', 2e-3),
    "pulse": ('pulse = { height = "2 mA", width = "1 ms", time = "9.5 ms" }', 2e-3),
    "pulses": ('pulse = { height = "2 mA", width = "1 ms", period = "5 ms" }', 2e-3),
    "staircase": ('staircase = { end_value = "4 mA", steps = 2, hold = "10 ms" }', 2e-3),
    "a sum": ('constant = "3 mA"\nstep = { after = "-1 mA", time = "5 ms" }', 2e-3),
}


@pytest.mark.parametrize("text, value", COMMANDS.values(), ids=COMMANDS.keys())
def test_every_command_is_read(load, text, value):
    scenario = load(f'duration = "20 ms"\n[command.current]\n{text}\n')
    assert evaluate(scenario.command, 0.010) == pytest.approx(value, rel=1e-9)


def test_a_file_of_windows_is_read(tmp_path):
    path = tmp_path / "case.toml"
    path.write_bytes(b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode())
    assert vs.load_scenario(path).duration == 0.02


# --- what is wrong ---------------------------------------------------------------------------------------------------

WRONG = {
    # unknown names: what, the nearest name, the line
    "section": ("[vlave]\n", "line 4: scenario: unknown key 'vlave'; did you mean 'valve'?"),
    "key": ('titel = "x"\n', "line 4: command.current: unknown command 'titel'"),
    "valve key": (
        '[valve]\n# a comment\n\nnul_gap = "0.03 mm"\n',
        "line 7: valve: unknown parameter of Valve 'nul_gap'; did you mean 'null_gap'?",
    ),
    "law in a file": (
        '[valve]\nflow_coefficients = "1"\n',
        "line 5: valve: unknown parameter of Valve 'flow_coefficients'",
    ),
    "oil": (
        '[oil]\nname = "mil_prf_5605"\n',
        "line 5: oil.name: unknown oil 'mil_prf_5605'; did you mean 'mil_prf_5606'?",
    ),
    "oil as a list": ('[oil]\nname = ["x"]\n', "line 5: oil.name: unknown oil"),
    "oil key": (
        '[oil]\ndensity = "9 kg/m^3"\n',
        "line 5: oil: unknown parameter of Oil 'density'; did you mean 'density_at_20'?",
    ),
    "thermal key": (
        "[thermal]\nisothermic = true\n",
        "line 5: thermal: unknown key 'isothermic'; did you mean 'isothermal'?",
    ),
    "pressure": ('[pressures]\nsuply = "1 MPa"\n', "line 5: pressures: unknown key 'suply'; did you mean 'supply'?"),
    "output key": ('[outputs]\nrat = "1 kHz"\n', "line 5: outputs: unknown key 'rat'; did you mean 'rate'?"),
    "solver key": (
        "[solver]\ntoleranse = 1e-3\n",
        "line 5: solver: unknown key 'toleranse'; did you mean 'tolerance'?",
    ),
    "effect": (
        '[effects.backlash]\nhalf_play = "1 um"\n',
        "line 4: effects: unknown effect 'backlash'; did you mean 'feedback_ball_backlash'?",
    ),
    "effect key": (
        '[effects.feedback_ball_backlash]\nhalf_ply = "1 um"\n',
        "line 5: effects.feedback_ball_backlash: unknown parameter of effect feedback_ball_backlash 'half_ply'; "
        "did you mean 'half_play'?",
    ),
    "route": (
        '[thermal]\nroutes = ["flow", "relutance"]\n',
        "line 5: thermal.routes: unknown temperature route 'relutance'; did you mean 'reluctance'?",
    ),
    "temperature command": (
        '[thermal.oil_temperature]\nrmp = { start_value = "20 degC" }\n',
        "line 5: thermal.oil_temperature: unknown command 'rmp'; did you mean 'ramp'?",
    ),
    # units
    "wrong dimension": (
        '[valve]\nnull_gap = "0.03 bar"\n',
        "line 5: valve.null_gap: 'bar' has the wrong dimension; expected a unit that converts to 'm'",
    ),
    "unknown unit": ('[valve]\nnull_gap = "3 mmm"\n', "line 5: valve.null_gap: unknown unit 'mmm'; expected one that"),
    "bare number": (
        "[valve]\nnull_gap = 0.03\n",
        "line 5: valve.null_gap: 0.03 has no unit; write it as text, such as '0.03 m'",
    ),
    "bare text": ('[valve]\nnull_gap = "0.03"\n', "line 5: valve.null_gap: '0.03' has no unit"),
    "no number": (
        '[valve]\nnull_gap = "small"\n',
        "line 5: valve.null_gap: cannot read 'small' as a number with a unit",
    ),
    "nan": ('[valve]\nnull_gap = "nan mm"\n', "line 5: valve.null_gap: 'nan mm' is not a finite number"),
    "infinity": ('[valve]\nnull_gap = "inf mm"\n', "line 5: valve.null_gap: 'inf mm' is not a finite number"),
    "list": (
        '[valve]\nnull_gap = ["1 mm"]\n',
        "line 5: valve.null_gap: expected a quantity such as '1 m', got ['1 mm']",
    ),
    "rate of pressure": ('[outputs]\nrate = "1 s"\n', "line 5: outputs.rate: 's' has the wrong dimension"),
    "temperature as pressure": (
        '[thermal]\noil_temperature = "300 bar"\n',
        "line 5: thermal.oil_temperature: 'bar' has the wrong dimension; expected a unit that converts to 'degC'",
    ),
    "line of the figure and not of its section": (
        '[thermal.oil_temperature]\nramp = { rate = "3 bar/s" }\n[thermal]\nisothermal = true\n',
        "line 5: thermal.oil_temperature.ramp.rate: 'bar/s' has the wrong dimension",
    ),
    "effect figure": (
        '[effects.feedback_ball_backlash]\nhalf_play = "1 N"\n',
        "line 5: effects.feedback_ball_backlash.half_play: 'N' has the wrong dimension",
    ),
    # sizes
    "negative size": ('[valve]\nnull_gap = "-0.03 mm"\n', "line 5: valve.null_gap = -3e-05 m is outside (0, 0.001] m"),
    "zero size": (
        '[valve]\nnull_gap = "0 mm"\n',
        "line 5: valve.null_gap = 0 m is outside (0, 0.001] m (x_f0, nozzle to flapper)",
    ),
    "out of bounds": ('[valve]\nnull_gap = "10 mm"\n', "line 5: valve.null_gap = 0.01 m is outside (0, 0.001] m"),
    "negative capacity": (
        '[thermal]\nbody_capacity = "-1 J/K"\n',
        "line 5: thermal.body_capacity = -1 J/K is outside (0, 100000] J/K",
    ),
    "oil out of bounds": (
        '[oil]\ndensity_at_20 = "1 kg/m^3"\n',
        "line 5: oil.density_at_20 = 1 kg/m³ is outside [500, 2000] kg/m³",
    ),
    "effect out of bounds": (
        "[effects.magnet_demagnetization]\nloss = 0.95\n",
        "line 5: effects.magnet_demagnetization.loss = 0.95 - is outside [0, 0.9] -",
    ),
    "effect without its amplitude": (
        "[effects.spool_stribeck_friction]\nkinetic_share = 0.5\n",
        "line 4: effects.spool_stribeck_friction needs breakaway_force (force F at rest)",
    ),
    "sensor effect without a channel": (
        '[effects.sensor_bias]\nbias = "5 um"\n',
        "line 4: effects.sensor_bias needs a channel, such as spool_position",
    ),
    "sensor effect on an unknown channel": (
        '[effects.sensor_lag]\nchannel = "spool_positon"\ntime_constant = "1 ms"\n',
        "line 5: effects.sensor_lag.channel: unknown channel 'spool_positon'; did you mean 'spool_position'?",
    ),
    "sensor effect in another unit": (
        '[effects.sensor_bias]\nchannel = "spool_position"\nbias = "5 bar"\n',
        "line 6: effects.sensor_bias.bias: 'bar' has the wrong dimension; expected a unit that converts to 'm'",
    ),
    "sensor effect in a table of lists": (
        "[effects]\nsensor_bias = [3]\n",
        "line 5: effects.sensor_bias: expected a table of its parameters, got 3",
    ),
    "channel of what is no sensor": (
        '[effects.spool_lap]\noverlap = "1 um"\nchannel = "load_flow"\n',
        "line 6: effects.spool_lap: unknown parameter of effect spool_lap 'channel'",
    ),
    "too high a rate": ('[outputs]\nrate = "1 GHz"\n', "line 5: outputs.rate = 1e+09 Hz is outside (0, 1e+07] Hz"),
    "no rate": ('[outputs]\nrate = "0 Hz"\n', "line 5: outputs.rate = 0 Hz is outside (0, 1e+07] Hz"),
    "loose tolerance": ("[solver]\ntolerance = 1\n", "line 5: solver.tolerance = 1 - is outside [1e-10, 0.01] -"),
    "hot air": (
        '[thermal]\nambient_temperature = "1000 degC"\n',
        "line 5: thermal.ambient_temperature = 1000 °C is outside [-100, 400] °C",
    ),
    "cold start below absolute zero": (
        '[thermal]\ninitial_temperature = "-300 degC"\n',
        "line 5: thermal.initial_temperature = -300 °C is outside [-100, 400] °C",
    ),
    # what does not go together
    "closed torque motor": (
        '[valve]\nlength_1 = "7.3 mm"\n',
        "line 5: valve.length_2 must be larger than valve.length_1: the torque motor has no air gap",
    ),
    "return above supply": (
        '[valve]\nreturn_pressure = "30 MPa"\n',
        "line 5: valve.return_pressure must be below valve.supply_pressure",
    ),
    "commanded return above supply": (
        '[pressures]\nreturn = "30 MPa"\n',
        "line 4: pressures: at the start of the run, valve.return_pressure must be below valve.supply_pressure",
    ),
    "no supply at the start": (
        '[pressures]\nsupply = { step = { before = "0 bar", after = "21 MPa", time = "5 ms" } }\n',
        "line 4: pressures: at the start of the run, valve.supply_pressure = 0 Pa is outside (0, 1e+08] Pa",
    ),
    "negative supply": (
        '[pressures]\nsupply = { step = { before = "21 MPa", after = "-1 bar", time = "5.123 ms" } }\n',
        "line 5: pressures.supply: -1 bar at t = 0.005123 s is negative; it is absolute",
    ),
    "load above supply": (
        '[pressures]\nload = "30 MPa"\n',
        "line 4: pressures: at the start of the run, valve.load_pressure must be within the supply pressure",
    ),
    # form
    "text for a table": (
        '[effects]\nspool_coulomb_friction = "2 N"\n',
        "line 5: effects.spool_coulomb_friction: expected a table of",
    ),
    "text for a switch": (
        '[thermal]\nisothermal = "yes"\n',
        "line 5: thermal.isothermal: expected true or false, got 'yes'",
    ),
    "text for a list of routes": (
        '[thermal]\nroutes = "flow"\n',
        "line 5: thermal.routes: expected a list of route names, got 'flow'",
    ),
    "numbers as routes": (
        "[thermal]\nroutes = [1]\n",
        "line 5: thermal.routes: expected a list of route names, got [1]",
    ),
    "text for a list of channels": (
        '[outputs]\nchannels = "current"\n',
        "line 5: outputs.channels: expected a list of channel names, got 'current'",
    ),
    "a number as channels": (
        "[outputs]\nchannels = 3\n",
        "line 5: outputs.channels: expected a list of channel names, got 3",
    ),
    "repeated section": ('[[valve]]\nnull_gap = "1 mm"\n', "case.toml, line 4: valve: expected a table, got"),
    "two drives": (
        '[command.voltage]\nconstant = "1 V"\n',
        "command: give either [command.current] or [command.voltage]",
    ),
}


@pytest.mark.parametrize("text, message", WRONG.values(), ids=WRONG.keys())
def test_a_wrong_line_is_refused_by_name_and_number(refused, text, message):
    assert message in refused(BASE + text)


WRONG_COMMANDS = {
    "no duration": ('[command.current]\nconstant = "1 mA"\n', "duration is missing, such as duration = '1 s'"),
    "no time": (
        'duration = "0 s"\n[command.current]\nconstant = "1 mA"\n',
        "line 1: duration = 0 s is outside (0, 100000] s",
    ),
    "duration in metres": (
        'duration = "1 m"\n[command]\ncurrent = "1 mA"\n',
        "line 1: duration: 'm' has the wrong dimension",
    ),
    "unknown key at the top": (
        'duration = "1 s"\ntitel = "x"\n',
        "line 2: scenario: unknown key 'titel'; did you mean 'title'?",
    ),
    "no command": ("", "command: give either [command.current] or [command.voltage]"),
    "no command in its section": (
        "[command.current]\n",
        "line 2: command.current: needs a command, one of constant, step",
    ),
    "text for a section": ('oil = "big"\n', "line 2: oil: expected a table, got 'big'"),
    "drive": ("[command.curent]\n", "line 2: command: unknown key 'curent'; did you mean 'current'?"),
    "command": (
        "[command.current]\nsin = {}\n",
        "line 3: command.current: unknown command 'sin'; did you mean 'sine'?",
    ),
    "command key": (
        '[command.current]\nsine = { amplitud = "1 mA" }\n',
        "line 3: command.current.sine: unknown key 'amplitud'; did you mean 'amplitude'?",
    ),
    "voltage for a current": (
        '[command.current]\nsine = { amplitude = "1 V" }\n',
        "line 3: command.current.sine.amplitude: 'V' has the wrong dimension; expected a unit that converts to 'A'",
    ),
    "text for a command": (
        '[command.current]\nsine = "1 mA"\n',
        "line 3: command.current.sine: expected a table such as",
    ),
    "falling rate": (
        '[command.current]\nramp = { end_value = "1 mA", rate = "-1 mA/s" }\n',
        "line 3: command.current.ramp.rate = -0.001 A/s is outside (0, inf) A/s (size of the slope)",
    ),
    "short period": (
        '[command.current]\npulse = { width = "1 s", period = "0.5 s" }\n',
        "line 3: command.current.pulse.period = 0.5 s must be longer than pulse.width = 1 s",
    ),
    "half a step": (
        "[command.current]\nstaircase = { steps = 2.5 }\n",
        "line 3: command.current.staircase.steps = 2.5 must be a whole number",
    ),
    "text for a choice": (
        '[command.current]\nchirp = { logarithmic = "yes" }\n',
        "line 3: command.current.chirp.logarithmic: expected true or false, got 'yes'",
    ),
    "table without a file": (
        '[command.current]\ntable = "a.csv"\n',
        "line 3: command.current.table: expected { file = 'name.csv' }, got 'a.csv'",
    ),
    "table key": (
        '[command.current]\ntable = { file = "a.csv", colum = "x" }\n',
        "line 3: command.current.table: unknown key 'colum'; did you mean 'column'?",
    ),
}


@pytest.mark.parametrize("text, message", WRONG_COMMANDS.values(), ids=WRONG_COMMANDS.keys())
def test_a_wrong_command_or_duration_is_refused_by_name_and_number(refused, text, message):
    timed = text if "duration" in text or "duration" in message else 'duration = "1 s"\n' + text
    assert message in refused(timed)


@pytest.mark.parametrize("text", ["duration = \n", 'duration = "1 s"\nduration = "2 s"\n', "duration\n"])
def test_broken_toml_is_refused_with_its_place(refused, text):
    message = refused(text)
    assert "case.toml: not valid TOML" in message and "line" in message


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml: no such file; `valvesim scenarios` lists"):
        vs.load_scenario(tmp_path / "none.toml")


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        vs.load_scenario(tmp_path)


def test_a_file_that_is_not_text_is_refused(tmp_path):
    (tmp_path / "case.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"case\.toml: cannot be read"):
        vs.load_scenario(tmp_path / "case.toml")


def test_the_message_starts_with_the_path_as_it_was_given(load, tmp_path):
    with pytest.raises(InputError) as caught:
        load(BASE + "[vlave]\n")
    assert str(caught.value).startswith(f"{tmp_path / 'case.toml'}, line 4: ")


@given(st.text(), st.text("abcdefgh_. ", min_size=1, max_size=8))
def test_no_text_breaks_the_reader(tmp_path_factory, value, key):
    path = tmp_path_factory.getbasetemp() / "any.toml"
    for row in (f"null_gap = {json.dumps(value)}", f"{json.dumps(key)} = 1", f"{key} = 1"):
        path.write_text(BASE + f"[valve]\n{row}\n", encoding="utf-8")
        with pytest.raises(InputError, match=r"any\.toml"):
            vs.load_scenario(path)


# --- at every instant -------------------------------------------------------------------------------------------------

AT_ANY_TIME = {
    "a supply that swings below zero between any samples": (
        'supply = { sine = { amplitude = "300 bar", offset = "210 bar", frequency = "100 Hz" } }',
        "line 5: pressures.supply: -90 bar at t = 0.0075 s is negative; it is absolute",
    ),
    "a return that rises above the supply": (
        'return = { step = { after = "230 bar", before = "5 bar", time = "12 ms" } }',
        "line 5: pressures.return: 20 bar above the supply pressure at t = 0.012 s",
    ),
    "a return that meets the supply": (
        'return = { ramp = { start_value = "5 bar", end_value = "210 bar", rate = "20000 bar/s" } }',
        "line 5: pressures.return: at the supply pressure at t = 0.01025 s",
    ),
    "a supply that falls below the load": (
        'supply = { step = { before = "210 bar", after = "40 bar", time = "7 ms" } }\nload = "-50 bar"',
        "line 6: pressures.load: 10 bar beyond the supply pressure at t = 0.007 s",
    ),
    "a load that is beyond the supply for 10 us": (
        'load = { pulse = { height = "215 bar", width = "10 us", time = "8.123 ms" } }',
        "line 5: pressures.load: 5 bar beyond the supply pressure at t = 0.008123 s",
    ),
}


@pytest.mark.parametrize("text, message", AT_ANY_TIME.values(), ids=AT_ANY_TIME.keys())
def test_pressures_are_judged_at_every_instant(refused, text, message):
    assert message in refused(BASE + f"[pressures]\n{text}\n")


def test_pressures_that_swing_together_are_judged_at_the_same_instant(load):
    # the load reaches 220 bar, more than the least of the supply, but never at one time with it
    swing = '{ sine = { amplitude = "%s bar", offset = "%s bar", frequency = "100 Hz" } }'
    scenario = load(BASE + f"[pressures]\nsupply = {swing % (100, 210)}\nload = {swing % (100, 120)}\n")
    assert largest(scenario.load_pressure, 0.02) == pytest.approx(220e5)


def test_oil_is_refused_for_the_instant_at_which_it_leaves_the_laws(refused):
    oil = 'pulse = { base = "20 degC", height = "400 K", width = "10 us", time = "12.34 ms" }\n'
    message = "line 4: thermal.oil_temperature: oil mil_prf_5606: 420 °C at t = 0.01234 s is outside -100 to 400 °C"
    assert message in refused(BASE + "[thermal.oil_temperature]\n" + oil)


# --- differences of temperature ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", ["80 K", "80 degC", "80 °C", "144 degF", "80 delta_degC"])
def test_a_height_is_a_difference_from_the_base(load, height):
    oil = f'pulse = {{ base = "20 degC", height = "{height}", width = "10 ms", time = "5 ms" }}\n'
    scenario = load(BASE + "[thermal.oil_temperature]\n" + oil)
    assert evaluate(scenario.oil_temperature, [0.0, 0.01, 0.02]) == pytest.approx([20.0, 100.0, 20.0], abs=1e-9)


def test_a_level_in_a_sum_of_temperatures_is_given_in_celsius(load, refused):
    section = '[thermal.oil_temperature]\nconstant = "20 degC"\nstep = { after = "%s", time = "5 ms" }\n'
    assert evaluate(load(BASE + section % "80 degC").oil_temperature, [0.0, 0.01]) == pytest.approx([20.0, 100.0])
    message = "line 6: thermal.oil_temperature.step.after: '80 K' in a sum of commands may be a temperature or a diff"
    assert message in refused(BASE + section % "80 K")


# --- parts at their own temperatures ----------------------------------------------------------------------------------


def test_parts_start_at_their_own_temperatures_and_the_others_with_the_oil(load):
    parts = 'initial_temperature = { body = "60 degC", spool = "293.15 K" }\noil_temperature = "40 degC"\n'
    scenario = load(BASE + "[thermal]\n" + parts)
    assert scenario.thermal.initial_temperature == pytest.approx({"body": 60.0, "spool": 20.0})
    section = load(BASE + '[thermal.initial_temperature]\nbody = "60 degC"\n')
    assert section.thermal.initial_temperature == {"body": 60.0}
    values = simulate(scenario).values
    start = {name: values[f"{name}_temperature"][0] for name in ("oil", "body", "spool", "sleeve", "torque_motor")}
    expected = {"oil": 40.0, "body": 60.0, "spool": 20.0, "sleeve": 40.0, "torque_motor": 40.0}
    assert start == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    "text, message",
    [
        ('{ bdy = "60 degC" }', "line 5: thermal.initial_temperature: unknown key 'bdy'; did you mean 'body'?"),
        ('{ oil = "60 degC" }', "line 5: thermal.initial_temperature: unknown key 'oil'"),
        ('{ body = "60 bar" }', "line 5: thermal.initial_temperature.body: 'bar' has the wrong dimension"),
        ('{ body = "500 degC" }', "line 5: thermal.initial_temperature.body = 500 °C is outside [-100, 400] °C"),
        ('"500 degC"', "line 5: thermal.initial_temperature = 500 °C is outside [-100, 400] °C (every part"),
    ],
)
def test_a_wrong_start_of_a_part_is_refused(refused, text, message):
    assert message in refused(BASE + f"[thermal]\ninitial_temperature = {text}\n")


def test_a_part_of_a_thermal_made_in_python_is_held_to_its_names():
    with pytest.raises(InputError, match="thermal.initial_temperature: unknown part 'oil'"):
        vs.Thermal(initial_temperature={"oil": 20.0})


# --- what only the temperatures of the run tell ----------------------------------------------------------------------


def test_a_clearance_that_closes_names_part_and_temperature(load):
    # the pilot metal narrows the gap by a_p l_x dT (model.md 3): 35 um/(1e-4/K * 2 mm) = 175 K above 20 °C
    scenario = load(
        BASE + '[valve]\npilot_expansion = "1e-4 1/K"\nflapper_length = "2 mm"\n'
        '[thermal]\nisothermal = true\noil_temperature = "250 degC"\n'
    )
    with pytest.raises(InputError, match=r"null gap 1 closes when the pilot metal reaches 195 °C \(asked for 250 °C"):
        simulate(scenario)


def test_a_spool_that_is_pinched_in_its_sleeve_is_told(load):
    # radial clearance 3 um, spool diameter sqrt(4 * 16.8 mm^2/pi) = 4.625 mm: 3e-6/(2.3125e-3 * 1e-5/K) = 129.7 K
    scenario = load(
        BASE + '[valve]\nspool_expansion = "2.2e-5 1/K"\n[thermal]\nisothermal = true\noil_temperature = "270 degC"\n'
    )
    with pytest.raises(InputError, match=r"radial clearance closes when the spool reaches 149\.7 °C \(asked for 270"):
        simulate(scenario)


def test_oil_beyond_every_law_is_refused(load):
    message = "line 5: thermal.oil_temperature: oil mil_prf_5606: -300 °C at t = 0 s is outside"
    with pytest.raises(InputError, match=message):
        simulate(load(BASE + '[thermal]\noil_temperature = "-300 degC"\n'))


def test_throttling_heat_is_that_of_the_commanded_pressures(load):
    # half of dp (1 - alpha T)/(rho cp), so in proportion to dp: 21 - 0.5 MPa of the valve's own, or 6 - 1 MPa
    own, other = (
        simulate(load(BASE + text + "[thermal]\nisothermal = true\nthrottling_heat = true\n")).values[
            "oil_temperature"
        ][0]
        for text in ("", '[pressures]\nsupply = "6 MPa"\nreturn = "1 MPa"\n')
    )
    assert (other - 20.0) / (own - 20.0) == pytest.approx(5.0 / 20.5, rel=1e-9) and own > 22.0


# --- tables ----------------------------------------------------------------------------------------------------------

TABLE = 'duration = "1 s"\n[command.current]\ntable = { file = "data/a.csv" }\n'


@pytest.fixture
def csv(tmp_path):
    """Write the table that TABLE names."""

    def write(text):
        (tmp_path / "data").mkdir(exist_ok=True)
        (tmp_path / "data" / "a.csv").write_text(text, encoding="utf-8")

    return write


def test_a_table_is_found_beside_the_scenario_file_wherever_one_stands(load, csv, monkeypatch):
    csv("time [ms],current [mA]\n0,0\n500,2\n1000,-2\n")
    monkeypatch.chdir("/")
    assert evaluate(load(TABLE).command, [0.0, 0.25, 0.75, 1.0]) == pytest.approx([0.0, 1e-3, 0.0, -2e-3])


def test_a_table_may_stand_at_an_absolute_path(load, csv, tmp_path):
    csv("time [s],current [A]\n0,0\n1,0.002\n")
    absolute = TABLE.replace("data/a.csv", str(tmp_path / "data" / "a.csv"))
    assert evaluate(load(absolute).command, 0.5) == pytest.approx(1e-3)


def test_a_column_of_another_name_can_be_chosen(load, csv):
    csv("time [s],current [mA],bench [mA]\n0,0,0\n1,2,4\n")
    assert evaluate(load(TABLE.replace(" }", ', column = "bench" }')).command, 0.5) == pytest.approx(2e-3)


def test_a_table_of_temperature_names_its_column_so(load, csv):
    csv("oil_temperature [K],time [min]\n293.15,0\n353.15,1\n")
    oil = '[thermal.oil_temperature]\ntable = { file = "data/a.csv" }\n'
    assert evaluate(load(BASE + oil).oil_temperature, 30.0) == pytest.approx(50.0)


@pytest.mark.parametrize(
    "text, message",
    [
        ("time [s],current [mA]\n0,0\n1,\n2,1\n", "data/a.csv, line 3: gap in column 'current'"),
        ("time [s],current [mA]\n0,0\n1\n2,1\n", "data/a.csv, line 3: gap in column 'current'"),
        ("time [s],current [mA]\n0,0\n1,nan\n", "data/a.csv, line 3: nan in column 'current' is not a finite number"),
        ("time [s],current [mA]\n0,0\n1,x\n", "data/a.csv, line 3: 'x' in column 'current' is not a number"),
        ("time [s],current [mA]\n0,0\n2,1\n1,2\n", "times must rise, but row 3 (1 s) is before row 2 (2 s)"),
        ("time [s],current [mA]\n0,0\n1,1\n1,2\n", "times must rise, but row 3 (1 s) repeats row 2 (1 s)"),
        ("time [s],curent [mA]\n0,0\n1,1\n", "data/a.csv, line 1: no column 'current'; did you mean 'curent'?"),
        ("t [s],current [mA]\n0,0\n1,1\n", "data/a.csv, line 1: no column 'time'"),
        ("time [s],current\n0,0\n1,1\n", "data/a.csv, line 1: column 'current' needs a name and a unit"),
        ("time [s],current [bar]\n0,0\n1,1\n", "column 'current': 'bar' has the wrong dimension"),
        ("time [s],current [mA]\n0,0\n", "needs two or more points"),
        ("time [s],current [mA]\n", "data/a.csv: holds no data"),
        ("", "data/a.csv: holds no data"),
        ("time [s],current [mA]\n0,0\n1,1,5\n", "data/a.csv, line 3: 3 cells under 2 columns"),
    ],
)
def test_a_bad_table_is_refused_with_both_files_and_the_line_of_each(refused, csv, text, message):
    csv(text)
    told = refused(TABLE)
    assert told.startswith("case.toml, line 3: command.current.table: data/a.csv") and message in told


def test_a_missing_table_is_refused_with_the_line_that_names_it(refused):
    assert refused(TABLE) == "case.toml, line 3: command.current.table: data/a.csv: no such file"


# --- settings from the command line ----------------------------------------------------------------------------------


def test_settings_override_and_add_keys(load):
    scenario = load(
        BASE + '[valve]\nnull_gap = "0.04 mm"\n',
        "valve.null_gap=0.03 mm", "valve.spool_mass='5 g'", "thermal.isothermal=true", "thermal.routes=['mmf']",
        "solver.tolerance=1e-5", "command.current=2 mA", "duration = 1 s",
    )  # fmt: skip
    assert scenario.valve.null_gap == pytest.approx(3e-5) and scenario.valve.spool_mass == pytest.approx(5e-3)
    assert scenario.thermal.network is None and scenario.thermal.routes == ("mmf",)
    assert scenario.tolerance == 1e-5 and scenario.duration == 1.0
    assert evaluate(scenario.command, 0.0) == pytest.approx(2e-3)


def test_a_setting_reaches_into_a_command(load):
    scenario = load(
        'duration = "1 s"\n[command.current]\nstep = { after = "1 mA", time = "5 ms" }\n',
        "command.current.step.after=4 mA",
    )
    assert evaluate(scenario.command, [0.0, 0.5]) == pytest.approx([0.0, 4e-3])


def test_the_last_of_two_settings_rules(load):
    assert load(BASE, "duration=1 s", "duration=2 s").duration == 2.0


@pytest.mark.parametrize(
    "setting, message",
    [
        ("valve.null_gap", "--set 'valve.null_gap': expected KEY=VALUE"),
        ("=1 mm", "--set '=1 mm': expected KEY=VALUE"),
        ("valve..null_gap=1 mm", "--set 'valve..null_gap=1 mm': expected KEY=VALUE"),
        ("duration.x=1 mm", "--set 'duration.x=1 mm': 'duration' is a value, not a table"),
        ("valve.null_gap=1 bar", "--set 'valve.null_gap=1 bar': valve.null_gap: 'bar' has the wrong dimension"),
        ("valve.null_gap=0.03", "--set 'valve.null_gap=0.03': valve.null_gap: 0.03 has no unit"),
        ("valve.null_gap=", "--set 'valve.null_gap=': valve.null_gap: cannot read ''"),
        (
            "valve.nul_gap=1 mm",
            "--set 'valve.nul_gap=1 mm': valve: unknown parameter of Valve 'nul_gap'; did you mean 'null_gap'?",
        ),
        ("vlave.null_gap=1 mm", "scenario: unknown key 'vlave'; did you mean 'valve'?"),
        ("valve=3", "--set 'valve=3': valve: expected a table, got 3"),
    ],
)
def test_a_wrong_setting_is_refused_as_such(refused, setting, message):
    assert message in refused(BASE, setting)


def test_a_wrong_setting_is_not_blamed_on_the_line_that_it_overrides(refused):
    message = refused(BASE + '[valve]\nnull_gap = "0.03 mm"\n', "valve.null_gap=1 bar")
    assert message.startswith("--set 'valve.null_gap=1 bar': ") and "line" not in message


def test_a_wrong_line_is_not_blamed_on_a_setting(refused):
    message = refused(BASE + '[valve]\nnull_gap = "1 bar"\n', "valve.spool_mass=5 g")
    assert "case.toml, line 5: valve.null_gap" in message


def test_tables_of_valve_and_oil_are_read_from_settings_alone():
    own = read_tables(["valve.null_gap=0.03 mm", "oil.name=yh12_paper"])
    assert own.valve.null_gap == pytest.approx(3e-5) and own.oil.name == "yh12_paper"
    assert dataclasses.replace(own.valve, null_gap=vs.Valve().null_gap) == vs.Valve()
    with pytest.raises(InputError, match="--set: unknown key 'solver'"):
        read_tables(["solver.tolerance=1e-3"])


# --- the scenario itself ---------------------------------------------------------------------------------------------


def test_a_batch_of_supply_pressures_is_refused():
    valve = dataclasses.replace(vs.Valve(), supply_pressure=np.array([20e6, 21e6]))
    with pytest.raises(InputError, match=r"valve\.supply_pressure is an array: the valves of a batch run at one"):
        vs.Scenario(valve=valve)


@pytest.mark.parametrize("field, value", [("duration", 0.0), ("output_rate", -1.0), ("tolerance", 1.0)])
def test_a_scenario_made_in_python_is_held_to_the_same_bounds(field, value):
    with pytest.raises(InputError, match=rf"scenario\.{field} = .* is outside"):
        vs.Scenario(**{field: value})


@pytest.mark.parametrize(
    "command, drive, told",
    [
        (vs.Constant(value=10e-3), vs.CurrentDrive(), None),
        (vs.Constant(value=-10.1e-3), vs.CurrentDrive(), "up to 10.1 mA (t = 0 s) is beyond the rated current of 10"),
        (vs.Constant(value=6.0), vs.VoltageDrive(), None),  # over 600 ohm
        (vs.Constant(value=-9.0), vs.VoltageDrive(), "up to 15 mA (t = 0 s) is beyond the rated current of 10"),
    ],
)
def test_a_command_beyond_the_rated_current_is_told(command, drive, told, recwarn):
    vs.Scenario(command=command, drive=drive).warn_of_large_command()
    assert [str(warning.message) for warning in recwarn] == (
        [f"command: {told} mA; spool and flapper may reach their stops"] if told else []
    )
