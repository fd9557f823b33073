"""Samples that are no measurement: gaps and corrupt readings are left out, and told by record, line and channel."""

from dataclasses import replace

import numpy as np
import pytest
from bench_plant import draw_bench, write_bench_session
from hypothesis import given
from hypothesis import strategies as st

import valvesim as vs
from valvesim.identification import bad_samples
from valvesim.identification.bad_samples import (
    _bursts,
    _is_off_at_first,
    _single_outliers,
    _standing_apart,
    without_beginnings,
    without_bursts,
    without_outliers,
    without_saturation,
)
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session, with_records

TIME = np.arange(400) / 1e3
WAVE = np.sin(2.0 * np.pi * 10.0 * TIME)
NOISE = np.random.default_rng(0).normal(size=(3, len(TIME)))
SPOOL = 0.2 * WAVE + 1e-3 * NOISE[0]


def loaded(folder, **changed):
    """A session of one record whose columns are `changed`, at rows of data."""
    columns = {"time [s]": TIME, "current [mA]": 5.0 * WAVE, "supply_pressure [bar]": 210.0 + 0.0 * TIME,
               "spool_position [mm]": SPOOL}  # fmt: skip
    for name, readings in changed.items():
        heading = next(heading for heading in columns if heading.startswith(name))
        columns[heading] = columns[heading].copy()
        for row, value in readings.items():
            columns[heading][row] = value
    cells = ["" if np.isnan(v) else f"{v:.9g}" for row in np.column_stack(list(columns.values())) for v in row]
    rows = [",".join(cells[k : k + 4]) for k in range(0, len(cells), 4)]
    (folder / "a.csv").write_text("\n".join([",".join(columns), *rows, ""]), encoding="utf-8")
    (folder / "session.toml").write_text("", encoding="utf-8")
    return load_session(folder)


@pytest.mark.parametrize("value", [32767.0, -32768.0, 2.0])
def test_a_corrupt_reading_is_left_out_and_named_by_record_line_and_channel(tmp_path, value):
    session = loaded(tmp_path, spool_position={70: value})
    (record,) = session.records
    assert np.flatnonzero(~record.usable["spool_position"]).tolist() == [70]
    assert abs(record.values["spool_position"][70] - 1e-3 * (SPOOL[69] + SPOOL[71]) / 2.0) < 1e-9
    (note,) = [note for note in session.notes if "corrupt" in note]
    assert note.startswith(f"a, line 72: spool_position of {value:.4g} mm is corrupt")


def test_several_corrupt_readings_are_found_whatever_their_side():
    readings = 0.2 * WAVE + 1e-3 * NOISE[1]
    wrong = [5, 90, 91, 200]
    readings[wrong] = [32767.0, 32767.0, -32768.0, 9.0]
    assert np.flatnonzero(_standing_apart(readings, options=OPTIONS)).tolist() == wrong


def test_what_a_valve_does_is_not_corrupt():
    peaks = 2.0 + np.exp(-((np.mod(TIME, 0.1) - 0.05) ** 2) / 1e-6)  # leakage about null, a sample wide
    step = np.where(TIME < 0.2, 0.0, 1.0)
    for readings in (WAVE, peaks, step, step[::-1], 0.0 * TIME, 1e-3 * NOISE[0], np.where(TIME < 0.39, 0.0, 5.0)):
        assert not _standing_apart(readings, options=OPTIONS).any()


@pytest.mark.parametrize("column, value", [("supply_pressure", 32767.0), ("current", 32767.0), ("current", np.nan)])
def test_in_an_input_a_straight_line_takes_the_place_of_a_corrupt_or_missing_sample(tmp_path, column, value):
    session = loaded(tmp_path, **{column: {70: value}})
    (record,) = session.records
    expected = {"supply_pressure": 210e5, "current": 2.5e-3 * (WAVE[69] + WAVE[71])}[column]
    assert record.values[column][70] == pytest.approx(expected) and record.usable["spool_position"].all()
    (note,) = [note for note in session.notes if "line 72" in note]
    assert column in note and ("corrupt" in note) == np.isfinite(value)


