"""A valve file: read strictly, written so that it reads back equal, and taken by scenarios, sessions and commands."""

import dataclasses
import json

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import valvesim as vs
from valvesim.characterisation.lumped_figures import lumped_figures
from valvesim.cli.main import cli
from valvesim.errors import InputError
from valvesim.identification.session_toml import load_session
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.units import POSITIVE, quantities
from valvesim.valve.oils import OILS
from valvesim.valve.valve_file import PRESETS

OWN = """
title = "Bench valve"
serial_number = "SN 7"

[valve]
rated_current = { value = "40 mA", source = "name plate" }
null_gap = { value = "38 um", tolerance = "10 %", source = "identified" }
nozzle_diameter = { value = "0.3 mm", tolerance = "6 um" }
spool_mass = "5 g"

[oil]
name = "mil_prf_83282"
density_at_20 = { value = "850 kg/m^3", source = "weighed" }

[effects.spool_coulomb_friction]
friction_force = "0.5 N"

[correlations]
null_gap = { nozzle_diameter = -0.9 }
"""


@pytest.fixture
def own(tmp_path):
    (tmp_path / "mine.toml").write_text(OWN, encoding="utf-8")
    return tmp_path


def test_a_valve_file_has_figures_sources_tolerances_oil_and_effects(own):
    read = vs.load_valve(own / "mine.toml")
    assert read.valve.rated_current == pytest.approx(0.04) and read.valve.spool_mass == pytest.approx(5e-3)
    assert read.valve.name == "Bench valve, serial number SN 7"
    assert read.sources == {"valve.rated_current": "name plate", "valve.null_gap": "identified",
                            "oil.density_at_20": "weighed"}  # fmt: skip
    assert read.tolerances == pytest.approx({"null_gap": 3.8e-6, "nozzle_diameter": 6e-6})
    assert read.oil.name == "mil_prf_83282" and read.oil.density_at_20 == pytest.approx(850.0)
    assert [active.effect.name for active in read.effects] == ["spool_coulomb_friction"]
    names, covariance = read.covariance()
    assert names == ("null_gap", "nozzle_diameter")
    np.testing.assert_allclose(covariance, [[1.9e-6**2, -0.9 * 1.9e-6 * 3e-6], [-0.9 * 1.9e-6 * 3e-6, 3e-6**2]])


def drawn_valves():
    def figure(name):
        field = quantities(vs.Valve)[name]
        low, high = field.metadata["bounds"]
        value = field.default
        near = (max(low, value - 0.01 * abs(value)), min(high, value + 0.01 * abs(value)))
        return st.floats(*near, allow_subnormal=False) if low != POSITIVE or near[0] > low else st.just(value)

    names = st.lists(st.sampled_from(sorted(quantities(vs.Valve))), unique=True, max_size=5)
    return names.flatmap(lambda chosen: st.fixed_dictionaries({name: figure(name) for name in chosen}))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(figures=drawn_valves(), source=st.text(max_size=40).filter(str.isprintable),
       oil=st.sampled_from(sorted(OILS)), width=st.floats(1e-9, 1e-5))  # fmt: skip
def test_what_is_written_reads_back_equal(tmp_path, figures, source, oil, width):
    described = vs.ValveFile(
        title="drawn", serial_number=source, valve=dataclasses.replace(vs.Valve(), **figures), oil=OILS[oil],
        effects=(vs.effect("spool_coulomb_friction")(friction_force=0.25),),
        sources={"valve.null_gap": source}, tolerances={"null_gap": width, "spool_mass": 1e-4},
        correlations={("null_gap", "spool_mass"): 0.125},
    )  # fmt: skip
    path = vs.save_valve(described, tmp_path / "drawn.toml")
    assert vs.load_valve(path) == described


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_valve_of_the_package_rests_at_null_and_reads_back(name, tmp_path):
    preset = vs.load_valve(name)
    assert abs(float(vs.static_solution(preset.valve, current=0.0).spool_position)) < 2e-5
    assert vs.load_valve(vs.save_valve(preset, tmp_path / "again.toml")) == preset


def test_the_nasa_valve_has_its_published_lumps():
    valve = vs.load_valve("nasa_tn_d_5388").valve
    lumps = {f.name: f.value for f in lumped_figures(Scenario(valve=valve, thermal=Thermal(network=None)))}
    assert lumps["armature_frequency"] == pytest.approx(730.0, rel=1e-3)
    assert lumps["loop_gain"] == pytest.approx(837.0, rel=5e-3)
    assert lumps["speed_limit"] == pytest.approx(0.18, rel=0.05)


