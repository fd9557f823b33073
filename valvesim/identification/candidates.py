"""The fault candidates of a session.

A candidate is a catalogue effect (on either side, on each sensor, with its shape parameters at a few values), a user's
effect, or a nominal parameter beyond its tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import ModelVariant
from valvesim.identification.prior import NominalModel, NuisanceParameter, measured_channels
from valvesim.identification.sensor_errors import ToleratedSensorError
from valvesim.identification.session import Session
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.effect import ActiveEffect, Effect
from valvesim.valve.equations import AT_20
from valvesim.valve.parameters import Valve

OTHER_NETWORK = "thermal_network"  # the label of all its figures: which of them is off, drifts hardly tell


@dataclass(frozen=True)
class Candidate:
    """One thing that may be wrong. `fixed` are the shape parameters at which it is looked for.

    `equivalent` is the nuisance parameter that an effect moves, all but alone, see `equivalent_rate`: the nominal
    fit stretches it where the effect is there.
    """

    name: str
    effect: Effect | None = None
    fixed: tuple[tuple[str, float], ...] = ()
    parameter: NuisanceParameter | None = None
    equivalent: NuisanceParameter | None = None

    @property
    def key(self) -> str:
        """A text that no other candidate has."""
        at = f"@{self.effect.channel}" if self.effect is not None and self.effect.channel else ""
        pace = f"~{self.typical:g} s" if self.effect is not None and self.unit == "s" else ""
        return self.name + at + "".join(f"[{name}={value:g}]" for name, value in self.fixed) + pace

    @property
    def label(self) -> str:
        """The key without what is fitted anyway: candidates of one label are one answer."""
        if self.parameter is not None and self.parameter.of_network:
            return OTHER_NETWORK
        at = f"@{self.effect.channel}" if self.effect is not None and self.effect.channel else ""
        fitted = {p.name for p in self.shapes()}
        return self.name + at + "".join(f"[{name}={value:g}]" for name, value in self.fixed if name not in fitted)

    @property
    def one_sided(self) -> bool:
        """True where only amplitudes above neutral make sense."""
        if self.effect is None:
            return False
        return self.effect.amplitude.bounds[0] >= (self.effect.amplitude.neutral or 0.0)

    @property
    def plainest(self) -> str:
        """The name of the plainer effect that it is without its own feature, or its own."""
        return (self.effect.plainer if self.effect is not None else "") or self.name

    @property
    def makes_sensor_late(self) -> bool:
        """Whether it is a lag or a delay of a sensor: a recorder's filters give all of its channels the same."""
        return self.effect is not None and self.effect.reading is not None and self.unit == "s"

    def excludes(self, other: Candidate) -> bool:
        """True for another shape or side of the same effect, whose name may stand in a model only once, and for another
        law of the same thing: of effects that are one plainer effect without their own features, one acts.
        """
        if self.effect is None or other.effect is None:
            return False
        mine, others = ((one.plainer or one.name, one.channel) for one in (self.effect, other.effect))
        return mine == others

    def is_equivalent_to(self, other: Candidate) -> bool:
        """True for an effect and the quantity of the valve that it changes: two names of one thing."""
        figures = {each.effect.figure for each in (self, other) if each.effect is not None}
        return any(each.parameter is not None and each.parameter.name in figures for each in (self, other))

    @property
    def indistinguishable_from(self) -> tuple[str, ...]:
        """The names of effects that together do the same as its effect, or as the one that its parameter is."""
        same = (e for e in CATALOGUE.values() if self.parameter is not None and e.figure == self.parameter.name)
        effect = self.effect or next(same, None)
        return effect.indistinguishable_from if effect is not None else ()

    @property
    def unit(self) -> str:
        """Of the amplitude."""
        if self.effect is not None:
            return self.effect.amplitude.unit
        return "1" if self._parameter.logarithmic else self._parameter.unit

    @property
    def typical(self) -> float:
        """An amplitude that makes sense, above neutral (SI): where the search starts, and the width of its prior."""
        if self.effect is None:
            return 4.0 * self._parameter.deviation
        amplitude = self.effect.amplitude
        if amplitude.typical is None:  # a user's effect may leave it out
            return 0.05 * max(map(abs, self.limits))
        return abs(float(amplitude.typical) - float(amplitude.neutral or 0.0))

    @property
    def limits(self) -> tuple[float, float]:
        """Of the amplitude above neutral."""
        if self.effect is None:
            p = self._parameter
            if p.logarithmic:
                return float(np.log(p.bounds[0] / p.nominal)), float(np.log(p.bounds[1] / p.nominal))
            return p.bounds[0] - p.nominal, p.bounds[1] - p.nominal
        neutral = self.effect.amplitude.neutral or 0.0
        return self.effect.amplitude.bounds[0] - neutral, self.effect.amplitude.bounds[1] - neutral

    @property
    def _parameter(self) -> NuisanceParameter:
        if self.parameter is None:
            raise InputError(f"candidate {self.name} is neither an effect nor a parameter")
        return self.parameter

    def is_ordinary(self, above_neutral: float) -> bool:
        """Whether what nobody would call faulty may have so little of this effect."""
        return self.effect is not None and abs(above_neutral) < self.effect.amplitude.ordinary

    def location(self) -> str:
        """The balance or sensor where it acts."""
        if self.effect is None:
            return "thermal network" if self._parameter.of_network else "valve parameter"
        return f"sensor of {self.effect.channel}" if self.effect.channel else self.effect.location

    def active(self, above_neutral: float, **shapes: float) -> ActiveEffect:
        """The effect at an amplitude of neutral + amplitude above neutral. For a parameter there is none
        (InputError).
        """
        if self.effect is None:
            raise InputError(f"candidate {self.name} is a parameter, not an effect")
        amplitude = self.effect.amplitude
        numbers = {**dict(self.fixed), **shapes, amplitude.name: (amplitude.neutral or 0.0) + above_neutral}
        bounds = {p.name: p.bounds for p in self.effect.parameters}
        return self.effect(**{name: float(np.clip(value, *bounds[name])) for name, value in numbers.items()})

    def apply_to(self, variant: ModelVariant, above_neutral: float, **shapes: float) -> ModelVariant:
        """The variant with this candidate at an amplitude above neutral, within its bounds."""
        if self.effect is not None:
            return variant.with_effect(self.active(above_neutral, **shapes))
        p = self._parameter
        return p.with_value(variant, float(np.clip(p.more_of(variant, above_neutral), *p.bounds)))

    def share(self, variant: ModelVariant, other: ModelVariant) -> tuple[NuisanceParameter, float] | None:
        """The nuisance parameter that tells a variant from another, but for this candidate alike, and by how many prior
        deviations; None where no single one does."""
        if self.parameter is not None:
            return self.parameter, self.parameter.apart(variant, other)
        rate = self.equivalent_rate(other)
        if self.equivalent is None or not rate:
            return None
        return self.equivalent, rate * (self._amplitude_in(variant) - self._amplitude_in(other))

    def equivalent_rate(self, variant: ModelVariant) -> float:
        """By how many prior deviations of its twin a unit more of this effect moves a variant; 0 where it moves it
        otherwise, or has no twin."""
        effect, equivalent, small = self.effect, self.equivalent, 1e-4
        if effect is None or equivalent is None:
            return 0.0
        if effect.channel:
            return 1.0 / equivalent.deviation
        if (change := effect.coefficients) is None:
            return 0.0
        valve, more = variant.valve, small * self.typical
        above_neutral = self._amplitude_in(variant) - (effect.amplitude.neutral or 0.0)
        figure: dict[str, Any] = {equivalent.name: getattr(valve, equivalent.name) + small * equivalent.deviation}

        def coefficients(valve: Valve, above_neutral: float) -> np.ndarray:
            return np.array(change(valve.at(AT_20), self.active(above_neutral).values, AT_20), dtype=float)

        before = coefficients(valve, above_neutral)
        by_effect = coefficients(valve, above_neutral + more) - before
        by_figure = coefficients(replace(valve, **figure), above_neutral) - before
        acts = by_figure != 0.0
        if not acts.any():
            return 0.0
        ratio = float(np.median(by_effect[acts] / by_figure[acts]))
        alike = np.abs(by_effect - ratio * by_figure) <= 0.01 * np.abs(ratio * by_figure)
        return ratio * small / more if alike.all() else 0.0

    def _amplitude_in(self, variant: ModelVariant) -> float:
        assert self.effect is not None  # noqa: S101 - only effects have twins
        amplitude = self.effect.amplitude
        own = [
            float(getattr(active.values, amplitude.name))
            for active in variant.effects
            if (active.effect.name, active.effect.channel) == (self.effect.name, self.effect.channel)
            and not isinstance(active.effect, ToleratedSensorError)
        ]
        # a sensor's error that the session states may have more of the same beside it
        return sum(own) - (len(own) - 1) * float(amplitude.neutral or 0.0)

    def shapes(self) -> tuple[Any, ...]:
        """The shape parameters that can be fitted."""
        if self.effect is None:
            return ()
        return tuple(p for p in self.effect.parameters if p.neutral is None and not p.discrete)


