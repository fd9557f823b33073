"""What to do about an answer: the part, what to inspect, how to confirm it, and the remedy.

Effects carry their own advice (`Effect.advice`); here is that of the valve's figures, of missing terms by their port,
of bench faults, and of the answers that name no cause.
"""

from __future__ import annotations

from collections.abc import Sequence

from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.result import CHANNEL_APART, MISREAD, OTHER_VALVE, RECORDS_APART, Term, WhatToDo
from valvesim.identification.candidates import Candidate
from valvesim.identification.prior import NETWORK
from valvesim.valve.effect import Advice
from valvesim.valve.thermal_network import THERMAL_NODES, ends_of, heat_words


def advice_on_causes(
    in_set: Sequence[FittedHypothesis], unknown_reason: str, *, or_instruments: bool = False
) -> tuple[WhatToDo, ...]:
    """What to do about each cause of an answer set, likeliest first, and about noise, unknown causes and instruments
    beside them.
    """
    found = {c.label: _of_candidate(c) for one in in_set for c in one.candidates}
    noise = {one.label: NOISE for one in in_set if not one.candidates}
    beside = {"none of the known causes": NONE_PERHAPS} if unknown_reason else {}
    errors = {"errors of the instruments": OF_INSTRUMENTS} if or_instruments else {}
    advice = {**found, **noise, **beside, **errors}
    return tuple(what_to_do(label, a) for label, a in advice.items() if a is not None)


def advice_on_oscillation(causes: Sequence[Candidate]) -> tuple[WhatToDo, ...]:
    """What to do about a valve that oscillates by itself: in general, and about each part that may cause it, effects
    first.
    """
    by_part, found = dict[str, WhatToDo](), [what_to_do("the oscillation", OSCILLATION)]
    for c in sorted(causes, key=lambda each: each.effect is None):
        if (advice := _of_candidate(c)) is not None:
            by_part.setdefault(advice.part, what_to_do(c.label, advice))
    return (*found, *by_part.values())


def advice_on_unknown(reason: str, odd: str, term: Term | None) -> tuple[WhatToDo, ...]:
    """What to do where nothing is named: by the `reason` of the verdict, else about a missing term, else in general.

    `odd` is the test, or the channel, that does not belong to the others.
    """
    if reason == CHANNEL_APART:
        return (what_to_do(f"the channel {odd}", APART_CHANNEL),)
    if reason == RECORDS_APART:
        return (what_to_do(f"the test {odd}", APART),)
    if reason == OTHER_VALVE:
        return (what_to_do("the stated valve", OTHER),)
    if reason == MISREAD:
        return (what_to_do("the channels", CHANNELS),)
    if term is None:
        return (what_to_do("none of the known causes", NOT_LOCATED),)
    return (what_to_do(term.in_words(), BY_PORT[term.port]),)


def what_to_do(label: str, advice: Advice) -> WhatToDo:
    return WhatToDo(label=label, part=advice.part, inspect=advice.inspect, confirm=advice.confirm, remedy=advice.remedy)


def _of_candidate(candidate: Candidate) -> Advice | None:
    """What to do about a candidate; of a user's effect None, where it says nothing."""
    if candidate.effect is not None:
        return candidate.effect.advice
    if candidate.parameter is not None and candidate.parameter.of_network:
        return _of_heat_path(candidate.parameter.name.removeprefix(NETWORK))
    figure = candidate.name.partition(":")[2]
    return BY_FIGURE.get(figure) or _of_figure(figure.replace("_", " "))


def _of_heat_path(name: str) -> Advice:
    """What to do about a figure of the thermal network."""
    parts = [end for end in ends_of(name) if end.replace(" ", "_") in THERMAL_NODES]
    return Advice(
        part=f"heat path of the {' and the '.join(parts)}: the {heat_words(name)}",
        inspect=f"thermometers at the {' and the '.join(parts)}, or next to it, during a warm-up",
        confirm=f"a warm-up with the column {parts[-1].replace(' ', '_')}_temperature: the part then goes by it, and "
        "nothing is left to explain",
        remedy=f"state thermal.{name} as found above, or measure that temperature; the valve need not be at fault",
    )


