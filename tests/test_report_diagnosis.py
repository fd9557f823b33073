"""The report of a diagnosis: every verdict has its page and pictures, with key figures, and no name becomes markup."""

import base64
import datetime
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from picture_texts import check_texts

from valvesim.diagnosis.result import (
    NO_TEST,
    NOTHING_NEXT,
    CandidateAnswer,
    DetectionLimit,
    Diagnosis,
    Estimate,
    Gain,
    NextTest,
    NoiseFound,
    Score,
    Shift,
    Term,
    Trace,
    WhatToDo,
)
from valvesim.errors import InputError
from valvesim.reports.diagnosis import page as diagnosis_page
from valvesim.reports.diagnosis.page import draw
from valvesim.reports.diagnosis.traces import worst_traces
from valvesim.reports.diagnosis.words import estimate_words, gain_words, number, percent, spoken, unit_of
from valvesim.reports.plotting import EXTENDED_COLOUR, MOST_POINTS

FRICTION = Estimate(
    name="friction_force", cause="spool_coulomb_friction", value=2.013, low=1.87, high=2.16, unit="N",
    doc="friction force F",
)  # fmt: skip
PLAY = Estimate(
    name="half_play", cause="feedback_ball_backlash", value=4.2e-6, low=3.1e-6, high=5.3e-6, unit="m",
    doc="half the play"
)  # fmt: skip


def trace(
    channel="spool_position", record="sine 20 Hz", *, wrong=0.05, samples=1000, scale=4e-4, role="train", noise=4e-6
):  # fmt: skip
    """A sine whose base model errs by a loop of `wrong` times its size; the extension is right."""
    t = np.arange(samples) * 1e-3
    dice = np.random.default_rng(len(channel) + len(record))
    truth = scale * np.sin(2 * np.pi * 3.0 * t)
    base = truth + wrong * scale * np.sign(np.cos(2 * np.pi * 3.0 * t)) * (1.0 + (t > 0.7 * t[-1]))
    unit = {"spool_position": "m", "load_flow": "m^3/s", "nozzle_pressure_1": "Pa"}[channel]
    return Trace(
        record=record, channel=channel, unit=unit, role=role, time=t, base=base, extended=truth, noise=noise,
        measured=truth + noise * dice.normal(size=samples),
    )  # fmt: skip


def limit(label, parameter, amplitude, unit):
    """What a session would have shown of a candidate."""
    return DetectionLimit(
        name=label.partition("@")[0], label=label, parameter=parameter, amplitude=amplitude, unit=unit
    )  # fmt: skip


def candidate(label, probability, fall, **changes):
    """A hypothesis that was fitted; its names are those of its label."""
    return replace(
        CandidateAnswer(
            names=tuple(label.split(" + ")), label=label, location="spool force balance", probability=probability,
            deviance_fall=fall,
        ),
        **changes,
    )  # fmt: skip


def empty(**changes):
    """A diagnosis with nothing in it but a verdict."""
    bare = Diagnosis(
        title="Valve 17", verdict="no_discrepancy", causes=(), summary="The model agrees with the records.",
        location="", candidates=(), parameters=(), gain=(), gain_claimed=False, extension_offered=False,
        detection_limits=(), next_test=None,
        term=None, shifts=(), noise=(), scores=(), alarm_level=np.inf, errors={}, notes=(), traces=(),
        extended_scenario="",
    )  # fmt: skip
    return replace(bare, **changes)


def no_discrepancy(**changes):
    """Nothing found, with all that is then known."""
    channels = ("spool_position", "load_flow")
    known = empty(
        summary="No discrepancy: what the model leaves on 4 records is noise, and the strongest of 64 candidates stays "
        "below the alarm.",
        detection_limits=(
            limit("spool_coulomb_friction", "friction_force", 0.312, "N"),
            limit("null_gap_asymmetry", "difference", 1.23e-6, "m"),
            limit("sensor_temperature_drift@spool_position", "drift", 2.5e-8, "m/K"),
            limit("magnet_demagnetization", "loss", 0.0231, "1"),
            limit("coil_resistance_drift", "share", None, "1"),
        ),
        shifts=(
            Shift(name="null_gap", unit="m", nominal=3.175e-5, value=3.212e-5, share_of_tolerance=0.58),
            Shift(name="supply_pressure", unit="Pa", nominal=2.1e7, value=2.08e7, share_of_tolerance=-0.95),
            Shift(name="sensor_gain@load_flow", unit="1", nominal=0.0, value=0.0012, share_of_tolerance=0.3),
        ),
        noise=(
            NoiseFound(
                channel="spool_position", rate=1e3, deviation=4e-6, unit="m", order=0, verified=False, source="residual"
            ),
            NoiseFound(
                channel="load_flow", rate=1e3, deviation=3.2e-6, unit="m^3/s", order=2, verified=True, source="repeats"
            ),
        ),
        scores=tuple(Score(label=f"candidate {k}", z=2.4 - 0.31 * k) for k in range(14)),
        alarm_level=3.46,
        errors={"step 1": dict.fromkeys(channels, 1.02), "sine 20 Hz": {"spool_position": 0.97}},
        notes=("record idle: nothing moves; left out",),
        traces=tuple(
            replace(one, extended=one.base) for one in (trace(wrong=0.0), trace("load_flow", wrong=0.0, scale=3e-4))
        ),
    )  # fmt: skip
    return replace(known, **changes)


