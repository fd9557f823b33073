"""The answer of a diagnosis: verdict, causes, candidates, estimates, gain, limits and next test, as data and JSON."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.io import write_atomically
from valvesim.shown import Shown
from valvesim.valve.additive_term import LAG, PATH

NO_DISCREPANCY, CAUSE, AMBIGUOUS, UNKNOWN = "no_discrepancy", "cause", "ambiguous", "unknown"

BENCH, RECORDS_APART, OTHER_VALVE, MISREAD = "bench", "records_apart", "other_valve", "misread_channels"
CHANNEL_APART, OSCILLATES = "channel_apart", "oscillates"
"""Reasons of a verdict: the bench and not the valve, records that do not belong together, records that are not of the
stated valve, channels that are misread, one channel that does not go with the others, a valve that oscillates by
itself."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A figure with its 95 % interval, in `unit` (SI)."""

    name: str
    cause: str
    value: float
    low: float
    high: float
    unit: str
    doc: str = ""


@dataclass(frozen=True, kw_only=True)
class CandidateAnswer:
    """A hypothesis: the cause or the causes together, and how probable it is among all.

    `in_set` tells whether it explains the data nearly as well as the best. Without `names` it is noise alone.
    `deviance_fall` is NaN, null in JSON, where nothing was fitted (`OSCILLATES`): the probabilities are those before
    any record.
    """

    names: tuple[str, ...]
    label: str
    location: str
    probability: float
    deviance_fall: float
    in_set: bool = True


