"""Dither as a condition: upon the command of every test, taken off what is told, stated and judged."""

import numpy as np
import pytest
from click.testing import CliRunner

import valvesim as vs
from valvesim.characterisation.acceptance.acceptance_tests import acceptance_tests
from valvesim.characterisation.dither import NO_DITHER, Dither, dither_of
from valvesim.characterisation.frequency_response import frequency_response
from valvesim.characterisation.measured_valve import load_measured_valve
from valvesim.characterisation.response_set import amplitudes_of, measure_responses, response_tests
from valvesim.characterisation.step_response import step_response
from valvesim.cli.main import cli
from valvesim.errors import InputError
from valvesim.inputs import Constant
from valvesim.valve.catalogue import effect

DITHER = Dither(amplitude=0.05, frequency=333.0)


def values(figures):
    return {one.name: one.value for one in figures if hasattr(one, "value")}


def test_means_over_whole_periods_leave_what_moves_slowly():
    t = np.linspace(0.0, 2.0, 20001)
    slow = 3.0 + 0.5 * t
    told = DITHER.means({"time": t, "current": slow + 0.3 * np.sin(2 * np.pi * 333.0 * t)})
    assert told["current"] == pytest.approx(3.0 + 0.5 * told["time"], abs=2e-3)
    assert len(told["time"]) == 665
    coarse = {"time": t[::1000], "current": slow[::1000]}  # a meter that has averaged it
    assert np.array_equal(DITHER.means(coarse)["current"], coarse["current"])
    assert NO_DITHER.means(coarse) == coarse and NO_DITHER.upon(command := Constant(value=1.0), 1.0) is command


def test_a_record_of_less_than_two_periods_has_no_mean():
    t = np.linspace(0.0, 4e-3, 100)
    with pytest.raises(InputError, match="holds no two periods"):
        DITHER.means({"time": t, "current": t})


def test_dither_takes_friction_out_of_hysteresis_and_threshold():
    friction = (effect("spool_coulomb_friction")(friction_force=2.0),)
    still, dithered = (acceptance_tests(effects=friction, dither=one, points=3000) for one in (NO_DITHER, DITHER))
    without, with_it = values(still.figures), values(dithered.figures)
    assert without["flow.hysteresis"] == pytest.approx(0.0125, rel=0.02) and without["flow.threshold"] > 3e-3
    assert with_it["flow.hysteresis"] < 1e-3 and with_it["flow.threshold"] < 1e-4
    assert with_it["flow.flow_gain_positive"] == pytest.approx(without["flow.flow_gain_positive"], rel=1e-3)
    assert with_it["pressure-gain.pressure_gain"] == pytest.approx(without["pressure-gain.pressure_gain"], rel=1e-3)
    assert dithered.conditions["dither_frequency"] == 333.0 and still.conditions["dither_amplitude"] == 0.0


def test_of_a_valve_without_friction_a_small_response_is_what_it_was():
    valve = vs.reference_valve()
    still, dithered = (
        frequency_response(valve, amplitude=0.1 * valve.rated_current, frequencies=(5.0, 100.0, 267.0), dither=one)
        for one in (NO_DITHER, DITHER)
    )
    assert dithered.amplitude_ratio == pytest.approx(still.amplitude_ratio, abs=0.01)
    assert dithered.phase_lag == pytest.approx(still.phase_lag, abs=0.05)
    assert np.all(dithered.distortion < 1e-3)


def test_a_step_is_told_without_the_dither():
    valve = vs.reference_valve()
    still, dithered = (step_response(valve, amplitude=0.05 * valve.rated_current, dither=one)
                       for one in (NO_DITHER, DITHER))  # fmt: skip
    without, with_it = values(still.figures), values(dithered.figures)
    assert with_it["time_to_90_percent"] == pytest.approx(without["time_to_90_percent"], rel=0.01)
    assert with_it["change"] == pytest.approx(without["change"], rel=1e-3) and with_it["overshoot"] < 0.1


