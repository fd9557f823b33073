"""The options of identification from figures: every threshold with its unit, meaning and where its value comes from.

`identify(specification, options=FromFiguresOptions(...))` passes them on; a `FigurePredictor` carries its own. See
`valvesim.options`.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.options import JUDGEMENT, option


@dataclass(frozen=True, kw_only=True)
class SimilarityOptions:
    """Which valves there are, and what they have in common."""

    flows: tuple[float, float] = option(
        (0.5 / 6e4, 400.0 / 6e4),
        "m^3/s",
        "rated flows at 70 bar of two-stage nozzle-flapper valves",
        "they are made from 1 to 250 L/min",
    )
    currents: tuple[float, float] = option((1e-3, 1.0), "A", "their rated currents", JUDGEMENT)
    stop: float = option(1.3, "1", "spool stroke over full stroke at rated current", JUDGEMENT)
    coil_power: float = option(
        0.1, "W", "i^2 R at rated current", "40 mA at 80 ohm, 30 mA at 85 ohm, 10 mA at 1000 ohm"
    )
    null_opening: float = option(
        5e-6, "m", "opening of the lands at null", "3 um of the reference valve, 7 um of the measured valve 5329"
    )
    ampere_turns_spread: float = option(
        0.3,
        "1",
        "deviation of the logarithm of turns times rated current, which follow from the full stroke",
        JUDGEMENT,
    )


@dataclass(frozen=True, kw_only=True)
class StaticOptions:
    """The points at which static figures are told."""

    line_points: int = option(16, "1", "currents of a flow gain, on either side of null", JUDGEMENT)
    leakage_points: int = option(31, "1", "load pressures of the leakage at blocked ports", JUDGEMENT)
    leakage_reach: float = option(0.93, "1", "the largest of them, share of the supply pressure", JUDGEMENT)
    pressure_points: int = option(21, "1", "load pressures of a pressure gain", JUDGEMENT)
    tare_points: int = option(4, "1", "currents of the tare, on either side of null", JUDGEMENT)
    tare_from: float = option(0.95, "1", "the smallest of them, share of the rated current", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class DynamicOptions:
    """How dynamic figures are simulated."""

    beside: tuple[float, float, float] = option(
        (0.94, 1.0, 1.06), "1", "shares of an expected frequency: the sines from which a crossing is told", JUDGEMENT
    )
    reference: float = option(
        1.0 / 20.0, "1", "share of an expected frequency: the sine to which amplitudes refer", JUDGEMENT
    )
    least_frequency: float = option(0.2, "Hz", "but no less", JUDGEMENT)
    settle_time: float = option(0.02, "s", "of a sine before it is read", "slowest mode of the reference valve: 1 ms")
    settle_cycles: int = option(1, "1", "whole cycles before it is read, beyond that time", JUDGEMENT)
    samples: int = option(48, "1", "samples of a cycle", JUDGEMENT)
    tolerance: float = option(3e-5, "1", "relative tolerance of the solver", "a third of that of records")
    decibel_slopes: tuple[float, float] = option(
        (4.0, 60.0), "1", "least and greatest fall in dB per unit of ln f", JUDGEMENT
    )
    degree_slopes: tuple[float, float] = option(
        (20.0, 250.0), "1", "least and greatest growth of the lag in degrees per unit of ln f", JUDGEMENT
    )
    step_time: float = option(5e-3, "s", "expected of a step of which the overshoot alone is asked", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class PosteriorOptions:
    """The fit of the unknowns."""

    step: float = option(0.05, "1", "prior deviations of a difference to both sides", JUDGEMENT)
    forward_step: float = option(0.005, "1", "prior deviations of one to one side alone, on the way", JUDGEMENT)
    farthest: float = option(
        4.0, "1", "prior deviations from similarity beyond which no believable valve is", "once in 16,000"
    )
    evaluations: int = option(25, "1", "evaluations of the fit, each with a Jacobian", JUDGEMENT)
    ftol: float = option(1e-3, "1", "relative reduction of the penalised chi-square that ends it", JUDGEMENT)
    drawn_starts: int = option(
        4, "1", "starts drawn from the prior, beside similarity",
        "where a flapper meets its nozzles, valves of two kinds may fit",
    )
    no_valve: float = option(1e3, "1", "deviations: the misfit of a point at which there is no valve", JUDGEMENT)
    identified: float = option(
        0.8, "1", "share of its prior's deviation below which a parameter is told to be identified", JUDGEMENT
    )


@dataclass(frozen=True, kw_only=True)
class ConflictOptions:
    """Which figures exclude each other."""

    most_left_out: int = option(6, "1", "figures that are each left out once", JUDGEMENT)
    evaluations: int = option(12, "1", "evaluations of a fit without one of the figures", JUDGEMENT)
    far: float = option(2.5, "1", "prior deviations from similarity that are worth a word", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class NextFigureOptions:
    """What is expected of figures that were not told."""

    rounds: int = option(8, "1", "predictions at most until they are of sines and steps about them", JUDGEMENT)
    settled: float = option(1e-3, "1", "relative change from one to the next that ends it", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class MeasurementOptions:
    """Measured figures."""

    least_deviation: float = option(1e-3, "1", "share of a figure: no measurement is taken to be better", JUDGEMENT)
    least_shift: float = option(5e-4, "1", "share of rated current: no null is taken to be known better", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class FromFiguresOptions:
    """All options of identification from figures, a stage each."""

    similarity: SimilarityOptions = SimilarityOptions()
    static: StaticOptions = StaticOptions()
    dynamic: DynamicOptions = DynamicOptions()
    posterior: PosteriorOptions = PosteriorOptions()
    conflict: ConflictOptions = ConflictOptions()
    next_figure: NextFigureOptions = NextFigureOptions()
    measurement: MeasurementOptions = MeasurementOptions()


DEFAULT_FROM_FIGURES = FromFiguresOptions()
