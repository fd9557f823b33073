"""Noise that grows with the reading: found from replicates, and whitened."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.identification.noise_estimation import identify_noise
from valvesim.identification.noise_growth import _growth, grown, growth_notes, noise_growth
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.study import prepare_session

CHANNEL = "spool_position"


def turns(growth, seed, n=3000):
    """Squared turns and squared readings of channels that swing, with noise that grows so."""
    draw = np.random.default_rng(seed)
    read = np.sin(np.arange(n) / 9.0) * draw.uniform(0.5, 1.0, n)
    turn = np.diff(grown(growth, read) * draw.normal(size=n), 2)[::3]
    return turn**2, read[1:-1][::3] ** 2


@given(st.integers(0, 2**32 - 1), st.floats(2.5, 8.0), st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_growth_is_found_in_any_unit_and_none_where_there_is_none(seed, growth, unit, size):
    square, level = turns(growth, seed)
    found = _growth(square * size**2, level * unit**2, options=OPTIONS)
    assert found * unit == pytest.approx(growth, rel=0.35)
    assert _growth(*turns(0.0, seed), options=OPTIONS) == 0.0


def test_nothing_is_found_in_few_samples_in_silence_or_at_rest():
    square, level = turns(5.0, 1)
    few = OPTIONS.audit.least_samples - 1
    assert _growth(square[:few], level[:few], options=OPTIONS) == 0.0
    for still in (np.ones_like(level), 3.0 + 1e-12 * level):  # a square wave, a pressure that is held
        assert _growth(square, still, options=OPTIONS) == 0.0
    assert _growth(0.0 * square, level, options=OPTIONS) == _growth(square, 0.0 * level, options=OPTIONS) == 0.0


def grown_session(session, growth):
    """A session each of whose tests is measured twice, with noise that grows so; and the same without that."""
    draw, quiet, loud = np.random.default_rng(5), [], []
    most = max(float(np.max(np.abs(r.values[CHANNEL]))) for r in session.records)
    for record in session.records:
        for name in (record.name, f"{record.name}_again"):
            one = replace(record, name=name, repeats=record.name)
            read = record.values[CHANNEL]
            noise = 5e-3 * most * grown(growth / most, read) * draw.normal(size=len(read))
            quiet.append(one)
            loud.append(replace(one, values={**record.values, CHANNEL: read + noise}))
    return replace(session, records=tuple(loud)), replace(session, records=tuple(quiet))


def test_a_session_s_growing_noise_is_whitened_and_told(biased_session):
    assert noise_growth(biased_session, options=OPTIONS) == {} and prepare_session(biased_session).noise_growth == {}
    session, quiet = grown_session(biased_session, 6.0)
    prepared = prepare_session(session)
    growth = prepared.noise_growth[CHANNEL]
    pairs = [(r.values[CHANNEL], q.values) for r, q in zip(session.training, quiet.training, strict=True)]
    study = prepared.with_noise(identify_noise(prepared, [values for _, values in pairs]))
    apart = [{n: (read - v if n == CHANNEL else 0.0 * v)[:, None] for n, v in values.items()} for read, values in pairs]
    rows = study.stack(apart)[:, 0]
    whole = sum(len(r.time) for r in session.training)
    assert float(rows @ rows) == pytest.approx(whole, rel=0.15)
    (note,) = prepared.session.notes[len(session.notes) :]
    assert note == growth_notes(session, prepared.noise_growth)[0]
    largest = max(float(np.max(np.abs(record.values[CHANNEL]))) for record in session.training)
    times = float(grown(growth, np.array(largest)))
    assert note.startswith(f"{CHANNEL}: its noise grows with the reading, to {times:.2g} times")


def test_without_replicates_nothing_tells_noise_from_the_model(biased_session):
    session, _ = grown_session(biased_session, 6.0)
    alone = replace(session, records=tuple(replace(record, repeats=None) for record in session.records))
    assert noise_growth(alone, options=OPTIONS) == {}
