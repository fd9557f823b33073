"""A measured valve: every test that its records allow, with instruments and conditions, judged and reported."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from picture_texts import check_texts
from scipy import signal

import valvesim as vs
from valvesim.characterisation.acceptance.coil import coil_figures
from valvesim.characterisation.acceptance.measured_threshold import measured_threshold
from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.characterisation.figure_of_merit import Absent
from valvesim.characterisation.measured_valve import load_measured_valve, measured_tests
from valvesim.characterisation.spectral_response import spectral_response
from valvesim.cli.judging import judged_by
from valvesim.cli.main import cli
from valvesim.errors import InputError
from valvesim.identification.from_figures.measured_figures import measured_limits, model_figures, with_measurements
from valvesim.reports.measured_valve import draw_result

RATED, GAIN, HYSTERESIS, NULL = 10e-3, 2.0 / 6e4 / 1e-3, 0.2e-3, 0.1e-3  # A, m^3/s/A, A, A
FREQUENCY, DAMPING = 120.0, 0.7
HEAD = """title = "Bench valve"
serial_number = "7"
rated_current = "10 mA"
[conditions]
supply_pressure = "210 bar"
"""


def triangle(points=4000, top=RATED):
    """Time and current of a full cycle from its upper end."""
    t = np.linspace(0.0, 100.0, points)
    return t, top * np.interp(t, [0.0, 50.0, 100.0], [1.0, -1.0, 1.0])


def flow_rows(null=NULL, noise=0.0, seed=0):
    """A flow curve with hysteresis and null bias."""
    t, i = triangle()
    side = np.where(np.gradient(i) > 0.0, 1.0, -1.0)
    q = GAIN * (i - null - side * HYSTERESIS / 2.0)
    return t, i, q + noise * np.random.default_rng(seed).normal(size=len(t))


def write(folder, name, **columns):
    heads = {"t": "time [s]", "i": "current [mA]", "q": "load_flow [L/min]", "x": "spool_position [mm]",
             "u": "voltage [V]"}  # fmt: skip
    scales = {"t": 1.0, "i": 1e3, "q": 6e4, "x": 1e3, "u": 1.0}
    table = np.column_stack([values * scales[key] for key, values in columns.items()])
    header = ",".join(heads[key] for key in columns)
    np.savetxt(folder / name, table, delimiter=",", header=header, comments="", fmt="%.9g")


def second_order(t, u):
    w = 2 * np.pi * FREQUENCY
    return signal.lsim(([w * w], [1.0, 2 * DAMPING * w, w * w]), u, t)[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a record of every test."""
    place = tmp_path_factory.mktemp("measured")
    t, i, q = flow_rows(noise=0.002 / 6e4)
    write(place, "flow.csv", t=t, i=i, q=q)
    t, i, q = flow_rows(null=NULL + 0.1e-3, noise=0.002 / 6e4, seed=1)
    write(place, "flow_hot.csv", t=t, i=i, q=q)
    t = np.arange(4000) / 1e5
    i = np.where(t < 2e-3, 0.0, 2.5e-3)
    write(place, "step.csv", t=t, i=i, x=second_order(t, 0.04 * i))
    t = np.arange(60000) / 1e4
    i = 4e-3 * signal.chirp(t, 5.0, 6.0, 400.0, method="linear")
    write(place, "chirp.csv", t=t, i=i, x=second_order(t, 0.04 * i))
    t = np.linspace(0.0, 1.0, 2001)
    u = 6.0 * np.sin(2 * np.pi * 20.0 * t)
    w = 2 * np.pi * 20.0
    current = 6.0 / np.hypot(800.0, w * 2.0) * np.sin(w * t - np.arctan2(w * 2.0, 800.0))
    write(place, "coil.csv", t=t, u=u, i=current)
    (place / "acceptance.toml").write_text(
        HEAD + 'oil_temperature = "40 degC"\n' + "\n".join(
            f'[[records]]\nfile = "{name}.csv"\ntest = "{test}"\n{more}'
            for name, test, more in (
                ("coil", "coil", ""), ("chirp", "chirp", ""), ("step", "step", ""), ("flow", "flow", ""),
                ("flow_hot", "flow", 'oil_temperature = "80 degC"\n'),
            )
        ), encoding="utf-8",
    )  # fmt: skip
    return place