def test_a_gap_in_one_channel_is_not_measured(tmp_path):
    session = loaded(tmp_path, spool_position=dict.fromkeys(range(100, 160), np.nan))
    (record,) = session.records
    assert np.flatnonzero(~record.usable["spool_position"]).tolist() == list(range(100, 160))
    assert np.isfinite(record.values["spool_position"]).all()
    assert "a, line 102: no reading of spool_position for 60 samples; they are left out" in session.notes


def test_a_channel_that_is_mostly_not_there_is_left_out(tmp_path):
    with pytest.raises(vs.InputError, match="spool_position has readings in 37.50% of the samples and is left out"):
        loaded(tmp_path, spool_position=dict.fromkeys(range(100, 350), np.nan))


def test_a_single_residual_off_its_neighbours_is_an_outlier_and_a_misfit_is_not():
    least = np.full(len(TIME), 8.0)
    for misfit in (0.0 * TIME, 30.0 * WAVE, 50.0 * np.exp(-(((TIME - 0.2) / 2e-3) ** 2))):
        left = misfit + NOISE[2]
        assert not _single_outliers(left, least, OPTIONS.noise.outlier_ratio).any()
    left[100] += 40.0
    assert np.flatnonzero(_single_outliers(left, least, OPTIONS.noise.outlier_ratio)).tolist() == [100]


def test_a_reading_off_the_fit_is_left_out_with_its_line_and_no_other(biased_session, biased_fit):
    prepared, nominal = prepare_session(biased_session), biased_fit
    assert without_outliers(prepared, nominal.study, nominal.fit, nominal.linearised) is prepared
    record, channel = prepared.predictors[1].record, "spool_position"
    values = {**record.values, channel: record.values[channel].copy()}
    values[channel][150] += 15.0 * nominal.study.noise[channel, record.pace].deviation
    predictors = list(nominal.linearised)
    predictors[1] = replace(
        predictors[1], predictor=replace(predictors[1].predictor, record=replace(record, values=values))
    )
    cleaned = without_outliers(prepared, nominal.study, nominal.fit, predictors)
    assert [np.count_nonzero(~one.record.usable[channel]) for one in cleaned.predictors].count(1) == 1
    (note,) = cleaned.session.notes[len(prepared.session.notes) :]
    assert note.startswith(f"{record.name}, line 152: {channel} of ") and "noise deviations off" in note


def bursts_of(left, floor, motion=0.0):
    """Bursts in residuals of readings of a motion."""
    return _bursts(left, left + motion, floor, options=OPTIONS)


@given(st.integers(0, 2**32 - 1), st.integers(5, 25), st.integers(20, 150), st.sampled_from([0.3, 1.0, 40.0]))
def test_a_burst_of_noise_is_found_and_noise_a_misfit_or_a_step_is_none(seed, count, start, size):
    draw, floor = np.random.default_rng(seed), np.zeros(len(TIME))
    step = size * (40.0 * (TIME > 0.1) + draw.normal(size=len(TIME)))
    assert bursts_of(step, floor) == []
    for misfit in (0.0 * TIME, 30.0 * WAVE, 50.0 * np.exp(-(((TIME - 0.3) / 2e-3) ** 2))):
        quiet = size * (misfit + draw.normal(size=len(TIME)))
        assert bursts_of(quiet, floor) == []
        burst = np.zeros(len(TIME))
        burst[start : start + count] = 60.0 * draw.choice([-1.0, 1.0], count) * (1.0 + draw.random(count))
        for start_found, end in bursts_of(quiet + size * burst, floor):
            assert start - 7 <= start_found and end <= start + count + 7
    alternating = np.where((np.arange(len(TIME)) >= start) & (np.arange(len(TIME)) < start + count), 60.0, 0.0)
    alternating *= (-1.0) ** np.arange(len(TIME))
    ((first, end),) = bursts_of(size * (alternating + draw.normal(size=len(TIME))), floor)
    assert start - 7 <= first <= start and start + count <= end <= start + count + 7
    assert bursts_of(size * alternating, np.full(len(TIME), 1e3 * size)) == []


