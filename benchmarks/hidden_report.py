"""How the lines of hidden_effects.py are scored, and the document that tells it: docs/hidden_effects.md.

Symbols
    d' distance of what is hidden off the base parameters; E true error on the locked records
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.effects.motor import MOTOR
from valvesim.valve.effects.pilot import PILOT
from valvesim.valve.effects.sensors import SENSORS
from valvesim.valve.effects.spool import SPOOL
from valvesim.valve.effects.supply import SUPPLY

Row = dict[str, Any]

SIDED = ("fixed_orifice_clogging", "nozzle_erosion")  # a figure does not tell the side: no credit for it
SAME = {f"parameter:{e.figure}": e.name for e in CATALOGUE.values() if e.figure and e.name not in SIDED}
"""Answer -> the hidden effect that is the same hypothesis by definition: naming it is right."""

TABLE_SEEDS = 130_000
STRONG = 8.0  # d' from which the right cause must come first
SHOWS = 6.0  # d' beside the other from which the weaker of a pair must be found
FORM_TARGET, FORM_ERROR = 40.0, 0.1
LIKELY = DEFAULT_DIAGNOSIS.design.least_power  # a next test predicted to resolve so surely should
POWER_BANDS = (0.0, 0.05, 0.3, LIKELY, 1.0)
LEAST_ROOM = 0.05  # noise deviations between base and oracle: where there is less, nothing can be gained
SINGLES = ("effect", "sensor", "parameter")
BANDS = ((0.0, 6.5), (6.5, 11.0), (11.0, 25.0), (25.0, np.inf))
GROUPS = ("torque motor", "pilot", "supply and oil", "spool", "thermal", "sensor", "parameter")
VERDICTS = ("cause", "ambiguous", "unknown", "no_discrepancy")
CHANNEL_GROUP = {
    "current": "torque motor",
    "armature_angle": "torque motor",
    "nozzle_pressure_1": "pilot",
    "nozzle_pressure_2": "pilot",
    "spool_position": "spool",
    "load_flow": "supply and oil",
    "internal_leakage": "supply and oil",
}
"""Where the largest residual would be looked for."""
BALANCE_GROUP = {"armature torque": "torque motor", "pilot flow": "pilot", "spool force": "spool"}


# ---------------------------------------------------------------- scoring one case


def plain(label: str) -> str:
    """A label without sensor and side."""
    return label.partition("@")[0].partition("[")[0]


def known(labels: Iterable[str]) -> list[str]:
    """Labels in order, each by the effect that it is by definition."""
    return sorted(SAME.get(label, label) for label in labels)


def causes_of(label: str) -> list[str]:
    """The causes of a hypothesis by its label, in order: in whatever order they stand there, they are the same."""
    return known(label.split(" + "))


def found_first(row: Row) -> bool:
    """Whether the most probable candidate has the true names, sensor and side included."""
    return bool(row["candidates"]) and known(row["candidates"][0]["labels"]) == known(row["labels"])


def in_set(row: Row) -> bool:
    """Whether the truth is among the candidates of the answer set."""
    return any(known(each["labels"]) == known(row["labels"]) for each in row["candidates"] if each["in_set"])


def right(row: Row) -> bool:
    """One answer, and the true one."""
    return row["verdict"] == "cause" and known(row["named"]) == known(row["labels"])


def wrong(row: Row) -> bool:
    """One answer, and something in it is not there."""
    return row["verdict"] == "cause" and bool(set(known(row["named"])) - set(known(row["labels"])))


def half(row: Row) -> bool:
    """One of the two of a pair named, and nothing else."""
    return row["verdict"] == "cause" and not wrong(row) and not right(row)


def detected(row: Row) -> bool:
    """Anything but `no_discrepancy`."""
    return row["verdict"] != "no_discrepancy"


def resolved(row: Row) -> bool:
    """Whether the test made one of the two leave the answer set, and not the truth, where it was in the set before."""
    left = [causes_of(label) for label in row["after_next_test"]["in_set"]]
    both_left = all(causes_of(label) in left for label in row["next_test"]["separates"])
    return not both_left and (known(row["labels"]) in left or not in_set(row))


def predicted_power(row: Row) -> float:
    """The power with which the next test was predicted to resolve."""
    return float(row["next_test"]["power"])


def covered(row: Row) -> list[bool]:
    """For each amplitude of what was rightly named, whether its 95 % interval holds the true one."""
    if not right(row):
        return []
    answers = []
    for cause, figures in row["truth"].items():
        name, value = _true_amplitude(cause, figures)
        for one in row["parameters"]:
            if plain(one["cause"]) == cause and one["name"] == name and one["low"] is not None:
                answers.append(one["low"] <= value <= one["high"])
    return answers


def _true_amplitude(cause: str, figures: dict[str, Any]) -> tuple[str, float]:
    if cause.startswith("parameter:"):
        return cause.removeprefix("parameter:"), figures["value"]
    name = CATALOGUE[cause].amplitude.name
    return name, figures[name]


def share_of_gain(row: Row) -> float | None:
    """(E_base - E_ext)/(E_base - E_oracle); None where the oracle is not known or has nothing to gain."""
    oracle = row.get("error_oracle")
    if oracle is None or row["error_before"] - oracle < LEAST_ROOM:
        return None
    return (row["error_before"] - row["error_after"]) / (row["error_before"] - oracle)


def extended(row: Row) -> bool:
    """Whether the answer brought another model than the base."""
    return row.get("error_after") is not None and row["error_after"] != row["error_before"]


def group(label: str) -> str:
    """The part of the valve that a cause belongs to."""
    name = plain(SAME.get(label, label))
    for where, entries in zip(GROUPS, (MOTOR, PILOT, SUPPLY, SPOOL), strict=False):
        if name in {entry.name for entry in entries}:
            return where
    if name in {entry.name for entry in SENSORS}:
        return "sensor"
    return name.partition(":")[0] if ":" in name else "thermal"


# ---------------------------------------------------------------- figures


def wilson(hits: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """95 % interval of a share after Wilson; (0, 1) of nothing."""
    if count == 0:
        return 0.0, 1.0
    p, n = hits / count, float(count)
    middle, reach = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return float(max((middle - reach) / (1 + z * z / n), 0.0)), float(min((middle + reach) / (1 + z * z / n), 1.0))


class Share(NamedTuple):
    """How many of how many."""

    hits: int
    count: int

    def __str__(self) -> str:
        if not self.count:
            return "none of this kind"
        low, high = wilson(*self)
        return (
            f"{100 * self.hits / self.count:.1f} % ({self.hits} of {self.count}; {100 * low:.1f} to {100 * high:.1f} %)"
        )

    @property
    def short(self) -> str:
        """Without the interval."""
        return f"{self.hits}/{self.count}" if self.count else "-"


def share(rows: Sequence[Row], holds: Callable[[Row], bool]) -> Share:
    """How many rows of a kind hold."""
    return Share(sum(map(holds, rows)), len(rows))


def _verdict(count: int, met: bool | None) -> str:
    return "" if not count or met is None else "met" if met else "missed"


def _at_least(value: Share, target: float) -> str:
    return _verdict(value.count, value.hits >= target * value.count)


def _at_most(value: Share, target: float) -> str:
    return _verdict(value.count, value.hits <= target * value.count)


# ---------------------------------------------------------------- the document


def write_report(rows: Sequence[Row], total: int, output: Path) -> None:
    """Write the document from the lines of the cases; `total` is how many the list has."""
    done = [row for row in rows if row["outcome"] == "done"]
    failed = [row for row in rows if row.get("message")]  # as a whole, or but the oracle, next test or baselines
    parts = [
        _head(rows, total, failed),
        _goals(done, failed),
        _definitions(),
        _by_kind(done),
        _by_distance(done),
        _pairs_missed(done),
        _beside(done),
        _confusion(done),
        _by_cause(done),
        _wrong(done),
        _abstentions(done),
        _limits(done),
        _forms(done),
        _next_tests(done),
        _times(done),
        _failed(failed),
    ]
    output.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")


def table(head: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    text = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*text, *("| " + " | ".join(map(str, line)) + " |" for line in lines)])


def _head(rows: Sequence[Row], total: int, failed: Sequence[Row]) -> str:
    partial = "" if len(rows) == total else f" **A part of the suite: {len(rows)} of {total} cases.**"
    offsets = sorted({row["seed"] // 10000 * 10000 for row in rows})
    seeds = "from " + ", ".join(map(str, offsets)) + ("" if offsets == [TABLE_SEEDS] else ": of development")
    return (
        "# Effects hidden in another plant\n\n"
        f"Written by `benchmarks/hidden_effects.py report` on {date.today()} from {len(rows)} cases "
        f"({len(failed)} of them failed), seeds {seeds}, Python {platform.python_version()}.{partial}\n\n"
        "The sessions come from `tests/hidden_plant.py`: another integrator, LuGre friction, play operators, a second\n"
        "armature mode, a supply line, valves scattered within tolerance, sensors with coloured noise, lag and\n"
        "resolution. The diagnosis sees their folders alone."
    )


def _goals(done: Sequence[Row], failed: Sequence[Row]) -> str:
    def of(*kinds: str) -> list[Row]:
        return [row for row in done if row["kind"] in kinds]

    strong = [row for row in of(*SINGLES) if row["distance"] >= STRONG]
    outside = [row for row in of("outside") if detected(row)]
    forms = [row for row in of("outside") if row["target"] == FORM_TARGET and row.get("term_truth")]
    gains = [s for row in done if extended(row) and (s := share_of_gain(row)) is not None]
    of_all = [s for row in done if (s := share_of_gain(row)) is not None]
    longer = [row for row in done if extended(row)]
    intervals = [inside for row in done for inside in covered(row)]
    coverage = Share(sum(intervals), len(intervals))
    false, first, among = share(of("none"), detected), share(strong, found_first), share(strong, in_set)
    pairs = [row for row in of("pair") if row.get("beside") and min(row["beside"]) >= SHOWS]
    paired, paired_among = share(pairs, found_first), share(pairs, in_set)
    mistakes, named = share(done, wrong), share(outside, lambda row: row["verdict"] == "cause")
    spared = Share(named.count - named.hits, named.count)
    fitted = share(forms, lambda row: row.get("term_error") is not None and row["term_error"] <= FORM_ERROR)
    worse = share(longer, lambda row: row["error_after"] > row["error_before"])
    seconds = [row["cpu_seconds"] for row in done]
    told = (
        "none of this kind"
        if not gains
        else (f"median {np.median(gains):.3f} of {len(gains)} extended; {np.median(of_all):.3f} of all {len(of_all)}")
    )
    made = _made(done)
    parted, likely = share(made, resolved), share([row for row in made if predicted_power(row) >= LIKELY], resolved)
    stopped = sum(bool(row.get("next_test_stopped")) for row in done)
    mean = float(np.mean([predicted_power(row) for row in made])) if made else 0.0
    lines = [
        ("false alarms on empty sessions", "at most 1 %", false, _at_most(false, 0.01)),
        (f"right cause first, d' >= {STRONG:g}, one hidden", "95 %", first, _at_least(first, 0.95)),
        ("right cause in the answer set, the same", "99 %", among, _at_least(among, 0.99)),
        (f"right pair first, each with d' >= {SHOWS:g} beside the other", "90 %", paired, _at_least(paired, 0.9)),
        ("right pair in the answer set, the same", "96 %", paired_among, _at_least(paired_among, 0.96)),
        ("one cause named, and wrong, over everything", "at most 0.5 %", mistakes, _at_most(mistakes, 0.005)),
        ("outside the catalogue, detected: no catalogue name", "95 %", spared, _at_least(spared, 0.95)),
        (
            f"form recovered at d' = {FORM_TARGET:g}: error at most {100 * FORM_ERROR:g} %",
            "90 %",
            fitted,
            _at_least(fitted, 0.9),
        ),
        (
            "gain, share of what the true model gains",
            "median 0.95",
            told,
            _verdict(len(gains), bool(gains) and np.median(gains) >= 0.95),
        ),
        ("made worse, of those extended", "none", worse, _at_most(worse, 0.0)),
        (
            "95 % intervals that cover the truth",
            "93 to 97 %",
            coverage,
            _verdict(coverage.count, 0.93 <= coverage.hits / max(coverage.count, 1) <= 0.97),
        ),
        (
            f"next test resolves the two, of those predicted to with {LIKELY:g} and more",
            "90 %",
            likely,
            _at_least(likely, 0.9),
        ),
        (
            "the same of all next tests",
            f"{mean:.2f}, as predicted" if made else "as predicted",
            f"{parted}{f'; {stopped} more were stopped' if stopped else ''}",
            _verdict(parted.count, wilson(*parted)[0] <= mean <= wilson(*parted)[1]),
        ),
        (
            "processor time of a session of four records of 1 s, s",
            "median 5, 95 % below 40",
            f"median {np.median(seconds):.1f}, 95 % below {np.quantile(seconds, 0.95):.1f}" if seconds else "-",
            _verdict(len(seconds), bool(seconds) and bool(np.all(np.quantile(seconds, [0.5, 0.95]) <= [5.0, 40.0]))),
        ),
        ("cases that failed with an exception", "0", len(failed), "met" if not failed else "missed"),
    ]
    return "## Reached\n\n" + table(("", "to reach", "measured (95 % interval after Wilson)", ""), lines)


def _made(done: Sequence[Row]) -> list[Row]:
    """The cases whose causes could not be told apart and whose next test was made on the plant."""
    return [row for row in done if row["verdict"] == "ambiguous" and row.get("after_next_test")]


def _definitions() -> str:
    same = "; ".join(f"`{answer}` for `{truth}`" for answer, truth in SAME.items())
    return f"""## What the words mean

