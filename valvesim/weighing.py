"""Hypotheses that were fitted, weighed against each other: what explains the data, and what does so nearly as well.

Differences of deviance count less than they would if the model were the plant, and what is rare or has more freedom
costs more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .hypotheses import Candidate
from .study import FLOOR, UNSETTLED, BaseFit, Extra, Fit

ANSWER_RATIO = 6.0  # difference of deviance up to which candidates stay in the answer set ...
ANSWER_SHARE = 0.04  # ... and this share of what the best explains, since no model is the plant
WORTH = 0.8  # of the squared alarm level: what a hypothesis must explain to be one at all
SECOND_WORTH = 30.0  # deviance: a second cause that brings less may be what the plant does otherwise than any model
NOTHING = 2.0 * FLOOR  # of what is typical: an amplitude that is none
PARAMETER_PRICE = 3.0  # deviance: a figure beyond its tolerance is rarer than an effect of the catalogue ...
MATERIAL_PRICE = 12.0  # ... and rarer still is one that the material has, and not how the part was made
REFINED_PRICE = 1.0  # the same for an effect that is another, plainer one where its own feature does not show


@dataclass(frozen=True, eq=False)
class Explained:
    """A hypothesis fitted."""

    fit: Fit

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        return tuple(extra.candidate for extra in self.fit.extras)

    @property
    def least(self) -> float:
        """The deviance, with what is still promised taken off."""
        return self.fit.deviance - min(self.fit.promised, UNSETTLED)

    @property
    def price(self) -> float:
        """What it costs to hold these candidates at all, whatever the data say."""
        return sum(2.0 * np.log(10.0) + _rarity(candidate) for candidate in self.candidates)

    @property
    def evidence(self) -> float:
        """`least` with the price of its freedom."""
        strength = sum((e.excess / (5.0 * e.candidate.typical)) ** 2 for e in self.fit.extras)
        return float(self.least + self.fit.occam + self.price + strength)

    def weighed(self, heat: float) -> float:
        """`evidence` where differences of deviance count so many times less, and prices do not, see `heat_of`."""
        return self.evidence + (heat - 1.0) * self.price

    @property
    def law_error(self) -> float:
        """The share of what it explains by which another law of the same effect may do better."""
        return max((c.effect.law_error for c in self.candidates if c.effect is not None), default=0.0)

    @property
    def label(self) -> str:
        """The candidates' families."""
        return " + ".join(c.family for c in self.candidates) or "nothing but noise"

    def is_within(self, other: Explained) -> bool:
        """Whether another hypothesis has all these candidates, by whatever name."""
        return all(
            any(mine.family == c.family or mine.is_same_as(c) for c in other.candidates) for mine in self.candidates
        )

    def means(self, other: Explained) -> bool:
        """Whether another hypothesis has just these candidates."""
        return len(self.candidates) == len(other.candidates) and self.is_within(other)


def _rarity(candidate: Candidate) -> float:
    """The price of what is rarer than an effect of the catalogue."""
    if candidate.effect is None:
        return MATERIAL_PRICE if candidate.unit.endswith("/K") else PARAMETER_PRICE
    return REFINED_PRICE if candidate.effect.plainer else 0.0


def settled(found: Sequence[Explained]) -> list[Explained]:
    """Best evidence first: one of each meaning, without pairs that hold an effect which has come to nothing."""
    kept: list[Explained] = []
    for one in sorted(found, key=lambda one: one.evidence):
        nothing = len(one.fit.extras) > 1 and any(map(is_nothing, one.fit.extras))
        if not nothing and not any(map(one.means, kept)):
            kept.append(one)
    return kept


def ran(fit: Fit) -> bool:
    return bool(np.isfinite(fit.deviance))


def is_nothing(extra: Extra, share: float = NOTHING) -> bool:
    """Whether an amplitude has come to less than a share of what is typical."""
    return abs(extra.excess) < share * extra.candidate.typical


def worth(base: BaseFit, found: Sequence[Explained], level: float) -> list[Explained]:
    """Those that explain enough to be hypotheses at all."""
    return [one for one in found if base.fit.deviance - one.fit.deviance > WORTH * level**2]


def width_of(base: BaseFit, best: Explained, more: float = 0.0) -> float:
    """The difference of evidence up to which another explains the data nearly as well as the best does.

    A fall beyond the noise itself tells how far astray the base was, not how much the best explains. `more` is what it
    would explain besides in further records.
    """
    fall = min(base.fit.deviance - best.fit.deviance, best.fit.rows) + more
    return max(ANSWER_RATIO, max(ANSWER_SHARE, best.law_error) * fall)


def heat_of(base: BaseFit, best: Explained) -> float:
    """By how much less a difference of deviance counts than it would if the model were the plant."""
    return width_of(base, best) / ANSWER_RATIO


def ranked(base: BaseFit, found: Sequence[Explained]) -> list[Explained]:
    """The found with those that explain the data nearly as well as the best in the order of their probabilities.

    Of two that fit alike for a model that is not the plant, the plainer goes first.
    """
    best = found[0]
    heat, width = heat_of(base, best), width_of(base, best)
    near = sorted((one for one in found if one.evidence - best.evidence < width), key=lambda one: one.weighed(heat))
    return [*near, *(one for one in found if one not in near)]


def rivals_of(base: BaseFit, found: Sequence[Explained], whole: bool = True) -> list[Explained]:
    """The best, and those that explain the data nearly as well; `whole` tells that the best leaves nothing over."""
    if not found:
        return []
    best, width, heat = found[0], width_of(base, found[0]), heat_of(base, found[0])
    most = len(best.candidates)  # how wide a prior is does not tell two apart that fit alike
    near = [
        one
        for one in found
        if one.weighed(heat) - best.weighed(heat) < width
        or (len(one.candidates) <= most and one.least - best.least < width)
        or (len(one.candidates) < most and one.is_within(best) and one.least - best.least < SECOND_WORTH)
    ]
    # what a better one says already, and something more besides, is no rival of it, unless there must be something more
    return [one for k, one in enumerate(near) if not whole or not any(better.is_within(one) for better in near[:k])]


def doubt(base: BaseFit, best: Explained, level: float) -> float:
    """The difference of evidence between noise alone and the best: at the alarm level the two are as likely."""
    return base.fit.deviance - best.fit.deviance - level**2


def chance_beside(base: BaseFit, rivals: Sequence[Explained], level: float) -> list[Explained]:
    """The model as it is, where what the best explains is so little that it may be chance."""
    return [Explained(base.fit)] if rivals and doubt(base, rivals[0], level) < ANSWER_RATIO else []
