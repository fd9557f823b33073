"""Threshold of a measured valve: the change of current that moves the output back after a turn (SAE ARP490).

Symbols
    i current A, y output; d the change of current since a turn at which y has moved back by a mark
"""

from __future__ import annotations

import numpy as np

from valvesim.characterisation.acceptance.metrics import merit
from valvesim.characterisation.acceptance.record import AcceptanceRecord
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit
from valvesim.errors import InputError


def measured_threshold(record: AcceptanceRecord, channel: str, *, rated_current: float) -> FigureOfMerit | Absent:
    """threshold, share of rated current, from small slow cycles of the current with `channel` as output.

    At each turn the current at which the output has moved back by a mark, less what the mark itself takes at the gain
    of the way back (told from a second mark as far again): the mean over the turns, their scatter as uncertainty.
    Absent where fewer than two turns have an output beyond its noise.
    """
    i, y = record.channel("current"), record.channel(channel)
    noise = float(1.4826 * np.median(np.abs(np.diff(y, 2)))) / np.sqrt(6.0)
    mark = max(record.options.reversal * noise, 1e-3 * float(np.ptp(y)))
    changes = []
    turns = _turns(i)
    for start, end in zip(turns[1:-1], turns[2:], strict=True):  # where a record begins nothing has turned
        moved, back = np.abs(i[start:end] - i[start]), np.abs(y[start:end] - y[start])
        if back.max() < 3.0 * mark:
            continue
        first, second = (float(moved[int(np.argmax(back >= level))]) for level in (mark, 2.0 * mark))
        changes.append(max(2.0 * first - second, 0.0))
    if len(changes) < (least := record.options.least_reversals):
        told = f"{len(changes)} turns of the current move the output beyond its noise; {least} are needed"
        return Absent("threshold", told)
    spacing = float(np.median(np.abs(np.diff(i)))) / np.sqrt(12.0)
    scatter = float(np.std(changes) / np.sqrt(len(changes)))
    return merit(
        "threshold", float(np.mean(changes)) / rated_current, float(np.hypot(scatter, spacing)) / rated_current, "1",
        "current change that reverses the output after a turn, share of i_R",
    )  # fmt: skip


def _turns(i: np.ndarray) -> list[int]:
    """Samples at which the current turns, both ends with them. InputError where it hardly moves."""
    if np.ptp(i) <= 0.0:
        raise InputError("threshold record: the current never moves")
    level, turns, direction, extreme = 0.1 * float(np.ptp(i)), [0], 0, 0
    for k in range(1, len(i)):
        if direction >= 0 and i[k] >= i[extreme] or direction <= 0 and i[k] <= i[extreme]:
            direction = direction or int(np.sign(i[k] - i[extreme]))
            extreme = k
        elif abs(i[k] - i[extreme]) > level:
            turns.append(extreme)
            direction, extreme = int(np.sign(i[k] - i[extreme])), k
    return [*turns, len(i)]
