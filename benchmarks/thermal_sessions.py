"""Warm-ups and launches of a plant whose parts follow otherwise than the model's: how often the diagnosis is right.

    .venv/bin/python benchmarks/thermal_sessions.py run --count 20      # of the working set; goes on where it stopped
    .venv/bin/python benchmarks/thermal_sessions.py run --set third     # to be opened once, at the end
    .venv/bin/python benchmarks/thermal_sessions.py run --set fifth --thermometer 0.5  # of a grid of so many kelvin
    .venv/bin/python benchmarks/thermal_sessions.py report              # docs/thermal_sessions.md from what there is

A session is drawn by tests/thermal_plant.py. A third are of healthy valves; in the others one of twelve causes is
hidden, in turn. Every other plant has another structure of heat paths, the others scattered figures; every third
session is a launch; in every fourth, body and torque motor were measured. The sets have seeds of their own. Each
session adds a line of JSON. d' counts what is hidden against the meters' noise, as far as a fit of the nuisance
parameters leaves; the strength is set so that this comes near a target, or one where that is less.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: a worker is one core
    os.environ.setdefault(threads, "1")
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]

import hidden_plant  # noqa: E402
import numpy as np  # noqa: E402
from bench_plant import round_temperatures  # noqa: E402
from hidden_report import wilson  # noqa: E402
from thermal_plant import CAUSES, draw_thermal, write_thermal_session  # noqa: E402

import valvesim as vs  # noqa: E402
from valvesim.identification.fit import Fit, evaluate_fit, is_adequate, predict_readings  # noqa: E402
from valvesim.identification.fit_jacobian import linearise_study  # noqa: E402
from valvesim.identification.noise_model import NoiseModel  # noqa: E402
from valvesim.identification.nominal_fit import linearise_nominal, refit_nominal  # noqa: E402
from valvesim.identification.options import DEFAULT_IDENTIFICATION  # noqa: E402
from valvesim.identification.projection import inverse_of  # noqa: E402
from valvesim.identification.session_toml import load_session  # noqa: E402
from valvesim.identification.study import PreparedSession, prepare_session, with_records  # noqa: E402

Row = dict[str, Any]
Records = list[dict[str, np.ndarray]]
SETS = {  # first seed, sessions
    "working": (710_000, 300), "second": (810_000, 300), "third": (910_000, 300), "fourth": (1_010_000, 300),
    "fifth": (1_060_000, 300),
}  # fmt: skip
RESULTS = ROOT / "benchmarks" / "results" / "thermal_sessions.jsonl"
DOCUMENT = ROOT / "docs" / "thermal_sessions.md"
MEASURED = ("body", "torque_motor")
NEAR, TRIES = 1.25, 4  # factor within which a d' is the target's, and how often the strength is tried
TARGETS = (15.0, 10.0, 25.0, 12.0)
CLEAR = 8.0  # d' from which a cause should be named
SAME = {"thermal_lag": ("thermal_network",)}  # another name of the same thing: the heat paths are not as assumed


def sessions(name: str) -> Iterator[Row]:
    """What the sessions of a set are."""
    first, count = SETS[name]
    for k in range(count):
        launch = (k + k // 3) % 3 == 2
        yield {
            "seed": first + k, "hidden": None if k % 3 == 0 else CAUSES[(2 * (k // 3) + k % 3 - 1) % len(CAUSES)],
            "profile": "launch" if launch else "warm_up", "network": ("structure", "scattered")[k % 2],
            "rate": 50.0 if launch else (100.0, 200.0)[(k // 6) % 2], "duration": 40.0 if launch else 20.0,
            "measured": k % 4 == 3,
        }  # fmt: skip


def drawn(spec: Row) -> hidden_plant.Case:
    """The plant and the runs of a session."""
    told = {name: spec[name] for name in ("profile", "network", "hidden", "rate", "duration")}
    return draw_thermal(spec["seed"], **told)


def diagnosed(spec: Row) -> Row:
    """One session, written to a folder and diagnosed from that alone; with a `thermometer` the oil is read
    on a grid of so many kelvin.
    """
    case, row = drawn(spec), dict(spec)
    with tempfile.TemporaryDirectory() as folder:
        strength, clean, row["distance"] = tuned(case, Path(folder))
        write_thermal_session(case, folder, clean, MEASURED if spec["measured"] else (), strength)
        if "thermometer" in spec:
            round_temperatures(folder, spec["thermometer"])
        worked = time.process_time()
        try:
            found = vs.diagnose(folder)
        except (vs.InputError, vs.SolveError) as error:
            return row | {"outcome": f"{type(error).__name__}: {error}"}
        worked = time.process_time() - worked
    ((cause, figures),) = hidden_plant.truth(case, strength)["parameters"].items() if case.hidden else (("", {}),)
    at = f"@{figures['channel']}" if "channel" in figures else ""
    wanted = {**figures, cause.removeprefix("parameter:"): figures.get("value")}
    own = [e for e in found.parameters if case.hidden and e.cause == cause + at and wanted.get(e.name) is not None]
    return row | {
        "outcome": found.verdict, "reason": found.reason, "bench": list(found.bench), "truth": cause + at,
        "set": [answer.label for answer in found.candidates if answer.in_set],
        "first": next((answer.label for answer in found.candidates), ""),
        "covered": [bool(e.low <= wanted[e.name] <= e.high) for e in own if e.low < e.high],
        "processor_seconds": round(worked, 1), "summary": found.summary,
    }  # fmt: skip


def tuned(case: hidden_plant.Case, folder: Path) -> tuple[float, Records, float]:
    """(strength, noise-free records, d') of what is hidden: at the target, or at strength one where that is less."""
    target, quiet = TARGETS[case.seed % len(TARGETS)], hidden_plant.responses(case, 0.0)
    if not case.hidden:
        return 0.0, quiet, 0.0
    write_thermal_session(case, folder, quiet)
    prepared = prepare_session(load_session(folder), options=DEFAULT_IDENTIFICATION)
    paces = {predictor.record.pace for predictor in prepared.predictors}
    noise = {(meter.channel, pace): meter_noise(meter) for meter in case.meters for pace in paces}
    runs = [run.name for run in case.runs]
    places = [runs.index(predictor.record.name) for predictor in prepared.predictors]
    base = fit_to_plant(prepared, noise, [quiet[k] for k in places])
    study = prepared.with_noise(noise)
    J = study.stack(linearise_study(study, base.variant(study.nominal))[1])
    projection = inverse_of(J.T @ J + np.eye(J.shape[1]))

    def changes(strength: float) -> tuple[Records, Records]:
        """The noise-free records, and by how much those that are learnt from differ from those of nothing hidden."""
        clean = hidden_plant.responses(case, strength)
        return clean, [{name: clean[k][name] - quiet[k][name] for name in case.channels} for k in places]

    clean, changed = changes(1.0)
    whole = study.stack([{name: change[:, None] for name, change in one.items()} for one in changed])[:, 0]
    taken = J.T @ whole
    linear = float(np.sqrt(max(whole @ whole - taken @ projection @ taken, 0.0)))
    strength = min(target / max(linear, 1e-9), 1.0)
    for _ in range(TRIES):  # a shift of a null goes with the strength, what it does to a peak does not
        clean, changed = changes(strength)
        found = left_by_fit(prepared, noise, base, changed)
        if found == 0.0:
            break
        more = min(float(np.clip(target / found, 0.1, 10.0)), 1.0 / strength)
        if 1.0 / NEAR < more < NEAR:
            break
        strength *= more
    return strength, clean, round(found, 1)


def fit_to_plant(
    prepared: PreparedSession, noise: Mapping[tuple[str, str], NoiseModel], readings: Sequence[Mapping[str, np.ndarray]]
) -> Fit:
    """The nominal model fitted to noise-free readings (n,) of a plant in which nothing is hidden, by predictor and
    channel: about the nominal valve instead, its peaks and nulls would be elsewhere, and what moves them a little would
    seem to do much.
    """
    study = _reading(prepared, readings).with_noise(noise)
    start = linearise_nominal(study, evaluate_fit(study, np.zeros(len(prepared.nominal.parameters)), ()))
    return refit_nominal(start, start.fit).fit


def left_by_fit(
    prepared: PreparedSession,
    noise: Mapping[tuple[str, str], NoiseModel],
    base: Fit,
    changes: Sequence[Mapping[str, np.ndarray]],
) -> float:
    """d' of changes (n,) of the readings, by predictor and channel, on top of what the model does at a fit: what a fit
    of the nuisance parameters leaves of them; zero where the model has not come near the plant, for that tells nothing.
    Samples next to sharp peaks count as they do in a fit.
    """
    if not is_adequate(base, options=prepared.options):
        return 0.0
    point, before = base.point, predict_readings(prepared, base.variant(prepared.nominal))
    left = []
    for share in (0.0, 0.3, 1.0):  # by and by: a fit of the whole at once may get lost
        changed = [
            {name: read[name] + share * change[name] for name in change}
            for read, change in zip(before, changes, strict=True)
        ]
        study = _reading(prepared, changed).with_noise(noise)
        start = linearise_nominal(study, evaluate_fit(study, point, ()))
        fit = refit_nominal(start, start.fit).fit
        point = fit.point
        left.append(fit.chi_square)
    return float(np.sqrt(max(left[-1] - left[0], 0.0)))


def _reading(prepared: PreparedSession, readings: Sequence[Mapping[str, np.ndarray]]) -> PreparedSession:
    """A session whose training records read otherwise: (n,) by predictor and channel."""
    changed = [
        replace(predictor.record, values={**predictor.record.values, **{name: read[name] for name in read}})
        for predictor, read in zip(prepared.predictors, readings, strict=True)
    ]
    return with_records(prepared, changed, ())


def meter_noise(meter: hidden_plant.Meter) -> NoiseModel:
    """A meter's noise and rounding."""
    rho = meter.colour
    innovation = float(np.hypot(meter.noise, meter.resolution / np.sqrt(12.0)) * np.sqrt(1.0 - rho * rho))
    return NoiseModel(innovation, (rho,) if rho else (), True, "the plant's")


def run(name: str, count: int | None, results: Path, thermometer: Row) -> None:
    """Diagnose what the results do not have yet, a line each."""
    results.parent.mkdir(parents=True, exist_ok=True)
    done = {row["seed"] for row in read_rows(results)}
    git = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude", "*"]
    engine = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    for k, spec in enumerate(sessions(name)):
        if count is not None and k >= count:
            break
        if spec["seed"] not in done:
            row = diagnosed(spec | thermometer) | {"engine": engine}
            with open(results, "a", encoding="utf-8") as file:
                file.write(json.dumps(row, ensure_ascii=False) + "\n")
            print(*_cells(row), sep=" | ", flush=True)


def measure_distances(name: str, results: Path) -> None:
    """Work the d' of what there is of a set out anew, in place."""
    rows, specs = read_rows(results), {spec["seed"]: spec for spec in sessions(name)}
    for row in rows:
        if row["hidden"] and row["seed"] in specs:
            before = row["distance"]
            with tempfile.TemporaryDirectory() as folder:
                _, _, row["distance"] = tuned(drawn(specs[row["seed"]]), Path(folder))
            print(row["seed"], row["hidden"], before, row["distance"], flush=True)
    write_rows(results, rows)


def read_rows(results: Path) -> list[Row]:
    """What there is of results, a line of JSON each."""
    if not results.exists():
        return []
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines() if line]