def candidates_of(session: Session, nominal: NominalModel) -> tuple[Candidate, ...]:
    """Everything that is looked for in a session."""
    known = {active.effect.name for active in session.effects}
    found = []
    for effect in (*CATALOGUE.values(), *session.user_effects):
        if not _may_show_feature(effect, session, options=nominal.options):
            continue
        if effect.reading is not None:
            for channel in measured_channels(session):
                found += [
                    Candidate(effect.name, one) for one in _paced(effect.on(channel), session, options=nominal.options)
                ]
            continue
        if effect.name in known:
            continue
        sought = [[(p.name, value) for value in p.sought] for p in effect.parameters if p.sought]
        found += [
            Candidate(effect.name, one, fixed)
            for fixed in product(*sought)
            for one in _paced(effect, session, options=nominal.options)
        ]
    found = [_with_equivalent(candidate, nominal) for candidate in found]
    own = [p for p in nominal.parameters if p.sensor is None and p.input is None]
    found += [Candidate(f"parameter:{p.name}", parameter=p) for p in own]
    return tuple(found)


def _may_show_feature(effect: Effect, session: Session, *, options: IdentificationOptions) -> bool:
    """Whether the coefficient, or of a sensor the oil temperature, that an effect's own feature hangs on may change in
    a session: if it stands still, the plainer effect is all there is of it. Parts at the oil's temperature change it
    by what they expand unlike.
    """
    if not effect.feature:
        return True
    oil = np.concatenate([record.values["oil_temperature"] for record in session.training])
    if effect.reading is not None:
        return bool(np.nanmax(oil) - np.nanmin(oil) > options.prior.least_warming)
    if session.thermal.network is not None:
        return True
    parts = PartTemperatures.uniform(np.array([np.nanmin(oil), np.nanmax(oil)]))
    coefficients = session.valve.at(parts, oil=session.oil, routes=session.thermal.routes)
    low, high = np.broadcast_to(getattr(coefficients, effect.feature), 2)
    return abs(high - low) > options.prior.least_feature * abs(low)


