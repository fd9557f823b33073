"""Sessions of a plant on a bench with imperfections: how often the diagnosis is right there.

    .venv/bin/python benchmarks/bench_sessions.py run --count 20        # of the working set; goes on where it stopped
    .venv/bin/python benchmarks/bench_sessions.py run --one-by-one      # one imperfection at a time
    .venv/bin/python benchmarks/bench_sessions.py run --set ninth       # 300 sessions, to be opened once, at the end
    .venv/bin/python benchmarks/bench_sessions.py run --set ninth --no-distances # d' is left to the next
    .venv/bin/python benchmarks/bench_sessions.py distances --set ninth            # d' where it is missing
    .venv/bin/python benchmarks/bench_sessions.py distances --set third --engine COMMIT  # d' of its rows, anew
    .venv/bin/python benchmarks/bench_sessions.py again --set tenth --part 1/25 # opened ones by the engine at hand
    .venv/bin/python benchmarks/bench_sessions.py report --set third    # docs/bench_sessions.md from what there is

`--part 1/2` takes every second session from the first on, so that two processes share a set.

A session is drawn by tests/bench_plant.py: the plant of tests/hidden_plant.py under ideal edges or held samples, with a
rippling supply, oil that warms and parts that follow by another network, a gap, a corrupt reading, clocks that run
apart, a drifting meter and a saturated channel. The sets have seeds of their own: the second led to mends while it was
opened, the third came after them. Each session adds a line of JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: a worker is one core
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(ROOT / "tests"))

import hidden_plant  # noqa: E402
import numpy as np  # noqa: E402
from bench_plant import IMPERFECTIONS, READINGS, Bench, bench_records, draw_bench, write_bench_session  # noqa: E402
from hidden_plant import DRAWN, truth  # noqa: E402
from hidden_report import wilson  # noqa: E402
from thermal_sessions import fit_to_plant, left_by_fit, meter_noise, read_rows, write_rows  # noqa: E402

import valvesim as vs  # noqa: E402
from valvesim.identification.input_choice import HELD_NAME, STRAIGHT, input_choices  # noqa: E402
from valvesim.identification.input_waves import wave_parameters, wave_size, with_parameters  # noqa: E402
from valvesim.identification.instrument_errors import instrument_errors  # noqa: E402
from valvesim.identification.nominal_fit import with_input_choice  # noqa: E402
from valvesim.identification.options import DEFAULT_IDENTIFICATION  # noqa: E402
from valvesim.identification.session_toml import load_session  # noqa: E402
from valvesim.identification.study import prepare_session  # noqa: E402

SETS = {"working": (700_000, 300), "second": (800_000, 300), "third": (820_000, 300),
        "fourth": (840_000, 300), "fifth": (860_000, 300), "sixth": (880_000, 300),
        "seventh": (960_000, 300), "eighth": (970_000, 300), "ninth": (991_000, 300),
        "tenth": (992_000, 300), "eleventh": (995_000, 300), "twelfth": (998_000, 300),
        "thirteenth": (1_040_000, 300), "fourteenth": (1_050_000, 300),
        "fifteenth": (1_070_000, 300), "sixteenth": (1_080_000, 300),
        "seventeenth": (1_110_000, 300), "eighteenth": (1_120_000, 300),
        "nineteenth": (1_130_000, 300), "twentieth": (1_140_000, 300),
        "twenty_first": (1_150_000, 300), "twenty_second": (1_160_000, 300),
        "twenty_third": (1_170_000, 300)}  # first seed, sessions
RESULTS = ROOT / "benchmarks" / "results" / "bench_sessions.jsonl"
DOCUMENT = ROOT / "docs" / "bench_sessions.md"
EXCEPTION = "exception"
CLEAR = 8.0  # d' from which a cause should be named
COMMON = ("ripple", "warming", "gap", "corrupt", "skew", "drift", "saturation")
SINCE = {"seventeenth": READINGS}  # what benches of later sets do besides
HIDDEN = (None, "spool_coulomb_friction", None, *DRAWN)
"""What is hidden, in turn: a third of the sessions and more are of healthy valves."""


def sessions(name: str) -> Iterator[tuple[int, str | None, tuple[str, ...]]]:
    """(seed, what is hidden, imperfections) of a set: all imperfections in each, steps ideal or held in turn."""
    first, count = SETS[name]
    for k in range(count):
        yield first + k, None if k % 3 == 0 else HIDDEN[k % len(HIDDEN)], (
            ("edges", "hold")[k % 2], *COMMON, *SINCE.get(name, ()),
        )  # fmt: skip


def one_by_one() -> Iterator[tuple[int, str | None, tuple[str, ...]]]:
    """The same of the working set with one imperfection each, or none: on a healthy valve, then with friction."""
    first, _ = SETS["working"]
    for hidden in (None, "spool_coulomb_friction"):
        for k in range(8):
            yield first + 1000 + k, hidden, ()
            for imperfection in IMPERFECTIONS:
                yield first + 1000 + k, hidden, (imperfection,)


def diagnosed(
    seed: int, hidden: str | None, imperfections: tuple[str, ...], *, measured: bool = True
) -> dict[str, Any]:
    """One session, written to a folder and diagnosed from that alone; its d' too where it is `measured`."""
    row: dict[str, Any] = {"seed": seed, "hidden": hidden, "imperfections": list(imperfections)}
    with tempfile.TemporaryDirectory() as folder:
        case, bench = draw_bench(seed, "effect" if hidden else "none", name=hidden, imperfections=imperfections)
        write_bench_session(case, bench, folder)
        if measured or not hidden:
            row["distance"] = distance(case, bench, folder) if hidden else 0.0
        worked = time.process_time()
        try:
            found = vs.diagnose(folder)
        except (vs.InputError, vs.SolveError) as error:
            return row | {"outcome": f"{type(error).__name__}: {error}"}
        except Exception as error:  # of a set that is opened once, it counts as an answer that is not right
            nothing: dict[str, Any] = {"bench": [], "causes": [], "set": [], "first": [], "covered": []}
            return row | nothing | {"outcome": EXCEPTION, "reason": "", "summary": f"{type(error).__name__}: {error}"}
    (figures,) = truth(case)["parameters"].values() if hidden else ({},)
    amplitudes = [e for e in found.parameters if hidden and e.cause.startswith(hidden) and e.name in figures]
    return row | {
        "outcome": found.verdict, "reason": found.reason, "bench": list(found.bench), "causes": list(found.causes),
        "set": [answer.label for answer in found.candidates if answer.in_set],
        "first": list(found.candidates[0].names) if found.candidates else [],
        "covered": [bool(e.low <= figures[e.name] <= e.high) for e in amplitudes],
        "claimed": found.gain_claimed, "power": found.next_test.power if found.next_test else None,
        "processor_seconds": round(time.process_time() - worked, 1), "summary": found.summary,
    }  # fmt: skip


