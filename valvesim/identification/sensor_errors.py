"""Errors of sensors within their tolerance: nuisance parameters, not faults."""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.valve.effect import ActiveEffect, Effect


@dataclass(frozen=True, kw_only=True)
class ToleratedSensorError(Effect):
    """A sensor's error within its tolerance, by the same amount in every record, or in the `records` that are named by
    so many times that.
    """

    records: tuple[tuple[str, float], ...] = ()


class ToleratedTimeError(ToleratedSensorError):
    """One of when it reads. What the reading does is read as late."""


def reads_channel(effect: Effect, channel: str, record: str) -> bool:
    """Whether an effect is of the sensor of a channel in a record."""
    own = effect.records if isinstance(effect, ToleratedSensorError) else ()
    return effect.channel == channel and (not own or record in dict(own))


def reads_between(effect: Effect) -> bool:
    """Whether what an effect reads may hang on what there was at other times: not an error of how much it reads."""
    return not isinstance(effect, ToleratedSensorError) or isinstance(effect, ToleratedTimeError)


def active_in(active: ActiveEffect, record: str) -> ActiveEffect:
    """An effect as it acts in a record that it is of."""
    effect = active.effect
    if not isinstance(effect, ToleratedSensorError) or not effect.records:
        return active
    name = effect.amplitude.name
    return effect(**{name: dict(effect.records)[record] * getattr(active.values, name)})