def _with_equivalent(candidate: Candidate, nominal: NominalModel) -> Candidate:
    """The candidate with the nuisance parameter that does the same: a sensor's small error, or the figure of an
    effect.
    """
    effect = candidate.effect
    assert effect is not None  # noqa: S101 - the caller has chosen effects
    name = f"{effect.name}@{effect.channel}" if effect.channel else effect.figure
    paired = replace(candidate, equivalent=next((p for p in nominal.parameters if p.name == name), None))
    return paired if paired.equivalent_rate(nominal.variant) else candidate


def _paced(effect: Effect, session: Session, *, options: IdentificationOptions) -> tuple[Effect, ...]:
    """An effect whose amplitude is a time: looked for at one that the records can tell from none and from endless.

    That is no shorter than a sample of the slowest training record, and no longer than a quarter of the longest.
    Where it is usually longer than that record, it is looked for beyond its end as well: there it shows something else.
    """
    amplitude = effect.amplitude
    if amplitude.unit != "s" or amplitude.typical is None:
        return (effect,)
    slowest = max(1.0 / record.rate for record in session.training)
    longest = max(float(record.time[-1] - record.time[0]) for record in session.training)
    times = [min(max(amplitude.typical, slowest), max(0.25 * longest, slowest))]
    if amplitude.typical > longest:
        times.append(options.prior.beyond_records * longest)

    def at(time: float) -> Effect:
        paced = replace(amplitude, typical=min(time, amplitude.bounds[1]))
        return replace(effect, parameters=tuple(paced if p is amplitude else p for p in effect.parameters))

    return tuple(map(at, times))
