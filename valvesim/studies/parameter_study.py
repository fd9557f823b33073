"""A parameter study: a base case, what varies, how members are drawn, and what is kept of each."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass
from typing import Any

import numpy as np

from valvesim.channels import Channel
from valvesim.characterisation.position_loop import PositionLoop, loop_channels
from valvesim.characterisation.specification import Specification
from valvesim.errors import InputError, unknown_name
from valvesim.io import check_printable
from valvesim.simulation.result import output_channels
from valvesim.studies.criteria import FigureLimit
from valvesim.studies.designs import Design
from valvesim.studies.distributions import OptionChoice
from valvesim.studies.figures import OwnFigures, check_families
from valvesim.studies.variables import Case, Varied, apply, scenario_of

MOST_BLOCK = 10_000  # members of a block: some 100 tasks of a million
LEAST_BLOCKS = 64  # where there are as many members: work for as many processes, and little is lost to a kill
MOST_WHOLE = 10_000  # members whose whole channels are kept


@dataclass(frozen=True, kw_only=True)
class ChannelPercentiles:
    """Percentiles over the members of channels over time: `levels` in %, at `points` times from `start` to `end` (s).

    What swings faster than the points stand is not seen as it is: a window of the run shows it.
    """

    channels: tuple[str, ...]
    levels: tuple[float, ...] = (1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0)
    points: int = 101
    start: float = 0.0
    end: float = float("inf")

    def __post_init__(self):
        if not self.channels:
            raise InputError("names no channel", key="percentiles.channels", joint=" ")
        if not 0.0 <= self.start < self.end:
            problem = f"{self.start:g} s must be before the end of {self.end:g} s"
            raise InputError(problem, key="percentiles.start", joint=" = ")
        if not self.levels or any(not 0.0 <= level <= 100.0 for level in self.levels):
            raise InputError(f"{self.levels} must be within 0 and 100", key="percentiles.levels", joint=" = ")
        if not 2 <= self.points <= 2000:
            raise InputError(f"{self.points} must be within 2 and 2000", key="percentiles.points", joint=" = ")


@dataclass(frozen=True, kw_only=True)
class WholeChannels:
    """Whole channels that are kept of a few members, by their numbers."""

    members: tuple[int, ...]
    channels: tuple[str, ...]

    def __post_init__(self):
        if not self.members or not self.channels:
            problem = "names no member" if self.channels else "names no channel"
            raise InputError(problem, key=f"whole.{'members' if self.channels else 'channels'}", joint=" ")


@dataclass(frozen=True, kw_only=True)
class FigureOptions:
    """What the figures of merit are taken from: runs from `start` (s) on, benches at a temperature (°C) and points,
    and `functions` of one's own.
    """

    start: float = 0.0
    bench_temperature: float = 20.0
    bench_points: int = 2000
    functions: tuple[OwnFigures, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ParameterStudy:
    """A study: `case` with its nominal values, the `variables` drawn by `design`, and what is `keep`-t of each member.

    `keep` are names of figures of merit, see `figures`; `block` members run as one task (None: by their number).
    `limits` and `specification` judge what is kept, and may change when the members have run.
    Raises InputError for what makes no sense together.
    """

    title: str = "study"
    case: Case
    variables: tuple[Varied, ...]
    design: Design = Design()
    keep: tuple[str, ...]
    options: FigureOptions = FigureOptions()
    percentiles: ChannelPercentiles | None = None
    whole: WholeChannels | None = None
    block: int | None = None
    limits: tuple[FigureLimit, ...] = ()
    specification: Specification | None = None

    def __post_init__(self):
        check_printable(self.title, "title")
        if not self.variables:
            raise InputError("nothing varies: give quantities, or tolerances = true", key="vary")
        keys = [variable.key for variable in self.variables]
        for key in keys:
            if keys.count(key) > 1:
                raise InputError("varies twice", key=f"vary.{key}", joint=" ")
        whole = [v.key for v in self.variables if isinstance(v.distribution, OptionChoice)]
        for key in keys:
            for other in whole:
                if key.startswith(f"{other}."):
                    raise InputError(f"{other} is a choice as a whole", key=f"vary.{key}")
        if not self.keep:
            raise InputError("nothing is kept: name figures of merit", key="figures.keep")
        check_families(self.keep)
        if self.design.rows is not None:
            self._check_rows(self.design.rows)
        if self.block is not None and self.block < 1:
            raise InputError(f"{self.block} must be 1 or more", key="block", joint=" = ")
        self._check_channels()
        if not 0.0 <= self.options.start < scenario_of(self.case).duration:
            problem = f"{self.options.start:g} s must be before the end of the run"
            raise InputError(problem, key="figures.start", joint=" = ")
        if not 100 <= self.options.bench_points <= 100_000:
            problem = f"{self.options.bench_points} must be within 100 and 100000"
            raise InputError(problem, key="figures.bench_points", joint=" = ")

    def _check_rows(self, rows: np.ndarray) -> None:
        """InputError for a table that does not fit, with the first row that leaves the bounds of a quantity."""
        if rows.shape != (self.design.members, len(self.variables)):
            problem = f"{rows.shape} is no table of {self.design.members} members and {len(self.variables)} quantities"
            raise InputError(problem, key="design.table")
        for k, variable in enumerate(self.variables):
            low, high = variable.quantity.bounds
            outside = np.flatnonzero(~((rows[:, k] >= low) & (rows[:, k] <= high)))
            if len(outside):
                member = int(outside[0])
                problem = f"{rows[member, k]:.6g} of member {member} is outside [{low:.6g}, {high:.6g}]"
                raise InputError(f"{problem} {variable.quantity.unit} ({variable.quantity.doc})", key=variable.key)

    def _check_channels(self) -> None:
        known = [channel.name for channel in self.channels]
        for what, given in (("percentiles", self.percentiles), ("whole", self.whole)):
            for name in given.channels if given is not None else ():
                if name not in known:
                    raise unknown_name("channel", name, known, f"{what}.channels")
        if self.percentiles is not None and self.percentiles.start >= scenario_of(self.case).duration:
            raise InputError("is behind the end of the run", key="percentiles.start", joint=" ")
        if self.whole is not None:
            if len(self.whole.members) > MOST_WHOLE:
                raise InputError(f"{len(self.whole.members)} members are more than {MOST_WHOLE}", key="whole.members")
            for number in self.whole.members:
                if not 0 <= number < self.members:
                    problem = f"{number} is no member: they are numbered 0 to {self.members - 1}"
                    raise InputError(problem, key="whole.members")

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of what varies."""
        return tuple(variable.key for variable in self.variables)

    @property
    def members(self) -> int:
        """How many members there are, numbered from 0."""
        return self.design.size(len(self.variables))

    @property
    def block_size(self) -> int:
        """Members of a block."""
        return self.block or int(np.clip(-(-self.members // LEAST_BLOCKS), 1, MOST_BLOCK))

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-self.members // self.block_size)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels of a member's run."""
        return channels_of(self.case)

    def draws(self) -> np.ndarray:
        """What each member has: (members, variables) in the units of the quantities; of a choice its number."""
        if self.design.rows is not None:
            return np.asarray(self.design.rows, dtype=float)
        u = self.design.probabilities(self.keys)
        for k, variable in enumerate(self.variables):
            u[:, k] = variable.distribution.quantile(u[:, k])
        return u

    def values(self, draw: np.ndarray) -> dict[str, Any]:
        """The values by key of one member's draw."""
        return {
            variable.key: variable.distribution.options[int(value)]
            if isinstance(variable.distribution, OptionChoice)
            else float(value)
            for variable, value in zip(self.variables, draw, strict=True)
        }

    def member(self, draw: np.ndarray) -> Case:
        """The case of one member, which runs alone as any other. Raises as `variables.apply` does."""
        return apply(self.case, self.values(draw))

    def identity(self) -> str:
        """A hash of all that decides on what is kept of every member: two studies of one identity give the same."""
        parts = {
            "case": _words(self.case),
            "variables": [[v.key, v.distribution.words, _words(v.distribution)] for v in self.variables],
            "design": [self.design.kind, self.design.members, self.design.seed, _words(self.design.correlations)],
            "rows": None if self.design.rows is None else hashlib.sha256(self.design.rows.tobytes()).hexdigest(),
            "keep": [list(self.keep), _words(self.options), _words(self.percentiles), _words(self.whole)],
            "block": self.block_size,
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def channels_of(case: Case) -> tuple[Channel, ...]:
    """All channels of a run of the case."""
    return loop_channels(case) if isinstance(case, PositionLoop) else output_channels(case)


def _words(value: Any) -> str:
    """What a value is, in words of every digit: data by its fields, a function by its name and, where it is not the
    package's, the code that it has.

    Fields at their defaults are left out: one that a later version adds makes no other study.
    """
    if hasattr(value, "__dataclass_fields__"):
        own = {name: getattr(value, name) for name in value.__dataclass_fields__ if not _at_default(value, name)}
        fields = [f"{name}={_words(given)}" for name, given in own.items()]
        return f"{type(value).__name__}({', '.join(fields)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_words(value[key])}' for key in sorted(value))}}}"
    if isinstance(value, np.ndarray):
        return f"array({hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()})"
    if isinstance(value, (str, bytes, int, float, bool, type(None))):
        return repr(float(value) if isinstance(value, np.floating) else value)
    if isinstance(value, Iterable):
        return f"({', '.join(_words(one) for one in value)})"
    name = getattr(value, "__qualname__", type(value).__name__)
    if str(getattr(value, "__module__", "")).startswith("valvesim."):
        return name  # its text is told by the versions
    return f"{name} {_code_hash(getattr(value, '__code__', None))}"


def _at_default(value: Any, name: str) -> bool:
    """Whether a field of a dataclass holds the default that it declares."""
    declared = value.__dataclass_fields__[name].default
    given = getattr(value, name)
    return declared is not MISSING and (given is declared or type(given) is type(declared) and bool(given == declared))


def _code_hash(code: Any) -> str:
    """A hash of what a function does: its instructions, names and constants."""
    if code is None:
        return ""
    constants = [_code_hash(one) if hasattr(one, "co_code") else repr(one) for one in code.co_consts]
    return hashlib.sha256(code.co_code + repr((code.co_names, constants)).encode()).hexdigest()[:16]
