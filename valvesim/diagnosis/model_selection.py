"""Hypotheses that were fitted, weighed against each other: what explains the data, and what does so nearly as well.

Differences of chi-square count less than they would if the model were the plant, and what is rare or has more freedom
costs more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from valvesim.diagnosis.options import DiagnosisOptions
from valvesim.diagnosis.power import asked_difference
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.nominal_fit import NominalFit


@dataclass(frozen=True, eq=False)
class FittedHypothesis:
    """A hypothesis fitted."""

    fit: Fit
    options: DiagnosisOptions

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        return tuple(member.candidate for member in self.fit.fitted)

    @property
    def least_chi_square(self) -> float:
        """The chi-square less what the fit still predicts to gain."""
        return self._predicted(0.0)

    def gain_beyond(self, alone: FittedHypothesis) -> float:
        """The chi-square that this explains beyond some of its own causes `alone`, whose fit may have stopped short: of
        either as little is left as its fit predicts, of this by no more than of that.
        """
        predicted = alone.fit.predicted_reduction
        return alone.fit.chi_square - predicted - self._predicted(predicted)

    def _predicted(self, least: float) -> float:
        """The chi-square less what the fit still predicts to gain, up to `least` or more."""
        most = max(2.0 * self.options.identification.fit.hypothesis_ftol, least)
        return self.fit.chi_square - min(self.fit.predicted_reduction, most)

    @property
    def prior_penalty(self) -> float:
        """Twice the log prior odds against these candidates."""
        return sum(2.0 * np.log(10.0) + rarity_penalty(c, options=self.options) for c in self._independent)

    @property
    def occam_factor(self) -> float:
        """That of the fit; the sensors of one recorder have one figure between them that makes them late."""
        one = len(self._independent) == 1
        return self.fit.occam_factor / len(self.candidates) if one else self.fit.occam_factor

    @property
    def _independent(self) -> tuple[Candidate, ...]:
        """The candidates but those that another one makes likely: what makes sensors late, their recorder may."""
        return tuple({c.name if c.makes_sensor_late else c.label: c for c in self.candidates}.values())

    @property
    def evidence(self) -> float:
        """Minus twice the log evidence, up to a constant (Laplace's approximation; MacKay 1992)."""
        strength = sum((e.above_neutral / (5.0 * e.candidate.typical)) ** 2 for e in self.fit.fitted)
        return float(self.least_chi_square + self.occam_factor + self.prior_penalty + strength)

    @property
    def promised_evidence(self) -> float:
        """The evidence where the fit gains all that it still predicts."""
        return self.evidence - self.least_chi_square + self.fit.chi_square - self.fit.predicted_reduction

    def tempered(self, temperature: float) -> float:
        """The same tempered: differences of chi-square over a temperature, prior odds not, see `temperature_of`. How
        wide the priors of shapes are does not count: each takes up as much as by chance at most.
        """
        by_chance = self.options.selection.law_gain * self.fit.fitted_shapes
        too_wide = max(self.fit.shape_occam_factor - by_chance, 0.0)
        return self.evidence - too_wide + (temperature - 1.0) * self.prior_penalty

    @property
    def law_error(self) -> float:
        """The share of what it explains by which another law of the same effect may do better: a recorder's filter,
        which makes several sensors late, is of any order.
        """
        own = max(self._law_errors, default=0.0)
        together = len(self.candidates) > len(self._independent) == 1
        return max(own, self.options.selection.filter_law_error) if together else own

    @property
    def _law_errors(self) -> tuple[float, ...]:
        """The `law_error` of each candidate by itself."""
        return tuple(c.effect.law_error if c.effect is not None else 0.0 for c in self.candidates)

    def law_error_of(self, explained: float) -> float:
        """`law_error` of a chi-square that all explain together: of several causes, each errs by its share of what it
        explains beside the others, where that is known.
        """
        beside = self.fit.wald_statistics
        if len(self._independent) == 1 or len(beside) != len(self.candidates) or explained <= 0.0:
            return self.law_error
        return max(own * min(by / explained, 1.0) for own, by in zip(self._law_errors, beside, strict=True))

    def law_may_leave(self, nominal: Fit) -> float:
        """The chi-square that another law of the same effect may explain more, of what a nominal fit leaves."""
        explained = nominal.chi_square - self.fit.chi_square
        return self.law_error_of(explained) * explained

    def bearable_share(self, nominal: Fit) -> float:
        """The share of what it explains, of what a nominal fit leaves, that may be left over without ruling it out:
        little, and no more than a plant does otherwise than any model.
        """
        explained = nominal.chi_square - self.fit.chi_square
        little, of_plant = self.options.detection.little_share, self.options.selection.second_gain
        return min(little, of_plant / explained) if explained > 0.0 else little

    @property
    def label(self) -> str:
        """The candidates' labels."""
        return " + ".join(c.label for c in self.candidates) or "nothing but noise"

    def is_within(self, other: FittedHypothesis) -> bool:
        """Whether another hypothesis has all these candidates, by whatever name."""
        return all(
            any(mine.label == c.label or mine.is_equivalent_to(c) for c in other.candidates) for mine in self.candidates
        )

    def nests_law_of(self, plainer: FittedHypothesis) -> bool:
        """Whether this is another hypothesis but for one law, as common as that in its place, which it holds."""
        labels, others = ({c.label: c for c in one.candidates} for one in (self, plainer))
        own = [c.effect for label, c in labels.items() if label not in others]
        replaced = [c.name for label, c in others.items() if label not in labels]
        alike = len(self.candidates) == len(plainer.candidates) and len(own) == 1
        return alike and own[0] is not None and own[0].as_common and [own[0].plainer] == replaced

    def is_indistinguishable_from(self, alone: FittedHypothesis) -> bool:
        """Whether this has the effects that together do what a single one does."""
        others = [candidate.indistinguishable_from for candidate in alone.candidates]
        return len(others) == 1 and bool(others[0]) and set(others[0]) == {c.name for c in self.candidates}

    def holds(self, smaller: FittedHypothesis) -> bool:
        """Whether this can follow all that another hypothesis can: it has its causes, or a fuller law of one."""
        return smaller.is_within(self) or self.nests_law_of(smaller)

    def has_same_causes(self, other: FittedHypothesis) -> bool:
        """Whether another hypothesis has just these candidates."""
        return len(self.candidates) == len(other.candidates) and self.is_within(other)


def rarity_penalty(candidate: Candidate, *, options: DiagnosisOptions) -> float:
    """Twice the log prior odds against what is rarer than an effect of the catalogue."""
    if candidate.parameter is not None:
        of_material = candidate.parameter.of_material
        return options.selection.material_penalty if of_material else options.selection.parameter_penalty
    assert candidate.effect is not None  # noqa: S101 - a candidate is either
    rarer = candidate.effect.plainer and not candidate.effect.as_common
    return options.selection.refined_penalty if rarer else 0.0


def distinct(found: Sequence[FittedHypothesis], *, options: DiagnosisOptions) -> list[FittedHypothesis]:
    """Best evidence first: one of each meaning, without pairs that hold an effect which has come to nothing."""
    kept: list[FittedHypothesis] = []
    for one in sorted(found, key=lambda one: one.evidence):
        nothing = len(one.fit.fitted) > 1 and any(
            is_negligible(member, options.selection.negligible_amplitude) for member in one.fit.fitted
        )
        if not nothing and not any(map(one.has_same_causes, kept)):
            kept.append(one)
    return kept


def is_negligible(member: FittedCandidate, share: float) -> bool:
    """Whether an amplitude has come to less than a share of what is typical."""
    return abs(member.above_neutral) < share * member.candidate.typical


def with_minimum_gain(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    level: float,
    of_bench: float = 0.0,
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """Those that explain enough to be hypotheses at all: more than chance, and in the readings more than what may be
    `of_bench`. A figure that is beyond its tolerance without them is out of the bench's reach.
    """
    least = options.selection.minimum_gain * level**2

    def gain(one: FittedHypothesis) -> float:
        whole = nominal.fit.chi_square - one.fit.chi_square
        of_readings = whole - (nominal.fit.point @ nominal.fit.point - one.fit.point @ one.fit.point)
        return float(whole - min(of_bench, max(of_readings, 0.0)))

    return [one for one in found if gain(one) > least]


def _explained(nominal: NominalFit, best: FittedHypothesis) -> float:
    """The chi-square that the best explains: a fall beyond the noise itself tells how inadequate the nominal fit was,
    not how much that is.
    """
    return min(nominal.fit.chi_square - best.fit.chi_square, best.fit.rows)


def answer_set_width(nominal: NominalFit, best: FittedHypothesis, more: float = 0.0) -> float:
    """The difference of evidence up to which another hypothesis explains the data nearly as well as the best does.
    `more` is what the best would explain besides in further records.
    """
    explained = _explained(nominal, best)
    return asked_difference(explained + more, best.law_error_of(explained), options=best.options.selection)


def width_beside(
    nominal: NominalFit, best: FittedHypothesis, other: FittedHypothesis, more: float = 0.0
) -> float:
    """The difference of evidence up to which one of two hypotheses explains the data nearly as well as the other, by
    the law of either.
    """
    return max(answer_set_width(nominal, best, more), answer_set_width(nominal, other, more))


def width_beside_smaller(
    nominal: NominalFit, larger: FittedHypothesis, smaller: FittedHypothesis, more: float = 0.0
) -> float:
    """What a hypothesis may explain beyond a smaller one that it holds, for that to explain the data nearly as well:
    what a plant does otherwise than any model, or what may be left over at most, by the law of either. `more` is what
    the larger would explain besides in further records.
    """
    options, explained = larger.options, _explained(nominal, larger)
    share = max(options.detection.doubtful_share, larger.law_error_of(explained), smaller.law_error_of(explained))
    return max(options.selection.second_gain, share * (explained + more))


def temperature_of(nominal: NominalFit, best: FittedHypothesis) -> float:
    """The temperature of a tempered posterior: the model is not the plant, so that differences count less."""
    return answer_set_width(nominal, best) / best.options.selection.answer_ratio


def ranked(nominal: NominalFit, found: Sequence[FittedHypothesis], level: float = np.inf) -> list[FittedHypothesis]:
    """The found with those that explain the data nearly as well as the best in the order of their probabilities.

    Of two that fit alike for a model that is not the plant, the plainer goes first; `level` is the z that a second
    cause must pass to stand beside one alone.
    """
    best, width, temperature = found[0], answer_set_width(nominal, found[0]), temperature_of(nominal, found[0])
    deviances = tempered_deviances(nominal, found, level)
    near = [
        k
        for k, one in enumerate(found)
        if one.evidence - best.evidence < width or deviances[k] < one.tempered(temperature)
    ]
    near.sort(key=deviances.__getitem__)
    return [found[k] for k in [*near, *(k for k in range(len(found)) if k not in near)]]


def tempered_deviances(nominal: NominalFit, found: Sequence[FittedHypothesis], level: float) -> list[float]:
    """Minus twice the log probability of each of the found, times the temperature of the best, up to a constant.

    A pair that has the likeliest single cause stands to it by its odds (`odds_of_second`), where the temperature puts
    it further behind: before it where it is likelier than all single ones that would stand before it, the likeliest of
    them by the odds of an answer set at most, the others by so much less. A law as common as the plainer one that it
    holds stands before that where it explains more than by chance, however wide the priors of its shapes are.
    """
    temperature = temperature_of(nominal, found[0])
    values = [one.tempered(temperature) for one in found]
    single = sorted((k for k, one in enumerate(found) if len(one.candidates) == 1), key=values.__getitem__)
    odds = dict[int, float]()
    for k, pair in enumerate(found):
        if len(pair.candidates) > 1 and single and found[single[0]].is_within(pair):
            before = [single[0], *(j for j in single[1:] if values[j] < values[k])]
            odds[k] = min(odds_of_second(nominal, pair, found[j], level) for j in before)
    above = max(max(odds.values(), default=0.0) - found[0].options.selection.answer_ratio, 0.0)
    for k, own in odds.items():
        values[k] = min(values[k], values[single[0]] - temperature * (own - above))
    for k, one in enumerate(found):
        for j, plainer in enumerate(found):
            more = plainer.fit.chi_square - one.fit.chi_square - one.options.selection.law_gain
            if more > 0.0 and one.nests_law_of(plainer):
                values[k] = min(values[k], values[j] - more)
    return values


def odds_of_second(nominal: NominalFit, pair: FittedHypothesis, alone: FittedHypothesis, level: float) -> float:
    """Twice the log odds of a pair against one cause alone: where it explains what a second cause must at least, and
    what the law of the first may err by, no shape is fitted and its prior odds are even, the two are as likely. Each
    shape more takes up one of the chi-square by chance. How wide the prior of a second amplitude is does not count.
    """
    explained = nominal.fit.chi_square - alone.fit.chi_square
    may_err = max(alone.law_error_of(explained), alone.options.selection.least_law_error) * explained
    shapes = pair.fit.fitted_shapes - alone.fit.fitted_shapes
    rarer = pair.prior_penalty - alone.prior_penalty
    return pair.gain_beyond(alone) - max(least_gain_of_second(nominal, alone, level), may_err) - shapes - rarer


def answer_set_of(
    nominal: NominalFit,
    found: Sequence[FittedHypothesis],
    whole: bool = True,
    level: float = np.inf,
    *,
    options: DiagnosisOptions,
) -> list[FittedHypothesis]:
    """The best, and those that explain the data nearly as well; `whole` tells that the best leaves nothing over, and
    `level` is the z that a second cause must pass to stand beside the best alone. However small it is beside
    what is typical does not count then: an amplitude's prior is too wide to tell a small one from none.
    """
    if not found:
        return []
    best, width, temperature = found[0], answer_set_width(nominal, found[0]), temperature_of(nominal, found[0])
    most = len(best.candidates)  # how wide a prior is does not tell two apart that fit alike
    least = min(one.tempered(temperature) for one in found if one is best or one.is_within(best))
    second = least_gain_of_second(nominal, best, level)

    def least_gain(alone: FittedHypothesis) -> float:
        """Of a second cause beside one: where one passes, those that explain nearly as much stand with it."""
        gain = max((one.gain_beyond(alone) for one in found if alone.is_within(one)), default=0.0)
        return min(second, gain - options.selection.answer_ratio) if gain > second else second

    def is_near(one: FittedHypothesis) -> bool:
        behind = one.least_chi_square - best.least_chi_square
        if len(one.candidates) < most and one.is_within(best):
            return behind < width_beside_smaller(nominal, best, one)
        if one.tempered(temperature) - least < width:
            return True
        if len(one.candidates) > most and not one.is_indistinguishable_from(best):
            return best.is_within(one) and one.gain_beyond(best) > least_gain(best)
        return behind < width_beside(nominal, best, one)

    near = [one for one in found if is_near(one)]
    # what a better one says already, and something more besides, is no rival of it, unless there must be something more
    return [
        one
        for k, one in enumerate(near)
        if not whole or not any(b.is_within(one) and one.gain_beyond(b) < least_gain(b) for b in near[:k])
    ]


def least_gain_of_second(
    nominal: NominalFit, best: FittedHypothesis, level: float, more: float = 0.0
) -> float:
    """The chi-square that a second cause must explain beside the best to be told: more than passes a `level` of z by
    chance, and than what the best's law may err by shows of another cause. `more` is what the best would explain
    besides in further records.
    """
    options, explained = best.options, _explained(nominal, best)
    law_error = min(best.law_error_of(explained), options.detection.doubtful_share)
    return max(level**2, max(options.selection.least_law_error, law_error) * (explained + more))


def odds_against_noise(nominal: NominalFit, best: FittedHypothesis, level: float) -> float:
    """Twice the log odds of the best against noise alone: at the alarm level, where no shape is fitted, the two are as
    likely. Of noise each shape takes up one of the chi-square more.
    """
    return nominal.fit.chi_square - best.fit.chi_square - level**2 - best.fit.fitted_shapes


def nested_levels(
    nominal: NominalFit, smaller: FittedHypothesis, larger: FittedHypothesis, level: float, second_level: float,
    more: float = 0.0,
) -> tuple[float, float, float]:  # fmt: skip
    """What a hypothesis that holds a smaller one must explain beyond it: so that it stands without that, so that both
    are as likely, and to stand beside it at all; one by a fuller law always does. `level` and `second_level` are the z
    of an alarm and of a second cause, `more` is what the smaller would explain besides in further records.
    """
    options = larger.options.selection
    if larger.nests_law_of(smaller):
        return width_beside(nominal, larger, smaller, more), options.law_gain, 0.0
    if not smaller.candidates:
        even = level**2 + larger.fit.fitted_shapes
        return even + options.answer_ratio, even, options.minimum_gain * level**2
    second = least_gain_of_second(nominal, smaller, second_level, more)
    return width_beside_smaller(nominal, larger, smaller, more), second, second


def null_hypothesis_beside(
    nominal: NominalFit, answer_set: Sequence[FittedHypothesis], level: float, *, options: DiagnosisOptions
) -> list[FittedHypothesis]:
    """The null hypothesis, where what the best explains is so little that it may be noise."""
    return (
        [FittedHypothesis(nominal.fit, options=options)]
        if answer_set and odds_against_noise(nominal, answer_set[0], level) < options.selection.answer_ratio
        else []
    )
