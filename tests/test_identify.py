"""A valve identified from the figures of a specification: what is reached, intervals, conflicts, what to measure."""

import dataclasses
import json

import numpy as np
import pytest
from click.testing import CliRunner

import valvesim as vs
from valvesim.characterisation.acceptance.acceptance_tests import acceptance_tests
from valvesim.characterisation.specification import FIGURES
from valvesim.cli.main import cli
from valvesim.errors import InputError
from valvesim.identification.from_figures.identify import identify
from valvesim.identification.from_figures.options import FromFiguresOptions, SimilarityOptions
from valvesim.identification.from_figures.prediction import FITTED, FigurePredictor, asked_of
from valvesim.identification.from_figures.similarity import UNKNOWNS, similar_valves
from valvesim.identification.from_figures.static_figures import static_figures
from valvesim.units import quantities

CONDITIONS = {"supply_pressure": 21e6, "return_pressure": 0.5e6, "oil_temperature": 40.0}
PAGE = """
title = "38 L/min"
[conditions]
supply_pressure = "210 bar"
oil_temperature = "40 degC"
[figures]
rated_current = "40 mA"
coil_resistance = { value = "80 ohm", tolerance = "10 %" }
rated_flow = { value = "38 L/min", tolerance = "10 %", pressure_drop = "70 bar" }
hysteresis = "2 %"
tare_leakage = { high = "0.9 L/min" }
pressure_gain_share = { low = "30" }
null_bias = { high = "2 %" }
frequency_minus_90_deg = { value = "110 Hz", amplitude = "40 %" }
time_to_90_percent = { high = "8 ms" }
"""


@pytest.fixture
def read(tmp_path):
    def load(text):
        (tmp_path / "page.toml").write_text(text, encoding="utf-8")
        return vs.load_specification(tmp_path / "page.toml")

    return load


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    path = tmp_path_factory.mktemp("identify") / "page.toml"
    path.write_text(PAGE, encoding="utf-8")
    return identify(vs.load_specification(path))


def test_every_figure_of_a_page_is_reached_within_its_limits(found):
    assert all(figure.reached for figure in found.figures) and found.conflicts == ()
    assert {figure.asked.limit.figure for figure in found.figures} == {
        "coil_resistance", "rated_flow", "tare_leakage", "pressure_gain_share", "null_bias", "frequency_minus_90_deg",
        "time_to_90_percent",
    }  # fmt: skip


def test_the_internals_stay_near_similarity_and_say_whether_they_are_assumed(found):
    by_name = {p.name: p for p in found.parameters}
    for name, p in by_name.items():
        low, high = quantities(vs.Valve)[name].metadata["bounds"]
        assert low <= p.value <= high and p.low < p.high and (p.similar == 0.0 or 0.4 < p.value / p.similar < 2.5), name
    assert by_name["coil_resistance"].identified and not by_name["spool_mass"].identified
    assert found.valve.sources["valve.spool_mass"].startswith("assumed")
    assert found.valve.sources["valve.port_width"].startswith("identified")


def test_the_valve_is_written_runs_and_has_its_hysteresis(found, tmp_path):
    path = vs.save_valve(found.valve, tmp_path / "valve.toml")
    read = vs.load_valve(path)
    assert read == found.valve and read.valve.name == "38 L/min"
    (hysteresis,) = read.effects
    assert hysteresis.effect.name == "magnetic_hysteresis"
    assert hysteresis.values.coercive_current == pytest.approx(0.01 * 40e-3)
    names, covariance = read.covariance()
    assert np.all(np.linalg.eigvalsh(covariance / np.outer(*2 * [np.sqrt(np.diag(covariance))])) > -1e-12)


def test_what_to_measure_next_is_what_narrows_most(found):
    gains = [one.gain for one in found.next_figures]
    assert gains == sorted(gains, reverse=True) and gains[0] > 0.5
    assert all(one.after <= one.before for one in found.next_figures)
    asked = {(f.asked.limit.figure, f.asked.limit.conditions.get("amplitude")) for f in found.figures}
    assert not asked & {(one.limit.figure, one.limit.conditions.get("amplitude")) for one in found.next_figures}