@pytest.mark.parametrize("missing", [0.3, 0.6])
def test_a_burst_is_found_where_much_of_its_record_is_left_out_already(missing):
    draw, resolution = np.random.default_rng(5), 0.6
    left = draw.normal(size=len(TIME))
    left[20:32] += 30.0 * (-1.0) ** np.arange(12)
    left[len(TIME) - int(missing * len(TIME)) :] = np.nan
    ((start, end),) = bursts_of(left, np.full(len(TIME), resolution))
    assert 13 <= start <= 20 and 32 <= end <= 39
    assert bursts_of(np.full(len(TIME), np.nan), np.zeros(len(TIME))) == []


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(4, 5), min_size=4, max_size=6), st.floats(40.0, 90.0))
def test_peaks_that_a_model_has_too_large_or_too_small_are_no_burst(seed, apart, size):
    """A chirp across null makes one for each crossing, of a sample each; a spike turns the samples next to it, too."""
    draw = np.random.default_rng(seed)
    left, floor, at = draw.normal(size=len(TIME)), np.zeros(len(TIME)), 20 + np.cumsum(apart)
    left[at] += draw.choice([-1.0, 1.0], len(at)) * size
    assert bursts_of(left, floor)
    floor[at] = 0.5 * size
    assert bursts_of(left, floor) == []


@given(st.integers(0, 2**32 - 1), st.integers(20, 150), st.floats(0.0, 1e3))
def test_what_goes_to_and_fro_in_the_fit_alone_is_no_burst(seed, start, motion):
    """The model of a stated valve whose figures are far off touched its nozzles, twelve times; its leakage did."""
    noise, own = np.random.default_rng(seed).normal(size=len(TIME)), np.zeros(len(TIME))
    own[start : start + 12] = 60.0 * (-1.0) ** np.arange(12)
    assert bursts_of(noise + own, np.zeros(len(TIME)), motion * WAVE)
    assert _bursts(noise - own, noise + motion * WAVE, np.zeros(len(TIME)), options=OPTIONS) == []


def test_noise_that_is_everywhere_is_no_burst():
    loud = np.where(TIME < 0.5 * TIME[-1], 1.0, 50.0) * np.random.default_rng(3).normal(size=len(TIME))
    assert bursts_of(loud, np.zeros(len(TIME))) == []


def test_a_burst_is_left_out_of_its_channel_alone_with_its_line(biased_session, biased_fit):
    prepared, nominal = prepare_session(biased_session), biased_fit
    assert without_bursts(prepared, nominal.fit, nominal.linearised) is prepared
    record, channel = prepared.predictors[1].record, "spool_position"
    cleaned = without_bursts(with_burst(prepared, nominal, [1], channel), nominal.fit, nominal.linearised)
    left_out = [np.flatnonzero(~one.record.usable[channel]).tolist() for one in cleaned.predictors]
    assert [bool(k) for k in left_out] == [k == 1 for k in range(len(left_out))]
    assert left_out[1][0] <= 150 and left_out[1][-1] >= 161
    (note,) = cleaned.session.notes[len(prepared.session.notes) :]
    told = f"{channel} goes to and fro for {len(left_out[1])} samples"
    assert note.startswith(f"{record.name}, line 1") and told in note


def with_burst(prepared, nominal, records, channel):
    """The prepared session with a burst of noise in a channel of some of its records."""
    predictors = list(prepared.predictors)
    for k in records:
        record = predictors[k].record
        values = {**record.values, channel: record.values[channel].copy()}
        values[channel][150:162] += 30.0 * nominal.study.noise[channel, record.pace].deviation * (-1.0) ** np.arange(12)
        predictors[k] = replace(predictors[k], record=replace(record, values=values))
    return replace(prepared, predictors=tuple(predictors))


