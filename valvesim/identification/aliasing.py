"""Records whose commands alias: what goes faster than half their rate looks slower in the samples (Shannon 1949).

No way of going on between its samples is that of such a command. A sine at half the rate turns at each sample, so that
its second difference is four times the sample itself: R = |u[k+1] - 2 u[k] + u[k-1]| / |u[k]| = 4 sin^2(pi f / f_s),
3.75 at f = 0.42 f_s; over few samples it scatters, and steady tones count from 0.4. Noise has 2.4, a hold that is as
fast as the samples too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from valvesim.identification.noise_growth import growth_notes
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.session import Record
from valvesim.identification.study import PreparedSession, prepare_session


def without_aliased_records(prepared: PreparedSession) -> PreparedSession:
    """The prepared session without the records whose commands reach half their rate, and notes on them; as it was where
    none or all of the training records do. Of those locked away the same, unless all do.
    """
    session, options = prepared.session, prepared.options
    aliased = {record.name for record in session.records if is_aliased(record, options=options)}
    left_out = [record for record in session.training if record.name in aliased]
    if len(left_out) in (0, len(session.training)):
        return prepared
    if all(record.name in aliased for record in session.locked):
        aliased -= {record.name for record in session.locked}
    known = growth_notes(session, prepared.noise_growth)
    notes = [
        f"{record.name}: the {record.command} reaches half the rate of its samples, which do not tell how it goes "
        "beyond that, and no model comes near; the record is left out: log it faster, or drive the valve slower"
        for record in left_out
    ]
    records = tuple(record for record in session.records if record.name not in aliased)
    notes = [*(note for note in session.notes if note not in known), *notes]
    return prepare_session(replace(session, records=records, notes=tuple(notes)), options=options)


def is_aliased(record: Record, *, options: IdentificationOptions) -> bool:
    """Whether the command of a record reaches half the rate of its samples for a while."""
    own = options.input
    values, width = record.values[record.command], own.aliasing_samples
    if len(values) < width:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(values, width)[:: width // 2]
    deviation = windows.std(axis=1)
    curvature = np.sqrt(np.mean(np.diff(windows, 2, axis=1) ** 2, axis=1))
    moves = deviation > options.audit.flat_reach * np.ptp(values)
    return bool(np.mean(moves & (curvature > own.aliasing_ratio * deviation)) > own.least_aliased)
