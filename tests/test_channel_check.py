"""A sign, a unit or a plug that is wrong is told before anything is fitted."""

import datetime
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plant import draw, shortened, write_session
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, filtfilt, lfilter

import valvesim as vs
from valvesim.identification.channel_check import (
    NOZZLES,
    WITH_COMMAND,
    _by_readings,
    _by_slopes,
    _samples_averaged,
    _slopes,
    _smoothed,
    misread_channels,
)
from valvesim.identification.options import DEFAULT_IDENTIFICATION
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session
from valvesim.reports.diagnosis.page import write_report

OPTIONS = DEFAULT_IDENTIFICATION.channel
WELL = {"record_1": (1.02, 0.999), "record_2": (0.97, 0.98)}
TURNED = {name: (-b, -r) for name, (b, r) in WELL.items()}


@pytest.mark.parametrize("slopes, told", [
    ({"spool_position": WELL, "load_flow": WELL}, []),
    ({"spool_position": WELL, "load_flow": TURNED}, ["load_flow goes the other way than the stated valve: its sign?"]),
    ({"load_flow": TURNED}, ["load_flow goes the other way than the stated valve: its sign, or that of the command?"]),
    ({"spool_position": TURNED, "load_flow": TURNED},
     ["spool_position and load_flow go the other way than the stated valve: the sign of the command?"]),
    ({"spool_position": WELL} | dict.fromkeys(NOZZLES, TURNED),
     ["nozzle_pressure_1 reads what nozzle_pressure_2 should, and the other way about: swapped?"]),
    (dict.fromkeys(NOZZLES, TURNED),
     ["nozzle_pressure_1 and nozzle_pressure_2 go the other way than the stated valve: are they swapped, or is it the "
      "sign of the command?"]),
    ({"spool_position": WELL, "nozzle_pressure_2": TURNED},
     ["nozzle_pressure_2 goes the other way than the stated valve: is it that of the other nozzle?"]),
    ({"spool_position": WELL, "load_flow": {**WELL, "record_3": (-1.0, -0.99)}},
     ["load_flow goes the other way in record_3 than in record_1, record_2: its sign?"]),
    ({"load_flow": {name: (60.0 * b, r) for name, (b, r) in WELL.items()}},
     ["load_flow reads 59.7 times what the stated valve does: its unit?"]),
    ({"load_flow": {**WELL, "record_3": (60.0, 0.99)}}, []),  # in one record alone it is none of unit
    ({"load_flow": {"record_1": (-0.4, -0.5)}}, []),  # what hardly follows the command tells nothing
])  # fmt: skip
def test_what_is_told_of_slopes(slopes, told):
    assert _by_slopes(slopes, options=OPTIONS) == told


@given(st.dictionaries(st.sampled_from(WITH_COMMAND), st.floats(0.3, 3.0), min_size=1))
def test_no_cause_that_weakens_or_strengthens_a_channel_threefold_is_a_unit(gains):
    assert _by_slopes({name: {"record_1": (b, 0.95)} for name, b in gains.items()}, options=OPTIONS) == []


@pytest.mark.parametrize("moves, found", [(0.1, {}), (2.0, {"spool_position": {"record_1": (-0.5, -1.0)}})])
def test_a_drift_with_the_oil_that_goes_the_other_way_is_no_sign(moves, found):
    """What hardly moves but for its drift tells nothing of a sign; what follows the command does beside any drift."""
    time = np.linspace(0.0, 10.0, 500)
    oil, command = 20.0 + 60.0 * np.clip(time - 2.0, 0.0, 4.0) / 4.0, moves * np.sin(2.0 * np.pi * time)
    record = SimpleNamespace(
        name="record_1", time=time, outputs=("spool_position", "internal_leakage"),
        values={"oil_temperature": oil, "spool_position": -0.5 * command - 0.2 * oil, "internal_leakage": -command},
        usable=dict.fromkeys(("spool_position", "internal_leakage"), np.full(500, True)),
    )  # fmt: skip
    predicted = {"spool_position": command + 0.02 * oil, "internal_leakage": command}
    slopes = _slopes([record], [predicted], options=OPTIONS)
    assert slopes == {name: {k: pytest.approx(v) for k, v in own.items()} for name, own in found.items()}