@pytest.fixture(scope="module")
def measured(folder):
    return load_measured_valve(folder)


def figure(measured, name, test=0):
    return [f for f, _ in measured.figures if f.name == name][test]


def test_tests_stand_in_the_order_of_the_standard_whatever_that_of_the_file(measured):
    assert [one.test for one in measured.tests] == ["flow", "flow", "step", "chirp", "coil", "null-shift"]


def test_a_flow_curve_gives_its_gain_within_the_classes_of_its_instruments(measured):
    gain = figure(measured, "flow.flow_gain_positive")
    assert gain.value == pytest.approx(GAIN, rel=2e-3)
    assert gain.uncertainty == pytest.approx(GAIN * np.hypot(0.0125, 0.0075), rel=0.1)
    assert figure(measured, "flow.hysteresis").value == pytest.approx(HYSTERESIS / RATED, rel=0.05)
    assert figure(measured, "flow.linearity").uncertainty < 0.002  # the scale of a meter bends nothing


def test_two_oil_temperatures_give_the_shift_of_null_as_a_curve(measured):
    shift = figure(measured, "null-shift.temperature")
    assert shift.value == pytest.approx(0.01, rel=0.05)
    (test,) = [one for one in measured.tests if one.test == "null-shift"]
    assert test.conditions == pytest.approx({"temperature_difference": 40.0})
    np.testing.assert_allclose(test.values["oil_temperature"], [40.0, 80.0])


def test_a_step_and_a_chirp_give_the_response_of_the_system_that_made_them(measured):
    assert figure(measured, "overshoot").value == pytest.approx(4.6, abs=0.1)
    half = figure(measured, "frequency_minus_90_deg")
    assert half.value == pytest.approx(FREQUENCY, rel=0.02)
    amplitudes = [at["amplitude"] for f, at in measured.figures if f.name in ("overshoot", "frequency_minus_90_deg")]
    assert amplitudes == pytest.approx([0.25, 0.4], rel=0.01)


def test_coils_show_resistance_and_inductance_and_both_are_told_at_20_degrees(measured):
    assert figure(measured, "coil.coil_resistance").value == pytest.approx(800.0, rel=1e-3)
    assert figure(measured, "coil.coil_inductance").value == pytest.approx(2.0, rel=1e-3)
    cold = figure(measured, "coil.coil_resistance_at_20").value
    assert cold == pytest.approx(800.0 / (1.0 + 3.93e-3 * 20.0), rel=1e-3)


def test_a_slow_record_of_coils_tells_no_inductance():
    t = np.linspace(0.0, 100.0, 500)
    i = 1e-3 * np.sin(0.1 * t)
    figures = {f.name: f for f in coil_figures(t, 800.0 * i + 1e-4, i)}
    assert figures["coil_resistance"].value == pytest.approx(800.0, rel=1e-3)
    assert isinstance(figures["coil_inductance"], Absent) and isinstance(figures["coil_resistance_at_20"], Absent)


@pytest.mark.parametrize("threshold", [0.0, 0.05e-3, 0.2e-3])
def test_a_threshold_is_what_the_current_turns_by_before_the_output_does(threshold):
    t = np.linspace(0.0, 60.0, 12001)
    i = 0.5e-3 * signal.sawtooth(2 * np.pi * t / 20.0, 0.5)
    held = i[0]
    y = np.empty_like(i)
    for k, value in enumerate(i):  # play of the threshold's width
        held = min(max(held, value - threshold / 2.0), value + threshold / 2.0)
        y[k] = GAIN * held
    record = AcceptanceRecord(source="x", values={"time": t, "current": i, "load_flow": y})
    assert measured_threshold(record, "load_flow", rated_current=RATED).value == pytest.approx(
        threshold / RATED, abs=2e-4
    )  # fmt: skip


def test_what_is_measured_takes_the_place_of_what_a_page_says(measured, folder):
    limits = {(one.figure, round(one.conditions.get("amplitude", 0.0), 2)): one for one in measured_limits(measured)}
    assert ("flow_gain", 0.0) in limits and ("frequency_minus_90_deg", 0.4) in limits
    assert limits["coil_resistance", 0.0].value == pytest.approx(800.0 / 1.0786, rel=1e-3)
    page = vs.Specification(limits=(vs.Limit(figure="coil_resistance", value=500.0), vs.Limit(figure="lap", value=0.0)))
    both = with_measurements(page, measured)
    assert [one.value for one in both.of("coil_resistance")] == pytest.approx([800.0 / 1.0786], rel=1e-3)
    assert len(both.of("lap")) > 0 and both.of("rated_current")[0].value == pytest.approx(RATED)
    assert both.of("hysteresis")[0].value == pytest.approx(HYSTERESIS / RATED, rel=0.05)


