"""Hold-out records: tests that are locked away for validation until the diagnosis is done (Ljung, System
Identification, ch. 16: cross-validation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import Record


def hold_out(records: Sequence[Record], seed: int, notes: list[str], *, options: IdentificationOptions) -> list[Record]:
    """The records with their final roles, and notes on what cannot be claimed."""
    tests: dict[str, list[Record]] = {}
    for record in records:
        tests.setdefault(record.test, []).append(record)
    repeated = [test for test, members in tests.items() if len(members) > 1]
    if not repeated:
        notes.append("no test was repeated: the noise is unverified")
    for test in repeated:
        if len({record.role for record in tests[test]}) > 1:
            notes.append(f"{test}: some are locked away and others not; they tell of the same test")
    if any(record.role == "test" for record in records):
        return list(records)
    if len(records) == 1:
        notes.append("one record only: no record can be locked away, so the gain cannot be claimed")
    elif len(tests) < 3:
        notes.append("fewer than three different tests: none is locked away, so the gain cannot be claimed")
    if len(tests) < 3:
        return list(records)
    order = [str(test) for test in np.random.default_rng(seed).permutation(sorted(tests))]
    if len(repeated) == 1:  # the noise is learnt from it
        order.remove(repeated[0])
    locked = order[: max(1, round(options.audit.hold_out_share * len(tests)))]
    names = [record.name for record in records if record.test in locked]
    notes.append(f"locked away until the end (drawn with seed {seed}): {', '.join(names)}")
    return [replace(record, role="test") if record.test in locked else record for record in records]