def cause(**changes):
    """Friction, found and gained from."""
    found = no_discrepancy(
        verdict="cause", causes=("spool_coulomb_friction",), location="spool force balance",
        summary="Coulomb friction of the spool, 2.01 N (95 %: 1.87 to 2.16 N), explains what the model gets wrong.",
        candidates=(
            candidate("spool_coulomb_friction", 0.981, 412.3),
            candidate("feedback_ball_backlash + spool_lap", 0.012, 405.1, in_set=False, location="feedback rod"),
            candidate("none of the known causes", 0.007, 0.0, in_set=False, location="", names=("unknown",)),
        ),
        parameters=(FRICTION,),
        gain=(
            Gain(record="locked sine", before=6.2, after=1.08, floor=1.0, change=-37.27, low=-41.0, high=-33.1,
                 claimed=True),
            Gain(record="locked step", before=1.31, after=1.28, floor=1.0, change=-0.078, low=-0.2, high=0.05,
                 claimed=False),
        ),
        gain_claimed=True,
        extension_offered=True,
        scores=(
            Score(label="spool_coulomb_friction", z=20.3), Score(label="spool_stribeck_friction", z=18.9),
            Score(label="feedback_ball_backlash", z=12.2), Score(label="parameter:null_gap", z=-4.1),
            *(Score(label=f"candidate {k}", z=3.0 - 0.4 * k) for k in range(10)),
        ),
        errors={
            "step 1": {"spool_position": 4.31, "load_flow": 2.2, "nozzle_pressure_1": 1.1},
            "sine 20 Hz": {"spool_position": 48.7, "load_flow": 12.4},
            "a slow staircase over the whole range of current": {"spool_position": 812.0, "load_flow": 230.0},
        },
        traces=(
            trace(), trace("load_flow", scale=3e-4, wrong=0.03), trace(record="step 1", wrong=0.01),
            trace("nozzle_pressure_1", scale=5e6, wrong=0.02, noise=4e4, samples=9000, role="test"),
        ),
        extended_scenario='[effects.spool_coulomb_friction]\nfriction_force = "2.013 N"\n',
    )  # fmt: skip
    return replace(found, **changes)


def ambiguous(**changes):
    """Two that the data cannot tell apart, with the test that would."""
    found = cause(
        verdict="ambiguous", causes=(), parameters=(PLAY,), location="feedback rod or magnetic circuit",
        gain_claimed=False,
        extension_offered=True,
        summary="Backlash of the feedback ball or magnetic hysteresis: these records cannot tell them apart.",
        candidates=(
            candidate("feedback_ball_backlash", 0.58, 120.4, location="feedback rod"),
            candidate("spool_silting", 0.11, 101.0, in_set=False),
            candidate("magnetic_hysteresis", 0.31, 119.5, location="magnetic circuit"),
        ),
        next_test=NextTest(
            description="Sine of 0.5 mA about 2 mA at 5 Hz",
            settings={"amplitude": "0.5 mA", "load_pressure": "70 bar"},
            duration=2.0, separates=("feedback_ball_backlash", "magnetic_hysteresis"), distance=11.7, power=0.994,
            alternatives=("repeat all four records (power 71 %)",),
        ),
    )  # fmt: skip
    return replace(found, **changes)


SPEEDS = np.linspace(-0.06, 0.06, 25)
TERM = Term(
    port="spool_force", port_unit="N", variable="spool_velocity", variable_unit="m/s", memory="none",
    at=tuple(SPEEDS), value=tuple(-1.5 * np.tanh(SPEEDS / 0.01)), deviation=tuple(0.05 + 2.0 * np.abs(SPEEDS)),
    formula="-1.5 tanh(spool_velocity/0.01)", formula_error=0.043,
)  # fmt: skip


def unknown(**changes):
    """No entry explains it; a term was recovered."""
    found = cause(
        verdict="unknown", causes=(), parameters=(), candidates=(), term=TERM, location="spool force balance",
        summary="No entry of the catalogue explains what the model gets wrong; a force on the spool does.",
    )  # fmt: skip
    return replace(found, **changes)