def distance(case: hidden_plant.Case, bench: Bench, folder: str) -> float:
    """d' of what is hidden in the training records: what the noise-free readings change by, in the meters' noise, less
    what a fit of valve, instruments, the ripple and the times of edges takes up of it; and no more than a figure of
    the valve would be off, in prior deviations, that does the same.

    The change is the plant's own, before it is rounded, on top of what the model does as fitted to the plant. As in
    every fit beside a ripple, samples next to sharp peaks count less.
    """
    quiet = replace(case, meters=tuple(replace(meter, noise=0.0, colour=0.0, resolution=0.0) for meter in case.meters))
    with_it, without = (bench_records(quiet, bench, strength) for strength in (1.0, 0.0))
    prepared = prepare_session(load_session(folder), options=DEFAULT_IDENTIFICATION)
    session, runs = prepared.session, [run.name for run in case.runs]
    prepared = with_parameters(prepared, instrument_errors(session, options=DEFAULT_IDENTIFICATION))
    if bench.has("ripple"):
        size = wave_size(prepared.nominal, session.training, "supply_pressure")
        ripple = wave_parameters(session.training, "supply_pressure", case.runs[0].ripple[1], size)
        prepared = with_parameters(prepared, ripple)
    choices = input_choices(session, options=DEFAULT_IDENTIFICATION)  # the fullest of them last
    way = choices[-1] if bench.has("edges") else STRAIGHT
    if bench.has("hold"):
        way = next(choice for choice in choices if choice.name == HELD_NAME)
    prepared = with_input_choice(prepared, way)
    paces = {predictor.record.pace for predictor in prepared.predictors}
    noise = {(meter.channel, pace): meter_noise(meter) for meter in case.meters for pace in paces}
    quiet_readings, changes = [], []
    for predictor in prepared.predictors:
        k = runs.index(predictor.record.name)
        quiet_readings.append({name: without[k][name] for name in predictor.record.outputs})
        changes.append({name: np.nan_to_num(with_it[k][name] - without[k][name]) for name in predictor.record.outputs})
    base = fit_to_plant(prepared, noise, quiet_readings)
    most = left_by_fit(prepared, noise, base, changes)
    ((hidden, figures),) = truth(case)["parameters"].items()
    for candidate in prepared.candidates:
        if candidate.effect is not None and candidate.effect.name == hidden:
            amplitude = candidate.effect.amplitude
            above = figures[amplitude.name] - (amplitude.neutral or 0.0)
            shared = candidate.share(candidate.apply_to(prepared.nominal.variant, above), prepared.nominal.variant)
            most = most if shared is None else min(most, abs(shared[1]))
    return round(most, 1)