def _of_figure(figure: str) -> Advice:
    """What to do about a figure that only a session's own tolerances make uncertain."""
    return Advice(
        part=f"the part that gives the valve its {figure}",
        inspect=f"{figure} against the drawing and the valve's own papers",
        confirm="measure it on the part; the figure and its interval stand above",
        remedy=STATE,
    )


STATE = "exchange the part, or state the figure in [valve] with its tolerance"
ALLOY = Advice(
    part="the part that the coefficient is of, and its alloy",
    inspect="certificate of the material against the drawing",
    confirm="null and flow gain from cold to hot oil at one current, the valve warmed through at each",
    remedy="the alloy of the drawing, or state the coefficient in [valve]",
)
_GROUPS: tuple[tuple[tuple[str, ...], Advice], ...] = (
    (("air_gap_area", "air_gap_difference", "flux_share", "armature_arm"), Advice(
        part="air gaps, pole pieces and armature of the torque motor",
        inspect="each gap with gauges; chips in them; the screws of the motor",
        confirm="angle of the armature over current without pressure: its slope and its offset at zero current",
        remedy="set the gaps anew; " + STATE)),
    (("polarization_mmf", "magnet_reluctance"), Advice(
        part="permanent magnets",
        inspect="flux in the air gaps with a gaussmeter, against the valve's own record",
        confirm="angle of the armature over current without pressure, against the valve's own record",
        remedy="remagnetise or exchange the magnets, or state the figure in [valve] with its tolerance")),
    (("coil_turns", "coil_resistance", "coil_inductance"), Advice(
        part="coils and their leads",
        inspect="resistance and inductance of each coil against the data sheet, at one temperature",
        confirm="both coils in series and in parallel: are they alike, and wired as stated?",
        remedy=STATE)),
    (("armature_inertia", "armature_damping"), Advice(
        part="armature and flapper",
        inspect="the armature's parts against the drawing; what clings to it",
        confirm="natural frequency and decay of the armature after a small step of current, without pressure",
        remedy=STATE)),
    (("spring_tube_stiffness",), Advice(
        part="spring tube",
        inspect="wall thickness against the drawing; cracks by dye penetrant",
        confirm="natural frequency of the armature without pressure, against the valve's own record",
        remedy=STATE)),
    (("feedback_rod_stiffness", "feedback_arm"), Advice(
        part="feedback rod and its ball",
        inspect="rod for bends and cracks; its length and diameter; the ball in its slot",
        confirm="spool position over current, slow, at full supply pressure: its slope is the rod's",
        remedy=STATE)),
    (("nozzle_arm", "nozzle_diameter", "nozzle_diameter_difference", "nozzle_length", "null_gap",
      "null_gap_difference", "flapper_length"), Advice(
        part="nozzles and flapper",
        inspect="nozzles under a microscope: diameter, edge, seat; traces on the flapper",
        confirm="both chamber pressures and the pilot flow at zero current, over supply pressure",
        remedy="set the nozzles anew; " + STATE)),
    (("fixed_orifice_diameter", "fixed_orifice_difference", "fixed_orifice_length"), Advice(
        part="fixed orifices",
        inspect="orifices and last-chance filter under a microscope: diameter, edge, deposits",
        confirm="both chamber pressures and the pilot flow at zero current, over supply pressure",
        remedy="flush them; " + STATE)),
    (("chamber_volume",), Advice(
        part="spool end chambers and their passages",
        inspect="plugs, spacers and seals against the drawing; trapped air",
        confirm="frequency response of the spool at low and at high supply pressure: air is stiff at high",
        remedy="bleed the valve; " + STATE)),
    (("spool_area", "spool_mass", "spool_damping"), Advice(
        part="spool",
        inspect="diameter and mass of the spool; scores and varnish in the bore; the oil's viscosity",
        confirm="spool velocity over chamber pressure difference in steps of several sizes",
        remedy=STATE)),
    (("port_width", "port_flow_coefficient"), Advice(
        part="ports of the sleeve",
        inspect="width and edges of the ports under a microscope; what blocks them",
        confirm="flow over spool position at a known pressure drop, against the valve's own record",
        remedy=STATE)),
    (("null_opening", "land_overlap"), Advice(
        part="metering edges of spool and sleeve",
        inspect="edges under a microscope: rounding, nicks; particles in the oil",
        confirm="flow gain, pressure gain and leakage about null, against the valve's own record",
        remedy=STATE)),
    (("radial_clearance", "land_length"), Advice(
        part="lands of spool and sleeve",
        inspect="diameters of spool and bore; scores along the lands",
        confirm="leakage at null over the oil's temperature, the load ports blocked",
        remedy=STATE)),
    (("magnet_expansion", "pole_expansion", "armature_expansion", "feedback_rod_expansion", "spring_tube_expansion",
      "pilot_expansion", "spool_expansion", "sleeve_expansion", "polarization_mmf_slope", "copper_resistance_slope"),
     ALLOY),
)  # fmt: skip
BY_FIGURE = {figure: advice for figures, advice in _GROUPS for figure in figures}
"""What to do about a figure of the valve beyond its tolerance."""