BARE = {"errors": {}, "traces": (), "scores": ()}  # for tests of words: drawing takes a second
VERDICTS = {"no_discrepancy": no_discrepancy, "cause": cause, "ambiguous": ambiguous, "unknown": unknown}
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Reader(HTMLParser):
    """Text and tags of a page; every element must be closed where it stands."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.open, self.tags, self.sources, self.words, self.headings = [], [], [], [], []
        self.feed(page)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        names = [name for name, _ in attributes]
        assert len(names) == len(set(names)) and not any(name.startswith("on") for name in names)
        self.sources += [value for name, value in attributes if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.words.append(data)
            if self.open[-1] == "h2":
                self.headings.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


def write_report(diagnosis, folder):
    """As the command does, on a day that is given."""
    return diagnosis_page.write_report(diagnosis, folder, valve="reference valve", date=datetime.date(2026, 1, 2))


def report(diagnosis, folder):
    """The page of a diagnosis as read by a browser."""
    write_report(diagnosis, folder)
    return Reader((folder / "report.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module", params=list(VERDICTS))
def written(request, tmp_path_factory):
    """(verdict, folder, paths, page) of each verdict."""
    folder = tmp_path_factory.mktemp(request.param) / "new folder"
    paths = write_report(VERDICTS[request.param](), folder)
    return request.param, folder, paths, (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture
def drawn(monkeypatch):
    """The figures that are drawn, by no file: kept for a look."""
    figures = []

    def keep(function):
        return lambda diagnosis: figures.append(function(diagnosis)) or figures[-1]

    kept = {name: keep(draw) for name, draw in diagnosis_page.DIAGNOSIS_PICTURES.items()}
    monkeypatch.setattr(diagnosis_page, "DIAGNOSIS_PICTURES", kept)
    return Drawn(figures)


class Drawn:
    """The figures, without the empty ones."""

    def __init__(self, figures):
        self.figures = figures

    def __iter__(self):
        return (figure for figure in self.figures if figure is not None)

    def __getitem__(self, k):
        return list(self)[k]


# ---------------------------------------------------------------- files


EVERY = {"errors.png", "traces.png", "scores.png", "report.html"}
FILES = {
    "no_discrepancy": EVERY, "cause": EVERY | {"gain.png"}, "ambiguous": EVERY | {"gain.png"},
    "unknown": EVERY | {"gain.png", "term.png"},
}  # fmt: skip


def test_the_files_of_each_verdict_appear_and_no_others(written):
    verdict, folder, paths, _ = written
    assert {path.name for path in paths} == FILES[verdict] == {path.name for path in folder.iterdir()}
    assert paths[-1] == folder / "report.html"  # last, so that a page never stands beside pictures of another


def test_the_page_holds_the_very_pictures_that_lie_beside_it_and_needs_no_network(written):
    _, folder, paths, page = written
    reader = Reader(page)
    assert all(f'id="{source[1:]}"' in page for source in reader.sources if source.startswith("#"))
    pictures = [source for source in reader.sources if not source.startswith("#")]
    heads = [source.split(",")[0] for source in pictures]
    assert heads == ["data:image/png;base64"] * (len(paths) - 1)
    inside = {base64.b64decode(source.split(",")[1]) for source in pictures}
    assert inside == {path.read_bytes() for path in paths[:-1]}
    outside = re.sub(r"<script>.*?</script>", "", page, flags=re.DOTALL)  # uPlot names its home in a comment
    assert "http" not in outside and "url(" not in page and not {"link", "iframe"} & set(reader.tags)


def test_every_picture_has_contrast_and_size(written):
    from matplotlib.image import imread

    for path in written[2][:-1]:
        pixels = imread(path)
        assert pixels.shape[1] >= 700 and pixels.shape[0] >= 200 and np.ptp(pixels[..., :3]) > 0.5


def test_the_page_is_a_whole_html_document(written):
    page = written[3]
    reader = Reader(page)  # balanced tags
    assert page.startswith('<!DOCTYPE html>\n<html lang="en">') and 'charset="utf-8"' in page
    assert reader.tags[:2] == ["html", "head"] and reader.tags.count("title") == reader.tags.count("h1") == 1
    assert len(re.findall('<img alt="[^"]{20,}"', page)) == reader.tags.count("img")


def test_the_same_diagnosis_gives_the_same_files(tmp_path):
    first, second = (write_report(unknown(traces=()), tmp_path / name) for name in "ab")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match="file.*cannot be written"):
        write_report(cause(), tmp_path / "file")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_verdict_that_is_none_is_refused_with_the_nearest(tmp_path):
    with pytest.raises(InputError, match="diagnosis: unknown verdict 'unknwon'; did you mean 'unknown'?"):
        write_report(empty(verdict="unknwon"), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_interrupted_while_drawing_it_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(diagnosis):
        raise KeyboardInterrupt

    monkeypatch.setitem(diagnosis_page.DIAGNOSIS_PICTURES, "gain", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_report(cause(), tmp_path)
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- words and figures


SAID = {
    "no_discrepancy": (
        "Diagnosis: Valve 17", "No discrepancy found", "stays below the alarm.", "0.312 N", "1.23 µm", "0.025 µm/K",
        "2.31 %", "sensor temperature drift, spool position drift", "Blind to: coil resistance drift.",
        "unverified for 1 of 2 channels", "4 µm", "0.192 L/min",
        "white", "coloured, order 2", "repeats", "what the model leaves (unverified)", "210.0 bar 208.0 bar -95 %",
        "0.03175 mm 0.03212 mm +58 %", "sensor gain, load flow 0 % 0.12 % +30 %",
        "record idle: nothing moves; left out",
        "Simulation beside records",
    ),
    "cause": (
        "Cause found", "explains what the model gets wrong.", "Where spool force balance", "Probability 98 %",
        "better on 1 of 2 hold-out records",
        "spool coulomb friction friction force 2.01 N 1.87 to 2.16 N friction force F",
        "By name in diagnosis.json: spool_coulomb_friction.", "What was weighed",
        "spool coulomb friction 98 % possible spool force balance 412.3",
        "feedback ball backlash with spool lap 1 % less likely feedback rod 405.1",
        "none of the known causes 1 % less likely",
        "locked sine 6.20 1.08 1.00 -97 % (-107 to -86 %) better: over 99 % of the error",
        "locked step 1.31 1.28 1.00 -5 % (-12 to 3 %) not claimed: the interval of the change includes zero",
        '[effects.spool_coulomb_friction] friction_force = "2.013 N"', "What the simulation gets wrong",
    ),
    "ambiguous": (
        "Several answers possible", "cannot tell them apart", "The data cannot tell the possible ones apart.",
        "If it is the likeliest", "feedback ball backlash half play 4.2 µm 3.1 to 5.3 µm half the play",
        "feedback ball backlash 58 % possible feedback rod 120.4 "
        "magnetic hysteresis 31 % possible magnetic circuit 119.5 spool silting 11 % less likely",
        "Next test Sine of 0.5 mA about 2 mA at 5 Hz", "load pressure 70 bar", "takes 2 s and would tell feedback ball "
        "backlash from magnetic hysteresis with a probability of 99 %", "distance 11.7 noise deviations",
        "Instead of it: repeat all four records (power 71 %).", "Gain none claimed",
        "No gain is claimed over all hold-out",
        "the more it falls, the more a candidate explains",
    ),
    "unknown": (
        "Unknown mechanism", "No entry of the catalogue explains", "The missing term", "Added to spool force [N]",
        "As a function of spool velocity", "Visited -60 to 60 mm/s", "Memory none",
        "Formula, in SI units -1.5 tanh(spool_velocity/0.01)", "Formula off by 4 %",
    ),
}  # fmt: skip


def test_key_figures_stand_on_the_page_with_their_units(written):
    verdict, _, _, page = written
    text = Reader(page).text
    for words in SAID[verdict]:
        assert words in text


def test_the_page_reads_top_down(written):
    order = [
        "Cause", "What was weighed", "Possible causes", "If it is the likeliest", "Next test",
        "Gain of the extended model", "The missing term",
        "What the simulation gets wrong", "Simulation beside records", "How strongly each candidate shows",
        "Nuisance parameters", "Noise", "What this session would have shown", "Notes", "The extended model", "Words",
    ]  # fmt: skip
    headings = Reader(written[3]).headings
    assert len(headings) >= 7 and headings == [heading for heading in order if heading in headings]


def test_nothing_on_the_page_is_the_word_of_a_machine(written):
    text = Reader(written[3]).text
    assert not re.search(r"\b(nan|NaN|inf|None|True|False|np)\b", text)


def test_an_empty_diagnosis_is_a_verdict_and_nothing_else(tmp_path):
    page = report(empty(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert page.headings == [] and not {"table", "ul", "figure", "section"} & set(page.tags)
    assert page.tags.count("dl") == 1  # what the page was made by
    assert "No discrepancy found The model agrees with the records. Made by" in page.text


def test_what_is_not_finite_is_said_in_words(tmp_path):
    nan = np.nan
    lost = cause(
        parameters=(replace(FRICTION, value=nan, low=nan, high=nan), replace(PLAY, low=nan),
            replace(PLAY, high=np.inf)),
        gain=(
            Gain(record="a", before=2.0, after=nan, floor=1.0, change=nan, low=nan, high=nan, claimed=False),
            Gain(record="b", before=0.0, after=1.0, floor=nan, change=1.0, low=0.5, high=1.5, claimed=True),
        ),
        detection_limits=(limit("the_unseen", "share", np.inf, "1"),),
        candidates=(
            candidate("one", nan, np.inf), candidate("two", 0.5, 1.0),
        ),
        term=replace(TERM, at=(), value=(), deviation=(), formula="", formula_error=nan),
        next_test=replace(ambiguous().next_test, duration=nan, distance=nan, power=nan), alarm_level=np.inf,
        errors={"a": {"load_flow": nan}}, scores=(Score(label="one", z=nan),),
        shifts=(Shift(name="null_gap", unit="m", nominal=1.0, value=nan, share_of_tolerance=0.5),),
        noise=(
            NoiseFound(channel="load_flow", rate=1e3, deviation=nan, unit="m^3/s", order=0, verified=False,
                source="residual"),
        ),
    )  # fmt: skip
    page = report(lost, tmp_path)
    assert not re.search(r"\bnan\b|\binf\b|None", page.text)
    for words in (
        "friction force not determined not determined", "below 5.3 µm", "above 3.1 µm",
        "a 2.00 not determined 1.00 not determined not claimed: the interval of the change is not determined",
        "It would tell feedback ball backlash from magnetic hysteresis.",
        "Blind to: the unseen.", "one not determined", "none holds up", "load flow 1000 Hz not determined",
    ):  # fmt: skip
        assert words in page.text
    assert "Nuisance parameters" not in page.headings
    assert {path.name for path in tmp_path.iterdir()} == {"report.html", "traces.png"}


HOSTILE = "<script>alert('a & b')</script>\"x\" $\\frac{1$ " + "long " * 20


def test_a_hostile_name_stays_text_wherever_it_stands(tmp_path):
    d = ambiguous(term=replace(TERM, port=HOSTILE, variable=HOSTILE, memory=HOSTILE, formula=HOSTILE))
    estimate = replace(FRICTION, name=HOSTILE, cause=HOSTILE, unit="N", doc=HOSTILE)
    candidates = tuple(replace(c, label=HOSTILE, location=HOSTILE) for c in d.candidates)
    test = replace(
        d.next_test, description=HOSTILE, settings={HOSTILE: HOSTILE}, separates=(HOSTILE, HOSTILE),
        alternatives=(HOSTILE,)
    )  # fmt: skip
    d = replace(
        d, title=HOSTILE, summary=HOSTILE, location=HOSTILE, causes=(HOSTILE,), parameters=(estimate,),
        candidates=candidates,
        gain=tuple(replace(g, record=HOSTILE) for g in d.gain), next_test=test, notes=(HOSTILE,),
        extended_scenario=HOSTILE,
        detection_limits=tuple(replace(one, label=HOSTILE, parameter=HOSTILE) for one in d.detection_limits),
        shifts=tuple(replace(s, name=HOSTILE) for s in d.shifts),
        scores=tuple(replace(s, label=HOSTILE) for s in d.scores),
        noise=tuple(replace(n, channel=HOSTILE, source=HOSTILE) for n in d.noise),
        errors={HOSTILE: {HOSTILE: 5.0}}, traces=tuple(replace(t, record=HOSTILE, channel=HOSTILE) for t in d.traces),
    )  # fmt: skip
    page = report(d, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.tags.count("script") == text.count("<script") == 1 + text.count('<figure class="chart">')  # our own
    assert page.text.count("<script>alert('a & b')</script>\"x\"") >= 25
    assert "<script>alert" not in text
    assert len(list(tmp_path.glob("*.png"))) == 5


def test_two_causes_are_both_named_one_without_figures(tmp_path):
    page = report(cause(causes=("spool_coulomb_friction", "spool_lap"), **BARE), tmp_path)
    assert "Causes found" in page.text and "Causes" in page.headings
    assert "friction force F spool lap By name" in page.text


def test_a_sensor_is_named_once_with_its_channel(tmp_path):
    bias = replace(PLAY, name="bias", cause="sensor_bias@load_flow")
    page = report(empty(verdict="cause", causes=("sensor_bias",), parameters=(bias,)), tmp_path)
    assert "sensor bias, load flow bias 4.2 µm" in page.text and page.text.count("sensor bias") == 1


def test_without_locked_records_it_says_why_no_gain_is_claimed(tmp_path):
    page = report(cause(gain=(), gain_claimed=False, **BARE), tmp_path)
    assert "No gain is claimed: there is no hold-out record" in page.text and "Gain none claimed" in page.text
    assert not (tmp_path / "gain.png").exists()


def test_a_record_on_which_nothing_changes_has_a_change_of_zero(tmp_path):
    still = gain(record="still", change=0.0, low=0.0, high=0.0, claimed=False)
    text = report(cause(gain=(gain(), still), **BARE), tmp_path).text
    assert " 0 % (0 to 0 %) not claimed" in text and "held fixed" not in text


def test_where_nothing_extends_the_model_no_gain_is_drawn(tmp_path):
    same = (gain(before=2.0, after=2.0, change=0.0, low=0.0, high=0.0, claimed=False),)
    page = report(unknown(gain=same, gain_claimed=False, term=None, **BARE), tmp_path / "unknown")
    assert "No gain is claimed: nothing was found to extend the model with." in page.text
    page = report(no_discrepancy(gain=same, **BARE), tmp_path / "nothing")
    assert "gain of the extended" not in page.text.lower() and "claimed" not in page.text
    assert not list(tmp_path.glob("*/gain.png"))


def test_noise_from_repeats_alone_is_told_as_known(tmp_path):
    noise = [one for one in cause().noise if one.verified]
    page = report(cause(noise=tuple(noise), **BARE), tmp_path)
    assert "known from repeats" in page.text and "unverified" not in page.text.lower()


def test_of_many_shifts_the_largest_are_shown(tmp_path):
    one = Shift(name="", unit="m", nominal=1e-3, value=1.1e-3, share_of_tolerance=0.0)
    shifts = tuple(replace(one, name=f"p_{k}", share_of_tolerance=0.01 * k) for k in range(12))
    text = report(empty(shifts=shifts), tmp_path).text
    assert text.index("p 11 ") < text.index("p 10 ") < text.index("p 4 ") and "p 3 " not in text
    assert "The other 4 moved less." in text and "Beyond the tolerance" not in text


def test_the_scenario_is_that_of_the_refitted_model_where_nothing_extends_it(tmp_path):
    scenario = "title = 'refitted'"
    page = report(empty(extended_scenario=scenario), tmp_path)
    assert page.headings == ["The refitted model"] and scenario in page.text
    extended = report(empty(extended_scenario=scenario, extension_offered=True), tmp_path)
    assert "The extended model" in extended.headings


def test_shifts_beyond_their_tolerance_are_named(tmp_path):
    first, second, third = no_discrepancy().shifts
    text = report(empty(shifts=(replace(first, share_of_tolerance=-1.2), second, third)), tmp_path).text
    assert "Beyond the tolerance: null gap." in text


def test_a_cause_with_several_figures_is_named_once_and_a_large_deviance_without_decimals(tmp_path):
    share = replace(FRICTION, name="kinetic_share", value=0.6, low=0.5, high=0.7, unit="1", doc="left at speed")
    large = (candidate("spool_coulomb_friction", 0.9, 560478.13), candidate("spool_lap", 0.1, 12.34, in_set=False))
    text = report(cause(parameters=(FRICTION, share), candidates=large, **BARE), tmp_path).text
    assert "friction force F kinetic share 60 % 50 to 70 % left at speed By name" in text
    assert "balance 560478 spool lap" in text and "balance 12.3" in text


def test_where_no_test_tells_them_apart_the_page_says_so(tmp_path):
    assert NO_TEST in report(ambiguous(next_test=None), tmp_path).text
    hopeless = report(
        ambiguous(next_test=replace(ambiguous().next_test, power=0.002, uninformative=True)), tmp_path
    ).text
    assert "No test that was thought of tells feedback ball backlash from magnetic hysteresis." in hopeless
    assert "This one, which takes 2 s and shows most, would do so with a probability of under 1 %" in hopeless
    likeliest = ambiguous(next_test=None).candidates[:1]
    assert NOTHING_NEXT in report(ambiguous(next_test=None, candidates=likeliest), tmp_path).text
    assert "Next test" not in report(cause(next_test=None), tmp_path).headings


def test_one_candidate_alone_is_not_weighed(tmp_path):
    only = cause().candidates[0]
    assert "What was weighed" not in report(cause(candidates=(only,), **BARE), tmp_path).headings


@pytest.mark.parametrize(
    "changes, value, interval",
    [
        ({}, "2.01 N", "1.87 to 2.16 N"),
        ({"unit": "Pa", "value": 2e5, "low": 1e5, "high": 3e5}, "2.0 bar", "1.0 to 3.0 bar"),
        ({"unit": "m^3/s", "value": 1e-5, "low": 9e-6, "high": 1.1e-5}, "0.600 L/min", "0.540 to 0.660 L/min"),
        ({"unit": "s", "value": 2e-3, "low": 1e-3, "high": 3e-3}, "2.0 ms", "1.0 to 3.0 ms"),
        ({"unit": "s", "value": 20.0, "low": 10.0, "high": 30.0}, "20 s", "10 to 30 s"),
        ({"unit": "1", "name": "clogged_share", "value": 0.1, "low": 0.08, "high": 0.12}, "10.0 %", "8.0 to 12.0 %"),
        ({"unit": "1", "name": "viscosity_factor", "value": 1.3, "low": 1.2, "high": 1.4}, "1.30", "1.20 to 1.40"),
        ({"unit": "Pa/K", "value": 1e4, "low": 9e3, "high": 1.1e4}, "0.100 bar/K", "0.090 to 0.110 bar/K"),
        ({"unit": "degC", "value": 20.0, "low": 19.0, "high": 21.0}, "20.0 °C", "19.0 to 21.0 °C"),
        ({"unit": "N/m", "value": 7.45e6, "low": 7e6, "high": 8e6}, "7.45e+06 N/m", "7e+06 to 8e+06 N/m"),
        ({"low": 2.013, "high": 2.013}, "2.013 N", "held fixed"),
        ({"low": -np.inf, "high": np.inf}, "2.013 N", "not determined"),
    ],
)  # fmt: skip
def test_an_estimate_reads_in_usual_units_to_the_digits_of_its_interval(changes, value, interval):
    assert estimate_words(replace(FRICTION, **changes)) == (value, interval)


def gain(**changes):
    return replace(
        Gain(record="r", before=3.0, after=1.0, floor=1.0, change=-8.0, low=-9.0, high=-7.0, claimed=True), **changes
    )  # fmt: skip


@pytest.mark.parametrize(
    "changes, words",
    [
        ({}, "better: 100 % of the error above the noise gone"),
        ({"after": 2.0}, "better: 62 % of the error above the noise gone"),
        ({"before": 1.0, "after": 0.9}, "better"),
        ({"claimed": False}, "not claimed: better, but too little to be worth having"),
        ({"claimed": False, "high": 0.0}, "not claimed: the interval of the change includes zero"),
        ({"claimed": False, "low": 1.0, "high": 2.0}, "not claimed: the extended model is worse here"),
        ({"claimed": False, "low": -np.inf}, "not claimed: the interval of the change is not determined"),
    ],
)
def test_a_gain_says_what_it_amounts_to_or_why_it_is_not_claimed(changes, words):
    assert gain_words(gain(**changes)) == words


@pytest.mark.parametrize(
    "share, words",
    [(0.0, "0 %"), (0.001, "under 1 %"), (0.62, "62 %"), (0.9949, "99 %"), (0.9999, "over 99 %"), (1.0, "100 %")],
)
def test_a_probability_is_never_rounded_to_certainty(share, words):
    assert percent(share) == words


def test_a_name_is_spoken():
    assert spoken("sensor_bias@load_flow") == "sensor bias, load flow"
    assert spoken("fixed_orifice_clogging[side=2]") == "fixed orifice clogging, side 2"
    assert spoken("spool_lap + sensor_gain@load_flow") == "spool lap with sensor gain, load flow"
    assert spoken("parameter:null_gap") == "parameter null gap"


# ---------------------------------------------------------------- pictures


def of(figures, label):
    """The axes one of whose labels, or whose title, starts so."""
    axes = [axis for figure in figures for axis in figure.axes]
    texts = [(axis.get_ylabel(), axis.get_xlabel(), axis.get_title("left")) for axis in axes]
    (axis,) = (axis for axis, own in zip(axes, texts, strict=True) if any(text.startswith(label) for text in own))
    return axis


def test_the_heat_map_shows_each_record_and_channel_in_noise_deviations(drawn):
    draw(empty(errors=cause().errors))
    axis = of(drawn, "error of the nominal model in noise deviations")
    assert [t.get_text() for t in axis.texts] == ["4.3", "2.2", "1.1", "48.7", "12.4", "–", "812", "230", "–"]
    assert [t.get_text() for t in axis.get_xticklabels()] == ["spool\nposition", "load flow", "nozzle\npressure 1"]
    names = [t.get_text() for t in axis.get_yticklabels()]
    assert names[:2] == ["step 1", "sine 20 Hz"] and names[2].startswith("a slow staircase") and names[2].endswith("…")


def test_the_heat_map_of_many_records_keeps_the_worst_in_their_order(drawn):
    draw(empty(errors={f"r{k}": {"load_flow": 1.0 + k % 7 + 0.01 * k} for k in range(60)}))
    axis = of(drawn, "error of the nominal model")
    assert "(24 worst of 60 records)" in axis.get_title("left")
    shown = [int(t.get_text()[1:]) for t in axis.get_yticklabels()]
    assert shown == sorted(shown) and len(shown) == 24 and 6 in shown and 0 not in shown


def test_traces_show_measured_base_and_extended_in_readable_units_with_the_noise_band(drawn):
    one = trace()
    draw(empty(traces=(one,)))
    top, below = of(drawn, "spool position [mm]"), of(drawn, "residual [mm]")
    for line, values in zip(top.lines, (one.measured, one.base, one.extended), strict=True):
        assert line.get_ydata() == pytest.approx(1e3 * values)
    base, extended, low, high = below.lines
    assert base.get_ydata() == pytest.approx(1e3 * (one.measured - one.base))
    assert extended.get_ydata() == pytest.approx(1e3 * (one.measured - one.extended))
    assert (low.get_ydata()[0], high.get_ydata()[0]) == pytest.approx((-8e-3, 8e-3))
    assert top.get_title("left") == "sine 20 Hz"


def test_an_extension_that_changes_nothing_is_not_drawn(drawn):
    one = trace()
    draw(empty(traces=(replace(one, extended=one.base),)))
    draw(empty(traces=(replace(one, extended=np.zeros(0)),)))
    assert [len(figure.axes[0].lines) for figure in drawn] == [2, 2]
    assert [t.get_text() for t in drawn[0].legends[0].texts] == ["measured", "nominal model", "±2 noise deviations"]


def test_of_a_long_record_the_stretch_that_errs_most_is_enlarged(drawn):
    one = trace(samples=9000, wrong=0.0, role="test")
    bad = slice(5000, 5600)
    base = one.base.copy()
    base[bad] += 1e-4
    draw(empty(traces=(replace(one, base=base),)))
    top, below = drawn[0].axes
    t = top.lines[0].get_xdata()
    assert len(t) == MOST_POINTS and t[0] <= one.time[bad][0] and t[-1] >= one.time[bad][-1]
    assert below.lines[0].get_xdata()[-1] == one.time[-1] and len(below.lines[0].get_xdata()) <= MOST_POINTS + 1
    assert top.get_title("left") == "sine 20 Hz, hold-out"
    assert "stretch shown above" in [text.get_text() for text in drawn[0].legends[0].texts]


def test_the_worst_trace_of_each_channel_comes_before_a_second_of_one():
    mild, worse, worst = (trace(record=f"r{k}", wrong=wrong) for k, wrong in enumerate((0.01, 0.1, 0.2)))
    other = trace("load_flow", wrong=0.003, scale=3e-4)
    third = trace("nozzle_pressure_1", wrong=0.001, scale=5e6, noise=4e4)
    silent = replace(trace(record="silent", wrong=5.0), noise=0.0)
    single = replace(worst, record="single", time=worst.time[:1])
    shown = worst_traces((single, silent, mild, other, worst, worse))
    assert [(one.record, one.channel) for one in shown] == [
        ("r2", "spool_position"), ("r1", "spool_position"), ("sine 20 Hz", "load_flow"),
    ]  # fmt: skip
    assert {one.channel for one in worst_traces((mild, worse, worst, other, third))} == {
        "spool_position", "load_flow", "nozzle_pressure_1",
    }  # fmt: skip


def test_a_gap_in_a_trace_is_no_error():
    one = trace(wrong=0.01)
    measured = one.measured.copy()
    measured[::2] = np.nan
    holes = replace(trace(record="holes", wrong=0.1), measured=measured)
    assert [t.record for t in worst_traces((one, holes))] == ["holes", "sine 20 Hz"]


def test_scores_are_bars_with_the_alarm_level_and_the_answer_in_colour(drawn):
    draw(cause(errors={}, traces=(), gain=()))
    axis = of(drawn, "|z|")
    assert [bar.get_width() for bar in axis.patches] == sorted((bar.get_width() for bar in axis.patches), reverse=True)
    assert len(axis.patches) == 12 and axis.patches[0].get_width() == pytest.approx(20.3)
    assert axis.patches[3].get_width() == pytest.approx(4.1) and "-4.1" in [t.get_text() for t in axis.texts]
    colours = [bar.get_facecolor() for bar in axis.patches]
    assert colours[0] != colours[1] and len(set(colours[1:])) == 1
    assert [line.get_xdata()[0] for line in axis.lines] == [3.46]
    assert [t.get_text() for t in drawn[0].legends[0].texts] == ["alarm level 3.46"]


def test_of_an_unknown_mechanism_no_candidate_is_coloured(drawn):
    draw(unknown(candidates=cause().candidates, errors={}, traces=(), gain=(), term=None))
    axis = of(drawn, "|z|")
    assert len({bar.get_facecolor() for bar in axis.patches}) == 1
    assert axis.get_yticklabels()[0].get_text() == "spool coulomb friction"


def test_without_an_alarm_level_no_line_is_drawn_and_the_page_says_so(drawn, tmp_path):
    page = report(empty(scores=(Score(label="one", z=0.3),)), tmp_path)
    assert not of(drawn, "|z|").lines and "set an alarm level" in page.text


def test_the_gain_is_drawn_beside_the_noise_floor_hollow_where_it_is_not_claimed(drawn):
    draw(empty(gain=cause().gain))
    errors, changes = of(drawn, "error [noise deviations]"), of(drawn, "change of the mean square [%]")
    labels = [t.get_text() for t in errors.get_yticklabels()]
    assert labels == ["locked sine", "locked step\n(not claimed)"]
    after = [line for line in errors.lines if line.get_label() == "extended model"]
    assert [line.get_xdata()[0] for line in after] == [1.08, 1.28]
    assert [line.get_markerfacecolor() for line in after] == [EXTENDED_COLOUR, "w"]
    floors = [line.get_xdata()[0] for line in errors.lines if line.get_label() == "noise floor"]
    assert floors == [1.0, 1.0]
    intervals = [line.get_xdata() for line in changes.lines if line.get_label() == "95 % interval"]
    assert intervals[0] == pytest.approx([-4100 / 6.2**2, -3310 / 6.2**2])
    legend = [t.get_text() for t in drawn[0].legends[0].texts]
    assert legend == ["noise floor", "nominal model", "extended model", "95 % interval"]


def test_a_term_is_drawn_over_its_variable_with_band_and_formula(drawn):
    shuffled = replace(TERM, **{name: getattr(TERM, name)[::-1] for name in ("at", "value", "deviation")})
    draw(empty(term=shuffled))
    axis = of(drawn, "added to spool force [N]")
    line = next(line for line in axis.lines if line.get_label() == "recovered term")
    assert line.get_xdata() == pytest.approx(1e3 * SPEEDS) and line.get_ydata() == pytest.approx(TERM.value)
    assert axis.get_xlabel() == "spool velocity [mm/s]" and "tanh" in axis.get_title("left")
    band = axis.collections[0].get_datalim(axis.transData)
    assert band.ymax == pytest.approx(max(np.add(TERM.value, 2.0 * np.array(TERM.deviation))), rel=1e-3)


def test_a_term_without_formula_is_drawn_as_what_it_is(drawn, tmp_path):
    page = report(empty(verdict="unknown", term=replace(TERM, formula="")), tmp_path)
    assert of(drawn, "added to").get_title("left") == "recovered term" and "none holds up" in page.text
    assert "Formula off by" not in page.text


@pytest.mark.parametrize("verdict", list(VERDICTS))
def test_the_texts_of_every_picture_are_plain_and_inside_it(verdict):
    for figure in draw(VERDICTS[verdict]()).values():
        check_texts(figure)


def test_the_page_carries_title_version_valve_and_date(tmp_path):
    assert "Diagnosis: Valve 17 reference valve · valvesim " in (text := report(empty(), tmp_path).text)
    assert " · 2026-01-02 No discrepancy found" in text


def test_the_page_ends_with_what_to_do_and_what_the_bench_did(tmp_path):
    todo = WhatToDo(label="spool_lap", part="lands", inspect="edges", confirm="flow about null", remedy="another spool")
    bench = replace(todo, label="the supply pressure ripples by 3 bar at 37 Hz", part="pump")
    found = replace(cause(), what_to_do=(todo, bench), bench=(bench.label,))
    report(found, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    for said in ("What to do", "lands", "flow about null", "another spool", bench.label, "pump"):
        assert said in text
    report(cause(), tmp_path)
    assert "What to do" not in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("reason, verdict, words", [
    ("bench", "no_discrepancy", "The bench, not the valve"), ("other_valve", "unknown", "Not the stated valve"),
    ("records_apart", "unknown", "Records that do not belong together"),
])  # fmt: skip
def test_the_banner_says_what_the_answer_is_about(reason, verdict, words):
    assert diagnosis_page.banner(empty(verdict=verdict, reason=reason)).words == words


def test_numbers_are_read_without_dead_zeros():
    assert (number(-0.3, 10.0), number(-0.3, 0.1)) == ("0", "-0.30")
    assert unit_of("m", 2e-7) == ("µm", 1e6) and unit_of("m", 2e-3)[0] == "mm"
    assert [unit_of("N*m", size)[0] for size in (1e-5, 2e-3, 2.0)] == ["µN·m", "mN·m", "N·m"]
    assert unit_of("A", 3e3) == ("A", 1.0) and unit_of("A", 1e-3)[0] == "mA" and unit_of("1/K", 1e-5) == ("1e-6/K", 1e6)
