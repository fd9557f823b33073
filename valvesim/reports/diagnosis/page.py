"""The report of a diagnosis: one page that can be mailed, with its pictures inside and beside it."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from valvesim.diagnosis.result import (
    AMBIGUOUS,
    BENCH,
    CAUSE,
    CHANNEL_APART,
    MISREAD,
    NO_DISCREPANCY,
    OSCILLATES,
    OTHER_VALVE,
    RECORDS_APART,
    UNKNOWN,
    CandidateAnswer,
    DetectionLimit,
    Diagnosis,
    NoiseFound,
    Shift,
)
from valvesim.errors import unknown_name
from valvesim.io import check_folder
from valvesim.reports.chart import Charts
from valvesim.reports.diagnosis import error_map, gain, scores, term, traces
from valvesim.reports.diagnosis.glossary import glossary
from valvesim.reports.diagnosis.words import (
    UNDETERMINED,
    estimate_words,
    extended_differs,
    gain_words,
    interval,
    number,
    percent,
    relative_change,
    spoken,
    term_units,
    unit_of,
    with_unit,
)
from valvesim.reports.html_page import (
    Banner,
    Bar,
    Bullets,
    Listing,
    Picture,
    Section,
    Table,
    Terms,
    Text,
    page,
    section,
)
from valvesim.reports.plotting import COLOURS, Figure, png, write_bytes
from valvesim.reports.title_block import TitleBlock
from valvesim.valve.additive_term import LAG, NONE, PATH

VERDICTS = {  # words, edge and ground of the banner
    NO_DISCREPANCY: ("No discrepancy found", COLOURS[2], "#e3f2e9"),
    CAUSE: ("Cause found", COLOURS[1], "#fbe6e8"),
    AMBIGUOUS: ("Several answers possible", COLOURS[3], "#fcf0dd"),
    UNKNOWN: ("Unknown mechanism", COLOURS[4], "#eee6f2"),
}
REASON_WORDS = {
    BENCH: "The bench, not the valve",
    RECORDS_APART: "Records that do not belong together",
    OTHER_VALVE: "Not the stated valve",
    MISREAD: "Channels, not the valve",
    OSCILLATES: "The valve oscillates by itself",
    CHANNEL_APART: "One channel apart",
}  # words of the banner in place of the verdict's
TOLD_BEFORE_FIT = (OTHER_VALVE, MISREAD, OSCILLATES)  # reasons that may be told before anything is fitted
DIAGNOSIS_DPI = 140  # of the pictures: sharp on paper too
MEMORY_WORDS = {NONE: "none", LAG: "follows with a lag", PATH: "turns with the direction, as hysteresis does"}
MOST_SHIFTS, MOST_CANDIDATES = 8, 8  # that are shown, largest first
DIAGNOSIS_PICTURES: dict[str, Callable[[Diagnosis], Figure | None]] = {
    "errors": error_map.draw_errors, "traces": traces.draw_traces, "scores": scores.draw_scores,
    "gain": gain.draw_gain, "term": term.draw_term,
}  # fmt: skip


def write_report(
    diagnosis: Diagnosis, folder: Path, *, valve: str, date: datetime.date, facts: Sequence[tuple[str, str]] = ()
) -> list[Path]:  # fmt: skip
    """Write `report.html` (pictures inside) into `folder`, and each picture as a PNG beside it; their paths, page last.

    `errors.png`, `traces.png`, `scores.png`, `gain.png` and `term.png`, each only where the diagnosis has something for
    it. Everything is drawn before the first file is written. Raises InputError for a folder that cannot be written and
    for a verdict that is none.
    """
    folder = Path(folder)
    if diagnosis.verdict not in VERDICTS:
        raise unknown_name("verdict", diagnosis.verdict, VERDICTS, "diagnosis")
    check_folder(folder)
    block = TitleBlock(title=f"Diagnosis: {diagnosis.title}", valve=valve, date=date, facts=facts)
    pictures = {name: png(figure, block, dpi=DIAGNOSIS_DPI) for name, figure in draw(diagnosis).items()}
    files = {f"{name}.png": data for name, data in pictures.items()}
    text = page(block, _sections(diagnosis, pictures), banner=banner(diagnosis))
    files["report.html"] = text.encode("utf-8")
    return [write_bytes(data, folder / name) for name, data in files.items()]


def draw(diagnosis: Diagnosis) -> dict[str, Figure]:
    """The pictures of a diagnosis by name, without those that would be empty."""
    drawn = {name: function(diagnosis) for name, function in DIAGNOSIS_PICTURES.items()}
    return {name: figure for name, figure in drawn.items() if figure is not None}


def _picture(pictures: dict[str, bytes], name: str, caption: str) -> Picture:
    return Picture(pictures.get(name, b""), caption, DIAGNOSIS_DPI)


def _sections(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> list[Section]:
    """The page from top to bottom."""
    answers = [causes(diagnosis), _answer_set(diagnosis)]
    return [
        section("", _facts(diagnosis)), *(answers if diagnosis.causes else reversed(answers)),
        _next_test(diagnosis), _gain(diagnosis, pictures), _term(diagnosis, pictures),
        section(
            "Simulation beside records" if diagnosis.verdict == NO_DISCREPANCY else "What the simulation gets wrong",
            _picture(pictures, "errors", "Error of the nominal model, fitted to these records, in noise deviations "
                     "(root mean square): 1 is noise alone; grey is not measured."),
            Charts(traces.trace_charts(diagnosis)),
            _picture(pictures, "traces", "The readings that the nominal model gets most wrong; below them the "
                     "residual, measured less model."),
        ),
        section(
            "How strongly each candidate shows",
            _picture(pictures, "scores", "What passes the alarm level is no accident: where nothing is hidden, the "
                     "strongest of all candidates hardly ever reaches it." if np.isfinite(diagnosis.alarm_level)
                     else "These records show none of the candidates well enough to set an alarm level."),
        ),
        _shifts(diagnosis.shifts), _noise(diagnosis.noise),
        _limits(() if diagnosis.reason in TOLD_BEFORE_FIT else diagnosis.detection_limits),
        section("Notes", Bullets(diagnosis.notes)), _extended(diagnosis), _what_to_do(diagnosis), glossary(diagnosis),
    ]  # fmt: skip


def banner(diagnosis: Diagnosis) -> Banner:
    """The verdict, in its colours."""
    words, edge, ground = VERDICTS[diagnosis.verdict]
    words = REASON_WORDS.get(diagnosis.reason, words)
    if diagnosis.verdict == CAUSE and len(diagnosis.causes) > 1:
        words = "Causes found"
    return Banner(words, diagnosis.summary, edge, ground)


def _facts(diagnosis: Diagnosis) -> Terms:
    """What a reader in a hurry wants to know besides."""
    first = [c for c in diagnosis.candidates if c.in_set and c.names not in ((), (UNKNOWN,))][:1]
    better, records = sum(one.claimed for one in diagnosis.gain), len(diagnosis.gain)
    claimed = f"better on {better} of {records} hold-out records" if diagnosis.gain_claimed else "none claimed"
    channels = {found.channel for found in diagnosis.noise}
    unverified = {found.channel for found in diagnosis.noise if not found.verified}
    noise = f"unverified for {len(unverified)} of {len(channels)} channels" if unverified else "known from repeats"
    return Terms(
        (
            ("Where", diagnosis.location),
            ("Probability", percent(first[0].probability) if first and diagnosis.verdict == CAUSE else ""),
            ("Gain", claimed if diagnosis.verdict != NO_DISCREPANCY else ""),
            ("Noise", noise if diagnosis.noise else ""),
        )
    )


def causes(diagnosis: Diagnosis) -> Section:
    """The causes, each with its parameters; a cause without any is named all the same."""
    rows, above = [], ""
    for e in diagnosis.parameters:
        rows.append((spoken(e.cause) if e.cause != above else "", spoken(e.name), *estimate_words(e), e.doc))
        above = e.cause
    told = [e.cause for e in diagnosis.parameters]  # these name the sensor or side too: sensor_bias@load_flow
    silent = [cause for cause in diagnosis.causes if not any(one.startswith(cause) for one in told)]
    rows += [(spoken(cause), "", "", "", "") for cause in silent]
    headings = ("cause", "parameter", "estimate", "95 % interval", "meaning")
    names = f"By name in diagnosis.json: {', '.join(diagnosis.causes)}." if diagnosis.causes else ""
    heading = "Causes" if len(diagnosis.causes) > 1 else "Cause" if diagnosis.causes else "If it is the likeliest"
    return section(heading, Table(headings, rows, (2, 3)), Text(names))


def _answer_set(diagnosis: Diagnosis) -> Section:
    """The candidates with their probabilities, where more than one was weighed."""
    candidates, several = diagnosis.candidates, diagnosis.verdict == AMBIGUOUS
    heading = "Possible causes" if several else "What was weighed"
    if len(candidates) < 2 and not several:
        return section(heading)
    ranked = sorted(candidates, key=lambda c: not c.in_set)  # the likeliest first, within each
    most = max(MOST_CANDIDATES, sum(c.in_set for c in candidates))

    def told(c: CandidateAnswer) -> bool:
        return bool(np.isfinite(c.deviance_fall)) and c.names != (UNKNOWN,)

    rows = [
        (
            spoken(c.label), Bar(c.probability, percent(c.probability)), "possible" if c.in_set else "less likely",
            c.location,
            number(c.deviance_fall, max(1.0, 0.01 * c.deviance_fall)) if told(c) else "",
        )
        for c in ranked[:most]
    ]  # fmt: skip
    headings = ("candidate", "probability", "answer", "where", "fall of deviance")
    above = "The data cannot tell the possible ones apart." if several else ""
    return section(heading, Text(above), Table(headings, rows, (4,)))


def _next_test(diagnosis: Diagnosis) -> Section:
    test = diagnosis.next_test
    if test is None:
        return section("Next test", Text(diagnosis.no_test))
    first, second = map(spoken, test.separates)
    settings = [(spoken(name), text) for name, text in test.settings.items()]
    duration = f"takes {test.duration:g} s and " if np.isfinite(test.duration) else ""
    distance = f" (distance {test.distance:.1f} noise deviations)" if np.isfinite(test.distance) else ""
    power = f"It {duration}would tell {first} from {second}"
    if test.uninformative:
        none = f"No test that was thought of tells {first} from {second}."
        power = f"{none} This one, which {duration}shows most, would do so"
    if np.isfinite(test.power):
        power += f" with a probability of {percent(test.power)}{distance}"
    others = f"Instead of it: {'; '.join(test.alternatives)}." if test.alternatives else ""
    return section("Next test", Text(test.description, strong=True), Table(("setting", "value"), settings),
                   Text(f"{power}."), Text(others))  # fmt: skip


def _gain(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> Section:
    """Before, after and noise floor on the hold-out records, or why no gain is claimed."""
    heading = "Gain of the extended model"
    if diagnosis.verdict == NO_DISCREPANCY or _is_unfitted(diagnosis):
        return section(heading)
    if not diagnosis.gain:
        none = "No gain is claimed: there is no hold-out record that the extended model could be tried on."
        return section(heading, Text(none))
    if not extended_differs(diagnosis):
        return section(heading, Text("No gain is claimed: nothing was found to extend the model with."))
    told = (
        "On records that the search never saw, opened once. Errors are in noise deviations, over all channels."
        if diagnosis.gain_claimed
        else "No gain is claimed over all hold-out records; the last column says what each of them shows."
    )
    rows = []
    for g in diagnosis.gain:
        change, low, high = relative_change(g)
        errors = [number(v, 0.1) if np.isfinite(v) else UNDETERMINED for v in (g.before, g.after, g.floor)]
        sign = "+" if change >= 0.5 else ""
        moved = f"{sign}{number(change, 10.0)} % ({interval(low, high, 10.0, '%')})"
        moved = moved if np.isfinite(change) else UNDETERMINED
        rows.append((g.record, *errors, moved, gain_words(g)))
    headings = ("record", "before", "after", "noise floor", "change of mean square (95 % interval)", "so")
    caption = "Error on the hold-out records before and after; a hollow mark is not claimed."
    return section(heading, Text(told), Table(headings, rows, (1, 2, 3, 4)), _picture(pictures, "gain", caption))


def _term(diagnosis: Diagnosis, pictures: dict[str, bytes]) -> Section:
    found = diagnosis.term
    heading = "The missing term" if diagnosis.verdict == UNKNOWN else "A term, if it is none of the known causes"
    if found is None:
        return section(heading)
    (x_unit, x_factor), (y_unit, _) = term_units(found)
    visited = ""
    if found.at:
        low, high = min(found.at) * x_factor, max(found.at) * x_factor
        visited = interval(low, high, (high - low) / 10.0, x_unit)
    off = percent(found.formula_error) if found.formula and np.isfinite(found.formula_error) else ""
    facts = (
        ("Added to", with_unit(spoken(found.port), f"[{y_unit}]" if y_unit else "")),
        ("As a function of", spoken(found.variable)),
        ("Visited", visited),
        ("Memory", MEMORY_WORDS.get(found.memory, found.memory)),
        ("Formula, in SI units", found.formula or "none holds up; the curve stands for itself"),
        ("Formula off by", off),
        ("Nearly as well", "; ".join(found.alike)),
    )
    caption = "The missing term as recovered from the records; it is not known beyond the range that they visited."
    return section(heading, Terms(facts), _picture(pictures, "term", caption))


def _shifts(shifts: Sequence[Shift]) -> Section:
    """The nuisance parameters that moved most, as share of their tolerance."""
    known = [s for s in shifts if np.isfinite((s.share_of_tolerance, s.nominal, s.value)).all()]
    moved = sorted(known, key=lambda s: -abs(s.share_of_tolerance))
    rows = []
    for s in moved[:MOST_SHIFTS]:
        unit, factor = unit_of(s.unit, max(abs(s.nominal), abs(s.value)), s.name)
        step = abs(s.value - s.nominal) * factor
        nominal, value = (with_unit(number(v * factor, step), unit) for v in (s.nominal, s.value))
        share = Bar(abs(s.share_of_tolerance), f"{100.0 * s.share_of_tolerance:+.0f} %")
        rows.append((spoken(s.name), nominal, value, share))
    left, beyond = len(moved) - len(rows), [spoken(s.name) for s in moved if abs(s.share_of_tolerance) > 1.0]
    told = "Parameters of the nominal model as refitted to the records, the largest shifts first."
    told += f" The other {left} moved less." if left > 0 else ""
    told += f" Beyond the tolerance: {'; '.join(beyond)}." if beyond else ""
    headings = ("parameter", "nominal", "refitted", "share of its tolerance")
    return section("Nuisance parameters", Text(told if rows else ""), Table(headings, rows, (1, 2)))


def _noise(noise: Sequence[NoiseFound]) -> Section:
    rows = []
    for n in noise:
        unit, factor = unit_of(n.unit, n.deviation)
        size = with_unit(f"{n.deviation * factor:.3g}", unit) if np.isfinite(n.deviation) else UNDETERMINED
        source = n.source.replace("residual", "what the model leaves")
        rows.append(
            (spoken(n.channel), f"{n.rate:.5g} Hz", size, f"coloured, order {n.order}" if n.order else "white",
             source if n.verified else f"{source} (unverified)")
        )  # fmt: skip
    doubt = "Unverified noise may hide errors of the model: only repeats of a test tell them apart."
    told = doubt if any(not n.verified for n in noise) else ""
    headings = ("channel", "rate", "standard deviation", "kind", "found in")
    return section("Noise", Table(headings, rows, (1, 2)), Text(told))


def _limits(limits: Sequence[DetectionLimit]) -> Section:
    """What this session would have shown nine times in ten; what it is blind to."""
    seen, blind = [], []
    for limit in limits:
        if limit.amplitude is None or not np.isfinite(limit.amplitude):
            blind.append(spoken(limit.label))
            continue
        unit, factor = unit_of(limit.unit, limit.amplitude, limit.parameter)
        parameter = "" if limit.label.endswith(f":{limit.parameter}") else spoken(limit.parameter)
        seen.append((spoken(limit.label), parameter, with_unit(f"{limit.amplitude * factor:.3g}", unit)))
    told = (
        "The smallest amplitude that these records would have shown, nine times in ten, from where the effect vanishes."
        if seen
        else ""
    )
    blindness = f"Blind to: {'; '.join(blind)}." if blind else ""
    headings = ("effect", "parameter", "smallest amplitude")
    return section("What this session would have shown", Text(told), Table(headings, seen, (2,)), Text(blindness))


def _extended(diagnosis: Diagnosis) -> Section:
    refitted = "stated model" if _is_unfitted(diagnosis) else "refitted model"
    model = "extended model" if diagnosis.extension_offered else refitted
    return section(f"The {model}", Listing("extended.toml", f", which runs the {model}", diagnosis.extended_scenario))


def _is_unfitted(diagnosis: Diagnosis) -> bool:
    """Whether the records were told as another valve's or an oscillating one's, or their channels as misread, before
    anything was fitted."""
    return diagnosis.reason in TOLD_BEFORE_FIT and not diagnosis.shifts


def _what_to_do(diagnosis: Diagnosis) -> Section:
    """Part, inspection, confirmation and remedy of each answer, and of what the bench did."""
    rows = [(spoken(one.label), one.part, one.inspect, one.confirm, one.remedy) for one in diagnosis.what_to_do]
    return section("What to do", Table(("what", "part", "inspect", "to confirm", "remedy"), rows))
