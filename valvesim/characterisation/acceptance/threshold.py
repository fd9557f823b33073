"""Threshold: the change of current that moves the output back after a stop (SAE ARP490)."""

from __future__ import annotations

import numpy as np

from valvesim.characterisation.acceptance.metrics import merit
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import FigureOfMerit
from valvesim.inputs import Table


def threshold_figure(rig: Rig) -> FigureOfMerit:
    """Current change that moves the output back after a stop at 10 % of i_R, share of i_R (ARP490).

    Told from a thousandth of rated output, whose own current at the gain of the way back is taken off.
    """
    top = float(rig.valve.rated_current)
    stop, unit = 0.1 * top, rig.period / 8.0
    command = Table(times=(0.0, unit, 1.5 * unit, 4 * unit), values=(0.0, stop, stop, 0.0))
    values = rig.run(command, 4 * unit)
    back = values["time"] >= 1.5 * unit
    i, x = values["current"][back], values["spool_position"][back]
    mark = 1e-3 * abs(x[0]) / stop * top
    fallen = np.abs(x - x[0])
    first, second = (float(np.interp(level, fallen, stop - i)) for level in (mark, 2 * mark))
    value = max(first - (second - first), 0.0) / top
    spacing = float(np.median(np.abs(np.diff(i)))) / top
    return merit("threshold", value, spacing, "1", "current change that reverses the output after a stop, % i_R")
