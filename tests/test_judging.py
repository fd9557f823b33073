"""Commands judge their figures by a specification: tables, rows for machines, and exit code 3 where one fails."""

import csv
import io
import json

import pytest
from click.testing import CliRunner

from valvesim.characterisation.acceptance.acceptance_tests import AcceptanceTests
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, merit_cells
from valvesim.characterisation.judgement_table import (
    asked_text,
    condition_text,
    interval_text,
    judgement_rows,
    limit_text,
    rows_of,
)
from valvesim.characterisation.specification import Limit, Specification, judge, load_specification
from valvesim.cli.judging import oil_temperatures
from valvesim.cli.main import COMMAND_NAMES, cli

PASSING = '[figures]\nrated_current = { high = "20 mA" }\nnull_leakage = { high = "2 L/min" }\n'
FAILING = PASSING + 'tare_leakage = { high = "0.1 L/min" }\nhysteresis = "3 %"\n'


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """`valvesim bench` on figures that are given: the verdict is what is tested here."""
    import valvesim as vs
    from valvesim.characterisation.acceptance import acceptance_tests as module
    from valvesim.reports import acceptance as report

    figures = (
        FigureOfMerit("leakage.null_leakage", 1.2 / 6e4, "m^3/s", "greatest leakage", 0.01 / 6e4),
        FigureOfMerit("leakage.tare", 0.4 / 6e4, "m^3/s", "least leakage", 0.01 / 6e4),
        Absent("flow.hysteresis", "too few points"),
    )
    monkeypatch.setattr(module, "acceptance_tests", lambda valve, oil_temperature, **_: AcceptanceTests(
        valve=valve, oil_temperature=oil_temperature, figures=figures, flow=None, blocked=None, flow_load=()))
    monkeypatch.setattr(report, "acceptance_report", lambda *_, **__: ())

    def run(specification, *more):
        path = tmp_path / "limits.toml"
        path.write_text(specification, encoding="utf-8")
        command = ["bench", "--spec", str(path), "-o", str(tmp_path / "out"), "--overwrite", *more]
        return CliRunner().invoke(cli, command)

    assert vs.Valve().rated_current == 10e-3
    return run


def test_a_valve_within_its_limits_ends_with_zero_and_one_out_of_them_with_three(bench):
    passed, failed = bench(PASSING), bench(FAILING)
    assert passed.exit_code == 0 and "pass" in passed.stdout and "fail" not in passed.stdout
    assert failed.exit_code == 3 and "fail" in failed.stdout
    assert "hysteresis" not in failed.stdout.partition("verdicts")[2]  # a value alone limits nothing


def test_rows_for_machines_have_figures_in_si_and_verdicts(bench):
    rows = json.loads(bench(FAILING, "--format", "json").stdout)
    (tare,) = [row for row in rows if row["figure"] == "leakage.tare"]
    assert tare["value"] == pytest.approx(0.4 / 6e4) and tare["unit"] == "m^3/s" and tare["uncertainty"] > 0.0
    assert [row["note"] for row in rows if row["figure"] == "flow.hysteresis"] == ["too few points"]
    verdicts = {row["figure"]: row["verdict"] for row in rows if row["test"] == "verdict"}
    assert verdicts == {"rated_current": "pass", "null_leakage": "pass", "tare_leakage": "fail"}
    table = list(csv.DictReader(io.StringIO(bench(FAILING, "--format", "csv").stdout)))
    assert [row["verdict"] for row in table if row["test"] == "verdict"] == ["pass", "pass", "fail"]


def test_a_specification_that_makes_no_sense_is_told_before_anything_runs(bench):
    told = bench("[figures]\ntare = '1 L/min'\n")
    assert told.exit_code == 1 and "unknown figure of a nozzle-flapper servo valve 'tare'" in str(told.exception)


def test_a_value_with_its_tolerance_is_told_to_it():
    limit = Limit(figure="rated_flow", value=9.56 / 6e4, low=9.2361 / 6e4, high=9.8839 / 6e4)
    assert asked_text(limit) == "9.56 ± 0.32 L/min"
    assert asked_text(Limit(figure="null_bias", value=0.002, low=0.001, high=0.004)) == "0.1 to 0.4 %"
    assert asked_text(Limit(figure="hysteresis", high=0.03)) == "at most 3 %"