def test_what_every_repeat_of_a_test_reads_alike_is_no_burst(biased_session, biased_fit):
    prepared, nominal = prepare_session(biased_session), biased_fit
    tests = [one.record.test for one in prepared.predictors]
    first, second = (k for k, test in enumerate(tests) if test == tests[0])
    other = next(k for k, test in enumerate(tests) if test != tests[0])
    for records, are_found in (([first], True), ([first, other], True), ([first, second], False)):
        burst = with_burst(prepared, nominal, records, "spool_position")
        cleaned = without_bursts(burst, nominal.fit, nominal.linearised)
        assert (cleaned is not burst) is are_found


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e3), st.floats(-3.0, 3.0))
def test_a_record_begins_in_motion_where_its_first_residuals_alone_are_far_off(seed, size, off):
    left = np.random.default_rng(seed).normal(size=len(TIME)) + off  # a bias is off throughout
    assert not _is_off_at_first(size * left, options=OPTIONS)
    decaying = np.exp(-TIME / 4e-3) * (8.0 * (5.0 + abs(off)))
    assert _is_off_at_first(size * (left + decaying), options=OPTIONS)
    assert _is_off_at_first(size * (left - decaying), options=OPTIONS)
    once = np.where(np.arange(len(TIME)) == 0, 100.0, 0.0)  # one sample is an outlier
    assert not _is_off_at_first(size * (left + once), options=OPTIONS)
    for few in ([], [9.0], [9.0, 9.0]):
        assert not _is_off_at_first(np.array(few), options=OPTIONS)


def test_the_beginning_of_a_record_that_begins_in_motion_is_left_out_and_of_those_locked(biased_session, biased_fit):
    prepared, fit = prepare_session(biased_session), biased_fit.fit
    assert without_beginnings(prepared, fit) is prepared
    predictor, channel = prepared.predictors[1], "spool_position"
    record = predictor.record
    values = {**record.values, channel: record.values[channel].copy()}
    values[channel][:4] += 60.0 * biased_fit.study.noise[channel, record.pace].deviation
    predictors = list(prepared.predictors)
    predictors[1] = replace(predictor, record=replace(record, values=values))
    cleaned = without_beginnings(replace(prepared, predictors=tuple(predictors)), fit)
    begun = [not one.record.usable[channel][0] for one in cleaned.predictors]
    assert begun == [k == 1 for k in range(len(begun))]
    first = cleaned.predictors[1].record
    for usable in first.usable.values():
        assert np.array_equal(usable, first.time - first.time[0] >= OPTIONS.noise.beginning)
    assert all(not good[0] for r in cleaned.session.locked for good in r.usable.values())
    assert cleaned.session.notes[len(prepared.session.notes) :] == (
        f"{record.name} begins in motion, and the model at rest: its first 50 ms are left out",
    )


def test_next_to_a_jump_only_a_reading_that_is_cut_short_is_left_out(biased_session, biased_fit, monkeypatch):
    prepared, nominal = prepare_session(biased_session), biased_fit
    record, channel = prepared.predictors[1].record, "spool_position"
    furthest = max(prepared.predictors, key=lambda one: one.record.values[channel].max()).record
    top = int(np.argmax(furthest.values[channel]))

    def left_out(of, at, off):
        """What is left out where the model reads `off` noise deviations more than sample `at`, next to a jump."""
        monkeypatch.setattr(bad_samples, "command_jumps", lambda command, options: [at])
        readings = [dict(read) for read in nominal.fit.readings]
        k = [one.record.name for one in prepared.predictors].index(of.name)
        readings[k][channel] = readings[k][channel].copy()
        readings[k][channel][at] += off * nominal.study.noise[channel, of.pace].deviation
        fit = replace(nominal.fit, readings=tuple(readings))
        cleaned = without_outliers(prepared, nominal.study, fit, nominal.linearised)
        return [
            (one.record.name, int(i))
            for before, one in zip(prepared.predictors, cleaned.predictors, strict=True)
            for i in np.flatnonzero(before.record.usable[channel] & ~one.record.usable[channel])
        ]

    assert left_out(furthest, top, 30.0) == [(furthest.name, top)]
    assert left_out(furthest, top, -30.0) == []  # it reads further than the model
    assert left_out(record, 150, 30.0) == []  # others read further


