"""The power of tests of hypotheses: what is detected, and what is told apart, nine times in ten.

Symbols
    d' distance of a candidate off the nuisance parameters, in noise deviations; d that which a rival leaves of it;
    w the difference of chi-squares that tells two hypotheses apart; z(0.9) = 1.2816, z(0.95) = 1.6449
    detected with 0.9: d' = level + z(0.9);  named: d'^2 beyond level^2 by w, so that noise is no rival
    power to tell apart = Phi((d^2 - w)/(2 d)): the likelihood ratio of two hypotheses d apart is normal with mean d^2
    and deviation 2 d; with the difference b by which the first is ahead already, Phi((d^2 + b - w)/(2 d)) where the
    first is true and Phi((d^2 - b - w)/(2 d)) where the second is; b the least and the most of several that count
    nested: the larger of two has all that the smaller has and something besides, by which it explains g more so far,
    and which is d in further records. Of these the larger explains more, N standard normal,
    (g + d^2 + d s N)^2/(g + d^2) if it is true, and (g + d N)^2/(g + d^2) if the smaller is; s^2 = 1 + d^2/g, for the
    amplitude that was fitted, and d with it, is known to 1/sqrt(g) of itself
"""

from __future__ import annotations

import numpy as np

from valvesim.diagnosis.options import SelectionOptions

NINE_IN_TEN, NINETEEN_IN_TWENTY = 1.2816, 1.6449


def detected_amplitude(distance: float, size: float, level: float, quantile: float = NINE_IN_TEN) -> float:
    """The amplitude that passes a level nine times in ten, of a candidate whose d' at `size` is `distance`."""
    return float((level + quantile) / distance * abs(size)) if distance > 0.0 else np.inf


def naming_level(level: float, *, options: SelectionOptions) -> float:
    """The z from which noise alone explains a cause no longer nearly as well, beside an alarm level."""
    return float(np.sqrt(level**2 + options.answer_ratio))


def detection_power(distance: float, level: float) -> float:
    """How surely a candidate at a distance d' passes the alarm."""
    from scipy.stats import norm

    return float(norm.cdf(distance - level))


def separation_power(
    distance: float, asked: float, lead: tuple[float, float] = (0.0, 0.0), probability: float = 0.5
) -> float:
    """How surely two hypotheses that far apart are told apart where a difference of chi-squares is asked. The `lead` of
    the first before is the least and the most of what counts: it must be ahead by all of that, and so must the second.
    The first is true with that probability.
    """
    from scipy.stats import norm

    if distance <= 0.0:
        return 0.0
    least, most = lead
    first, second = norm.cdf((distance**2 + np.array([least, -most]) - asked) / (2.0 * distance))
    return float(probability * first + (1.0 - probability) * second)


def nested_power(distance: float, gain: float, asked: float, forgone: float, probability: float) -> float:
    """How surely one of two nested hypotheses is left: the larger where it explains `asked` more than the smaller in
    the end, the smaller where it is less than `forgone`; the larger explains `gain` more so far, and is true with that
    probability.
    """
    from scipy.stats import norm

    if distance <= 0.0:
        return 0.0
    spread = np.sqrt(1.0 + distance**2 / max(gain, 1.0))
    gain = max(gain, 0.0)
    whole = gain + distance**2
    enough, little = np.sqrt(asked * whole), np.sqrt(forgone * whole)
    larger = norm.cdf((whole - enough) / (distance * spread))
    smaller = norm.cdf((little - gain) / distance) - norm.cdf((-little - gain) / distance)
    return float(probability * larger + (1.0 - probability) * smaller)


def asked_difference(explained: float, law_error: float, *, options: SelectionOptions) -> float:
    """The difference of evidence up to which another hypothesis explains as well what the best `explained`."""
    return max(options.answer_ratio, max(options.answer_share, law_error) * explained)


def separated_share(
    whole: float, left: float, law_error: float, quantile: float = NINE_IN_TEN, *, options: SelectionOptions
) -> float:
    """By how much a candidate at the distance `whole`, of which a rival leaves `left`, must grow to be told from it
    nine times in ten; infinite where no size is enough."""
    if left <= 0.0:
        return np.inf
    enough = quantile + np.sqrt(quantile**2 + options.answer_ratio)
    share = max(options.answer_share, law_error)
    growth = enough / left
    if share * (growth * whole) ** 2 <= options.answer_ratio:
        return float(growth)
    remains = 1.0 - share * (whole / left) ** 2
    return float(2.0 * quantile / remains / left) if remains > 0.0 else np.inf