CARRY = "until the part is found, extended.toml carries the term, where it is offered"
BY_PORT = {
    "armature_torque": Advice(
        part="torque motor, spring tube or feedback rod",
        inspect="the air gaps for chips, the spring tube for cracks, the ball in its slot, the screws of the motor",
        confirm="angle of the armature over current without pressure, slow and fast: is the term there too?",
        remedy=CARRY),
    "pilot_flow": Advice(
        part="nozzles, flapper, fixed orifices or end chambers of the spool",
        inspect="nozzles and orifices under a microscope; seals and plugs of the chambers for leaks",
        confirm="both chamber pressures at rest over current, the spool blocked where it can be",
        remedy=CARRY),
    "spool_force": Advice(
        part="spool and sleeve, or what pulls at the spool: feedback ball, centring springs, flow forces",
        inspect="spool and bore for scores, burrs and varnish; sleeve and springs against the drawing",
        confirm="chamber pressure difference over spool position, slow, with and without load flow",
        remedy=CARRY),
    "load_flow": Advice(
        part="metering edges and ports, or the lines and the meter between valve and load",
        inspect="ports for what blocks them; bore of the lines; the range of the flow meter",
        confirm="flow over spool position at two pressure drops: a port scales with their root, a meter does not",
        remedy=CARRY),
    "internal_leakage": Advice(
        part="lands of the spool, pilot stage and seals",
        inspect="lands and edges for scores; seals between the stages",
        confirm="leakage over spool position, slow, at two supply pressures",
        remedy=CARRY),
}  # fmt: skip
"""What to do about a missing term, by the port where it acts."""