def test_what_was_not_told_is_expected_where_its_valve_has_it(found):
    conditions = CONDITIONS | dict(found.specification.conditions)
    asked = tuple(asked_of(dataclasses.replace(one.limit, value=one.expected)) for one in found.next_figures)
    own = FigurePredictor(asked, conditions, found.specification.oil).predict(found.valve.valve, 1)[0]
    for one, value in zip(found.next_figures, own, strict=True):
        assert value == pytest.approx(one.expected, rel=0.01), one.limit.figure
        assert 0.0 < one.interval[0] < one.expected < one.interval[1]


def test_of_two_kinds_of_valve_that_fit_alike_the_wider_is_likelier(found):
    near = found.posterior
    narrow = dataclasses.replace(near, slopes=2.0 * near.slopes)
    assert near.log_evidence > narrow.log_evidence
    assert near.log_evidence > dataclasses.replace(near, chi_square=near.chi_square + 1.0).log_evidence


def test_a_coil_of_any_power_in_print_is_reached(read):
    answer = identify(read("""
[figures]
rated_current = "400 mA"
coil_resistance = "20 ohm"
rated_flow = "38 L/min"
"""))
    assert answer.conflicts == () and all(one.limit.figure[:4] != "coil" for one in answer.next_figures)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_valve(found):
    assert identify(found.specification).valve == found.valve


@pytest.mark.slow
def test_the_figures_told_fast_are_those_of_the_bench():
    valve = dataclasses.replace(vs.Valve(), air_gap_difference=2e-6, null_gap_difference=0.5e-6)
    conditions = CONDITIONS | {"oil_temperature": 20.0, "pressure_drop": 7e6, "temperature_difference": 38.0}
    names = {"flow_gain", "flow_at_rated", "null_bias", "pressure_gain", "null_leakage", "tare_leakage", "rated_flow",
             "linearity", "null_shift_temperature"}  # fmt: skip
    fast = static_figures(valve, names, conditions, vs.MIL_PRF_5606)
    bench = {f.name: f.value for f in acceptance_tests(valve, points=4000).figures if hasattr(f, "value")}
    for name in names:
        shown = [bench[one] for one in FIGURES[name].shown_by if one in bench]
        near = 0.1 if name in ("null_shift_temperature", "linearity") else 5e-3
        assert fast[name][0] == pytest.approx(np.mean(shown), rel=near), name


