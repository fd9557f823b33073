"""The options of identification: every threshold with its unit, meaning and where its value comes from.

Options are passed on: a `Study` carries its own. Those that follow from judgement are held as a whole, with those of
the diagnosis, against `benchmarks/hidden_effects.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.options import JUDGEMENT, option


@dataclass(frozen=True, kw_only=True)
class AuditOptions:
    """What a record must be to be used."""

    least_samples: int = option(50, "1", "samples that a record needs", JUDGEMENT)
    clock_jitter: float = option(
        0.02, "1", "share of the median step by which a step of the clock may differ", JUDGEMENT
    )
    gap: float = option(
        1.5, "1", "times the median step from which a longer step is a gap", "a lost sample makes a step of 2"
    )
    repeat_ends: float = option(
        0.01, "1", "share of a record by which it may be longer than its repeats, and is cut off", JUDGEMENT
    )
    replicate_mismatch: float = option(
        0.05, "1", "share of the input's span: rms difference of inputs between replicates", JUDGEMENT
    )
    replicate_disagreement: float = option(
        3.0, "1", "times their white noise by which the readings of replicates differ where it is told", JUDGEMENT
    )
    least_motion: float = option(1e-3, "1", "share of an input's scale: a smaller span is at rest", JUDGEMENT)
    most_command: float = option(2.0, "1", "rated commands: a larger one is refused", "coils take little more")
    noise_motion: float = option(
        5e-3, "1", "share of an input's scale: white noise of smaller rms is a sensor's at rest", JUDGEMENT
    )
    flat_samples: int = option(10, "1", "equal readings in a row at the extreme that make a flat top", JUDGEMENT)
    top_samples: int = option(3, "1", "equal readings in a row at the extreme that a step may leave there", JUDGEMENT)
    few_tops: int = option(4, "1", "readings at the extreme, and none next to it, that are saturated", JUDGEMENT)
    alike_chance: float = option(
        1e-3, "1", "chance that readings at the extreme are equal by noise: with less they are saturated", "noise"
    )
    top_rests: int = option(3, "1", "other rests of the command that long, whose second half has noise", JUDGEMENT)
    stay_ratio: float = option(
        3.0, "1", "times as long as equal readings elsewhere that a channel stands where it is saturated or held",
        JUDGEMENT,
    )  # fmt: skip
    frozen_false_alarm: float = option(
        1e-6, "1", "chance of so many equal readings in a row in a record: with less they are a dead channel's", "noise"
    )
    frozen_chance: float = option(
        0.25, "1", "share of equal neighbours elsewhere: a channel with more is coarse and may stand still", JUDGEMENT
    )
    frozen_jump: float = option(
        3.0, "1", "times the readings' steps beside it by which they jump where they are no longer held", JUDGEMENT
    )
    held_reach: float = option(
        0.5, "1", "share of its span that the command moves while a channel stands once", "no friction is so large"
    )
    frozen_rest: float = option(2.0, "1", "times that share at rest, where readings are equal more often", JUDGEMENT)
    flat_reach: float = option(
        0.05, "1", "share of the output's span that the command must ask for beyond a flat top", JUDGEMENT
    )
    crowd_width: float = option(
        5e-4, "1", "share of the output's span next to its extreme in which readings are counted", JUDGEMENT
    )
    crowd_ratio: float = option(
        5.0, "1", "times as many readings at the extreme as at any value next to it: saturated", "a sine has 2.4"
    )
    finest_grid: float = option(
        1e-4,
        "1",
        "share of a channel's span: a finer grid is the writing of the file, not the sensor",
        "files of five digits",
    )
    corrupt_reach: float = option(
        3.0, "1", "times the range of all others by which a corrupt reading stands apart from them", JUDGEMENT
    )
    corrupt_share: float = option(0.01, "1", "most of a channel's readings that may stand apart", JUDGEMENT)
    corrupt_run: int = option(3, "1", "most of them in a row", JUDGEMENT)
    least_spread: float = option(
        0.01, "1", "share of its size that a channel is taken to range over, where it stands still", JUDGEMENT
    )
    longest_bridge: int = option(
        10, "1", "samples in a row that an input may miss: a straight line takes their place", JUDGEMENT
    )
    samples_told: int = option(5, "1", "corrupt samples of a channel that are told one by one", JUDGEMENT)
    overshoot: float = option(
        0.02, "1", "share of the supply by which a measured load pressure may exceed it", JUDGEMENT
    )
    coldest_oil: float = option(
        -20.0, "degC", "coldest oil of a bench: what never falls below it in kelvin may be written in these", JUDGEMENT
    )
    hold_out_share: float = option(
        0.25, "1", "share of the tests that is held out where the session names none", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class PredictorOptions:
    """How a record is predicted."""

    oil_intervals: int = option(400, "1", "most straight lines that follow a record's oil temperature", JUDGEMENT)
    oil_resolution: float = option(0.05, "delta_degC", "deviation to which they follow it", JUDGEMENT)
    grid_spacing: float = option(
        1e-4,
        "s",
        "a trajectory is kept at this spacing or finer where the record is fast enough to need it",
        "measured: at 0.25 ms sensitivities err by up to a quarter next to edges, and fits end far off",
    )
    most_points: int = option(
        60_000,
        "1",
        "points of the trajectories of all training records; with more, the spacing is wider",
        "memory of the linear equations",
    )
    quasi_static_step: float = option(
        5e-3,
        "s",
        "a record sampled more slowly is quasi-static between its samples, and kept as it is",
        "response of the spool, some milliseconds",
    )
    tolerance: float = option(
        1e-4,
        "1",
        "relative tolerance of the solver",
        "measured: a chi-square of 11,000 errs by less than 0.1; with three times as much by 0.25, and fits get lost",
    )
    most_steps: int = option(1_000_000, "1", "steps of the solver that any run may take", "runs take thousands")
    steps_per_point: int = option(
        500,
        "1",
        "steps of the solver to a point of the sensors' grid that a run may take besides",
        "runs take some; a valve that oscillates throughout a slow sweep thousands: a fit must turn back there",
    )
    sensor_spacing: float = option(
        1e-4,
        "s",
        "sensors are applied on a grid this fine, since a fast lag sees the corners between samples",
        JUDGEMENT,
    )
    curvature_reach: int = option(
        3,
        "1",
        "steps of the sensors' grid on either side over which a reading's curvature counts for a sample",
        JUDGEMENT,
    )
    long_record: float = option(
        20.0, "s", "in longer records the sensors' grid is no finer than half the trajectory's", "memory"
    )


@dataclass(frozen=True, kw_only=True)
class InputOptions:
    """What inputs do that their samples do not tell."""

    jump: float = option(
        3e-3, "1", "share of its span by which a command moves otherwise in one interval where it jumps", JUDGEMENT
    )
    jump_noise: float = option(10.0, "1", "times the usual such difference that it is at least", "never by chance")
    minimum_gain: float = option(
        30.0, "1", "chi-square by which another way between samples must be better than straight lines", JUDGEMENT
    )
    gain_share: float = option(
        0.02, "1", "the same as a share of what straight lines leave beyond the noise", "a cause may be hidden as well"
    )
    linear_share: float = option(
        2e-4, "1", "and as one of how far the chi-square falls by the linearised equations", "they err by as much"
    )
    holdout_steps: int = option(6, "1", "steps at most in which the inputs of a hold-out record are fitted", JUDGEMENT)
    spread: float = option(
        0.03, "1", "share of what another way than straight lines changes of a reading that may be wrong", JUDGEMENT
    )
    undersampled: float = option(
        3e-3,
        "1",
        "share of its span by which splines of degree 7 and 5 differ where samples do not tell a command",
        "at 0.3 of the sampling rate; at 0.2 they differ by 2e-4",
    )
    least_undersampled: float = option(0.01, "1", "share of a record in which they differ that counts", JUDGEMENT)
    aliasing_samples: int = option(16, "1", "samples in which a command is asked whether it aliases", JUDGEMENT)
    aliasing_ratio: float = option(
        3.75, "1", "rms of its second differences over that of itself from which it reaches half the rate",
        "4 sin^2(pi f / f_s) at 0.42 of the rate",
    )  # fmt: skip
    least_aliased: float = option(0.02, "1", "share of a record in which it does that counts", JUDGEMENT)
    edge_places: int = option(8, "1", "places in its interval at which an edge is tried", JUDGEMENT)
    edge_samples: int = option(8, "1", "samples after an edge that may tell it is elsewhere", "the valve's response")
    settling_samples: int = option(
        32, "1", "samples after a jump in which a fit under other inputs leaves what edges would gain", JUDGEMENT
    )
    edge_misfit: float = option(3.0, "1", "mean square of what is left there, in noise deviations", JUDGEMENT)
    edge_gain: float = option(10.0, "1", "reduction of the chi-square by which another place must be better", JUDGEMENT)
    edge_share: float = option(0.03, "1", "least share of an edge that lies before and after a sample in it", JUDGEMENT)
    corner_ratio: float = option(20.0, "1", "times what the lines bend beside it that they do at a corner", JUDGEMENT)
    known_bends: float = option(
        0.9, "1", "share of the squares of a command's bends that is at corners and jumps where there are corners",
        JUDGEMENT,
    )
    at_sample: float = option(0.02, "1", "share of an interval in which a corner is at the sample beside it", JUDGEMENT)
    most_edges: int = option(60, "1", "jumps of a record whose times are fitted", "a linearisation solves for each")
    jump_ratio: float = option(5.0, "1", "times the same difference two intervals off", JUDGEMENT)
    half_ratio: float = option(
        3.0, "1", "times what the intervals beside differ from half of it", "filtered steps have less"
    )


@dataclass(frozen=True, kw_only=True)
class InputNoiseOptions:
    """How noise and rounding of an instrument are taken from the command and the pressures that were measured with it,
    and rounding from temperatures.

    White noise that is more than `AuditOptions.noise_motion` is no noise but an excitation, and stays.
    """

    least: float = option(
        5e-5, "1", "share of an input's scale: less noise or rounding than this is left on it",
        "measured: at ten times as much the armature of a healthy valve was possibly too light",
    )  # fmt: skip
    coarsest: float = option(5e-3, "1", "share of an input's scale: a coarser grid is a staircase's", JUDGEMENT)
    coarsest_temperature: float = option(2.0, "delta_degC", "coarser readings were held there", JUDGEMENT)
    spectrum: int = option(256, "1", "samples of each spectrum that tells the noise", JUDGEMENT)
    stretch: int = option(32, "1", "samples of the stretches whose spectra are asked; a record has more", JUDGEMENT)
    threshold: float = option(3.0, "1", "noise deviations below which a coefficient is noise", "0.3 % by chance")
    realisations: int = option(8, "1", "realisations of it that tell what readings hang on it", JUDGEMENT)
    long_realisations: int = option(2, "1", "the same of a long session, whose samples are many", JUDGEMENT)
    width: int = option(5, "1", "samples over which these are averaged besides", JUDGEMENT)
    lags: int = option(40, "1", "samples after which readings have forgotten it", "slowest readings, at 1 kHz")


@dataclass(frozen=True, kw_only=True)
class WaveOptions:
    """Waves upon the inputs that no record tells; the sizes are prior deviations."""

    ripple: float = option(0.05, "1", "amplitude of a ripple, share of the supply pressure", "ripple of piston pumps")
    hum: float = option(0.02, "1", "amplitude of a hum, share of the command's span", JUDGEMENT)
    frequencies: int = option(3, "1", "frequencies at which waves are thought of", JUDGEMENT)
    peak: float = option(15.0, "1", "times the spectrum beside it that such a frequency stands out", JUDGEMENT)
    beside_bins: int = option(25, "1", "bins of that spectrum beside it", JUDGEMENT)
    turns: float = option(4.0, "1", "turns of a wave in the longest record, at least", JUDGEMENT)
    highest_share: float = option(0.8, "1", "highest frequency, share of half the sampling rate", JUDGEMENT)
    clipped: float = option(3.0, "1", "robust deviations at which what is left is clipped for the spectrum", JUDGEMENT)
    minimum_gain: float = option(
        60.0, "1", "chi-square that a wave must explain", "waves pass 40 by chance once in 1e3"
    )
    dominant_share: float = option(
        0.3, "1", "share of the excess chi-square from which a wave is fitted before any cause is sought", JUDGEMENT
    )
    most: int = option(3, "1", "waves that are fitted so", JUDGEMENT)
    tuning_step: float = option(
        0.02, "1", "turns in the longest record by which its frequency is moved to see what a fit leaves", JUDGEMENT
    )
    tunings: int = option(3, "1", "times that a fit is made again with its waves tuned", JUDGEMENT)
    settling: float = option(
        0.01, "s", "start of a record that does not count beside a wave", "pilot chambers fill within a millisecond"
    )


@dataclass(frozen=True, kw_only=True)
class InstrumentOptions:
    """Errors of a bench's instruments that no record tells; the sizes are prior deviations."""

    oil_temperature: float = option(2.0, "delta_degC", "error of the oil's thermometer", JUDGEMENT)
    assumed_oil_temperature: float = option(
        15.0, "delta_degC", "the same where no oil temperature was measured", "benches at -40 to 80 °C"
    )
    supply_pressure: float = option(0.005, "1", "error of the supply's manometer, share of it", JUDGEMENT)
    assumed_supply_pressure: float = option(
        0.1, "1", "the same where no supply pressure was measured: the pump may be set to another", JUDGEMENT
    )
    pressure_delay: float = option(3e-3, "s", "delay of a pressure transducer beside the other channels", JUDGEMENT)
    clock_rate: float = option(1e-4, "1", "difference of two clocks, share of the time", "quartz clocks: 20 to 100 ppm")
    meter_drift: float = option(0.005, "1", "drift within a record, share of the channel's span", JUDGEMENT)
    meter_zero: float = option(
        0.001, "1", "zero of a meter in one record beside the others, share of the range that it read", JUDGEMENT
    )
    meter_gain: float = option(0.002, "1", "the same of its gain", JUDGEMENT)
    reset_reach: float = option(50.0, "1", "deviations by which a meter that was set anew is off at most", JUDGEMENT)
    meter_linearity: float = option(
        0.00125, "1", "departure of a meter from a straight line, share of its largest reading",
        "transducers and flow meters: 0.1 to 0.5 % at most, which is two of these and more",
    )  # fmt: skip
    both_ways: float = option(
        0.2, "1", "share of its largest reading from which a meter reads the other way too", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class PriorOptions:
    """Priors of the nuisance parameters, and candidates."""

    sensor_bias: float = option(
        2e-3, "1", "tolerance of every sensor's offset, share of the range that it read", JUDGEMENT
    )
    sensor_gain: float = option(4e-3, "1", "tolerance of every sensor's gain", JUDGEMENT)
    sensor_delay: float = option(
        1e-4, "s", "tolerance of every sensor's delay: its electronics and the logger's clock", JUDGEMENT
    )
    least_share: float = option(
        0.01, "1", "share of its nominal value that a positive quantity keeps: the equations divide by some", JUDGEMENT
    )
    reach: float = option(
        10.0, "1", "prior deviations that no quantity of the valve goes beyond", "five tolerances: another part"
    )
    heat_transfer: float = option(
        5.0,
        "1",
        "factor within which the heat transfer between two parts is known, either way",
        "jets 3 to 10 kW/m2K; contacts, and where a part's heat goes, are known less well: no valve has been measured",
    )
    network_reach: float = option(
        100.0, "1", "factor within which a figure of the thermal network is sought either way", JUDGEMENT
    )
    least_warming: float = option(
        1.0, "delta_degC", "change of the oil's temperature by which the drift of a sensor is no bias", JUDGEMENT
    )
    least_feature: float = option(
        0.01, "1", "share by which a coefficient changes that an effect's own feature hangs on, to show it", JUDGEMENT
    )
    beyond_records: float = option(
        5.0, "1", "times the longest record: a time constant of what hardly moves in it", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class SensitivityOptions:
    """How sensitivities are worked out."""

    forcing_bytes: float = option(1.5e8, "byte", "forcings that are solved for at once", "memory")
    step: float = option(
        0.01,
        "1",
        "prior deviations by which a parameter is moved",
        "sensitivities that trade off must hold to a thousandth",
    )
    simulated_below: float = option(
        2.5e-4,
        "s",
        "an effect that acts sooner is simulated: the grid of trajectories does not follow it",
        "air in the chambers",
    )
    simulated_step: float = option(
        0.3, "1", "prior deviations by which a parameter is moved whose linear answer grows without end", JUDGEMENT
    )
    most_spans: float = option(
        100.0,
        "1",
        "times what a channel reads by which it may answer to a change: what answers by more is simulated",
        "friction that falls with speed lets linear answers grow without end",
    )
    most_change: float = option(
        5.0,
        "1",
        "by which the Jacobian times the step may change within a step of the trajectory's grid: it is divided else",
        "measured: 0.02 where motion is smooth, 3 where a land passes null, 20 where friction turns, 90 at a contact",
    )
    most_parts: int = option(
        16,
        "1",
        "parts at most that such a step is divided into, so that it changes by no more in each",
        "time; 64 are some times as exact where a flapper touches",
    )
    most_divided: float = option(
        0.1, "1", "share of the steps of a trajectory's grid that are divided, the fastest of them", "time"
    )
    smooth_change: float = option(
        0.2, "1", "by which the Jacobian times the step may change where every second point is left out", JUDGEMENT
    )
    smooth_chord_deviation: float = option(
        0.01,
        "1",
        "share of its span by which a state or input may lie off the chord of its neighbours there",
        "measured: answers to contact and inertia hold to their tolerances, at twice that they do not",
    )
    fast: float = option(
        1e-3, "s", "what acts sooner is held while trajectories are kept at the samples alone", "a sample at 1 kHz"
    )
    segments: int = option(2, "1", "segments of a record, for the test that an amplitude is constant", JUDGEMENT)
    shape_ratio: float = option(1.1, "1", "ratio by which a shape parameter is moved", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """How noise is estimated."""

    most_spread: float = option(
        0.01,
        "1",
        "share of its span by which a reading may be off for what is not known of inputs, and tell noise",
        JUDGEMENT,
    )
    first_guess: float = option(
        0.01,
        "1",
        "noise at most at first, as a share of the span, where a command moves too fast for its samples",
        JUDGEMENT,
    )

    least_common: float = option(
        0.2, "1", "share of the samples of replicates that none has lost: of fewer their noise is not taken", JUDGEMENT
    )
    most_lags: int = option(8, "1", "highest order of the autoregression", JUDGEMENT)
    burst: float = option(
        6.0, "1", "times as far to and fro as in the rest of a record that a burst of noise goes", "never by chance"
    )
    burst_samples: int = option(5, "1", "readings that go so far in one burst, at least", JUDGEMENT)
    burst_beside: int = option(3, "1", "half the samples between two of one burst, and those beside it", JUDGEMENT)
    burst_share: float = option(0.1, "1", "share of a record that bursts may take: more is its noise", JUDGEMENT)
    growth_significance: float = option(
        5.0, "1", "its deviations from which noise grows with the reading", "never by chance"
    )
    least_growth: float = option(
        1.0, "1", "its variance at the largest reading more than at none, in that, from which it counts", JUDGEMENT
    )
    growth_floor: float = option(0.01, "1", "least share of its mean variance that noise has at no reading", JUDGEMENT)
    growth_steps: int = option(5, "1", "times that squares are weighted anew by their variance", JUDGEMENT)
    beginning: float = option(
        0.05, "s", "what is left out of a record that begins in motion", "several time constants of a spool"
    )
    beginning_samples: int = option(2, "1", "its first residuals that are all far off, to one side", JUDGEMENT)
    beginning_off: float = option(
        5.0, "1", "times as far off as most of the record's residuals that these are", "never by chance"
    )
    outlier: float = option(
        8.0, "1", "noise deviations from its neighbours at which a single residual is an outlier", "never by chance"
    )
    outlier_ratio: float = option(
        3.0, "1", "times the range of its neighbours by which it must differ from them", JUDGEMENT
    )
    saturated_noise: float = option(
        3.0, "1", "noise deviations by which a reading of a saturated channel may be beyond the model", "noise"
    )
    saturated_share: float = option(
        0.5, "1", "share of what an inadequate fit leaves that saturated readings carry, to be left out", JUDGEMENT
    )
    samples_per_lag: int = option(
        20, "1", "samples for each lag that is estimated; half of them with their past unbroken", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Fits of the nominal model and of hypotheses."""

    most_rows: int = option(
        300_000, "1", "whitened rows that are kept: of longer sessions every second, third ... one", "memory"
    )
    long_session: int = option(
        60_000, "1", "points of all trajectories from which a session is long", "a linearisation takes minutes there"
    )
    relative_ftol: float = option(
        1e-3, "1", "share of the excess chi-square whose reduction is not worth a linearisation", JUDGEMENT
    )
    negligible_share: float = option(
        0.02,
        "1",
        "the same of what is beyond `inadequate_ratio`",
        JUDGEMENT,
    )
    inadequate_ratio: float = option(
        1.5,
        "1",
        "chi-square over its expectation from which a fit is inadequate and is fitted robustly first",
        JUDGEMENT,
    )
    adequate_pace: float = option(
        0.05,
        "1",
        "share of what is beyond adequate that a linearisation must bring, or an adequate fit is given up",
        JUDGEMENT,
    )
    shape_stride: float = option(4.5, "1", "ratio by which one step may change a shape parameter", JUDGEMENT)
    shape_deviation: float = option(
        1.0, "1", "prior deviation of the logarithm of a shape parameter about its default", JUDGEMENT
    )
    interior: float = option(0.98, "1", "share of its limits to which an amplitude keeps while it is fitted", JUDGEMENT)
    least_amplitude: float = option(
        1e-4,
        "1",
        "share of the typical amplitude to which a one-sided amplitude may come while it is fitted",
        "at zero a step would not see its direction",
    )
    largest_chi_square: float = option(1e30, "1", "chi-square beyond which readings make no sense", JUDGEMENT)
    update_threshold: float = option(
        3.0, "1", "change of the chi-square from which Broyden's update is made", "below is the solver's noise"
    )
    linearisation_radius: float = option(
        3.0, "1", "prior deviations from the linearisation at which it is renewed", JUDGEMENT
    )
    longest_step: float = option(3.0, "1", "step of a nuisance parameter, in prior deviations", JUDGEMENT)
    longest_delay_step: float = option(
        10.0, "1", "step of when a sensor reads, in prior deviations", "half a millisecond, little of a valve's rise"
    )
    patience: int = option(
        2,
        "1",
        "in a long session, steps in a row that bring less than predicted",
        "a linearisation costs as much as six steps",
    )
    steps: int = option(20, "1", "steps with one linearisation", JUDGEMENT)
    failures: int = option(4, "1", "steps in a row that bring much less than predicted", JUDGEMENT)
    short_step: float = option(
        0.1, "1", "share of the first step that is tried last where none has led down: valleys are narrow", JUDGEMENT
    )
    acceleration_ratio: float = option(
        0.4,
        "1",
        "share of a step that its geodesic acceleration may be",
        "Transtrum and Sethna 2012: 0.75 of twice that",
    )
    robust_scale: float = option(3.0, "1", "times the median residual at which a sample counts less", JUDGEMENT)
    peak_share: float = option(
        3.0,
        "1",
        "times a reading's curvature within a tenth of a millisecond that it may be wrong by",
        "measured: sensitivities next to peaks err by half, and with 0.3 these pull fits along",
    )
    nominal_linearisations: int = option(24, "1", "linearisations of the fit of the nominal model", JUDGEMENT)
    robust_ftol: float = option(0.1, "1", "relative reduction of the chi-square that ends the robust start", JUDGEMENT)
    robust_linearisations: int = option(8, "1", "linearisations of the robust start", JUDGEMENT)
    peak_ratio: float = option(
        3.0,
        "1",
        "times the excess chi-square between peaks: where they leave more, the model cannot follow them",
        JUDGEMENT,
    )
    tolerance_deviations: float = option(
        2.0, "1", "prior deviations at which a tolerance ends", "the prior of `NominalModel`"
    )
    preliminary_ftol: float = option(10.0, "1", "reduction of the chi-square that ends a preliminary fit", JUDGEMENT)
    preliminary_share: float = option(
        0.02,
        "1",
        "the same as a share of its expectation, where repeats tell the noise",
        "a fit in full goes on from it",
    )
    nominal_ftol: float = option(
        1.0, "1", "reduction of the chi-square that ends the fit of the nominal model", JUDGEMENT
    )
    linearisations: int = option(4, "1", "linearisations of a hypothesis that does not come near", JUDGEMENT)
    predicted_reductions: float = option(
        3.0, "1", "times the predicted reduction that such a one may still be hoped to bring", JUDGEMENT
    )
    nominal_reductions: float = option(
        5.0, "1", "the same of the nominal model under other inputs", JUDGEMENT
    )
    most_linearisations: int = option(12, "1", "linearisations of a hypothesis that does", JUDGEMENT)
    refinements: int = option(3, "1", "times that a fit is linearised anew and continued at last", JUDGEMENT)
    refined_gain: float = option(
        10.0, "1", "reduction of the chi-square by a refinement from which there is another", "mostly below 5"
    )
    hypothesis_ftol: float = option(
        2.0,
        "1",
        "reduction of the chi-square that ends the fit of a hypothesis",
        "the answer set goes by several, and the rest is predicted",
    )
    law_ftol: float = option(
        0.1, "1", "the same where laws of one effect are weighed against each other", "they differ by 1 to 3"
    )
    most_explained: float = option(
        10.0, "1", "multiple of the rows up to which what is explained counts for `relative_ftol`", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class ChannelOptions:
    """When a channel's sign, unit or plug seems wrong."""

    correlation: float = option(
        0.9, "1", "correlation with what the stated valve reads, of either sign, from which a channel tells", JUDGEMENT
    )
    factor: float = option(
        5.0, "1", "times what the stated valve reads, or a share of one in as many, likewise", "no cause comes near"
    )
    zero_off: float = option(
        0.5, "1", "span of the stated valve's reading by which a channel alone is off throughout", "no cause does that"
    )
    zeros_apart: float = option(
        0.1, "1", "span by which beginnings, or means, of the stated valve's records are apart", JUDGEMENT
    )
    noise_ends: float = option(
        2e-3, "1", "share of its lower spectrum that smoothed noise has left near half the sampling rate, at most",
        "analogue filters, and what samples them, leave more",
    )  # fmt: skip
    spectrum: int = option(64, "1", "samples of each spectrum that tells it", JUDGEMENT)
    mean_spectrum: int = option(256, "1", "samples of each spectrum that tells a moving mean, at most", JUDGEMENT)
    mean_depth: float = option(
        0.05, "1", "share of its neighbours that the noise may have where that of a moving mean vanishes",
        "by chance one spectrum in a million has so little",
    )  # fmt: skip
    longest_mean: int = option(25, "1", "samples of the longest moving mean that is looked for", "50 Hz at 1 kHz")
    set_to_zero: float = option(0.02, "1", "span within which readings that were set to zero are, in all", JUDGEMENT)
    goes_back: float = option(
        0.2, "1", "share of its span by which the stated valve reads on either side of zero", JUDGEMENT
    )
    no_way_back: float = option(
        0.02, "1", "largest reading's share by which a meter without direction goes below zero, by noise", JUDGEMENT
    )
    by_command: float = option(
        0.5, "1", "share of a channel's variance that goes neither with time nor with the oil's temperature", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class SelfOscillationOptions:
    """When the stated valve oscillates by itself and the measured one does not, or the other way round."""

    step: float = option(0.5, "1", "prior deviations of a figure to either side, for the gradient", JUDGEMENT)
    reach: float = option(
        4.0, "1", "prior deviations of all figures together within which every valve must oscillate", JUDGEMENT
    )
    samples: float = option(2.0, "1", "samples per period from which a record can tell", "Nyquist")
    share: float = option(
        0.3, "1", "share of the stated valve's motion there from which the measured one oscillates too", JUDGEMENT
    )
    line_share: float = option(
        0.2, "1", "share of a reading's mean square that the line of an oscillation has", "a steady one: 0.4 and more"
    )
    line_width: float = option(0.05, "1", "half of its width, per frequency", "it goes a little with the command")
    least_periods: float = option(10.0, "1", "periods of it in a record", JUDGEMENT)
    least_travel: float = option(
        0.03, "1", "size of it per full travel of that part", "a meter's hum, at rest, is no motion"
    )
    input_share: float = option(
        0.05, "1", "what an input does there, per most of it, from which it may be what drives the valve", JUDGEMENT
    )
    least_lines: float = option(
        0.5, "1", "share of the channels that could tell an oscillation, in all records, which have its line", JUDGEMENT
    )
    least_size: float = option(
        0.3, "1", "size of it per motion of the stated valve in all records, and of the stated one's there per its own",
        "ripple and hum: 0.01",
    )
    amounts: tuple[float, ...] = option(
        (1.0, 2.0, 4.0, 8.0, 16.0), "1", "times the typical amplitude of a candidate that may cause it", JUDGEMENT
    )
    bisections: int = option(6, "1", "halvings of the interval in which it begins to", "to 1.6 % of it")


@dataclass(frozen=True, kw_only=True)
class IdentificationOptions:
    """All options of identification, a stage each."""

    audit: AuditOptions = AuditOptions()
    predictor: PredictorOptions = PredictorOptions()
    input: InputOptions = InputOptions()
    input_noise: InputNoiseOptions = InputNoiseOptions()
    wave: WaveOptions = WaveOptions()
    instrument: InstrumentOptions = InstrumentOptions()
    prior: PriorOptions = PriorOptions()
    sensitivity: SensitivityOptions = SensitivityOptions()
    noise: NoiseOptions = NoiseOptions()
    fit: FitOptions = FitOptions()
    channel: ChannelOptions = ChannelOptions()
    self_oscillation: SelfOscillationOptions = SelfOscillationOptions()


DEFAULT_IDENTIFICATION = IdentificationOptions()
