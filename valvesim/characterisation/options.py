"""The options of characterisation: every threshold with its unit, meaning and where its value comes from.

What a figure of merit is by its standard (where a line is laid, which harmonics count) is no option. A record, a
response and a curve carry their own. See `valvesim.options`.
"""

from __future__ import annotations

from dataclasses import dataclass

from valvesim.options import JUDGEMENT, option


@dataclass(frozen=True, kw_only=True)
class AcceptanceOptions:
    """Records of static tests."""

    least_points: int = option(50, "1", "points that a branch needs", JUDGEMENT)
    longest_interval: float = option(
        5.0, "1", "times the usual sampling interval from which a longer one is a gap", JUDGEMENT
    )
    motion_in_gap: float = option(
        0.02, "1", "share of its span that the current, or the pressure drop of flow over load, may move in a gap",
        JUDGEMENT,
    )
    reversal: float = option(
        4.0, "1", "deviations of its noise by which an output must have moved back after a turn", "never by chance"
    )
    least_reversals: int = option(2, "1", "turns with such a reversal that a threshold needs", "one has no scatter")
    inductive_share: float = option(
        0.02, "1", "share of the voltage that the inductance must have had for it to be told", JUDGEMENT
    )
    dithered_period: float = option(
        20.0, "s", "of a simulated cycle with dither", "the branches part by 0.05 % of i_R, which the valve trails by"
    )


@dataclass(frozen=True, kw_only=True)
class ResponseOptions:
    """Steps, sines and chirps."""

    cycle_samples: int = option(64, "1", "samples of a cycle of a simulated sine", JUDGEMENT)
    read_time: float = option(0.02, "s", "of a sine that are read at least, in whole cycles", JUDGEMENT)
    sine_tolerance: float = option(
        1e-5, "1", "relative tolerance of the solver", "its error shows as a distortion of about 1e-7"
    )
    least_coherence: float = option(0.8, "1", "coherence below which a point serves no figure", JUDGEMENT)
    highest_reference: float = option(
        0.2, "1", "share of the -3 dB frequency that the lowest frequency may be",
        "a first order has fallen by 0.2 dB there, 2 % of the frequency",
    )
    chirp_rest: float = option(
        0.5, "s", "before and after a simulated chirp", "the length of a window, which tapers its ends"
    )
    excited: float = option(
        1e-3, "1", "share of the input's greatest power density above which a frequency counts as excited", JUDGEMENT
    )
    dither_time: float = option(0.05, "s", "of dither before a step", "slowest mode of the reference valve: 1 ms")


@dataclass(frozen=True, kw_only=True)
class RestCurveOptions:
    """A characteristic at rest."""

    angles: int = option(81, "1", "angles of the armature", JUDGEMENT)
    density: float = option(3.5, "1", "how dense they are about null: equal steps of asinh", JUDGEMENT)
    false_positions: int = option(7, "1", "steps from two angles to the one in between", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class ReductionOptions:
    """Bandwidths and reduced forms of a linear system."""

    lowest_frequency: float = option(0.1, "Hz", "from which bandwidths are looked for", JUDGEMENT)
    highest_frequency: float = option(1e4, "Hz", "up to which they are", JUDGEMENT)
    points: int = option(200, "1", "frequencies of the fit of a reduced form, even in their logarithm", JUDGEMENT)
    decades: float = option(2.0, "1", "decades below the upper end of the fit", JUDGEMENT)


@dataclass(frozen=True, kw_only=True)
class CharacterisationOptions:
    """All options of characterisation, a stage each."""

    acceptance: AcceptanceOptions = AcceptanceOptions()
    response: ResponseOptions = ResponseOptions()
    rest_curve: RestCurveOptions = RestCurveOptions()
    reduction: ReductionOptions = ReductionOptions()


DEFAULT_CHARACTERISATION = CharacterisationOptions()