def run(
    name: str, start: int, count: int | None, single: bool, part: tuple[int, int], results: Path, measured: bool
) -> None:
    """Diagnose what the results do not have yet from the `start`-th on, a line each."""
    results.parent.mkdir(parents=True, exist_ok=True)
    done = {(row["seed"], row["hidden"], tuple(row["imperfections"])) for row in read_rows(results)}
    git = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude", "*"]
    engine = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    for k, spec in enumerate(one_by_one() if single else sessions(name)):
        if count is not None and k >= count:
            break
        if k >= start and spec not in done and k % part[1] == part[0] - 1:
            row = diagnosed(*spec, measured=measured) | {"engine": engine}
            with open(results, "a", encoding="utf-8") as file:
                file.write(json.dumps(row, ensure_ascii=False) + "\n")
            print(row["seed"], hidden_words(row), row["outcome"], row.get("set"), flush=True)


def again(name: str, part: tuple[int, int], results: Path) -> None:
    """Diagnose opened sessions by the engine at hand, and print answers and times beside those of the results, which
    stay as they are. With PYTHONPATH set to the worktree of another engine its times of the same hour stand beside.
    """
    opened, seconds = {row["seed"]: row for row in read_rows(results)}, list[tuple[float, float]]()
    for spec in list(sessions(name))[part[0] - 1 :: part[1]]:
        if (before := opened.get(spec[0])) is None:
            continue
        row = diagnosed(*spec, measured=False)
        seconds.append((before.get("processor_seconds", 0.0), row.get("processor_seconds", 0.0)))
        answers = [f"{one['outcome']} {one.get('set')}" for one in (before, row)]
        told = answers[0] if answers[0] == answers[1] else " -> ".join(answers)
        print(f"{row['seed']} {hidden_words(row)} {told} {seconds[-1][0]} -> {seconds[-1][1]} s", flush=True)
    print(f"{len(seconds)} sessions, {sum(one for one, _ in seconds):.1f} -> {sum(new for _, new in seconds):.1f} s")


def hidden_words(row: dict[str, Any]) -> str:
    """What a session hides, and its imperfections."""
    return f"{row['hidden'] or '-'} | {'+'.join(row['imperfections']) or '-'}"


SAME = {
    "magnet_demagnetization": "parameter:polarization_mmf", "coil_turns_loss": "parameter:coil_turns",
    "coil_resistance_drift": "parameter:coil_resistance", "flexure_stiffness_loss": "parameter:spring_tube_stiffness",
    "null_gap_asymmetry": "parameter:null_gap_difference", "spool_edge_wear": "parameter:null_opening",
    "spool_lap": "parameter:land_overlap",
}  # fmt: skip
"""Another name of the same thing, as in `hidden_report`."""


def is_right(names: list[str], hidden: str) -> bool:
    """Whether a hypothesis is what is hidden: its only cause, by either of its names."""
    return [name.split("@")[0] for name in names] in ([hidden], [SAME.get(hidden, hidden)])