def test_limits_and_conditions_are_told_as_people_read_them():
    limit = Limit(figure="rated_flow", low=34.2 / 6e4, high=41.8 / 6e4)
    assert limit_text(limit) == "34.2 to 41.8 L/min"
    assert limit_text(Limit(figure="hysteresis", high=0.03)) == "at most 3 %"
    assert limit_text(Limit(figure="frequency_minus_90_deg", low=110.0)) == "at least 110 Hz"
    assert limit_text(Limit(figure="pressure_gain_share", value=30.0)) == "30"
    conditions = {"supply_pressure": 21e6, "amplitude": 0.4, "temperature_difference": 55.0}
    assert condition_text(conditions, ("supply_pressure",)) == "amplitude 40 %, temperature difference 55 K"
    assert interval_text(3.5e-5, 3e-5, 4e-5, "m") == ("35.00", "30.00 to 40.00", "um")
    assert interval_text(2720.0, 1785.0, 4144.0, "N/m")[:2] == ("2720", "1780 to 4140")


def test_large_uncertainties_round_their_figures_and_nothing_is_minus_zero():
    assert merit_cells(FigureOfMerit("pressure_gain", 2816e8, "Pa/A", "", 2468e8)) == ("2800", "2500", "bar/mA")
    assert merit_cells(FigureOfMerit("null_bias", -1e-9, "1", "", 4.9e-5)) == ("0.0000", "0.0049", "%")


@pytest.mark.parametrize(
    "figure, told",
    [
        (FigureOfMerit("overshoot", 3.5946e-7, "%", ""), ("0", "", "%")),
        (FigureOfMerit("overshoot", 3.5946, "%", ""), ("3.5946", "", "%")),
        (FigureOfMerit("rated_flow", 38.2142 / 6e4, "m^3/s", "", 0.5 / 6e4), ("38.21", "0.50", "L/min")),
    ],
)
def test_figures_are_told_to_what_is_known_of_them(figure, told):
    assert merit_cells(figure) == told


def test_rows_of_an_absent_figure_say_why():
    (row,) = rows_of([("flow", {"amplitude": 0.4}, (Absent("lap", "a polarity has no line"),))])
    assert row["note"] == "a polarity has no line" and row["value"] is None and row["conditions"] == "amplitude=0.4"


@pytest.mark.parametrize("command", sorted(set(COMMAND_NAMES) - {"export", "open"}))  # which tell nothing
def test_every_command_has_a_form_for_machines(command):
    assert "--format" in CliRunner().invoke(cli, [command, "--help"]).stdout


@pytest.mark.parametrize("command", ["effects", "parameters", "oils", "scenarios"])
@pytest.mark.parametrize("form", ["json", "csv"])
def test_catalogues_are_told_to_machines(command, form):
    told = CliRunner().invoke(cli, [command, "--format", form], catch_exceptions=False).stdout
    rows = json.loads(told) if form == "json" else list(csv.DictReader(io.StringIO(told)))
    assert len(rows) > 3 and len({tuple(row) for row in rows}) == 1


@pytest.mark.parametrize(
    "given, conditions, told",
    [(None, "", [20.0]), (None, "[conditions]\noil_temperature = '40 degC'\n", [40.0]), ("20, 95 degC", "", [20, 95])],
)
def test_a_command_tests_at_the_oil_temperature_of_its_specification(tmp_path, given, conditions, told):
    (tmp_path / "page.toml").write_text(f"{conditions}[figures]\nthreshold = {{ high = '1 %' }}\n", encoding="utf-8")
    assert oil_temperatures(given, load_specification(tmp_path / "page.toml")) == told
    assert oil_temperatures("30 degC", None) == [30.0]


def test_a_verdict_says_which_test_shows_the_figure():
    limit = Limit(figure="hysteresis", high=0.03)
    shown_by = [FigureOfMerit(name, 0.02, "1", "") for name in ("flow.hysteresis", "pressure-gain.hysteresis")]
    flow = Limit(figure="rated_flow", low=30.0 / 6e4)
    shown_by.append(FigureOfMerit("flow-load.rated_flow_negative", 33.0 / 6e4, "m^3/s", ""))
    judged = judge(Specification(limits=(limit, flow)), [(one, {}) for one in shown_by])
    names = [row[0] for row in judgement_rows(judged)]
    assert names == ["hysteresis (flow)", "hysteresis (pressure-gain)", "rated flow (flow-load negative)"]
    absent = judge(Specification(limits=(flow,)), [])
    assert judgement_rows(absent)[0][0] == "rated flow"
