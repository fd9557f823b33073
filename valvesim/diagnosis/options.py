"""The options of a diagnosis: every threshold with its unit, meaning and where its value comes from.

`diagnose(session, options=DiagnosisOptions(...))` passes them on. See `valvesim.options`.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.identification.options import IdentificationOptions
from valvesim.options import JUDGEMENT, option


@dataclass(frozen=True, kw_only=True)
class DetectionOptions:
    """Detection: score tests and the alarm."""

    knots: int = option(6, "1", "knots of each free term while it is looked for", JUDGEMENT)
    reach: float = option(
        10.0,
        "1",
        "multiple of its typical amplitude at which a candidate must show, or the session is blind to it",
        JUDGEMENT,
    )
    equivalent_share: float = option(
        0.9, "1", "share of a parameter's z that an equivalent effect must have to be counted in its place", JUDGEMENT
    )
    stated_ratio: float = option(
        2.0, "1", "ratio of what a model leaves to the stated noise from which it is told, without repeats", JUDGEMENT
    )
    noise_error: float = option(0.06, "1", "relative error of a noise's variance", "a pair of short replicates")
    false_alarm: float = option(
        0.005,
        "1",
        "probability of an alarm of the candidates where nothing is hidden",
        "with `term_false_alarm` below 0.01",
    )
    second_false_alarm: float = option(
        0.02,
        "1",
        "probability that a second cause is told as possible where there is but one",
        "it is rarer than a first, and stands in an answer set of 20 to 1",
    )
    term_false_alarm: float = option(
        0.002, "1", "probability of an alarm of the free terms where nothing is hidden", JUDGEMENT
    )
    term_significance: float = option(
        0.01, "1", "p-value of a free term in what the best hypothesis leaves", "naming asks for more than an alarm"
    )
    doubtful_share: float = option(
        0.02,
        "1",
        "share of the explained chi-square left over, up to which the best is still possible, as is an unknown cause",
        JUDGEMENT,
    )
    little_share: float = option(
        0.2,
        "1",
        "the same where it is less than a second cause must explain",
        "flexures at which the valve nearly oscillates leave 7 to 14 % of 130",
    )
    most_explained: float = option(
        100.0,
        "1",
        "multiple of the rows up to which what is explained counts for such shares",
        "where a nominal fit is lost it is 1e5 of them, and five times the noise is next to nothing of that",
    )
    other_valve_figures: int = option(
        3, "1", "figures of the valve at their limits from which it is another one", "a cause may carry two there"
    )
    other_valve_ratio: float = option(
        10.0, "1", "times the chi-square that they leave, which the likeliest cause leaves then", JUDGEMENT
    )
    other_valve_left: float = option(
        100.0,
        "1",
        "variances of the noise at a row that the likeliest cause leaves then, whatever they leave",
        "the likeliest of 12 bench sessions and of a worn edge that shows by 629 deviations left 0 to 28",
    )
    draws: int = option(20_000, "1", "draws by which the alarm level is found", "a quantile of 0.005 to 10 %")


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """What the bench may do that no record tells."""

    most_faults: int = option(3, "1", "faults of the bench at once; 0: none is sought", JUDGEMENT)
    minimum_gain: float = option(
        60.0, "1", "chi-square that a bench fault must explain", "waves pass 40 by chance once in 1e3"
    )
    gain_share: float = option(
        0.05, "1", "the same as a share of what is left: linear answers of a strong cause err by as much", JUDGEMENT
    )
    wave_peak: float = option(
        5.0, "1", "times the spectrum beside it at which a wave is thought of", "a cause hides it: the gain decides"
    )
    unexplained_share: float = option(
        5e-6, "1", "share of what the bench explains that a candidate or a term may show of it", "no model is the plant"
    )
    excess_share: float = option(
        1e-4, "1", "share of it that may be left beyond the noise without an alarm", "no model is the plant"
    )
    left_share: float = option(
        0.05, "1", "share of the excess chi-square that the cause may leave beside which the bench is sought", JUDGEMENT
    )
    alike_share: float = option(
        0.5, "1", "share of what the plainer of two alike laws leaves, below which the other stands for it", JUDGEMENT
    )
    asked_share: float = option(
        0.1, "1", "share of what a cause left when ways of the commands were run beside it, to rerun them", JUDGEMENT
    )
    causes_beside: int = option(3, "1", "likeliest causes beside which it must explain as much", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class IsolationOptions:
    """Isolation: which hypotheses are fitted."""

    most_causes: int = option(2, "1", "causes at once", "what two leave over tells that one of them is wrong")
    singles: int = option(5, "1", "single candidates that are fitted", JUDGEMENT)
    pairs: int = option(3, "1", "pairs of candidates that are fitted", JUDGEMENT)
    largest_ratio: float = option(
        1.5, "1", "ratio of a named figure to the stated one from which something else may be wrong", JUDGEMENT
    )
    far_figure: float = option(10.0, "1", "prior deviations that it must be off besides", JUDGEMENT)
    single_share: float = option(
        0.5,
        "1",
        "share of the best one's reduction from which a single candidate is fitted",
        "far off, linear answers err by so much",
    )
    pair_reduction: float = option(
        20.0, "1", "reduction of the chi-square that a second candidate must promise", JUDGEMENT
    )
    slight_share: float = option(
        0.002,
        "1",
        "share of the typical amplitude below which one of a pair is left out",
        "where leakage peaks are measured a thousandth may show",
    )
    shifted: float = option(
        3.0,
        "1",
        "prior deviations from which a nuisance parameter may stand in a cause's way",
        "beyond the tolerance, at 2",
    )
    near_linearisations: int = option(
        2, "1", "linearisations in which a cause must come near records that the nominal valve cannot", JUDGEMENT
    )
    restarts: int = option(3, "1", "times that what may be best, or the nominal model, is fitted again", JUDGEMENT)
    slight_gain: float = option(
        60.0, "1", "chi-square below which the nominal fit may be what explains it, fitted from there", JUDGEMENT
    )
    same_start: float = option(
        0.05, "1", "distance of two starts, as a share of the way there, below which they end alike", JUDGEMENT
    )
    same_end: float = option(
        2.0, "1", "chi-square to which linearised equations tell the end of a fit from within tolerance", "chance"
    )
    refined: int = option(3, "1", "best hypotheses that are refined", JUDGEMENT)
    refined_gain: float = option(
        30.0, "1", "chi-square that a refinement may gain: what is further behind is not refined", "mostly below 5"
    )
    amounts: tuple[float, ...] = option(
        (1.0, 0.77, 1.3, 0.6, 1.7, 0.35, 3.0, 0.2, 0.1),
        "1",
        "times the same share of its typical amplitude in which another law of the best's is tried first",
        "friction of different laws: 0.8 of it leaves twenty times as much",
    )
    further_amount: float = option(
        0.99, "1", "times the chi-square in the last amount that a further one must leave less than to be followed",
        JUDGEMENT,
    )
    nearly_as_much: float = option(
        2.0, "1", "times the chi-square of the best single cause up to which one whose law may err is as likely",
        "hysteresis of another law: 1.3 times what friction leaves of it",
    )
    reach: float = option(
        5.0, "1", "times the largest adequate chi-square that another law may leave by equations linear at the best",
        "those that came near left up to 2.7; hysteresis and silting for strong friction 6 and 9",
    )
    indistinguishable_start: float = option(
        3.0, "1", "times their typical amplitudes at which effects are begun that cannot be told from one", JUDGEMENT
    )
    seconds: int = option(3, "1", "candidates that are tried beside a first cause", JUDGEMENT)
    most_starts: int = option(
        12, "1", "single causes that are tried where the bench is looked at beside one and none explains much",
        "a worn edge of d' 41 was the fifth",
    )
    enough_share: float = option(
        0.5, "1", "share of the nominal fit's chi-square that one explains of which few need be tried", JUDGEMENT
    )
    second_share: float = option(0.8, "1", "share of the largest z from which they are", JUDGEMENT)
    promised: float = option(
        2.0, "1", "times the reduction that linear answers promise of one instead of instruments' errors, to fit it",
        "of six it explained 0.7 to 1.1 times as much",
    )
    unexplained_share: float = option(
        0.005, "1", "share of the explained chi-square that may stay behind for free terms", "no model is the plant"
    )
    as_good: float = option(
        0.1, "1", "share of the answer set's width within which a hypothesis need not be fitted further", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class SelectionOptions:
    """Model selection: evidence, answer set and verdict."""

    answer_ratio: float = option(
        6.0,
        "1",
        "difference of twice the log evidence up to which hypotheses stay in the answer set",
        "odds of 20 to 1",
    )
    answer_share: float = option(
        0.04, "1", "share of the explained chi-square that the answer set is wide", "no model is the plant"
    )
    filter_law_error: float = option(
        0.1, "1", "share that another order explains beyond a lag of all sensors", "0.08 for a Bessel filter of order 4"
    )
    least_law_error: float = option(
        5e-4,
        "1",
        "share of what a cause explains by which another law of it may do better, at least",
        "no model is the plant: figures of strong causes 1 to 2.5 % off",
    )
    discrepancy_share: float = option(
        0.1,
        "1",
        "share of what a cause does to a reading by which its law may be wrong, of laws that may err",
        "measured: play operators and the law of Dahl fitted to them differ by 0.08 rms",
    )
    discrepancy_samples: int = option(
        2, "1", "samples either way within which it may do so", "a leakage peak at another sample"
    )
    minimum_gain: float = option(0.8, "1", "share of the squared alarm level that a hypothesis must explain", JUDGEMENT)
    second_gain: float = option(
        30.0, "1", "chi-square that a second cause must explain", "what a plant does otherwise than any model"
    )
    law_gain: float = option(
        1.0,
        "1",
        "chi-square that a law as common explains by chance beyond the plainer one that it holds",
        "at the end of one of its shapes the others have no effect: half of a chi-square of one",
    )
    negligible_amplitude: float = option(
        2e-4, "1", "share of the typical amplitude below which there is none", "twice `least_amplitude` of the fit"
    )
    parameter_penalty: float = option(
        3.0, "1", "twice the log prior odds against a parameter beyond its tolerance", JUDGEMENT
    )
    material_penalty: float = option(
        12.0, "1", "the same for one that the material has, and not how the part was made", JUDGEMENT
    )
    refined_penalty: float = option(
        1.0, "1", "the same for a rarer effect that is another, plainer one where its feature does not show", JUDGEMENT
    )
    unknown_penalty: float = option(
        6.4,
        "1",
        "twice the log prior odds against a cause that nobody has listed",
        "of a hundred names given alone four stand for one",
    )
    record_share: float = option(
        0.8, "1", "share of what is left beyond the noise that one test carries where it may not belong", JUDGEMENT
    )
    inadequate_share: float = option(
        0.35, "1", "share of the signal left unexplained where the records are not of this valve", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class CoarseToFineOptions:
    """Long sessions: leading segments first."""

    samples: int = option(20_000, "1", "samples of the leading segments of all different tests together", JUDGEMENT)
    least_samples: int = option(500, "1", "samples of one leading segment", JUDGEMENT)
    motion: float = option(
        2e-3, "1", "share of its span by which an input must have changed to have begun to move", JUDGEMENT
    )
    lead: float = option(0.05, "s", "kept before the first input moves", JUDGEMENT)
    taken_along: int = option(
        2, "1", "hypotheses that are taken along where none explains the leading segments", JUDGEMENT
    )
    aliased_share: float = option(
        0.1, "1", "share of the excess chi-square that may be left without records whose commands alias", JUDGEMENT
    )
    taken_width: float = option(
        3.0, "1", "times the width of the answer set: what is no further behind there is taken along", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class MissingTermOptions:
    """A term that no catalogue has."""

    knots: int = option(11, "1", "knots of a term", JUDGEMENT)
    fine_knots: int = option(47, "1", "knots of a term whose shape asks for more", JUDGEMENT)
    few_knots: int = option(6, "1", "knots of a term that explains little", JUDGEMENT)
    little: float = option(3.0, "1", "times the cost of its knots: a term that explains less gets few", JUDGEMENT)
    fine_test_knots: int = option(24, "1", "knots of the score test that finds which terms ask for more", JUDGEMENT)
    minimum_gain: float = option(
        15.0, "1", "chi-square, beyond the cost of its freedom, that a term must explain", JUDGEMENT
    )
    complexity_penalty: float = option(
        10.0, "1", "chi-square that memory or another variable than the port's own must explain", JUDGEMENT
    )
    complexity_share: float = option(0.02, "1", "the same as a share of what the best term explains", JUDGEMENT)
    estimated: int = option(2, "1", "term hypotheses estimated inside the simulation", JUDGEMENT)
    score_share: float = option(0.75, "1", "share of the best score from which they are", JUDGEMENT)
    steps: int = option(5, "1", "Gauss-Newton steps", JUDGEMENT)
    ftol: float = option(1.0, "1", "predicted reduction that ends the estimation", JUDGEMENT)
    relative_ftol: float = option(3e-3, "1", "the same as a share of what is explained", JUDGEMENT)
    last_share: float = option(
        0.05, "1", "reduction, as a share of what is explained, after which no linearisation is made", JUDGEMENT
    )
    longest_step: float = option(3.0, "1", "step of a nuisance parameter, in prior deviations", JUDGEMENT)
    tail: float = option(0.002, "1", "share of the samples beyond the outermost knots, at either end", JUDGEMENT)
    line_deviation: float = option(
        0.25, "1", "prior deviation of offset and of slope over half the range, in units of the term's size", JUDGEMENT
    )
    bend_deviation: float = option(
        1.0, "1", "prior deviation of a second difference, in units of the term's size", JUDGEMENT
    )
    memory_deviation: float = option(
        1.0, "1", "prior deviation of the logarithm of a time constant or width", JUDGEMENT
    )
    memory_step: float = option(0.1, "1", "step of such a logarithm in differences", JUDGEMENT)
    rival_margin: float = option(
        2.0, "1", "chi-square by which a plain term does better, or no worse, than a cause", "of one more figure: AIC"
    )
    rival_times: tuple[float, ...] = option((1e-3, 3e-3, 1e-2, 3e-2, 0.1), "s", "lags of plain terms", JUDGEMENT)
    rival_widths: tuple[float, ...] = option(
        (0.02, 0.1, 0.5), "1", "widths of the turning of plain terms' paths, in the variable's scale", JUDGEMENT
    )
    formula_error: float = option(0.1, "1", "relative error up to which a formula is offered", JUDGEMENT)
    formula_condition: float = option(
        1e12, "1", "condition of a formula's normal equations from which records do not tell its figures", "rounding"
    )
    formulas: int = option(2, "1", "formulas that are fitted", JUDGEMENT)
    pure_share: float = option(
        0.04, "1", "share of what the term explains that a formula of one shape may leave", "no model is the plant"
    )
    mixed_share: float = option(
        0.02, "1", "the same of a formula with offset or slope", "offsets and slopes are what tolerances are for"
    )
    formula_steps: int = option(3, "1", "steps of the fit of a formula", JUDGEMENT)
    formula_ftol: float = option(
        0.1, "1", "reduction, as a share of the loss against the spline, that ends it", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class DesignOptions:
    """Experiment design."""

    power: float = option(0.95, "1", "power that an experiment should have", JUDGEMENT)
    least_power: float = option(0.8, "1", "power below which it is not worth a day on the rig", JUDGEMENT)
    uninformative_power: float = option(
        0.05, "1", "power below which an experiment is told as telling nothing", "chance"
    )
    power_margin: float = option(
        0.05, "1", "power that a shorter experiment may have less than the most powerful one", "chance"
    )
    model_error: float = option(
        2e-4,
        "1",
        "share of what the readings move by which the plant does otherwise than its model, refitted",
        "measured on plants that are not the model: 1e-4 to 6e-4",
    )
    replicates: tuple[int, ...] = option((1, 2, 4, 8, 16), "1", "numbers of replicates that are thought of", JUDGEMENT)
    examined: int = option(
        8, "1", "experiments whose refits are predicted: those whose plain differences are largest", JUDGEMENT
    )
    refitted: int = option(
        5, "1", "experiments whose refits are simulated: those that would be proposed by predicted ones", JUDGEMENT
    )
    alternatives: int = option(
        2, "1", "members of the answer set from which an experiment is sought that tells the likeliest", JUDGEMENT
    )
    rate: float = option(1000.0, "Hz", "sampling rate", JUDGEMENT)
    full: float = option(0.9, "1", "share of the rated command of a full triangle and of a large chirp", JUDGEMENT)
    chirp: float = option(0.45, "1", "share of the rated command of a chirp", JUDGEMENT)
    small: float = option(0.06, "1", "share of the rated command of a small triangle about null", JUDGEMENT)
    flapper_reach: float = option(
        0.9, "1", "share of its gap by which the flapper may move towards a nozzle in an experiment", JUDGEMENT
    )
    scaling: float = option(0.85, "1", "share to which a command that exceeds it is made smaller at least", JUDGEMENT)
    scalings: int = option(4, "1", "times that it is made smaller at most", JUDGEMENT)
    low_supply: float = option(0.4, "1", "share of the nominal supply pressure", JUDGEMENT)
    load: float = option(0.35, "1", "share of the nominal supply pressure that is load", JUDGEMENT)
    oil_margin: float = option(10.0, "delta_degC", "by which the oil may leave the range of the session", JUDGEMENT)
    coldest_oil: float = option(0.0, "degC", "but no colder", JUDGEMENT)
    hottest_oil: float = option(90.0, "degC", "and no hotter", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class ChannelApartOptions:
    """One channel that does not go with the others."""

    least_score: float = option(
        2.0, "1", "times the alarm level that z must reach before a channel may be apart",
        "less is hidden by leaving any channel out",
    )
    largest_mean_square: float = option(
        10.0, "1", "mean square that the equations linear at the stated valve may leave of the other channels",
        "1 and 4 with one that is apart; 18 and more with friction",
    )
    left_share: float = option(
        0.5, "1", "share of what they leave of all channels beyond the noise, which they may leave without one",
        "of ten that were apart 0 to 0.24",
    )
    most_left: float = option(
        0.3, "1", "times the rows that a fit of the others may promise to leave beyond the noise, to go on with it",
        "five times what a noise that few repeats tell may be off",
    )
    frequencies: tuple[float, ...] = option(
        (0.02, 0.08, 0.25), "1", "natural frequencies of a response of second order to begin with, per sample rate",
        JUDGEMENT,
    )
    explained: float = option(
        0.25, "1", "share of what a lag of first order with a delay leaves beyond noise, which a response may leave",
        JUDGEMENT,
    )
    noise: float = option(2.0, "1", "mean square, in noise deviations, that a response may leave", JUDGEMENT)
    nearly_all: float = option(
        0.02, "1", "share of what the lag leaves, which a response may leave above that", "the other channels err too"
    )


@dataclass(frozen=True, kw_only=True)
class HoldOutOptions:
    """The gain on hold-out records."""

    interval: tuple[float, float] = option((0.025, 0.975), "1", "quantiles of the bootstrap interval", "95 %")


@dataclass(frozen=True, kw_only=True)
class DiagnosisOptions:
    """All options of a diagnosis, a stage each."""

    identification: IdentificationOptions = IdentificationOptions()
    detection: DetectionOptions = DetectionOptions()
    bench: BenchOptions = BenchOptions()
    isolation: IsolationOptions = IsolationOptions()
    selection: SelectionOptions = SelectionOptions()
    coarse_to_fine: CoarseToFineOptions = CoarseToFineOptions()
    missing_term: MissingTermOptions = MissingTermOptions()
    design: DesignOptions = DesignOptions()
    channel_apart: ChannelApartOptions = ChannelApartOptions()
    hold_out: HoldOutOptions = HoldOutOptions()


DEFAULT_DIAGNOSIS = DiagnosisOptions()
