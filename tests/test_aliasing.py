"""Records whose commands alias are told from fast ones, and left out where no model comes near."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench_plant import draw_bench, keep_every_second_sample, write_bench_session
from hypothesis import given
from hypothesis import strategies as st

import valvesim as vs
from valvesim.diagnosis import coarse_to_fine
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.identification.aliasing import is_aliased, without_aliased_records
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.study import prepare_session

K = np.arange(1000)


def chirp(top):
    """A sine up to a frequency, in shares of the rate."""
    return np.sin(np.pi * top * K**2 / len(K))


def record_of(command):
    return SimpleNamespace(command="current", values={"current": np.asarray(command, dtype=float)})


@pytest.mark.parametrize("top, aliased", [(0.1, False), (0.35, False), (0.4, False), (0.55, True), (0.8, True)])
def test_a_chirp_that_reaches_half_the_rate_aliases(top, aliased):
    assert is_aliased(record_of(3e-3 * chirp(top) + 1e-3), options=OPTIONS) is aliased


@given(st.integers(0, 2**32 - 1), st.sampled_from(["noise", "random binary", "steps", "smooth", "tones"]))
def test_what_is_fast_and_does_not_reach_half_the_rate_does_not_alias(seed, kind):
    dice = np.random.default_rng(seed)
    if kind == "noise":
        command = dice.normal(size=1000)
    elif kind == "random binary":
        command = dice.choice([-1.0, 1.0], 1000)
    elif kind == "steps":
        command = np.repeat(dice.uniform(-1.0, 1.0, 50), 20) + 1e-4 * dice.normal(size=1000)
    elif kind == "smooth":
        command = np.convolve(dice.normal(size=1040), np.hanning(41), "valid")
    else:
        command = sum(np.sin(2.0 * np.pi * (f * K + dice.random())) for f in dice.uniform(0.001, 0.3, 12))
    assert not is_aliased(record_of(command), options=OPTIONS)


def test_few_samples_or_none_that_move_do_not_alias():
    assert not is_aliased(record_of(np.resize([1.0, -1.0], 10)), options=OPTIONS)
    assert not is_aliased(record_of(np.zeros(100)), options=OPTIONS)


def aliasing(record):
    """A record under a command that aliases."""
    values = record.values[record.command]
    fast = float(np.ptp(values)) * np.sin(np.pi * 0.9 * np.arange(len(values)) ** 2 / len(values))
    return replace(record, values={**record.values, record.command: fast})


def test_records_that_alias_are_left_out_of_the_session_and_told(biased_session):
    first, *others = biased_session.training
    session = replace(biased_session, records=(aliasing(first), *others, *biased_session.locked))
    prepared = prepare_session(session)
    fewer = without_aliased_records(prepared)
    assert [record.name for record in fewer.session.training] == [record.name for record in others]
    assert [one.record.name for one in fewer.predictors] == [record.name for record in others]
    assert fewer.session.locked == session.locked
    (note,) = (note for note in fewer.session.notes if note not in prepared.session.notes)
    assert note.startswith(f"{first.name}: the {first.command} reaches half the rate") and "log it faster" in note
    assert len(set(fewer.session.notes)) == len(fewer.session.notes)


def test_where_none_or_all_alias_all_stay_and_so_do_the_only_records_to_measure_the_gain_on(biased_session):
    plain = prepare_session(biased_session)
    assert without_aliased_records(plain) is plain
    every = prepare_session(replace(biased_session, records=tuple(map(aliasing, biased_session.records))))
    assert without_aliased_records(every) is every
    first, *others = biased_session.training
    locked = tuple(map(aliasing, biased_session.locked))
    prepared = prepare_session(replace(biased_session, records=(aliasing(first), *others, *locked)))
    assert without_aliased_records(prepared).session.locked == locked


@pytest.mark.parametrize(
    "with_all, without, taken", [(2e6, 1.1e4, True), (2e6, 3e5, False), (1.2e4, 1e4, False)]
)
def test_aliased_records_are_left_out_where_the_others_leave_next_to_nothing(monkeypatch, with_all, without, taken):
    """A chirp to 400 Hz, logged at 500 Hz, had a healthy valve "not the stated valve", after six minutes."""
    every, fewer = (SimpleNamespace(is_long=False, options=OPTIONS, left=left) for left in (with_all, without))
    monkeypatch.setattr(coarse_to_fine, "without_aliased_records", lambda prepared: fewer)
    monkeypatch.setattr(
        coarse_to_fine,
        "fit_nominal",
        lambda prepared, progress: SimpleNamespace(fit=SimpleNamespace(chi_square=prepared.left, rows=1e4)),
    )
    found = coarse_to_fine._without_aliased_records(every, lambda share: None, options=DIAGNOSIS)
    assert found is (fewer if taken else every)


@pytest.mark.slow
def test_a_healthy_valve_under_a_chirp_that_aliases_is_told_by_the_other_records(tmp_path):
    imperfections = ("edges", "ripple", "warming", "corrupt", "calibration")
    case, bench = draw_bench(5000006, "none", imperfections=imperfections, duration=2.0)
    write_bench_session(case, bench, tmp_path)
    keep_every_second_sample(tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.verdict == "no_discrepancy"
    assert [note.split(":")[0] for note in found.notes if "half the rate" in note] == ["record_2"]