def both_ways(name, **changed):
    """A record of channels that swing, each as the stated valve reads it but for what is `changed`, and that."""
    time = np.linspace(0.0, 1.0, 400)
    stated = {n: size * np.sin(2.0 * np.pi * 3.0 * time) for n, size in (("spool_position", 2e-4), ("load_flow", 3e-4))}
    noise = np.random.default_rng(2).normal(size=400)
    read = {n: changed.get(n, lambda m: m)(m) + 0.002 * np.max(m) * noise for n, m in stated.items()}
    usable = dict.fromkeys(stated, np.full(400, True))
    return SimpleNamespace(name=name, time=time, outputs=tuple(stated), values=read, usable=usable), stated


@pytest.mark.parametrize("changed, told", [
    ({}, []),
    ({"load_flow": np.abs},
     ["load_flow reads nothing below zero, where the stated valve does: is its direction lost?"]),
    ({"spool_position": lambda m: m + 5e-4},
     ["spool_position reads 0.5 mm more than the stated valve does, in all records: its zero?"]),
    ({"spool_position": lambda m: 0.8 * m - 5e-4},
     ["spool_position reads 0.5 mm less than the stated valve does, in all records: its zero?"]),
    ({"spool_position": lambda m: m + 5e-4, "load_flow": lambda m: m + 5e-4}, []),  # the valve's null
    ({"spool_position": lambda m: m + 1e-4}, []),  # a bias, which is fitted
    ({"spool_position": lambda m: 0.0 * m + 5e-4}, []),  # it does not follow the command
    ({"load_flow": lambda m: np.maximum(m, 0.0)}, []),  # one land is blocked
])  # fmt: skip
def test_a_lost_direction_and_a_zero_that_is_far_off_are_told(changed, told):
    records, readings = zip(*(both_ways(name, **changed) for name in ("record_1", "record_2")), strict=True)
    found = _by_readings(records, readings, options=OPTIONS)
    assert [re.sub(r"0\.[45]\d* mm", "0.5 mm", words) for words in found] == told


def test_a_zero_that_is_off_in_one_record_alone_is_another_thing():
    (off, stated), (well, other) = both_ways("record_1", spool_position=lambda m: m + 5e-4), both_ways("record_2")
    assert _by_readings([off, well], [stated, other], options=OPTIONS) == []
    well.usable["spool_position"][:] = off.usable["spool_position"][:] = False  # nor does what was not read tell
    assert _by_readings([off, well], [stated, other], options=OPTIONS) == []


@pytest.mark.parametrize("what, count", [("first reading", 1), ("first ten readings", 10), ("mean", None)])
def test_records_that_were_each_given_a_zero_are_told(what, count):
    """Position and flow set to zero where a record begins had been another valve."""
    records, readings = [], []
    for k, by in enumerate((0.0, 1.2e-4, -0.8e-4)):  # where the stated valve stands, so that each begins otherwise
        record, stated = both_ways(f"record_{k}")
        start = 30 * k
        stated = {name: by + np.roll(values, -start) for name, values in stated.items()}
        record.values.update({name: values - np.mean(values[:count]) for name, values in stated.items()})
        records.append(record)
        readings.append(stated)
    found = _by_readings(records, readings, options=OPTIONS)
    assert len(found) == 2 and all(f"is zero by its {what} in all records" in words for words in found)
    for record, stated in zip(records, readings, strict=True):
        record.values.update(stated)
    assert _by_readings(records, readings, options=OPTIONS) == []


def repeats(smooth, wander, size=3e-4):
    """Two repeats of a swing, each with a noise of its own, that wanders besides, smoothed before it was written."""
    time, draw = np.arange(900) * 1e-3, np.random.default_rng(7)
    swing = np.sin(2.0 * np.pi * (3.0 + 60.0 * time) * time)
    for name in ("record_1", "record_2"):
        noise = draw.normal(size=900) + wander * np.cumsum(draw.normal(size=900))
        other = swing + (0.0 if name == "record_1" else 0.01 * swing * np.abs(swing))
        values = {"load_flow": smooth(1e-4 * (other + size * noise))}
        usable = {"load_flow": np.full(900, True)}
        yield SimpleNamespace(name=name, time=time, repeats="a", outputs=("load_flow",), values=values, usable=usable)