def report(name: str, results: Path, document: Path) -> None:
    """A table of what there is: counts with Wilson's intervals, and every session; counts of the sets before it too."""

    def rows_of(name: str) -> list[dict[str, Any]]:
        first, number = SETS[name]
        return sorted(
            (r for r in read_rows(results) if first <= r["seed"] < first + number), key=lambda row: row["seed"]
        )

    rows, number = rows_of(name), SETS[name][1]
    before = list(SETS)[1 : list(SETS).index(name)]
    columns = {"this set": _measured(rows)}
    if len({row.get("engine") for row in rows}) > 1:
        seeds = {row["seed"] for row in rows}
        engine = [row.get("engine") for row in read_rows(results) if row["seed"] in seeds][-1]
        columns[f"of it by `{engine}`"] = _measured([row for row in rows if row.get("engine") == engine])
    columns |= {f"the {one} set": _measured(rows_of(one)) for one in before}
    lines = [
        "# Sessions of a bench with imperfections", "",
        f"Written by `benchmarks/bench_sessions.py report --set {name}` from {len(rows)} of the {number} sessions of",
        f"the {name} set. All imperfections of `tests/bench_plant.py` in each; what is hidden has the size that is",
        "drawn for it, however little that shows. d' is what it changes of the readings before noise and rounding,",
        "less what a fit of valve, instruments, ripple and the times of edges takes up of it, samples next to sharp",
        "peaks counting less as in every fit beside a ripple; and no more than a figure that does the same would be",
        "off, in prior deviations. (Of the second set, d' is from before the times of edges were among that.)",
        f"It has been worked out for {_measured_of(rows)}: these count by d'.", "",
        f"Engines, by commit: {_engines(rows)}.", "",
        f"| measured (95 % interval after Wilson) | {' | '.join(columns)} |", f"|---|{'---|' * len(columns)}",
        *(f"| {test} | {' | '.join(one[test] for one in columns.values())} |" for test in columns["this set"]), "",
        "| seed | hidden | d' | steps | answer | bench | processor, s |", "|---|---|---|---|---|---|---|",
        *(_line(row) for row in rows), "",
    ]  # fmt: skip
    document.write_text("\n".join(lines), encoding="utf-8")


def _measured_of(rows: list[dict[str, Any]]) -> str:
    """Of how many sessions with a cause there is a d'."""
    faulty = [row for row in rows if row["hidden"]]
    return f"{sum('distance' in row for row in faulty)} of the {len(faulty)} sessions with a cause"


def _measured(rows: list[dict[str, Any]]) -> dict[str, str]:
    """What was measured in some sessions, in words: counts with Wilson's intervals, and the time."""
    healthy = [row for row in rows if row["hidden"] is None]
    faulty = [row for row in rows if row["hidden"] is not None and ":" not in row["outcome"]]
    clear = [row for row in faulty if row.get("distance", 0.0) >= CLEAR]
    tests = {
        "false alarms on healthy valves": [row["outcome"] != "no_discrepancy" for row in healthy],
        f"right cause first, d' of {CLEAR:g} and more": [is_right(row["first"], row["hidden"]) for row in clear],
        "right cause in the answer set, the same": [
            any(is_right([part.split("[")[0] for part in label.split(" + ")], row["hidden"]) for label in row["set"])
            for row in clear
        ],
        "one cause named, and wrong, over everything": [
            row["outcome"] == "cause" and not (row["hidden"] and is_right(row["causes"], row["hidden"])) for row in rows
        ],
        "95 % intervals that cover the truth": [hit for row in faulty for hit in row["covered"]],
        "a ripple of the supply is told to 5 % of its frequency": [
            _tells_ripple(row) for row in rows if "bench" in row
        ],
        "refused or failed": [":" in row["outcome"] or row["outcome"] == EXCEPTION for row in rows],
    }
    for low, high in ((CLEAR, 30.0), (30.0, 100.0), (100.0, np.inf)):
        some = [row for row in clear if low <= row["distance"] < high]
        tests[f"right cause first, d' of {low:g} to {high:g}"] = [is_right(r["first"], r["hidden"]) for r in some]
    seconds = sorted(row["processor_seconds"] for row in rows if "processor_seconds" in row)
    spent = (
        f"median {seconds[len(seconds) // 2]}, 95 % below {seconds[int(0.95 * (len(seconds) - 1))]}" if seconds else "-"
    )
    return {test: _share(hits) for test, hits in tests.items()} | {
        "processor time of a session, s, two at a time": spent
    }


