"""Published dynamic figures of merit of valves of this class."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClassFigure:
    """A published figure of a valve of this class: `low` to `high` (equal for one value), and where it stands."""

    name: str
    low: float
    high: float
    unit: str
    source: str


_TYPICAL = "typical limit of the class; not checked against a vendor's sheet"
_NASA = "NASA TN D-5388 (1969), Table I"


def class_figures() -> tuple[ClassFigure, ...]:
    """Published dynamic figures of valves of this class (NASA TN D-5388, ARP490), by the names of the computed."""
    return (
        ClassFigure("armature_frequency", 730.0, 730.0, "Hz", _NASA),
        ClassFigure("loop_gain", 837.0, 837.0, "1/s", "computed from " + _NASA),
        ClassFigure("speed_limit", 0.18, 0.18, "m/s", "computed from " + _NASA + ": stroke of the flapper"),
        ClassFigure("frequency_minus_3_db", 60.0, 250.0, "Hz", _TYPICAL + "; at 25 % of rated"),
        ClassFigure("frequency_minus_90_deg", 60.0, 250.0, "Hz", _TYPICAL + "; at 25 % of rated"),
        ClassFigure("time_to_90_percent", 2e-3, 10e-3, "s", _TYPICAL),
        ClassFigure("overshoot", 0.0, 25.0, "%", _TYPICAL),
    )
