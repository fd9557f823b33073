"""What the command does between its samples."""

from __future__ import annotations

import numpy as np

from valvesim.identification.options import IdentificationOptions


def command_jumps(values: np.ndarray, *, options: IdentificationOptions) -> np.ndarray:
    """Indices k of the samples of a command (n,) after which it jumps: it hardly moves in the intervals beside."""
    change = np.abs(np.diff(values))
    beside = np.maximum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    size = options.input.jump * max(float(np.ptp(values)), 1e-300)
    return np.flatnonzero((change > size) & (change > options.input.jump_ratio * beside))
