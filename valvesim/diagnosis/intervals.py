"""Confidence intervals of amplitudes and shapes: Laplace's approximation, widened by a sandwich over segments.

Segments that disagree widen an interval, for no model is the plant (White 1980; few segments: Student's t), and so does
the error of an effect's law, of which another may have another amplitude.
"""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.result import Estimate
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.fit_jacobian import perturbation
from valvesim.identification.nominal_fit import NominalFit
from valvesim.identification.prior import NETWORK
from valvesim.identification.projection import inverse_of
from valvesim.valve.thermal_network import heat_words


def confidence_intervals(nominal: NominalFit, final: ScoreTest) -> tuple[Estimate, ...]:
    """Amplitudes and shapes of the fit's fitted candidates with 95 % intervals, from the curvature at the fit."""
    from scipy.stats import t as student_t

    fit, gram = final.fit, final.gram
    p, total = gram.parameters, gram.total
    own = [1 + p + k for k in final.own]
    at = [*range(1, 1 + p), *own]
    H = total[np.ix_(at, at)].copy()
    for k, (_, shape) in enumerate(fit.layout):
        H[p + k, p + k] += np.log(final.options.identification.sensitivity.shape_ratio) ** 2 if shape else 0.0
    H[np.arange(p), np.arange(p)] += 1.0
    C = inverse_of(H)
    # parts of records that disagree widen the interval: no model is the plant (a sandwich over the parts)
    pushes = C @ np.array([part[at, 0] for part in gram.products]).T
    parts = len(gram.products)
    others = max(parts - 1, 1)
    few = float(student_t.ppf(0.975, others))

    def half_width(combine: np.ndarray) -> float:
        among = float(np.sum((combine @ pushes) ** 2)) * parts / others
        return float(max(1.96 * np.sqrt(combine @ C @ combine), few * np.sqrt(among)))

    names = [parameter.name for parameter in nominal.study.nominal.parameters]
    found = []
    for k, (member, shape) in enumerate(fit.layout):
        candidate = member.candidate
        if candidate.effect is None:
            j = names.index(candidate.name.removeprefix("parameter:"))
            parameter = nominal.study.nominal.parameters[j]
            combine = np.zeros(len(at))
            combine[j], combine[p + k] = parameter.deviation, perturbation(member)
            value, half = parameter.at(fit.point[j], member.above_neutral), half_width(combine)
            low, high = (parameter.at(fit.point[j], member.above_neutral + by) for by in (-half, half))
            found.append(
                Estimate(
                    name=parameter.name,
                    cause=candidate.name,
                    value=value,
                    low=low,
                    high=high,
                    unit=parameter.unit,
                    doc=heat_words(parameter.name.removeprefix(NETWORK)) if parameter.of_network else "",
                )
            )
            continue
        effect = candidate.effect
        least = max(effect.law_error, final.options.selection.least_law_error)
        law = max(np.sqrt(least), effect.figure_error)  # the chi-square goes with the square of a figure
        if shape:
            declared = next(q for q in effect.parameters if q.name == shape)
            value = dict(member.shapes)[shape]
            half = np.log(final.options.identification.sensitivity.shape_ratio) * half_width(np.eye(len(at))[p + k])
            half = float(np.hypot(half, law))
            low, high = value * np.exp(-half), value * np.exp(half)
        else:
            declared = effect.amplitude
            value = (declared.neutral or 0.0) + member.above_neutral
            combine = perturbation(member) * np.eye(len(at))[p + k]
            if candidate.label in names:  # the sensor's error within tolerance is the same error: their sum is known
                j = names.index(candidate.label)
                combine[j] = nominal.study.nominal.parameters[j].deviation
                value += fit.point[j] * combine[j]
            half = float(np.hypot(half_width(combine), law * member.above_neutral))
            low, high = value - half, value + half
        low, high = max(low, declared.bounds[0]), min(high, declared.bounds[1])
        found.append(
            Estimate(name=declared.name, cause=candidate.label, value=float(value), low=float(low), high=float(high),
                     unit=declared.unit, doc=declared.doc)
        )  # fmt: skip
        if not shape:
            found += [
                Estimate(name=name, cause=candidate.label, value=v, low=v, high=v, unit="1", doc="as found")
                for name, v in candidate.fixed
                if name not in dict(member.shapes)
            ]
    return tuple(found)
