"""Resistance and inductance of the coils from a record of voltage and current (ISO 10770-1).

Symbols
    v voltage V, i current A, R ohm, L H; v = R i + L di/dt by least squares over the record
"""

from __future__ import annotations

import numpy as np

from valvesim.characterisation.acceptance.metrics import jackknife, merit
from valvesim.characterisation.figure_of_merit import Absent, FiguresOfMerit
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, AcceptanceOptions
from valvesim.characterisation.record_checks import checked_record
from valvesim.errors import InputError
from valvesim.valve.parameters import Valve


def coil_figures(
    time, voltage, current, *, temperature: float | None = None,
    options: AcceptanceOptions = DEFAULT_CHARACTERISATION.acceptance,
) -> FiguresOfMerit:  # fmt: skip
    """coil_resistance: as measured. coil_resistance_at_20: at 20 °C by the slope of copper, from the oil temperature
    (°C) that the coils have soaked at. coil_inductance: absent where the record is too slow to show it.

    Arrays (n,) in s, V, A. Raises InputError for gaps, different lengths, and a current that does not move.
    """
    t, v, i = checked_record(time, voltage, current)
    if np.ptp(i) <= 1e-9 * float(np.max(np.abs(i))):
        raise InputError("coil record: the current does not move, and a bias of the meters would show as resistance")
    rate = np.gradient(i, t)
    columns = np.column_stack([i, rate, np.ones_like(i)])

    def fit(keep: np.ndarray) -> np.ndarray:
        scale = np.abs(columns[keep]).max(axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        return np.linalg.lstsq(columns[keep] / scale, v[keep], rcond=None)[0] / scale

    R, L, _ = (float(value) for value in fit(np.arange(len(i))))
    R_error = jackknife(lambda keep: float(fit(keep)[0]), len(i))
    L_error = jackknife(lambda keep: float(fit(keep)[1]), len(i))
    slow = np.std(L * rate) < options.inductive_share * np.std(v)
    why = "the current moves too slowly for the inductance to show: record a step or a sine of the voltage"
    referred = Absent("coil_resistance_at_20", "no oil temperature is stated")
    share = 1.0 if temperature is None else 1.0 + Valve().copper_resistance_slope * (temperature - 20.0)
    return (
        merit("coil_resistance", R, R_error, "ohm", "voltage over current, as measured"),
        referred
        if temperature is None
        else merit("coil_resistance_at_20", R / share, R_error / share, "ohm", "the same at 20 °C, by that of copper"),
        Absent("coil_inductance", why)
        if slow or L <= 0.0
        else merit("coil_inductance", L, L_error, "H", "voltage over the rate of the current"),
    )