@pytest.mark.parametrize("wander", [0.0, 0.3])
def test_readings_that_were_smoothed_before_they_were_written_are_told(wander):
    """A filter of 150 Hz, run forwards and backwards, had made another valve of a healthy one."""
    ahead = butter(4, 150.0, fs=1000.0)
    (words,) = _smoothed(list(repeats(lambda y: filtfilt(*ahead, y), wander, 3e-3)), options=OPTIONS)
    (end,) = re.fullmatch(r"load_flow has hardly any noise above (\d+) Hz: was it smoothed before .*", words).groups()
    assert 120.0 < float(end) < 240.0
    analogue = lambda y: lfilter(*butter(1, 60.0, fs=1000.0), y)  # noqa: E731
    for honest in (lambda y: y, analogue, lambda y: np.round(y, 6)):
        assert _smoothed(list(repeats(honest, wander)), options=OPTIONS) == []
    first, _ = repeats(lambda y: y, wander)
    assert _smoothed([first, first], options=OPTIONS) == []


@pytest.mark.parametrize("count", [3, 4, 5])
def test_a_moving_mean_is_told_by_its_samples(count):
    """Of five samples it had been another mechanism, or no answer after seven minutes."""
    averaged = list(repeats(lambda y: uniform_filter1d(y, count, mode="nearest"), 0.0, 3e-2))
    (words,) = _smoothed(averaged, options=OPTIONS)
    assert words.startswith(f"load_flow has no noise at {1000.0 / count:.0f} Hz and its multiples: is it a mean over "
                            f"{count} samples")  # fmt: skip


@given(st.integers(0, 9999), st.floats(-0.9, 0.97), st.floats(0.2, 3.0), st.sampled_from([300, 500, 1000, 4000]))
def test_no_noise_of_a_sensor_is_taken_for_a_moving_mean(seed, colour, resonance, samples):
    noise = np.random.default_rng(seed).standard_normal(samples)
    noise = lfilter([1.0], [1.0, -colour], noise)
    assert _samples_averaged(noise, options=OPTIONS) == 1
    rings = lfilter([1.0], [1.0, -2.0 * 0.98 * np.cos(resonance), 0.98**2], noise)
    assert _samples_averaged(rings, options=OPTIONS) == 1


@pytest.fixture(scope="module")
def folder_of_healthy_valve(tmp_path_factory):
    folder = tmp_path_factory.mktemp("healthy")
    write_session(shortened(draw(3400017, "none", noise=0.004), 301), folder)
    return folder


def changed(folder, target, column, by):
    """The session with one column of every record other than it was."""
    shutil.copytree(folder, target)
    for path in target.glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        k = next(k for k, name in enumerate(head.split(",")) if name.startswith(column))
        cells = [row.split(",") for row in rows]
        lines = [",".join([*row[:k], repr(by(float(row[k]))), *row[k + 1 :]]) for row in cells]
        path.write_text("\n".join([head, *lines]) + "\n")
    return target


def test_channels_that_read_well_are_not_told(folder_of_healthy_valve):
    assert misread_channels(prepare_session(load_session(folder_of_healthy_valve))) is None


@pytest.mark.parametrize("column, by, told", [
    ("load_flow", lambda x: -x, "load_flow goes the other way than the stated valve: its sign?"),
    ("load_flow", lambda x: 60.0 * x, r"load_flow reads [56]\d\.?\d* times what the stated valve does: its unit\?"),
    ("current", lambda x: -x, "nozzle_pressure_2 and load_flow go the other way than the stated valve: the sign of the "
                              "command?"),
])  # fmt: skip
def test_a_sign_or_a_unit_is_told_before_anything_is_fitted(
    folder_of_healthy_valve, tmp_path, monkeypatch, column, by, told
):
    monkeypatch.setattr("valvesim.diagnosis.diagnose.fit_coarse_to_fine", None)
    found = vs.diagnose(changed(folder_of_healthy_valve, tmp_path / "changed", column, by))
    assert (found.verdict, found.reason) == ("unknown", "misread_channels") and not found.extension_offered
    assert told in found.summary or re.search(told, found.summary)
    assert found.what_to_do[0].label == "the channels"
    write_report(found, tmp_path / "page", valve="-", date=datetime.date(2026, 1, 1))
    page = (tmp_path / "page" / "report.html").read_text()
    assert "Channels, not the valve" in page and "stated model" in page and "refitted model" not in page


def test_an_oil_that_is_hotter_than_any_throughout_is_asked_for_its_unit(folder_of_healthy_valve, tmp_path):
    session = load_session(changed(folder_of_healthy_valve, tmp_path / "kelvin", "oil_temperature", lambda x: x + 273))
    assert any("oil_temperature is 29" in note and "in kelvin?" in note for note in session.notes)
    assert not any("kelvin" in note for note in load_session(folder_of_healthy_valve).notes)
    assert np.isfinite(session.records[0].values["oil_temperature"]).all()