@dataclass(frozen=True, kw_only=True)
class WhatToDo:
    """What to do about one thing that an answer says (`label`): part, what to inspect, how to confirm, remedy."""

    label: str
    part: str
    inspect: str
    confirm: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What the extension gains on one hold-out record: root mean square errors in units of the noise, over all
    channels.

    `change` is after minus before of the mean square, with its 95 % interval; `claimed` where that is below zero.
    """

    record: str
    before: float
    after: float
    floor: float
    change: float
    low: float
    high: float
    claimed: bool


@dataclass(frozen=True, kw_only=True)
class DetectionLimit:
    """The smallest amplitude of an effect that this session would have shown, nine times in ten; None: it is blind.

    It is counted from the value at which the effect vanishes, and a parameter's from its nominal value.
    """

    name: str
    label: str
    parameter: str
    amplitude: float | None
    unit: str


NO_TEST = (
    "None of the tests that are thought of can be run with the likeliest and with what comes next: measure a further "
    "channel, or with less noise."
)
NEXT_AT_REST = (
    "Find the supply pressure below which the oscillation stops, the command at rest: records from there can be "
    "fitted, and tell more."
)
NOTHING_NEXT = "No test is proposed: nothing known comes next to the likeliest. Measure a further channel."


@dataclass(frozen=True, kw_only=True)
class NextTest:
    """The cheapest further test that tells candidates apart, and how surely (`power`).

    `inputs` are its columns (n,) in SI, temperatures in °C: time, current or voltage, oil_temperature, supply_pressure,
    load_pressure. JSON leaves them out. `uninformative` where it hardly tells them apart: then no test thought of does.
    """

    description: str
    settings: dict[str, str]
    duration: float
    separates: tuple[str, str]
    distance: float
    power: float
    alternatives: tuple[str, ...] = ()
    inputs: dict[str, np.ndarray] = field(default_factory=dict, compare=False)
    uninformative: bool = False


@dataclass(frozen=True, kw_only=True)
class Shift:
    """A nuisance parameter as refitted: nominal, refitted value, and its shift as a share of its tolerance."""

    name: str
    unit: str
    nominal: float
    value: float
    share_of_tolerance: float


@dataclass(frozen=True, kw_only=True)
class NoiseFound:
    """The noise of a channel: standard deviation in `unit`, order of its colour, where it was found."""

    channel: str
    rate: float
    deviation: float
    unit: str
    order: int
    verified: bool
    source: str


@dataclass(frozen=True, kw_only=True)
class Score:
    """How strongly one candidate shows in what the nominal model leaves (standard normal where nothing is hidden)."""

    label: str
    z: float


@dataclass(frozen=True, kw_only=True)
class Term:
    """A recovered term: what is added at `port` as a function of `variable`, (k,) each, with its standard deviation.

    `alike`: other places and variables, in words, of which a term would explain nearly as much.
    """

    port: str
    port_unit: str
    variable: str
    variable_unit: str
    memory: str
    at: tuple[float, ...]
    value: tuple[float, ...]
    deviation: tuple[float, ...]
    formula: str
    formula_error: float
    alike: tuple[str, ...] = ()

    def in_words(self) -> str:
        """Where it acts and what it depends on."""
        place, argument = (name.replace("_", " ") for name in (self.port, self.variable))
        remembered = {LAG: "lagged ", PATH: "direction of the "}.get(self.memory, "")
        return f"a term in the {place} that depends on the {remembered}{argument}"


@dataclass(frozen=True, kw_only=True)
class Trace:
    """A record for the pictures: measured, nominal and extended readings of one channel, (n,) each, in SI.

    Measured is NaN where there is no reading, or none that counts.
    """

    record: str
    channel: str
    unit: str
    role: str
    time: np.ndarray
    measured: np.ndarray
    base: np.ndarray
    extended: np.ndarray
    noise: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Diagnosis(Shown):
    """What the measured data show of the model's errors. `summary` says it in words.

    `what_to_do` is what to do about each cause of the answer set, or where none is named, and about the bench.
    `reason` is "" or why the verdict is not about a cause in the valve: `BENCH`, `RECORDS_APART`, `OTHER_VALVE`,
    `MISREAD`, `CHANNEL_APART` or `OSCILLATES`; `bench` is what the bench did, in words, whatever the verdict.

    `extended_scenario` holds the extension where `extension_offered`: where a gain is claimed, or no record was held
    out; else it is the nominal model's, refitted.
    """

    title: str
    verdict: str
    causes: tuple[str, ...]
    summary: str
    location: str
    candidates: tuple[CandidateAnswer, ...]
    parameters: tuple[Estimate, ...]
    gain: tuple[Gain, ...]
    gain_claimed: bool
    extension_offered: bool
    detection_limits: tuple[DetectionLimit, ...]
    next_test: NextTest | None
    term: Term | None
    shifts: tuple[Shift, ...]
    noise: tuple[NoiseFound, ...]
    scores: tuple[Score, ...]
    alarm_level: float
    errors: dict[
        str, dict[str, float]
    ]  # record -> channel -> root mean square error of the nominal model in noise deviations
    notes: tuple[str, ...]
    traces: tuple[Trace, ...]
    extended_scenario: str  # the text of a scenario file
    extended_effects: dict[str, str] = dataclasses.field(default_factory=dict)  # Python files that it names, by name
    extended_variant: Any = None  # the valve and its effects: prediction.Variant
    reason: str = ""
    bench: tuple[str, ...] = ()
    what_to_do: tuple[WhatToDo, ...] = ()

    def in_words(self) -> str:
        """Title, verdict and summary."""
        return f"{self.title!r}, {self.verdict.replace('_', ' ')}: {self.summary}"

    @property
    def no_test(self) -> str:
        """Why an ambiguous answer has no next test, in words; "" where it has one, or nothing is to be told apart."""
        if self.verdict != AMBIGUOUS or self.next_test is not None:
            return ""
        if self.reason == OSCILLATES:
            return NEXT_AT_REST
        known = [one for one in self.candidates if one.in_set and one.names != (UNKNOWN,)]
        return NO_TEST if len(known) > 1 else NOTHING_NEXT

    def to_dict(self) -> dict[str, Any]:
        """Everything but the traces, ready for JSON."""
        left_out = ("traces", "extended_variant", "extended_effects")
        names = [f.name for f in dataclasses.fields(self) if f.name not in left_out]
        table = {name: getattr(self, name) for name in names}
        table["extended_scenario"] = "extended.toml"
        plain = plain_json(table)
        if plain["next_test"] is not None:
            del plain["next_test"]["inputs"]
        return plain

    def to_json(self, path: str | Path) -> Path:
        """Write `diagnosis.json`."""
        text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"

        def write(temporary: Path) -> None:
            temporary.write_text(text, encoding="utf-8")

        return write_atomically(Path(path), write)


def plain_json(value: Any) -> Any:
    """Dataclasses, tuples and numbers of numpy as JSON knows them; what is not finite becomes null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain_json(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain_json(each) for key, each in value.items()}
    if isinstance(value, (tuple, list, np.ndarray)):
        return [plain_json(each) for each in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value
