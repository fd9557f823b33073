"""A fixed set of sessions and scenarios and the answers to them: whether a change of the code changes any answer.

    .venv/bin/python benchmarks/answers.py run /tmp/answers-before             # at the commit before the change
    .venv/bin/python benchmarks/answers.py run /tmp/answers-after              # at the commit after it
    .venv/bin/python benchmarks/answers.py compare /tmp/answers-before /tmp/answers-after

`run` writes a JSON file for each case: `diagnosis.json` of each session, and of each scenario a hash and a few values
of every channel. It uses only what `valvesim` exports and `tests/hidden_plant.py`, so that one copy runs at any commit.
`compare` prints a line for each case and ends with code 1 where an answer, apart from its wording, is not the same.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import numpy as np  # noqa: E402
from hidden_plant import draw, write_session  # noqa: E402

import valvesim as vs  # noqa: E402

SESSIONS = {  # seed, kind, what is hidden, strength
    "empty": (3, "none", None, 0.0),
    "coulomb_friction": (3, "effect", "spool_coulomb_friction", 1.0),
    "magnetic_hysteresis": (5, "effect", "magnetic_hysteresis", 1.0),
    "sensor_bias": (3, "sensor", "sensor_bias", 1.0),
    "stiffness_loss": (4, "effect", "flexure_stiffness_loss", 4.0),
    "outside_the_catalogue": (6, "outside", "quadratic_spool_damping", 1.0),
    "parameter_off": (7, "parameter", "feedback_rod_stiffness", 1.0),
    "pair": (2, "pair", "spool_coulomb_friction+supply_pressure_droop", 1.0),
}
LONGEST = 600  # samples of a record that are kept
RECORDS = ("record_1", "record_2", "record_6", "record_4")  # a test, another, the repeat of the first, a locked one

SETTINGS: dict[str, dict[str, str]] = {
    "step": {},
    "sine_sweep": {"duration": "1 s"},
    "static_map": {"duration": "10 s"},
    "launch_shock": {"duration": "5 s"},
    "cold_start": {"duration": "10 s"},
    "experiment_section_v": {"duration": "30 s"},
}
"""Scenarios of the folder, and what is changed of them so that they are short."""

THERMAL = (
    '[thermal]\nisothermal = true\n[command.{drive}]\nstep = {{ before = "0 {u}", after = "2 {u}", time = "5 ms" }}\n'
)
OWN = {
    "voltage_drive": 'duration = "60 ms"\n' + THERMAL.format(drive="voltage", u="V"),
    "friction_and_hysteresis": 'duration = "60 ms"\n'
    + THERMAL.format(drive="current", u="mA")
    + """
[effects.spool_coulomb_friction]
friction_force = "2 N"
[effects.magnetic_hysteresis]
coercive_current = "0.2 mA"
""",
    "lagged_sensor": 'duration = "60 ms"\n'
    + THERMAL.format(drive="current", u="mA")
    + """
[[effects.sensor_lag]]
channel = "load_flow"
time_constant = "1 ms"
""",
}
"""Scenarios of its own."""


def session(name: str, folder: Path) -> None:
    """Write a session's folder."""
    seed, kind, hidden, strength = SESSIONS[name]
    case = draw(seed, kind, name=hidden)
    runs = [
        replace(run, command=run.command[:LONGEST], oil=run.oil[:LONGEST]) for run in case.runs if run.name in RECORDS
    ]
    write_session(replace(case, runs=tuple(runs)), folder, strength)