def write_rows(results: Path, rows: Sequence[Row]) -> None:
    """Results anew, a line of JSON each."""
    results.write_text("".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows), encoding="utf-8")


# ---------------------------------------------------------------- the report


def _is_right(label: str, row: Row) -> bool:
    return label in (row["truth"], *SAME.get(row["truth"], ()))


def _is_false_alarm(row: Row) -> bool:
    """Whether a healthy valve is called faulty: its heat paths may be called other than assumed."""
    return row["outcome"] != "no_discrepancy" and row.get("set") != ["thermal_network"]


def report(name: str, results: Path, document: Path) -> None:
    """A table of what there is of a set: counts with Wilson's intervals, and every session."""
    first, count = SETS[name]
    rows = [row for row in read_rows(results) if first <= row["seed"] < first + count]
    healthy = [row for row in rows if row["hidden"] is None]
    clear = [row for row in rows if row["hidden"] is not None and row["distance"] >= CLEAR]
    tests = {
        "false alarms on healthy valves": [_is_false_alarm(row) for row in healthy],
        "healthy valves whose heat paths were called other than assumed": [
            row.get("set") == ["thermal_network"] for row in healthy
        ],
        f"right cause first, d' of {CLEAR:g} and more": [_is_right(row.get("first", ""), row) for row in clear],
        "right cause in the answer set, the same": [
            any(_is_right(x, row) for x in row.get("set", [])) for row in clear
        ],
        "one cause named, and wrong, over everything": [
            row["outcome"] == "cause"
            and not _is_right(row["first"], row)
            and (_is_false_alarm(row) or row["distance"] >= CLEAR)
            for row in rows
        ],
        "95 % intervals that cover the truth": [hit for row in rows for hit in row.get("covered", [])],
        "refused or failed": [":" in row["outcome"] for row in rows],
    }
    seconds = sorted(row["processor_seconds"] for row in rows if "processor_seconds" in row)
    lines = [
        "# Warm-ups and launches", "",
        f"Written by `benchmarks/thermal_sessions.py report --set {name}` from {len(rows)} sessions of the {name} set.",
        "Records of 20 s while the oil warms from 20 to 80 °C (one cools down), or of 40 s of a launch at 3 to 5 K/s.",
        "The plant's parts follow by other heat paths than the model's: every figure off by up to a factor of two",
        "(scattered), and besides the rod at the oil's temperature at once and the tube halfway between oil and torque",
        "motor (structure). A lag of all parts (`thermal_lag`) and a figure of the network (`thermal_network`) count",
        "as one answer: the heat paths are not as assumed. That is so on every one of these plants, and no wrong name",
        f"where what is hidden has a d' below {CLEAR:g}.", "",
        "|  | measured (95 % interval after Wilson) |", "|---|---|",
        *(f"| {words} | {_share(hits)} |" for words, hits in tests.items()),
        f"| processor time of a session, s | median {np.median(seconds):.0f}, longest {seconds[-1]:.0f} |", "",
        "| seed | hidden | d' | plant | answer | processor, s |", "|---|---|---|---|---|---|",
        *("| " + " | ".join(map(str, _cells(row))) + " |" for row in rows), "",
    ]  # fmt: skip
    document.write_text("\n".join(lines), encoding="utf-8")


