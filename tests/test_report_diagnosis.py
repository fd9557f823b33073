"""The report of a diagnosis: every verdict has its page and pictures, with key figures, and no name becomes markup."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from valvesim import report_diagnosis
from valvesim.answer import (
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
)
from valvesim.errors import InputError
from valvesim.report import MOST_POINTS
from valvesim.report_diagnosis import draw, estimate_words, gain_words, spoken, worst_traces, write_report

FRICTION = Estimate(
    name="friction_force", cause="spool_coulomb_friction", value=2.013, low=1.87, high=2.16, unit="N", doc="friction force F"
)  # fmt: skip
PLAY = Estimate(
    name="half_play", cause="feedback_ball_backlash", value=4.2e-6, low=3.1e-6, high=5.3e-6, unit="m", doc="half the play"
)  # fmt: skip
COERCIVE = Estimate(
    name="coercive_current", cause="magnetic_hysteresis", value=2.1e-4, low=1.8e-4, high=2.4e-4, unit="A", doc="half width i_c"
)  # fmt: skip


def trace(channel="spool_position", record="sine 20 Hz", *, wrong=0.05, samples=1000, scale=4e-4, role="train", noise=4e-6):
    """A sine whose base model errs by a loop of `wrong` times its size; the extension is right."""
    t = np.arange(samples) * 1e-3
    dice = np.random.default_rng(len(channel) + len(record))
    truth = scale * np.sin(2 * np.pi * 3.0 * t)
    base = truth + wrong * scale * np.sign(np.cos(2 * np.pi * 3.0 * t)) * (1.0 + (t > 0.7 * t[-1]))
    unit = {"spool_position": "m", "load_flow": "m^3/s", "nozzle_pressure_1": "Pa"}[channel]
    return Trace(
        record=record, channel=channel, unit=unit, role=role, time=t, measured=truth + noise * dice.normal(size=samples),
        base=base, extended=truth, noise=noise,
    )  # fmt: skip


def empty(**changes):
    """A diagnosis with nothing in it but a verdict."""
    bare = Diagnosis(
        title="Valve 17", verdict="no_discrepancy", causes=(), summary="The model agrees with the records.", location="",
        candidates=(), parameters=(), gain=(), gain_claimed=False, detection_limits=(), next_test=None, term=None, shifts=(),
        noise=(), scores=(), alarm_level=np.inf, errors={}, notes=(), traces=(), extended_scenario="",
    )  # fmt: skip
    return replace(bare, **changes)


def no_discrepancy(**changes):
    """Nothing found, with all that is then known."""
    channels = ("spool_position", "load_flow")
    known = empty(
        summary="No discrepancy: what the model leaves on 4 records is noise, and the strongest of 64 candidates stays "
        "below the alarm.",
        detection_limits=(
            DetectionLimit(
                name="spool_coulomb_friction", label="Coulomb friction of the spool", parameter="friction_force",
                amplitude=0.312, unit="N",
            ),
            DetectionLimit(
                name="null_gap_asymmetry", label="null gap asymmetry", parameter="difference", amplitude=1.23e-6, unit="m"
            ),
            DetectionLimit(
                name="sensor_drift", label="drift of the spool sensor", parameter="drift", amplitude=2.5e-8, unit="m/K"
            ),
            DetectionLimit(
                name="magnet_demagnetization", label="loss of the magnets", parameter="loss", amplitude=0.0231, unit="1"
            ),
            DetectionLimit(
                name="coil_resistance_drift", label="drift of the coil resistance", parameter="share", amplitude=None,
                unit="1",
            ),
        ),
        shifts=(
            Shift(name="null_gap", unit="m", nominal=3.175e-5, value=3.212e-5, share_of_tolerance=0.58),
            Shift(name="supply_pressure", unit="Pa", nominal=2.1e7, value=2.08e7, share_of_tolerance=-0.95),
            Shift(name="sensor_gain@load_flow", unit="1", nominal=0.0, value=0.0012, share_of_tolerance=0.3),
        ),
        noise=tuple(
            NoiseFound(channel=name, rate=1000.0, deviation=size, unit=unit, order=order, verified=order > 0, source=source)
            for name, size, unit, order, source in zip(
                channels, (4e-6, 3.2e-6), ("m", "m^3/s"), (0, 2), ("residual", "repeats"), strict=True
            )
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
            CandidateAnswer(
                names=("spool_coulomb_friction",), label="Coulomb friction of the spool", location="spool force balance",
                probability=0.981, deviance_fall=412.3, estimates=(FRICTION,),
            ),
        ),
        parameters=(FRICTION,),
        gain=(
            Gain(record="locked sine", before=6.2, after=1.08, floor=1.0, change=-37.27, low=-41.0, high=-33.1, claimed=True),
            Gain(record="locked step", before=1.31, after=1.28, floor=1.0, change=-0.078, low=-0.2, high=0.05, claimed=False),
        ),
        gain_claimed=True,
        scores=(
            Score(label="Coulomb friction of the spool", z=20.3), Score(label="Stribeck friction of the spool", z=18.9),
            Score(label="backlash of the feedback ball", z=12.2), Score(label="parameter null gap", z=-4.1),
            *(Score(label=f"candidate {k}", z=3.0 - 0.4 * k) for k in range(10)),
        ),
        errors={
            "step 1": {"spool_position": 4.31, "load_flow": 2.2, "nozzle_pressure_1": 1.1},
            "sine 20 Hz": {"spool_position": 48.7, "load_flow": 12.4},
            "a slow staircase over the whole range of current, oil at 20 °C": {"spool_position": 812.0, "load_flow": 230.0},
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
        verdict="ambiguous", causes=(), parameters=(), location="feedback rod or magnetic circuit", gain_claimed=False,
        summary="Backlash of the feedback ball or magnetic hysteresis: these records cannot tell them apart.",
        candidates=(
            CandidateAnswer(
                names=("feedback_ball_backlash",), label="backlash of the feedback ball", location="feedback rod",
                probability=0.62, deviance_fall=120.4, estimates=(PLAY,), same_as=("sensor_bias@load_flow",),
            ),
            CandidateAnswer(
                names=("magnetic_hysteresis",), label="magnetic hysteresis", location="magnetic circuit", probability=0.38,
                deviance_fall=119.5, estimates=(COERCIVE,), same_as=("feedback_ball_backlash",),
            ),
        ),
        next_test=NextTest(
            description="Sine of 0.5 mA about 2 mA at 5 Hz", settings={"amplitude": "0.5 mA", "load_pressure": "70 bar"},
            duration=2.0, separates=("feedback_ball_backlash", "magnetic_hysteresis"), distance=11.7, power=0.994,
            alternatives=("repeat all four records (power 71 %)",),
        ),
    )  # fmt: skip
    return replace(found, **changes)


SPEEDS = np.linspace(-0.06, 0.06, 25)
TERM = Term(
    port="spool_force", port_unit="N", variable="spool_velocity", variable_unit="m/s", memory="without memory",
    at=tuple(SPEEDS), value=tuple(-1.5 * np.tanh(SPEEDS / 0.01)), deviation=tuple(0.05 + 2.0 * np.abs(SPEEDS)),
    formula="-1.5 tanh(spool_velocity/0.01)", formula_error=0.043,
)  # fmt: skip


def unknown(**changes):
    """No entry explains it; a term was recovered."""
    found = cause(
        verdict="unknown", causes=(), parameters=(), candidates=(), term=TERM, location="spool force balance",
        summary="No entry of the catalogue explains what the model gets wrong; a force on the spool over its velocity does.",
    )  # fmt: skip
    return replace(found, **changes)


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
        if self.open and self.open[-1] not in ("style",):
            self.words.append(data)
            if self.open[-1] == "h2":
                self.headings.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())


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