@pytest.mark.slow
def test_a_batch_is_predicted_as_each_valve_alone():
    similar = similar_valves(
        rated_flow=15.0 / 6e4, pressure_drop=7e6, rated_current=0.02, conditions=CONDITIONS, oil=vs.MIL_PRF_5606
    )
    points = np.random.default_rng(3).normal(size=(3, len(UNKNOWNS)))
    limits = [vs.Limit(figure=name, value=80.0 if FIGURES[name].unit == "Hz" else 5e-3,
                       conditions={k: v or 60.0 for k, v in FIGURES[name].conditions.items()})
              for name in FITTED]  # fmt: skip
    predictor = FigurePredictor(tuple(map(asked_of, limits)), CONDITIONS, vs.MIL_PRF_5606)
    together = predictor.predict(similar.valves(points), 3)
    for k in range(3):
        alone = predictor.predict(similar.valves(points[k : k + 1]), 1)
        np.testing.assert_allclose(together[k], alone[0], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("flow, current", [(1.0, 10e-3), (250.0, 0.1), (38.0, 40e-3)])
def test_valves_drawn_by_similarity_are_stable_and_pass_about_their_rated_flow(flow, current):
    similar = similar_valves(
        rated_flow=flow / 6e4, pressure_drop=7e6, rated_current=current, conditions=CONDITIONS, oil=vs.MIL_PRF_5606
    )
    points = np.vstack([np.zeros(len(UNKNOWNS)), np.random.default_rng(1).normal(size=(30, len(UNKNOWNS)))])
    valves = similar.valves(points)
    rated = static_figures(valves, {"rated_flow"}, CONDITIONS | {"pressure_drop": 7e6}, vs.MIL_PRF_5606)["rated_flow"]
    assert rated[0] == pytest.approx(flow / 6e4, rel=0.2) and np.all((rated > 0.2 * rated[0]) & (rated < 5 * rated[0]))
    rest = vs.static_solution(valves, current=0.0, temperature=40.0)
    assert np.all(np.abs(rest.spool_position) < 0.2 * valves.spool_stroke)


@pytest.mark.parametrize(
    "text, message",
    [
        ("rated_current = '40 mA'\n", "figures.rated_flow is missing: the size of a valve is told by it"),
        ("rated_flow = '38 L/min'\n", "figures.rated_current is missing"),
        ("rated_current = '40 mA'\nrated_flow = { low = '38 L/min' }\n", "figures.rated_flow has one limit alone"),
        ("rated_current = '2.7 A'\nrated_flow = '38 L/min'\n", "figures.rated_current: 2700 mA: two-stage"),
        ("rated_current = '40 mA'\nrated_flow = { value = '600 L/min', pressure_drop = '5 bar' }\n", "2245"),
    ],
)  # fmt: skip
def test_a_specification_that_tells_no_valve_is_refused(read, text, message):
    with pytest.raises(InputError) as refused:
        identify(read(f"[figures]\n{text}"))
    assert message in str(refused.value)


def test_which_valves_there_are_goes_by_the_options():
    size = {"rated_flow": 15.0 / 6e4, "pressure_drop": 7e6, "rated_current": 0.02, "oil": vs.MIL_PRF_5606}
    usual = similar_valves(**size, conditions=CONDITIONS)
    wide = FromFiguresOptions(similarity=SimilarityOptions(stop=2.0))
    ends = [one.valves(np.zeros((1, len(UNKNOWNS)))).spool_stroke[0]
            for one in (usual, similar_valves(**size, conditions=CONDITIONS, options=wide))]  # fmt: skip
    assert ends[1] / ends[0] == pytest.approx(2.0 / 1.3, rel=0.01)
    small = FromFiguresOptions(similarity=SimilarityOptions(flows=(1.0 / 6e4, 10.0 / 6e4)))
    with pytest.raises(InputError, match="15 L/min"):
        similar_valves(**size, conditions=CONDITIONS, options=small)


@pytest.mark.slow
def test_figures_that_exclude_each_other_are_told_with_the_reason(read):
    answer = identify(read("""
[figures]
rated_current = "40 mA"
rated_flow = { value = "38 L/min", tolerance = "10 %" }
flow_gain = { value = "3 L/min/mA", tolerance = "5 %" }
null_leakage = { high = "0.5 L/min" }
pressure_gain_share = { high = "15" }
"""))  # fmt: skip
    told = {c.figure.limit.figure: ({a.limit.figure for a in c.against}, c.reason) for c in answer.conflicts}
    assert told["rated_flow"][0] == {"flow_gain"} and "root of the pressure drops" in told["rated_flow"][1]
    assert told["flow_gain"][0] == {"rated_flow"}
    assert any("opening at null" in reason for _, reason in told.values())


def test_a_valve_of_another_type_is_refused_with_its_file_and_line(tmp_path):
    page = tmp_path / "page.toml"
    page.write_text("[figures]\nrated_flow = '40 L/min'\nrated_current = '1.2 A'\n", encoding="utf-8")
    refused = CliRunner().invoke(cli, ["identify", str(page), "-o", str(tmp_path / "mine.toml")])
    assert "page.toml, line 3: figures.rated_current: 1200 mA" in str(refused.exception)
    assert "have 1 to 1000" in str(refused.exception) and not (tmp_path / "mine.toml").exists()


def test_the_command_writes_a_valve_and_tells_rows(tmp_path, found, monkeypatch):
    monkeypatch.setattr("valvesim.identification.from_figures.identify.identify", lambda *_, **__: found)
    (tmp_path / "page.toml").write_text(PAGE, encoding="utf-8")
    command = ["identify", str(tmp_path / "page.toml"), "-o", str(tmp_path / "mine.toml")]
    table = CliRunner().invoke(cli, command, catch_exceptions=False)
    assert "measure next" in table.stdout and "assumed" in table.stdout
    assert "expected of what was not told" in table.stdout and "amplitude 25 %" in table.stdout
    refused = CliRunner().invoke(cli, command)
    assert "stands there already; name another file, or give --overwrite" in str(refused.exception)
    again = [*command, "--overwrite", "--format", "json"]
    rows = json.loads(CliRunner().invoke(cli, again, catch_exceptions=False).stdout)
    assert {row["kind"] for row in rows} == {"figure", "parameter", "next figure"}
    flow = next(row for row in rows if row["name"] == "rated_flow")
    assert flow["asked_low"] == pytest.approx(34.2 / 6e4) and flow["asked_high"] == pytest.approx(41.8 / 6e4)
    assert vs.load_valve(tmp_path / "mine.toml") == found.valve
