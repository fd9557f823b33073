"""Errors of sensors within their tolerance: nuisance parameters, not faults."""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.valve.effect import Effect


@dataclass(frozen=True, kw_only=True)
class ToleratedSensorError(Effect):
    """A sensor's error within its tolerance, in all records or in the `record` that is named."""

    record: str = ""


class ToleratedTimeError(ToleratedSensorError):
    """One of when it reads. What the reading does is read as late."""


def reads_channel(effect: Effect, channel: str, record: str) -> bool:
    """Whether an effect is of the sensor of a channel in a record."""
    return effect.channel == channel and getattr(effect, "record", "") in ("", record)