@pytest.mark.parametrize(
    "text, message",
    [
        ('[valve]\nnull_gap = { value = "38 um", sauce = "x" }\n', "line 2: valve.null_gap: unknown key 'sauce'"),
        ('[valve]\nnull_gap = { source = "x" }\n', "line 2: valve.null_gap needs a value"),
        ('[valve]\nnul_gap = "38 um"\n', "line 2: valve: unknown parameter of Valve 'nul_gap'; did you mean"),
        ('[valve]\nnull_gap = { value = "38 mm" }\n', "line 2: valve.null_gap = 0.038 m is outside (0, 0.001] m"),
        ('[valve]\nnull_gap = { value = "38 um", tolerance = "-3 um" }\n', "line 2: valve.null_gap.tolerance: '-3 um'"),
        ('[oil]\nname = { value = "castor" }\n', "unknown oil 'castor'"),
        ('duration = "1 s"\n', "unknown key 'duration'"),
        ('title = "a\\u0007b"\n', "line 1: title: holds the control character"),
        ("[correlations]\nnull_gap = { spool_mass = 0.5 }\n", "unknown parameter with a tolerance 'null_gap'"),
    ],
)  # fmt: skip
def test_a_bad_valve_file_is_refused_with_its_place(tmp_path, text, message):
    (tmp_path / "bad.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        vs.load_valve(tmp_path / "bad.toml")
    assert message in str(refused.value) and "bad.toml" in str(refused.value)


def test_a_name_that_is_no_file_tells_of_the_valves_that_are_known(tmp_path):
    with pytest.raises(InputError, match="no such file; a valve is a TOML file or one of .*mean 'nasa_tn_d_5388'"):
        vs.load_valve("nasa_tn_d_5838", folder=tmp_path)


CASE = """duration = "10 ms"
{valve}
[command.current]
constant = "1 mA"
"""


@pytest.mark.parametrize("valve", ['valve = "mine.toml"', '[valve]\nfile = "mine.toml"'])
def test_a_scenario_takes_a_valve_file_beside_it(own, valve):
    (own / "case.toml").write_text(CASE.format(valve=valve), encoding="utf-8")
    case = vs.load_scenario(own / "case.toml", settings=["valve.spool_mass=6 g"])
    assert case.valve.rated_current == pytest.approx(0.04) and case.valve.spool_mass == pytest.approx(6e-3)
    assert case.oil.name == "mil_prf_83282" and len(case.effects) == 1
    assert "changed: spool mass" in case.valve.name
    other = vs.load_scenario(own / "case.toml", valve="nasa_tn_d_5388", settings=["oil.name=yh12_paper"])
    assert other.valve == vs.load_valve("nasa_tn_d_5388").valve and other.oil.name == "yh12_paper"
    assert other.effects == ()


def test_a_wrong_valve_file_is_told_with_both_places(own):
    (own / "case.toml").write_text(CASE.format(valve='valve = "bad.toml"'), encoding="utf-8")
    (own / "bad.toml").write_text('[valve]\nnull_gap = "0 m"\n', encoding="utf-8")
    with pytest.raises(InputError, match=r"case\.toml, line 2: valve: .*bad\.toml, line 2: valve\.null_gap = 0 m"):
        vs.load_scenario(own / "case.toml")


def test_a_session_takes_a_valve_file_with_its_tolerances(own):
    t = np.arange(400) / 400.0
    i = 2e-3 * np.sin(9.0 * t)
    rows = "\n".join(f"{a:.6g},{b * 1e3:.6g},{0.1 * b:.6g}" for a, b in zip(t, i, strict=True))
    (own / "one.csv").write_text(f"time [s],current [mA],spool_position [m]\n{rows}\n", encoding="utf-8")
    (own / "session.toml").write_text(
        'valve = "mine.toml"\n[tolerances]\nspool_mass = "20 %"\n[[records]]\nfile = "one.csv"\n', encoding="utf-8"
    )
    session = load_session(own)
    assert session.valve.rated_current == pytest.approx(0.04)
    assert session.tolerances == pytest.approx({"null_gap": 3.8e-6, "nozzle_diameter": 6e-6, "spool_mass": 1e-3})
    assert [active.effect.name for active in session.effects] == ["spool_coulomb_friction"]
    assert load_session(own, valve="reference").valve == vs.Valve()


def test_commands_take_a_valve_file(own):
    arguments = ["static", "--current", "1 mA", "--oil-temperature", "20 degC", "--format", "json"]
    mine = CliRunner().invoke(cli, [*arguments, "--valve", str(own / "mine.toml")], catch_exceptions=False)
    read = vs.load_valve(own / "mine.toml")
    rest = vs.static_solution(read.valve, current=1e-3, temperature=20.0, oil=read.oil)
    assert json.loads(mine.stdout)[0]["spool_position_m"] == pytest.approx(float(rest.spool_position))
    for command in ("static", "bench", "response", "datasheet", "run", "diagnose"):
        assert "--valve" in CliRunner().invoke(cli, [command, "--help"]).stdout