def measure_distances(name: str, results: Path, engine: str | None) -> None:
    """Work out the d' of the rows that have none, and anew that of those of an engine, in place."""
    specs = {seed: (hidden, imperfections) for seed, hidden, imperfections in sessions(name)}
    for row in read_rows(results):
        anew = engine is not None and row.get("engine") == engine
        if row["seed"] in specs and row["hidden"] and ("distance" not in row or anew):
            hidden, imperfections = specs[row["seed"]]
            case, bench = draw_bench(row["seed"], "effect", name=hidden, imperfections=imperfections)
            with tempfile.TemporaryDirectory() as folder:
                write_bench_session(case, bench, folder)
                measured = distance(case, bench, folder)
            print(row["seed"], hidden, row.get("distance"), measured, flush=True)
            rows = read_rows(results)  # as they are by now
            write_rows(results, [one | {"distance": measured} if one["seed"] == row["seed"] else one for one in rows])


def _engines(rows: list[dict[str, Any]]) -> str:
    """The engines that diagnosed the rows, each with the spans of its seeds, in which are no others."""
    by = {row["seed"]: row.get("engine", "unknown") for row in rows}
    spans: dict[str, list[tuple[int, int]]] = {}
    for engine, span in groupby(sorted(by), key=by.__getitem__):
        seeds = list(span)
        spans.setdefault(engine, []).append((seeds[0], seeds[-1]))
    return "; ".join(
        f"`{engine}` {', '.join(f'{a}' if a == b else f'{a} to {b}' for a, b in own)}" for engine, own in spans.items()
    )


def _tells_ripple(row: dict[str, Any]) -> bool:
    case, _ = draw_bench(row["seed"], "none", imperfections=tuple(row["imperfections"]))
    said = [fault for fault in row["bench"] if "ripples" in fault]
    return any(abs(float(one.split(" at ")[1].split()[0]) / case.runs[0].ripple[1] - 1.0) < 0.05 for one in said)


def _line(row: dict[str, Any]) -> str:
    answer = row["outcome"].replace("_", " ") + (f": {', '.join(row['set'])}" if row.get("set") else "")
    cells = (
        row["seed"], row["hidden"] or "-", row.get("distance", "-"), (*row["imperfections"], "-")[0], answer,
        "; ".join(row.get("bench", [])) or "-", row.get("processor_seconds", "-"),
    )  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def _share(hits: list[bool]) -> str:
    """A share with its 95 % interval after Wilson."""
    if not hits:
        return "none"
    n, (low, high) = len(hits), wilson(sum(hits), len(hits))
    return f"{100 * sum(hits) / n:.0f} % ({sum(hits)} of {n}; {100 * low:.0f} to {100 * high:.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "again", "distances", "report"))
    parser.add_argument("--set", choices=tuple(SETS), default="working", dest="name")
    parser.add_argument("--start", type=int, default=0, help="the first of them")
    parser.add_argument("--count", type=int, help="the first so many of the set")
    parser.add_argument("--one-by-one", action="store_true", help="one imperfection at a time")
    parser.add_argument("--engine", help="whose distances are worked out anew")
    parser.add_argument("--distances", action=argparse.BooleanOptionalAction, default=True, help="d' with each session")
    parser.add_argument("--part", default="1/1", help="k/n: every n-th session from the k-th on")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("-o", "--output", type=Path, default=DOCUMENT)
    given = parser.parse_args()
    k, n = map(int, given.part.split("/"))
    if given.what == "again":
        again(given.name, (k, n), given.results)
    elif given.what == "run":
        run(given.name, given.start, given.count, given.one_by_one, (k, n), given.results, given.distances)
    elif given.what == "distances":
        measure_distances(given.name, given.results, given.engine)
    else:
        report(given.name, given.results, given.output)


if __name__ == "__main__":
    main()