- **d'**: norm, whitened by the meters' true noise (AR(1), and rounding), of what the hidden adds to the noise-free
  training records, less what the base parameters can take up against their priors: by the linear equations about the
  valve on the bench, and no more than a fit to the noise-free records leaves (less what even the true cause leaves
  then, which is the plant's). Cases are tuned to a target; where the catalogue's bounds or the plant forbid
  it, the largest d' possible stands. All tables go by the measured d'.
- **beside the other**: d' of each of a pair where the other is known, by fits to the noise-free records: what a linear
  estimate had put at 6 and more, with the other unknown, may be next to nothing. The goals for pairs count those
  where both show by {SHOWS:g} and more; the other tables count all.
- **false alarm**: on an empty session, any verdict but `no_discrepancy`. **detected**: the same where something is
  hidden.
- **right cause first**: the most probable candidate has the true names, sensor and side included. By definition the
  same hypothesis, and so right: {same}.
- **in the answer set**: a candidate of the set has the true names.
- **unique and wrong**: verdict `cause`, and any named cause is not there. **half**: one of two that are there, and no
  other.
- **E**: root mean square over the locked records of prediction less the plant's noise-free readings, in noise
  deviations. **Share of gain**: (E_base - E_ext)/(E_base - E_oracle); the oracle is the true cause fitted to the same
  data, from the true figures. Only where the oracle gains at least {LEAST_ROOM:g}. **Made worse**: E_ext > E_base, of
  all that were extended.
- **covered**: of verdicts `cause` with the right names, the true amplitude (SI) lies in its 95 % interval.
- **form recovered**: relative L2 error over the recovered term's knots, offset removed; a term at another port, of
  another variable or memory is not recovered. Only of forms that are a function of one variable.
- **resolved**: the plant is put through the test and the longer session diagnosed: one of the two causes is out of the
  answer set, and the truth, where it was in the set before, is still in it. A diagnosis that takes longer than four
  minutes of the processor there is stopped, and told apart.
- **predicted power**: the power that the answer states for its next test, the probability that it resolves. That is
  calibrated where the mean predicted power lies within the interval of the share that resolved.
- **seconds**: of `diagnose` on the wall clock, a worker a core, BLAS on one thread; beside it what the processor
  worked."""


def _by_kind(done: Sequence[Row]) -> str:
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in done):
        rows = [row for row in done if row["kind"] == kind]
        verdicts = [share(rows, lambda row, v=verdict: row["verdict"] == v).hits for verdict in VERDICTS]  # noqa: B023
        truth = [
            share(rows, test).short if kind not in ("none", "outside") else "-" for test in (found_first, in_set, right)
        ]
        lines.append(
            (
                kind,
                len(rows),
                *verdicts,
                *truth,
                share(rows, wrong).short,
                share(rows, half).hits if kind == "pair" else "-",
            )
        )
    head = (
        "hidden",
        "cases",
        *(f"`{v}`" for v in VERDICTS),
        "right first",
        "in set",
        "unique and right",
        "unique and wrong",
        "half",
    )
    empty = [row for row in done if row["kind"] == "none"]
    noise = [
        f"{name}: {share([row for row in empty if (row['colour'] > 0.0) == coloured], detected)}"
        for name, coloured in (("white noise", False), ("coloured noise", True))
    ]
    return "## By kind\n\n" + table(head, lines) + "\n\nFalse alarms with " + "; with ".join(noise) + "."


def _by_distance(done: Sequence[Row]) -> str:
    lines = []
    for kind in (*SINGLES, "pair", "outside"):
        for low, high in BANDS:
            rows = [row for row in done if row["kind"] == kind and low <= row["distance"] < high]
            if rows:
                tests = (detected, found_first, in_set, right, wrong)
                span = f"{low:g} to {high:g}" if np.isfinite(high) else f"{low:g} and more"
                lines.append((kind, span, *(share(rows, test).short for test in tests)))
    return "## By distance\n\n" + table(
        ("hidden", "d'", "detected", "right first", "in set", "unique and right", "unique and wrong"), lines
    )


def more_by_truth(row: Row) -> float | None:
    """By how much the truth, fitted from the true figures, lowers the deviance beyond what stands first; None where
    that is not known.
    """
    if row.get("oracle_fall") is None:
        return None
    first = next((each for each in row["candidates"] if each["labels"]), {"deviance_fall": 0.0})
    more = row["oracle_fall"] - first["deviance_fall"]
    return more if np.isfinite(more) else None


def _pairs_missed(done: Sequence[Row]) -> str:
    pairs = [row for row in done if row["kind"] == "pair"]
    missed = [(row, more) for row in pairs if not found_first(row) and (more := more_by_truth(row)) is not None]
    if not missed:
        return ""
    lines = [
        (
            _case(row),
            f"{row['distance']:.1f}",
            ", ".join(f"{each:.1f}" for each in row.get("beside", ())),
            " + ".join(row["labels"]),
            next((each["label"] for each in row["candidates"] if each["labels"]), "nothing"),
            "yes" if in_set(row) else "no",
            f"{more:.0f}",
        )
        for row, more in sorted(missed, key=lambda pair: -pair[1])
    ]
    level = float(np.median([row["alarm_level"] for row, _ in missed])) ** 2
    above = sum(more > level for _, more in missed)
    return (
        f"## Pairs that are not first\n\n{len(missed)} of {len(pairs)}. **More**: by how much the pair, fitted from "
        "its true figures, lowers the deviance beyond the likeliest cause that was given: what these records have to "
        f"tell the two apart by. A cause more is not looked for below {level:.0f}, which the best of all candidates "
        f"reaches by chance in one session of two hundred; {above} of {len(missed)} lie above that, the most at "
        f"{lines[0][-1]}.\n\n"
    ) + table(("case", "d'", "beside the other", "hidden", "likeliest", "in set", "more"), lines)


def _beside(done: Sequence[Row]) -> str:
    both = [row for row in done if row.get("baselines")]
    if not both:
        return ""
    single = [row for row in both if row["kind"] in SINGLES]
    strong = [row for row in single if row["distance"] >= STRONG]
    placed = [row for row in single if row["kind"] != "parameter"]
    empty, outside = ([row for row in both if row["kind"] == kind] for kind in ("none", "outside"))

    def names(method: str) -> Callable[[Row], bool]:
        return lambda row: bool(row["baselines"].get(method))

    def right_name(method: str) -> Callable[[Row], bool]:
        return lambda row: names(method)(row) and known([row["baselines"][method]]) == known(row["labels"])

    def same_group(row: Row) -> bool:
        return bool(row["candidates"]) and any(
            group(each) == group(row["labels"][0]) for each in row["candidates"][0]["labels"]
        )

    def residual_group(row: Row) -> bool:
        channel = row["baselines"]["largest_residual"]
        if row["kind"] == "sensor":
            return channel == row["truth"][next(iter(row["truth"]))]["channel"]
        return CHANNEL_GROUP.get(channel) == group(row["labels"][0])

    def balance(row: Row) -> str | None:
        return (row["baselines"].get("pysindy") or {}).get("balance")

    fitted = [row for row in placed if balance(row)]
    lines = [
        (
            "diagnosis",
            share(empty, detected).short,
            share(strong, found_first).short,
            share(both, wrong).short,
            share(outside, lambda row: row["verdict"] == "cause").short,
            share(placed, same_group).short,
        ),
        *(
            (
                label,
                share(empty, names(method)).short,
                share(strong, right_name(method)).short,
                share(both, lambda row, m=method: names(m)(row) and not right_name(m)(row)).short,  # noqa: B023
                share(outside, names(method)).short,
                share(
                    placed,
                    lambda row, m=method: names(m)(row) and group(row["baselines"][m]) == group(row["labels"][0]),
                ).short,
            )  # noqa: B023
            for label, method in (("refit all, lowest RMSE", "lowest_rmse"), ("AIC", "aic"))
        ),
        ("largest residual", "-", "-", "-", "-", share(placed, residual_group).short),
        (
            "PySINDy's discrepancy fit",
            "-",
            "-",
            "-",
            "-",
            share(fitted, lambda row: BALANCE_GROUP[balance(row) or ""] == group(row["labels"][0])).short,
        ),
    ]
    skipped = Counter(
        row["baselines"]["pysindy"]["skipped"] for row in both if "skipped" in row["baselines"].get("pysindy", {})
    )
    why = "; ".join(f"{count} times: {reason}" for reason, count in skipped.most_common())
    return (
        f"## Beside it\n\nOn the same {len(both)} sessions. Lowest RMSE refits a dozen candidates, the best by score, "
        "and must name one; AIC may name none.\n\n"
        + table(
            (
                "",
                "false alarms, empty",
                f"right, d' >= {STRONG:g}",
                "named and wrong, all",
                "named, outside",
                "right part of the valve",
            ),
            lines,
        )
        + (f"\n\nPySINDy was left out {why}." if why else "")
    )


def _confusion(done: Sequence[Row]) -> str:
    """What was hidden against what was answered, by parts of the valve."""
    counts: Counter = Counter()
    for row in done:
        truth = " + ".join(sorted({group(each) for each in row["labels"]})) or "nothing"
        truth = "outside" if row["kind"] == "outside" else "poor" if row["kind"] == "poor" else truth
        truth = "two" if row["kind"] == "pair" else truth
        answer = row["verdict"]
        if answer == "cause":
            parts = {group(each) for each in row["named"]}
            answer = parts.pop() if len(parts) == 1 else "two parts"
        counts[truth, answer] += 1
    truths = [each for each in ("nothing", *GROUPS, "two", "outside", "poor") if any(t == each for t, _ in counts)]
    answers = [each for each in (*GROUPS, "two parts", *VERDICTS[1:]) if any(a == each for _, a in counts)]
    lines = [(t, *(counts[t, a] or "" for a in answers)) for t in truths]
    return (
        "## Confusion\n\nHidden (down) against answered (across; parts of the valve where a cause was named).\n\n"
        + table(("hidden", *answers), lines)
    )


def _by_cause(done: Sequence[Row]) -> str:
    lines = []
    for kind in (*SINGLES, "outside"):
        rows_of = [row for row in done if row["kind"] == kind]
        for name in sorted({row["name"] for row in rows_of}):
            rows = [row for row in rows_of if row["name"] == name]
            verdicts = Counter(row["verdict"] for row in rows)
            others = Counter(
                " + ".join(row["candidates"][0]["labels"]) or "none of the known"
                for row in rows
                if detected(row) and row["candidates"] and not found_first(row)
            )
            reached = f"{min(row['distance'] for row in rows):.1f} to {max(row['distance'] for row in rows):.1f}"
            lines.append(
                (
                    name,
                    len(rows),
                    reached,
                    share(rows, detected).hits,
                    *(share(rows, test).hits for test in (found_first, in_set, right)),
                    *(verdicts[v] for v in VERDICTS[1:3]),
                    share(rows, wrong).hits,
                    ", ".join(f"{other} {count}" for other, count in others.most_common(4)),
                )
            )
    head = (
        "hidden",
        "cases",
        "d'",
        "detected",
        "right first",
        "in set",
        "unique and right",
        "ambiguous",
        "unknown",
        "unique and wrong",
        "first instead",
    )
    return "## By cause\n\n" + table(head, lines)


def _case(row: Row) -> str:
    return f"`{row['key']}`"


def _wrong(done: Sequence[Row]) -> str:
    rows = [row for row in done if wrong(row)]
    if not rows:
        return "## Unique and wrong\n\nNone."
    lines = [
        (
            _case(row),
            f"{row['distance']:.1f}",
            " + ".join(row["labels"]) or "nothing",
            " + ".join(row["named"]),
            f"{row['candidates'][0]['probability']:.2f}" if row["candidates"] else "",
            f"{row['candidates'][0]['deviance_fall'] / row['distance'] ** 2:.2f}" if row["distance"] > 1.0 else "",
            ", ".join(row["channels"]),
        )
        for row in sorted(rows, key=lambda row: row["kind"])
    ]
    return (
        "## Unique and wrong\n\nEvery one. **Explains**: the fall of the deviance by what is named over d'^2; about 1 "
        "where it shows in these records all that is hidden would, whatever its name.\n\n"
    ) + table(("case", "d'", "hidden", "named", "probability", "explains", "measured"), lines)


def _abstentions(done: Sequence[Row]) -> str:
    hidden = [row for row in done if row["kind"] != "none" and row["verdict"] != "cause"]
    sizes = [sum(each["in_set"] for each in row["candidates"]) for row in done if row["verdict"] == "ambiguous"]
    lines = []
    for kind in dict.fromkeys(row["kind"] for row in hidden):
        rows = [row for row in hidden if row["kind"] == kind]
        lines.append((kind, *(share(rows, lambda row, v=v: row["verdict"] == v).hits for v in VERDICTS[1:])))
    mean = f" An answer set has {np.mean(sizes):.1f} members on average, {max(sizes)} at most." if sizes else ""
    return f"## Abstentions\n\nSomething was hidden and no cause named: {len(hidden)} cases.{mean}\n\n" + table(
        ("hidden", *(f"`{v}`" for v in VERDICTS[1:])), lines
    )


def _limits(done: Sequence[Row]) -> str:
    """For each effect the amplitudes that sessions said they would show, and the strongest that was missed."""
    lines = []
    for name in sorted({plain(label) for row in done for label in row["limits"]}):
        values, blind, unit = [], 0, ""
        for row in done:
            for label, value in row["limits"].items():
                if plain(label) == name and CATALOGUE.get(name) not in SENSORS:
                    unit = row["limit_units"][label]
                    values += [value] if value is not None else []
                    blind += value is None
        rows = [row for row in done if row["kind"] in SINGLES and plain(row["labels"][0]) == name]
        missed = [row["distance"] for row in rows if not detected(row)]
        if not rows and (not values or name not in CATALOGUE):  # parameters only where some were hidden
            continue
        quantiles = [f"{v:.3g}" for v in np.quantile(values, (0.1, 0.5, 0.9))] if values else ["-"] * 3
        seen = share(rows, detected).short
        lines.append((name, unit, *quantiles, blind, seen, f"{max(missed):.1f}" if missed else ""))
    return (
        "## Detection limits\n\nThe amplitude that a session itself says it would show nine times in ten, over all\n"
        "sessions (sensor faults, in the unit of their channel, are not pooled), how many sessions were blind to it,\n"
        "and the largest d' that went unseen.\n\n"
        + table(
            ("effect", "unit", "a tenth below", "median", "a tenth above", "blind", "detected", "largest d' unseen"),
            lines,
        )
    )


def _forms(done: Sequence[Row]) -> str:
    rows = [row for row in done if row["kind"] == "outside" and detected(row)]
    if not rows:
        return ""
    lines = [
        (
            _case(row),
            f"{row['distance']:.1f}",
            row["verdict"],
            row["term"]["port"] if row["term"] else "-",
            row["term"]["variable"] if row["term"] else "-",
            row["term"]["memory"] if row["term"] else "-",
            f"{row['term_error']:.3f}"
            if row.get("term_error") is not None
            else ""
            if row.get("term_truth")
            else "no function of one variable",
        )
        for row in sorted(rows, key=lambda row: (row["name"], row["distance"]))
    ]
    return "## Outside the catalogue\n\n" + table(
        ("case", "d'", "verdict", "port", "variable", "memory", "error of the term"), lines
    )


def _next_tests(done: Sequence[Row]) -> str:
    rows = [row for row in done if row["next_test"]]
    if not rows:
        return ""
    lines = [
        (
            _case(row),
            " / ".join(row["next_test"]["separates"]),
            row["next_test"]["description"],
            f"{predicted_power(row):.2f}",
            ", ".join(row["after_next_test"]["in_set"]) if row.get("after_next_test") else "",
            ("yes" if resolved(row) else "no") if row.get("after_next_test") else "",
        )
        for row in rows
    ]
    return (
        "## Next tests\n\nProposed where causes could not be told apart, with the predicted power, and what was left "
        "in the answer set once the test had been made on the plant.\n\n"
        + _by_power(_made(done))
        + "\n\n"
        + table(("case", "to tell apart", "test", "predicted power", "left", "resolved"), lines)
    )


def _by_power(made: Sequence[Row]) -> str:
    """How many resolved of those predicted alike."""
    lines = []
    for low, high in pairwise(POWER_BANDS):
        last = high == POWER_BANDS[-1]  # which holds its end
        rows = [row for row in made if low <= predicted_power(row) < high or (last and predicted_power(row) == high)]
        if rows:
            mean = f"{np.mean([predicted_power(row) for row in rows]):.2f}"
            lines.append((f"{low:g} to {high:g}", len(rows), mean, share(rows, resolved)))
    return table(("predicted power", "tests", "on average", "resolved"), lines)


def _times(done: Sequence[Row]) -> str:
    def spread(key: str, rows: Sequence[Row]) -> tuple[str, ...]:
        values = [row[key] for row in rows if row.get(key) is not None]
        return tuple(f"{v:.1f}" for v in (*np.quantile(values, (0.5, 0.95)), max(values))) if values else ("-",) * 3

    lines = [
        ("`diagnose`, wall clock", *spread("seconds", done)),
        ("`diagnose`, processor", *spread("cpu_seconds", done)),
    ]
    for verdict in VERDICTS:
        rows = [row for row in done if row["verdict"] == verdict]
        if rows:
            lines.append((f"`diagnose`, answer `{verdict}`", *spread("seconds", rows)))
    lines += [
        ("drawing and tuning a case", *spread("preparing", done)),
        ("baselines", *spread("baseline_seconds", done)),
        ("a case in all", *spread("total", done)),
    ]
    return "## Seconds\n\n" + table(("", "median", "95 %", "longest"), lines)


def _failed(failed: Sequence[Row]) -> str:
    if not failed:
        return ""
    lines = [(_case(row), row.get("message", "").replace("|", "/").replace("\n", " ")[:200]) for row in failed]
    return "## Failed\n\n" + table(("case", "message"), lines)