def test_a_model_stands_beside_what_was_measured(measured):
    beside = model_figures(vs.load_valve("reference"), measured)
    gains = [value for (_, name), value in beside.items() if name == "flow.flow_gain_positive"]
    assert len(gains) == 2 and gains[0] == pytest.approx(0.0448, rel=0.02)


SPEC = '[figures]\nhysteresis = { high = "3 %" }\nfrequency_minus_90_deg = { low = "200 Hz", amplitude = "40 %" }\n'


def test_the_command_writes_the_page_and_ends_with_three_where_a_figure_fails(folder, tmp_path):
    (tmp_path / "spec.toml").write_text(SPEC, encoding="utf-8")
    command = ["acceptance", str(folder), "--spec", str(tmp_path / "spec.toml"), "-o", str(tmp_path / "out")]
    told = CliRunner().invoke(cli, command)
    assert told.exit_code == 3 and "fail" in told.stdout and "pass" in told.stdout
    page = (tmp_path / "out" / "acceptance.html").read_text(encoding="utf-8")
    headings = ["Identification", "Conditions", "Instruments", "Verdicts", "Flow of flow.csv", "Chirp of chirp.csv"]
    places = [page.index(f">{heading}<", page.index("<h2")) for heading in headings]
    assert places == sorted(places) and "serial number 7" in page and "Fails" in page
    rows = json.loads(CliRunner().invoke(cli, [*command, "--format", "json"]).stdout)
    assert {row["verdict"] for row in rows} == {None, "pass", "fail"}


SINGLE = """[figures]
phase_lag = [{ high = "60 deg", frequency = "60 Hz" }, { high = "40 deg", frequency = "60 Hz" },
             { high = "60 deg", frequency = "900 Hz" }]
amplitude_ratio = { low = "-1 dB", high = "1 dB", frequency = "60 Hz" }
"""


def second_order_at(frequency):
    """(dB, degrees of lag) of the system that made the records."""
    r = frequency / FREQUENCY
    gain = 1.0 / (1.0 - r * r + 2j * DAMPING * r)
    return 20.0 * np.log10(abs(gain)), -np.rad2deg(np.angle(gain))


def judged_by_single_frequencies(measured, path):
    path.write_text(SINGLE, encoding="utf-8")
    return judged_by(vs.load_specification(path), measured_tests(measured, vs.load_specification(path)))


def test_a_chirp_is_judged_at_single_frequencies(measured, tmp_path):
    judged = judged_by_single_frequencies(measured, tmp_path / "spec.toml")
    assert [one.verdict.value for one in judged] == ["pass", "fail", "not measured", "pass"]
    ratio, lag = second_order_at(60.0)
    assert judged[0].measured.value == pytest.approx(lag, abs=0.2)
    assert judged[3].measured.value == pytest.approx(ratio, abs=0.2)  # its reference is the edge of the band
    assert "900 Hz is outside the response" in judged[2].measured.reason


def test_sines_are_judged_at_single_frequencies_between_them(folder, tmp_path):
    t = np.arange(20000) / 2e4
    frequencies = (5.0, 50.0, 70.0, 200.0)
    for f in frequencies:
        i = 4e-3 * np.sin(2.0 * np.pi * f * t)
        write(tmp_path, f"sine_{f:g}.csv", t=t[10000:], i=i[10000:], x=second_order(t, 0.04 * i)[10000:])
    listed = "".join(
        f'[[records]]\nfile = "sine_{f:g}.csv"\ntest = "sine"\nfrequency = "{f:g} Hz"\n' for f in frequencies
    )
    (tmp_path / "acceptance.toml").write_text(HEAD + listed, encoding="utf-8")
    judged = judged_by_single_frequencies(load_measured_valve(tmp_path), tmp_path / "spec.toml")
    assert [one.verdict.value for one in judged] == ["pass", "fail", "not measured", "pass"]
    assert judged[0].measured.value == pytest.approx(second_order_at(60.0)[1], abs=1.0)