def test_readings_that_stand_at_their_furthest_where_the_model_goes_on_are_saturated(biased_session, biased_fit):
    prepared, nominal, channel = prepare_session(biased_session), biased_fit, "spool_position"
    records = [linear.predictor.record for linear in nominal.linearised]
    top = max(float(record.values[channel].max()) for record in records)
    k = next(k for k, record in enumerate(records) if record.values[channel].max() == top)
    noise = nominal.study.noise[channel, records[k].pace].deviation

    def cleaned(model):
        """The session where four samples of a record stand at the same value and the model reads `model` there."""
        values = records[k].values[channel].copy()
        values[at] = top
        readings = [dict(read) for read in nominal.fit.readings]
        readings[k][channel] = readings[k][channel].copy()
        readings[k][channel][at] = model
        linearised = list(nominal.linearised)
        record = replace(records[k], values={**records[k].values, channel: values})
        linearised[k] = replace(linearised[k], predictor=replace(linearised[k].predictor, record=record))
        fit = replace(nominal.fit, readings=tuple(readings))
        return without_outliers(prepared, nominal.study, fit, linearised)

    at = sorted({40, 41, 90, int(np.argmax(records[k].values[channel]))})
    found = cleaned(top + 20.0 * noise)
    left_out = records[k].usable[channel] & ~found.predictors[k].record.usable[channel]
    assert np.flatnonzero(left_out).tolist() == at
    for before, after in zip(prepared.session.locked, found.session.locked, strict=True):
        assert np.array_equal(after.usable[channel], before.usable[channel] & (before.values[channel] < top))
    (note,) = found.session.notes[len(prepared.session.notes) :]
    assert note.startswith(f"{channel} reads ") and "and no further, 4 times" in note and "saturated" in note
    # by its noise a reading may stand at the end where the model does not quite
    near, short = (top + noise * np.append(np.full(len(at) - 1, 20.0), off) for off in (-2.0, -5.0))
    assert any("saturated" in note for note in cleaned(near).session.notes)
    for model in (top - noise, top + noise, short):  # the model stops there too
        assert not any("saturated" in note for note in cleaned(model).session.notes[len(prepared.session.notes) :])


def test_what_is_saturated_is_left_out_of_an_inadequate_fit_where_it_carries_the_misfit(biased_session, biased_fit):
    prepared, nominal, channel = prepare_session(biased_session), biased_fit, "spool_position"
    records = [predictor.record for predictor in nominal.study.predictors]
    top = max(float(record.values[channel].max()) for record in records)
    k = next(k for k, record in enumerate(records) if record.values[channel].max() == top)
    at = int(np.argmax(records[k].values[channel]))
    values = records[k].values[channel].copy()
    values[at : at + 5] = top
    readings = [dict(read) for read in nominal.fit.readings]
    readings[k][channel] = values.copy()
    readings[k][channel][at : at + 5] += 100.0 * nominal.study.noise[channel, records[k].pace].deviation
    record = replace(records[k], values={**records[k].values, channel: values})
    prepared, study = (with_records(one, [record], ()) for one in (prepared, nominal.study))

    def left_out(chi_square):
        """How many samples are left out where a fit with these readings leaves so much."""
        fit = replace(nominal.fit, readings=tuple(readings), chi_square=chi_square)
        cleaned = without_saturation(prepared, study, fit)
        return np.count_nonzero(records[k].usable[channel] & ~cleaned.predictors[k].record.usable[channel])

    rows, carried = nominal.fit.rows, 5.0 * 100.0**2
    assert left_out(rows + 1.5 * carried) == 5
    assert left_out(rows + 3.0 * carried) == 0  # something else is wrong, and the model errs itself


@pytest.mark.slow
@pytest.mark.parametrize("imperfection", ["gap", "corrupt"])
@pytest.mark.parametrize("name", [None, "spool_coulomb_friction"])
def test_a_session_with_such_samples_is_diagnosed_as_one_without(tmp_path, imperfection, name):
    case, bench = draw_bench(500, "effect" if name else "none", name=name, imperfections=(imperfection,), duration=0.3)
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    if name is None:
        assert found.verdict == "no_discrepancy"
    else:
        assert name in {each for answer in found.candidates if answer.in_set for each in answer.names}
    assert any(("corrupt" if imperfection == "corrupt" else "no reading of") in note for note in found.notes)