def _cells(row: Row) -> tuple[Any, ...]:
    plant = f"{row['profile'].replace('_', '-')}, {row['network']}, {row['rate']:g} Hz"
    found = f": {', '.join(row['set'])}" if row.get("set") else ""
    answer = row["outcome"].replace("_", " ") + found + "".join(f"; {fault}" for fault in row.get("bench", []))
    plant += ", parts measured" if row["measured"] else ""
    return (
        row["seed"],
        row.get("truth") or "-",
        row["distance"] or "-",
        plant,
        answer,
        row.get("processor_seconds", "-"),
    )


def _share(hits: list[bool]) -> str:
    if not hits:
        return "none"
    low, high = wilson(sum(hits), len(hits))
    return f"{np.mean(hits):.0%} ({sum(hits)} of {len(hits)}; {100 * low:.0f} to {100 * high:.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "distances", "report"))
    parser.add_argument("--set", choices=tuple(SETS), default="working", dest="name")
    parser.add_argument("--count", type=int, help="the first so many of the set")
    parser.add_argument("--thermometer", type=float, metavar="KELVIN", help="resolution of the oil's, as run")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("-o", "--output", type=Path, default=DOCUMENT)
    given = parser.parse_args()
    if given.what == "run":
        coarse = {} if given.thermometer is None else {"thermometer": given.thermometer}
        run(given.name, given.count, given.results, coarse)
    elif given.what == "distances":
        measure_distances(given.name, given.results)
    else:
        report(given.name, given.results, given.output)


if __name__ == "__main__":
    main()