def test_a_measured_amplitude_need_not_be_the_page_s_to_the_last_digit(measured):
    limit = vs.Limit(figure="frequency_minus_90_deg", low=50.0, conditions={"amplitude": 0.4})
    (both,) = with_measurements(vs.Specification(limits=(limit,)), measured).of("frequency_minus_90_deg")
    assert both.source == "measured" and both.conditions["amplitude"] != 0.4


def test_the_picture_of_every_test_can_be_read(measured):
    for test in measured.tests:
        check_texts(draw_result(test))


def test_columns_that_are_no_channel_are_named_and_may_be_stated(folder):
    path = folder / "acceptance.toml"
    good = path.read_text(encoding="utf-8")
    listed = HEAD + '[[records]]\nfile = "odd.csv"\ntest = "flow"\n'
    text = (folder / "flow.csv").read_text(encoding="utf-8").replace("current [mA]", "AI 0", 1)
    (folder / "odd.csv").write_text(text.replace("[L/min]", "(lpm)", 1), encoding="utf-8")
    try:
        path.write_text(listed, encoding="utf-8")
        with pytest.raises(InputError, match=r"records.file: odd.csv: no column 'current'.*no channel: AI 0; state"):
            load_measured_valve(folder)
        path.write_text(listed + '[records.columns]\ncurrent = { column = "AI 0", unit = "mA" }\n', encoding="utf-8")
        stated = load_measured_valve(folder)
        path.write_text(listed + "[records.columns]\ncurrant = 2\n", encoding="utf-8")
        with pytest.raises(InputError, match="line 10: records.columns: unknown channel 'currant'"):
            load_measured_valve(folder)
    finally:
        path.write_text(good, encoding="utf-8")
    assert figure(stated, "flow.flow_gain_positive").value == pytest.approx(GAIN, rel=2e-3)


def test_an_amplitude_ratio_has_no_reference_where_a_chirp_begins_too_high():
    t = np.arange(60000) / 1e4
    i = 4e-3 * signal.chirp(t, 60.0, 6.0, 400.0, method="linear")
    ratio, lag = spectral_response(t, i, second_order(t, 0.04 * i)).figures_at(100.0)
    assert isinstance(ratio, Absent) and "to which it refers, is too near" in ratio.reason
    assert lag.value == pytest.approx(second_order_at(100.0)[1], abs=0.5)


@pytest.mark.parametrize(
    "text, message",
    [
        ("[[records]]\nfile = 'flow.csv'\ntest = 'flaw'\n", "records.test: unknown test 'flaw'; did you mean"),
        ("[[records]]\nfile = 'flow.csv'\ntest = 'chirp'\n", "records.file"),
        ("[[records]]\nfile = 'flow.csv'\ntest = 'coil'\n", "voltage"),
        ("[[records]]\nfile = 'flow.csv'\ntest = 'sine'\n", "the frequency of a sine is missing"),
        ("[[records]]\nfile = 'gone.csv'\ntest = 'flow'\n", "no such file"),
        ("[[records]]\ntest = 'flow'\n", "records needs a file"),
        ("[instruments]\nflow = '80 %'\n[[records]]\nfile = 'flow.csv'\ntest = 'flow'\n", "instruments.flow: '80 %'"),
        ("[instruments]\nflows = '2 %'\n", "unknown key 'flows'"),
        ("", "records: expected [[records]]"),
    ],
)  # fmt: skip
def test_a_bad_folder_is_refused_with_its_place(folder, text, message):
    path = folder / "acceptance.toml"
    good = path.read_text(encoding="utf-8")
    try:
        path.write_text(HEAD + text, encoding="utf-8")
        with pytest.raises(InputError) as refused:
            load_measured_valve(folder)
    finally:
        path.write_text(good, encoding="utf-8")
    assert message in str(refused.value)


def test_a_folder_without_rated_current_or_description_is_refused(tmp_path):
    with pytest.raises(InputError, match="a measured valve is a folder with acceptance.toml"):
        load_measured_valve(tmp_path)
    (tmp_path / "acceptance.toml").write_text('title = "x"\n', encoding="utf-8")
    with pytest.raises(InputError, match="rated_current is missing"):
        load_measured_valve(tmp_path)