def diagnosed(name: str) -> dict[str, Any]:
    """The answer to a session, with a hash of its files."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "session"
        session(name, folder)
        files = b"".join(path.read_bytes() for path in sorted(folder.iterdir()))
        found = vs.diagnose(folder).to_json(Path(place) / "diagnosis.json")
        return {"session": hashlib.sha256(files).hexdigest(), "diagnosis": json.loads(found.read_text("utf-8"))}


def simulated(scenario: vs.Scenario) -> dict[str, Any]:
    """Of each channel of a run: a hash of its values, their span, the last, and every hundredth part."""
    result = vs.simulate(scenario)
    table = {}
    for name, values in {"time": result.time, **result.values}.items():
        values = np.ascontiguousarray(values, dtype=float)
        some = values[np.linspace(0, len(values) - 1, 101).astype(int)]
        table[name] = {
            "hash": hashlib.sha256(values.tobytes()).hexdigest(), "span": float(np.ptp(values)),
            "values": [float(v) for v in some],
        }  # fmt: skip
    return table


def scenario(name: str, folder: Path) -> vs.Scenario:
    """A scenario of the folder, shortened, or one of our own."""
    if name in SETTINGS:
        path = ROOT / "scenarios" / f"{name}.toml"
        text = path.read_text(encoding="utf-8")
        for key, value in SETTINGS[name].items():
            lines = [f'{key} = "{value}"' if line.startswith(f"{key} =") else line for line in text.splitlines()]
            text = "\n".join(lines)
        text = text.replace('"triangle.csv"', json.dumps(str(path.parent / "triangle.csv")))
    else:
        text = OWN[name]
    (folder / "scenario.toml").write_text(text, encoding="utf-8")
    return vs.load_scenario(folder / "scenario.toml")


def _simulated(name: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as place:
        return simulated(scenario(name, Path(place)))


def run(folder: Path, only: list[str]) -> None:
    """Write the answer to each case."""
    folder.mkdir(parents=True, exist_ok=True)
    jobs: dict[str, Callable[[str], dict[str, Any]]] = dict.fromkeys((*SETTINGS, *OWN), _simulated)
    jobs |= dict.fromkeys(SESSIONS, diagnosed)
    for name, job in jobs.items():
        if only and name not in only:
            continue
        begin = time.perf_counter()
        answer = job(name)
        (folder / f"{name}.json").write_text(json.dumps(answer, indent=1, ensure_ascii=False) + "\n", "utf-8")
        verdict = answer.get("diagnosis", {}).get("verdict", "simulated")
        print(f"{name}: {verdict} in {time.perf_counter() - begin:.1f} s", flush=True)


# ---------------------------------------------------------------- comparison


def leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Every number, text and None of an answer, with its place."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from leaves(each, f"{where}.{key}")
    elif isinstance(value, list):
        for k, each in enumerate(value):
            yield from leaves(each, f"{where}[{k}]")
    else:
        yield where, value


def compared(before: dict[str, Any], after: dict[str, Any]) -> tuple[str, bool]:
    """(what is to be said of two answers, whether they are the same apart from wording)."""
    old, new = dict(leaves(before)), dict(leaves(after))
    spans = {where.removesuffix(".span"): v for where, v in old.items() if where.endswith(".span")}
    largest, at, texts, structure, hashes = 0.0, "", [], [], 0
    for where in dict.fromkeys((*old, *new)):
        a, b = old.get(where, "absent"), new.get(where, "absent")
        if a == b:
            continue
        if where.endswith(".hash"):
            hashes += 1
        elif isinstance(a, (int, float)) and isinstance(b, (int, float)) and not isinstance(a, bool):
            scale = spans.get(where.partition(".values[")[0], 0.0) or max(abs(a), abs(b))
            if (off := abs(a - b) / scale) > largest:
                largest, at = off, where
        elif isinstance(a, str) and isinstance(b, str) and where in old and where in new and not _decides(where):
            texts.append(f"{where}: {a!r} -> {b!r}")
        else:
            structure.append(f"{where}: {a!r} -> {b!r}")
    numbers = "same bits" if not largest and not hashes else f"largest relative difference {largest:.2g} at {at}"
    said = [numbers, *structure, *(f"wording {text}" for text in texts)]
    return "\n    ".join(said), not structure and not largest and not hashes


def _decides(where: str) -> bool:
    """Whether a text is part of the answer and not its wording."""
    return any(part in where for part in (".verdict", ".causes", ".names", ".session", ".cause", ".name"))


def compare(before: Path, after: Path) -> bool:
    """Print what differs; whether nothing does but wording."""
    same = True
    for path in sorted(before.glob("*.json")):
        other = after / path.name
        if not other.exists():
            print(f"{path.stem}: not run")
            same = False
            continue
        said, alike = compared(*(json.loads(p.read_text(encoding="utf-8")) for p in (path, other)))
        print(f"{path.stem}: {said}")
        same &= alike
    return same


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="what", required=True)
    one = commands.add_parser("run", help="write the answers of this commit into a folder")
    one.add_argument("folder", type=Path)
    one.add_argument("--only", nargs="+", default=[], choices=[*SETTINGS, *OWN, *SESSIONS])
    two = commands.add_parser("compare", help="compare two folders")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    options = parser.parse_args()
    if options.what == "compare":
        sys.exit(0 if compare(options.before, options.after) else 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run(options.folder, options.only)


if __name__ == "__main__":
    main()