NOT_LOCATED = Advice(
    part="not located",
    inspect="the readings that the model gets most wrong, in the pictures: which channel, which record, when",
    confirm="repeat the worst record: what comes back is the valve's or the bench's, and no accident",
    remedy="diagnose again with a pressure between the stages, or with further tests",
)
NONE_PERHAPS = Advice(
    part="unknown",
    inspect="before a part is exchanged: does what is found on it account for the size that is given above?",
    confirm="diagnose again after the remedy: what was wrong must be gone",
    remedy="where it is not, measure a further channel",
)
NOISE = Advice(
    part="none",
    inspect="the noise: are its repeats as many and as quiet as they should be?",
    confirm="repeat the tests: what is real grows with their number, noise does not",
    remedy="none until it shows clearly",
)
OF_INSTRUMENTS = Advice(
    part="oil thermometer, supply manometer, clocks and meters of the bench",
    inspect="their calibrations, and the zeros of the meters before and after a record",
    confirm="repeat a record with other instruments: what a cause in the valve does stays",
    remedy="calibrate, or exchange, the instrument that differs; then diagnose again",
)
APART = Advice(
    part="that test and its bench",
    inspect="what was different: oil and its temperature, supply and return pressure, wiring, ranges, the valve itself",
    confirm="repeat that test and diagnose again",
    remedy="leave the test out of the session, or state what was different",
)
OTHER = Advice(
    part="session and bench before the valve",
    inspect="name plate and serial number; units, sign and wiring of each channel; [valve] and [oil] of the session",
    confirm="flow over current and leakage at null, slow, against the data sheet of this valve",
    remedy="correct units or signs, or state the figures of the valve that was measured in [valve]",
)
OSCILLATION = Advice(
    part="armature and its spring tube, pilot stage, feedback rod; or what shakes valve and bench",
    inspect="whether the valve is heard to squeal; pump, mounts and mains for what goes at this frequency",
    confirm="supply pressure slowly down and up again, the command at rest: where does it stop, and begin?",
    remedy="records below that pressure, or with the command where it rests, tell more: diagnose these by themselves",
)
APART_CHANNEL = Advice(
    part="measuring chain of that channel: sensor, lines to it, amplifier and its filter, converter",
    inspect="its filter and range; air in the lines to a pressure transducer; play in a displacement sensor; whether "
    "all samples are of the same instants",
    confirm="the same test with another instrument in that channel, or a step that both measure",
    remedy="mend its chain, or leave the channel out; what no other channel shows may be the valve still",
)
CHANNELS = Advice(
    part="wiring of these channels, and their columns",
    inspect="polarity of sensor and coils, plugs, scale of the amplifier; name and unit in the header of each column",
    confirm="a slow triangle: does each channel go the way, and as far, as the data sheet of this valve has it?",
    remedy="correct the columns, or their units, and diagnose again",
)

OF_WAVE = {
    "supply_pressure": Advice(
        part="pump and supply line",
        inspect="speed times number of pistons against this frequency; charge of the accumulator",
        confirm="supply pressure at the valve's port with a fast transducer, the valve at rest",
        remedy="accumulator or damper at the valve; else record the supply pressure fast, as a column"),
}  # fmt: skip
HUM = Advice(
    part="amplifier and its cables",
    inspect="ground loops; mains frequency, its multiples, and the amplifier's own switching",
    confirm="the command at zero: is the wave still there, by a shunt or a clamp?",
    remedy="one ground and screened cables; else record the command where it enters the valve",
)
OF_INPUT = {
    "oil_temperature": Advice(
        part="oil thermometer and cooler",
        inspect="where the thermometer sits, its calibration; when cooler and heater switch",
        confirm="a second thermometer at the valve's port during one record",
        remedy="measure the oil at the valve's port and record it as a column"),
    "supply_pressure": Advice(
        part="supply manometer, pump and accumulator",
        inspect="calibration and place of the manometer; the pump's compensator; charge of the accumulator",
        confirm="a second transducer at the valve's port during one record",
        remedy="measure the supply at the valve's port and record it as a column"),
    "load_pressure": Advice(
        part="transducers at the load ports",
        inspect="calibration and zeros of both transducers; hoses, filters and couplings between them and the valve",
        confirm="both ports joined at rest: what difference is read? A second pair at the valve's ports",
        remedy="measure the load pressure at the valve's ports and record it as a column"),
}  # fmt: skip
TRANSDUCER = Advice(
    part="transducer of that pressure",
    inspect="its amplifier's filter, the line to it and the air in that; which logger it is on",
    confirm="a valve that is shut at once: how long does the reading fall behind another transducer there?",
    remedy="a fast transducer at the valve's port, on the logger of the other channels",
)
CLOCKS = Advice(
    part="loggers of the channels",
    inspect="which channels share a clock; the loggers' sampling rates",
    confirm="one signal into all channels for as long as the longest record",
    remedy="one logger, or one clock, for all channels",
)
METER = Advice(
    part="meter of that channel",
    inspect="its warm-up, its supply, its temperature",
    confirm="its zero before and after a record",
    remedy="let it warm up before the tests; set its zero between them",
)
LINEARITY = Advice(
    part="meter of that channel",
    inspect="its calibration sheet: gain over the range, and both ways",
    confirm="five known values over its range, both ways",
    remedy="calibrate it, and record what it reads by the curve of that calibration",
)