def test_a_limit_with_dither_is_judged_by_a_test_with_it_alone(tmp_path):
    (tmp_path / "page.toml").write_text(
        "[conditions]\ndither_amplitude = '5 %'\ndither_frequency = '333 Hz'\n"
        "[figures]\nfrequency_minus_90_deg = { low = '200 Hz', amplitude = '10 %' }\n"
        "time_to_90_percent = { high = '8 ms', amplitude = '50 %', dither_amplitude = '0 %' }\n"
        "phase_lag = { high = '60 deg', amplitude = '10 %', frequency = '100 Hz' }\n", encoding="utf-8",
    )  # fmt: skip
    specification, valve = vs.load_specification(tmp_path / "page.toml"), vs.reference_valve()
    steps, sweeps = amplitudes_of(specification)
    assert 0.5 in steps and 0.5 not in sweeps and 0.1 in sweeps and 0.1 not in steps
    told = {}
    for dither in (NO_DITHER, DITHER):
        sets = measure_responses(
            valve, steps=(0.5,), sweeps=(0.1,), frequencies=(5.0, 90.0, 110.0, 250.0, 300.0), chirp=False, dither=dither
        )
        measured = [(figure, at) for _, at, figures in response_tests(sets, valve, specification) for figure in figures]
        told[dither] = [one.verdict.value for one in vs.judge(specification, measured)]
    assert told == {NO_DITHER: ["not measured", "pass", "not measured"], DITHER: ["pass", "not measured", "pass"]}


def test_measured_records_state_their_dither(tmp_path):
    t = np.linspace(0.0, 20.0, 80001)
    i = 10.0 * np.interp(t, [0.0, 10.0, 20.0], [1.0, -1.0, 1.0])
    q = 2.0 * (i - 0.1) + 0.2 * np.sin(2 * np.pi * 333.0 * t)
    table = np.column_stack([t, i + 0.5 * np.sin(2 * np.pi * 333.0 * t), q])
    np.savetxt(tmp_path / "flow.csv", table, delimiter=",", comments="",
               header="time [s],current [mA],load_flow [L/min]", fmt="%.8g")  # fmt: skip
    head = 'rated_current = "10 mA"\n[conditions]\ndither_amplitude = "5 %"\n'
    records = '[[records]]\nfile = "flow.csv"\ntest = "flow"\n'
    (tmp_path / "acceptance.toml").write_text(head + 'dither_frequency = "333 Hz"\n' + records, encoding="utf-8")
    measured = load_measured_valve(tmp_path)
    told = {one.name: one.value for one, _ in measured.figures if hasattr(one, "value")}
    assert told["flow.flow_gain_positive"] == pytest.approx(2.0 / 6e4 / 1e-3, rel=2e-3)
    assert told["flow.null_bias"] == pytest.approx(0.01, abs=1e-3) and told["flow.hysteresis"] < 2e-3
    assert measured.tests[0].conditions["dither_frequency"] == 333.0
    (tmp_path / "acceptance.toml").write_text(head + records, encoding="utf-8")
    with pytest.raises(InputError, match="needs dither_frequency"):
        load_measured_valve(tmp_path)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--dither-amplitude", "2 %"], "go together"),
        (["--dither-amplitude", "80 %", "--dither-frequency", "400 Hz"], "--dither-amplitude: '80 %' is outside"),
        (["--dither-amplitude", "2 %", "--dither-frequency", "4 mm"], "--dither-frequency"),
    ],
)
@pytest.mark.parametrize("command", ["bench", "response"])
def test_a_dither_that_makes_no_sense_is_refused(command, arguments, message, tmp_path):
    outcome = CliRunner().invoke(cli, [command, "-o", str(tmp_path / "out"), *arguments])
    assert outcome.exit_code != 0 and message in str(outcome.exception) + outcome.output


def test_a_dither_of_nothing_needs_no_frequency():
    assert dither_of({}) == NO_DITHER and dither_of({"dither_amplitude": 0.0}) == NO_DITHER
