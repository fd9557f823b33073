"""Long sessions: their records' beginnings are searched first, and the whole session for what these have shown.

A look at ten minutes of records takes some twenty times as long as one at their first seconds. What does not explain
these does not explain the whole either, so that few hypotheses are left to be fitted to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from .errors import InputError, SolveError
from .search import Searched, search
from .session import Record
from .study import BaseFit, Fit, Study, fit_base, fit_base_near, restricted

SAMPLES = 20_000  # of all beginnings that differ together
FEWEST = 500  # of one
STILL = 2e-3  # of its span: an input that has changed by less has not begun to move
BEFORE = 0.05  # s before the first input moves are kept
UNEXPLAINED = 2  # hypotheses that are taken along where none explains the beginnings


def begin(study: Study, tell: Callable[[str, float], None]) -> tuple[BaseFit, Sequence[Fit]]:
    """The base fit of a session, and of a long one the hypotheses (fitted to beginnings) that are to be fitted to it.

    Without hypotheses the whole session is to be searched for them. `tell(stage, share)` is told what is being done.
    Raises SolveError where the valve cannot be run.
    """
    stage = "fitting the nominal model"
    tell(stage, 0.0)
    if study.is_long:
        with suppress(SolveError, InputError):  # a record's beginning need not hold what makes it a record
            searched = _search_beginnings(study, lambda what, share: tell(f"{what}, in the first seconds", 0.5 * share))
            tell(stage, 0.5)
            base = fit_base_near(study, searched.base.fit.point, peaks=not searched.base.study.weights)
            known = searched.rivals or searched.found[:UNEXPLAINED]
            return base, [one.fit for one in known if one.fit.extras]
    return fit_base(study, lambda share: tell(stage, share)), ()


def _search_beginnings(study: Study, tell: Callable[[str, float], None]) -> Searched:
    short = restricted(study, beginnings([bench.record for bench in study.benches], len(set(study.firsts))))
    tell("fitting the nominal model", 0.0)
    base = fit_base(short, lambda share: tell("fitting the nominal model", 0.3 * share))
    return search(base, lambda stage, share: tell(stage, 0.3 + 0.7 * share))


def beginnings(records: Sequence[Record], tests: int) -> list[Record]:
    """The records' first seconds, from just before their inputs move; repeats, of so many tests, keep in step."""
    most, starts = max(SAMPLES // tests, FEWEST), dict[str, int]()
    for record in records:
        starts[record.test] = min(_start(record), starts.get(record.test, len(record.time)))
    return [_part(record, slice(starts[record.test], starts[record.test] + most)) for record in records]


def _start(record: Record) -> int:
    """The sample from which a record says something."""
    moved = np.zeros(len(record.time), dtype=bool)
    for name in record.inputs:
        values = record.values[name]
        moved |= np.abs(values - values[0]) > STILL * np.ptp(values)
    return max(int(np.argmax(moved)) - int(np.ceil(BEFORE * record.rate)), 0)


def _part(record: Record, kept: slice) -> Record:
    return replace(
        record,
        time=record.time[kept] - record.time[kept.start],
        values={name: values[kept] for name, values in record.values.items()},
        usable={name: usable[kept] for name, usable in record.usable.items()},
    )
