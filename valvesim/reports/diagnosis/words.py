"""The numbers and names of a diagnosis as people read them."""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.result import AMBIGUOUS, CAUSE, Diagnosis, Estimate, Gain, Term
from valvesim.units import DISPLAY, symbol

UNDETERMINED = "not determined"
LONGEST_LABEL = 44  # signs of a name that a picture has room for
_SHARE_WORDS = ("share", "loss", "error", "fraction", "gain")  # of names whose plain number reads better in %
_UNITS = {**DISPLAY, "m/K": ("µm/K", 1e6), "Pa/(m^3/s)": ("bar/(L/min)", 1e-5 / 6e4)}


def unit_of(unit: str, size: float, name: str = "") -> tuple[str, float]:
    """(unit as people read it, factor from SI) of a quantity of that size; a share by name is in %."""
    if unit in ("1", "-", ""):
        return ("%", 100.0) if any(word in name for word in _SHARE_WORDS) else ("", 1.0)
    if unit == "s":
        return ("ms", 1e3) if abs(size) < 1.0 else ("s", 1.0)
    if unit == "1/K":
        return "1e-6/K", 1e6
    if unit == "A" and abs(size) >= 10.0:  # of a magnet, not of a coil
        return "A", 1.0
    if unit == "m" and 0.0 < abs(size) < 1e-5:
        return "µm", 1e6
    if unit == "N*m" and 0.0 < abs(size) < 0.1:
        return ("µN·m", 1e6) if abs(size) < 1e-4 else ("mN·m", 1e3)
    if unit.endswith("/K") and unit not in _UNITS:
        above, factor = DISPLAY.get(unit.removesuffix("/K"), (unit.removesuffix("/K"), 1.0))
        return f"{symbol(above)}/K", factor
    shown, factor = _UNITS.get(unit, (unit, 1.0))
    return symbol(shown), factor


def number(value: float, step: float) -> str:
    """A number to two digits of `step`, which is what it is known to; to four digits where that is not known."""
    if value == 0.0:
        return "0"
    size = max(abs(value), abs(step))
    if not (np.isfinite(step) and step > 0.0) or not 1e-4 <= size < 1e6:
        return f"{value:.4g}"
    places = int(np.clip(1 - np.floor(np.log10(step)), 0, 9))
    text = f"{value:.{places}f}"
    return text if float(text) else text.removeprefix("-")


def with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}" if unit else text


def interval(low: float, high: float, step: float, unit: str) -> str:
    """An interval in words, open sides included."""
    if np.isfinite(low) and np.isfinite(high):
        return with_unit(f"{number(low, step)} to {number(high, step)}", unit)
    if np.isfinite(low) or np.isfinite(high):
        side, bound = ("above", low) if np.isfinite(low) else ("below", high)
        return f"{side} {with_unit(number(bound, step), unit)}"
    return UNDETERMINED


def estimate_words(estimate: Estimate) -> tuple[str, str]:
    """(value, 95 % interval) with units as people read them; what is not finite is not determined.

    A figure whose interval has no width was not fitted but held.
    """
    unit, factor = unit_of(estimate.unit, estimate.value, estimate.name)
    value, low, high = (figure * factor for figure in (estimate.value, estimate.low, estimate.high))
    step = (high - low) / 2.0
    text = with_unit(number(value, step), unit) if np.isfinite(value) else UNDETERMINED
    return text, "held fixed" if step == 0.0 else interval(low, high, step, unit)


def spoken(name: str) -> str:
    """A name as a person says it: `sensor_bias@load_flow` is 'sensor bias, load flow'."""
    words = (("@", ", "), ("[", ", "), ("]", ""), ("=", " "), (":", " "), ("_", " "), (" + ", " with "))
    for sign, word in words:
        name = name.replace(sign, word)
    return name


def short(name: str) -> str:
    """A name on one line, cut where a picture has no more room for it."""
    name = " ".join(name.split())
    return name if len(name) <= LONGEST_LABEL else f"{name[: LONGEST_LABEL - 1]}…"


def answer_labels(diagnosis: Diagnosis) -> set[str]:
    """Labels of the causes that the answer names, alone or together."""
    named = diagnosis.verdict in (CAUSE, AMBIGUOUS)
    return {label for c in diagnosis.candidates if named and c.in_set for label in (c.label, *c.label.split(" + "))}


def percent(share: float) -> str:
    """A probability or a share; never rounded to certainty."""
    percent = 100.0 * share
    if not np.isfinite(percent):
        return UNDETERMINED
    if 99.5 <= percent < 100.0 or 0.0 < percent < 0.5:
        return "over 99 %" if percent > 50.0 else "under 1 %"
    return f"{percent:.0f} %"


def deviations(value: float) -> str:
    """An error in noise deviations."""
    return f"{value:.1f}" if value < 99.5 else f"{value:.0f}" if value < 1e5 else f"{value:.1e}"


def gain_words(gain: Gain) -> str:
    """What the errors on one hold-out record amount to, or why nothing is claimed of it."""
    if gain.claimed:
        above, left = gain.before**2 - gain.floor**2, gain.after**2 - gain.floor**2
        if above > 0.0 and np.isfinite(left):
            return f"better: {percent(float(np.clip(1.0 - left / above, 0.0, 1.0)))} of the error above the noise gone"
        return "better"
    if not (np.isfinite(gain.low) and np.isfinite(gain.high)):
        return "not claimed: the interval of the change is not determined"
    if gain.low > 0.0:
        return "not claimed: the extended model is worse here"
    if gain.high >= 0.0:
        return "not claimed: the interval of the change includes zero"
    return "not claimed: better, but too little to be worth having"


def extended_differs(diagnosis: Diagnosis) -> bool:
    """Whether any hold-out record saw a model that is not the nominal itself."""
    return any(gain.change != 0.0 for gain in diagnosis.gain)


def relative_change(gain: Gain) -> tuple[float, float, float]:
    """(change, low, high) in % of the mean square before; NaN where there was none."""
    share = 100.0 / gain.before**2 if gain.before > 0.0 else np.nan
    return gain.change * share, gain.low * share, gain.high * share


def term_units(term: Term) -> tuple[tuple[str, float], tuple[str, float]]:
    """Unit and factor of the variable and of what is added."""
    sizes = [max(map(abs, each), default=0.0) for each in (term.at, term.value)]
    return unit_of(term.variable_unit, sizes[0]), unit_of(term.port_unit, sizes[1])
