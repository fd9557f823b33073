"""How valvesim takes what it should not be given: counts by outcome, and every case that was not answered well.

    nice .venv/bin/python benchmarks/robustness.py inputs --cases 10000     # mutated inputs of every reader
    nice .venv/bin/python benchmarks/robustness.py scenarios --cases 1000   # random scenarios through the command line
    nice .venv/bin/python benchmarks/robustness.py kills --cases 200        # signals at random moments of commands
    nice .venv/bin/python benchmarks/robustness.py caches                   # damaged caches, four at once, full discs

Outcomes of inputs: `ok` (read; a short scenario also run, every sample finite), `refused` (InputError) and `failed`
(SolveError) with one printable line; `traceback` (any other exception, the end of the process included), `hang` (no
answer within 10 s), `large` (more than 200 MB for a refusal, here or in the process that reads binary formats),
`nonsense` (samples that are not finite, pressures below zero, times that do not rise), `unclear` (a message of several
lines, or unprintable). The readers work in a process of its own with bounded memory, which is ended when it hangs. The
exit code is 1 where anything is bad; `--keep FOLDER` keeps the cases.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import multiprocessing
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import interrupted
import mutations

PATIENCE = 10.0  # s
MEMORY = 6_000_000_000  # bytes of address space; beyond it a MemoryError is a traceback
REFUSAL_MEMORY = 200_000  # kB
GOOD = ("ok", "refused", "failed")


# ---------------------------------------------------------------- inputs


def read(reader: str, folder: Path) -> str:
    """Have a reader read its case; what is nonsense in what it gives, or ""."""
    import numpy as np

    from valvesim.simulation.scenario_toml import load_scenario

    (first, *_) = sorted(folder.iterdir())
    if reader in ("scenario", "table", "oil"):
        return _run(load_scenario(folder / "case.toml"))
    if reader == "session":
        from valvesim.identification.session_toml import load_session

        for record in load_session(folder).records:
            if not (np.diff(record.time) > 0.0).all() or not np.isfinite(record.time).all():
                return f"the times of {record.name} do not rise"
    elif reader == "valve":
        from valvesim.valve.valve_file import load_valve

        load_valve(first)
    elif reader == "specification":
        from valvesim.characterisation.specification import load_specification

        load_specification(first)
    elif reader == "study":
        from valvesim.studies.study_toml import load_study

        if not np.isfinite(np.asarray(load_study(first).draws(), dtype=float)).all():
            return "draws are not finite"
    elif reader == "plan":
        from valvesim.planning.plan_toml import load_plan

        load_plan(first)
    elif reader == "effects":
        from valvesim.valve.effect_files import load_effects

        load_effects(first)
    elif reader in ("record", "columns"):
        from valvesim.identification.session import UNITS
        from valvesim.measurement.recording import read_recording
        from valvesim.measurement.survey import survey_stated

        stated = survey_stated(folder / "columns.toml" if reader == "columns" else None, None)
        found = read_recording([next(p for p in folder.iterdir() if p.suffix != ".toml")], UNITS, stated=stated)
        if not (np.diff(found.time) > 0.0).all() or not np.isfinite(found.time).all():
            return "times do not rise"
    else:
        raise KeyError(reader)
    return ""


def _run(case: Any) -> str:
    """What is nonsense in the run of a short scenario."""
    import numpy as np

    from valvesim.simulation.result import check_channels
    from valvesim.simulation.run import simulate

    check_channels(case)
    if case.duration > 0.1:
        return ""
    for name, values in simulate(case).values.items():
        if not np.isfinite(values).all():
            return f"{name} is not finite"
        if name in ("supply_pressure", "return_pressure") and (values < 0.0).any():
            return f"{name} below zero"
    return ""


def outcome(reader: str, folder: Path) -> tuple[str, str]:
    """(outcome, message) of one case, in this process."""
    from valvesim.errors import InputError, SolveError

    try:
        nonsense = read(reader, folder)
    except (InputError, SolveError) as error:
        told = str(error)
        clear = told and "\n" not in told and told.isprintable() and len(told) < 2000
        return ("unclear" if not clear else "refused" if isinstance(error, InputError) else "failed"), told
    except BaseException:
        return "traceback", traceback.format_exc()
    return ("nonsense", nonsense) if nonsense else ("ok", "")


def work(pipe: Connection) -> None:
    """Answer cases by (outcome, message, seconds, kB) until the pipe ends.

    kB are what this process held more than before, or all of the process that read a binary format.
    """
    warnings.simplefilter("ignore")
    watch_readers()
    sys.stdout = sys.stderr = io.StringIO()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    with contextlib.suppress(EOFError):
        while True:
            reader, folder = pipe.recv()
            before, begin, READERS_PEAK[0] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic(), 0
            found, told = outcome(reader, folder)
            more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
            pipe.send((found, told, time.monotonic() - begin, max(more, READERS_PEAK[0])))


READERS_PEAK = [0]


def watch_readers() -> None:
    """Keep the peak of memory of every process that read a binary format, as it is ended after a refusal."""
    from valvesim.measurement.reader_process import Reader

    end = Reader.end

    def watched(reader: Reader, patience: float = 0.0) -> int:
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{reader.process.pid}/status").read_text().splitlines():
                if line.startswith("VmHWM"):  # none of a process that has crashed
                    READERS_PEAK[0] = max(READERS_PEAK[0], int(line.split()[1]))
        return end(reader, patience)

    Reader.end = watched  # type: ignore[method-assign]


class Worker:
    """A process that answers cases, begun again where one ended it."""

    def __init__(self) -> None:
        self.process: Any = None

    def ask(self, reader: str, folder: Path, patience: float) -> tuple[str, str, float, int]:
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.pipe, other = context.Pipe()
            self.process = context.Process(target=work, args=(other,), daemon=True)
            self.process.start()
            other.close()
            patience = max(patience, 60.0)
        self.pipe.send((reader, folder))
        try:
            if self.pipe.poll(patience):
                return self.pipe.recv()
            found = "hang", f"more than {patience:g} s"
        except EOFError:
            self.process.join(5.0)
            found = "traceback", f"the process ended with {self.process.exitcode}"
        self.process.kill()
        self.process.join()
        self.process = None
        return (*found, patience, 0)


def inputs(cases: int, seed: int, keep: Path | None) -> collections.Counter[str]:
    """Mutated inputs of every reader."""
    rng, worker = random.Random(seed), Worker()
    counts: collections.Counter[str] = collections.Counter()
    table: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    slowest: tuple[float, str] = (0.0, "")
    largest: tuple[int, str] = (0, "")
    for k in range(cases):
        reader, files = mutations.draw(rng)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write(files, folder)
            found, told, seconds, more = worker.ask(reader, folder, 60.0)
            if seconds > PATIENCE and found in GOOD:  # a compilation takes longer, once
                found, told, seconds, more = worker.ask(reader, folder, PATIENCE)
            if found == "refused":
                if seconds > slowest[0] or more > largest[0]:  # what was loaded for the first time does not count
                    found, told, seconds, more = worker.ask(reader, folder, PATIENCE)
                slowest = max(slowest, (seconds, f"{reader} {k}: {told[:100]}"))
                largest = max(largest, (more, f"{reader} {k}: {told[:100]}"))
                if more > REFUSAL_MEMORY:
                    found = "large"
            counts[found] += 1
            table[reader][found] += 1
            so_far(k + 1, counts)
            if found not in GOOD:
                report(f"{reader} {k}", found, told, keep and keep / f"{seed}_{k}_{reader}", files)
    for reader in sorted(table):
        print(f"{reader:14} " + ", ".join(f"{name} {count}" for name, count in sorted(table[reader].items())))
    print(f"slowest refusal {slowest[0]:.2f} s ({slowest[1]})")
    print(f"largest refusal {largest[0] / 1e3:.0f} MB ({largest[1]})")
    return counts


def so_far(cases: int, counts: collections.Counter[str]) -> None:
    """Tell now and then how many cases are through: a run may be stopped."""
    if cases % 50 == 0:
        print(f"{cases}: {', '.join(f'{name} {count}' for name, count in sorted(counts.items()))}", file=sys.stderr)


def write(files: dict[str, str | bytes], folder: Path) -> None:
    """Write the files of a case."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))


def report(what: str, found: str, told: str, folder: Path | None, files: dict[str, str | bytes]) -> None:
    """Print what is wrong, and keep the case."""
    last = told.strip().splitlines()[-1] if told.strip() else ""
    print(f"{what}: {found}: {last}"[:300], flush=True)
    if folder is not None:
        write(files, folder)
        (folder / "answer.txt").write_text(told, encoding="utf-8", errors="replace")


# ---------------------------------------------------------------- random scenarios through the command line


def scenarios(cases: int, seed: int, keep: Path | None) -> collections.Counter[str]:
    """Random scenarios through `valvesim run`, in this process: every file whole, every sample finite."""
    import numpy as np
    import xarray
    from random_scenarios import scenarios as draw

    from valvesim.cli import main as command_line
    from valvesim.simulation.scenario_toml import scenario_to_toml

    counts: collections.Counter[str] = collections.Counter()
    warnings.simplefilter("ignore")
    for k, case in enumerate(draw(seed, cases)):
        text = scenario_to_toml(case)
        with tempfile.TemporaryDirectory() as name:
            path, out = Path(name) / "case.toml", Path(name) / "out"
            path.write_text(text, encoding="utf-8")
            code, told = call(command_line.main, ["run", str(path), "-o", str(out), "--no-pictures"])
            if code == 0:
                with xarray.open_dataset(out / "result.nc") as result:
                    finite = all(
                        np.isfinite(values).all() for values in result.variables.values() if values.dtype.kind == "f"
                    )
                found = "ok" if finite and interrupted.whole(out) else "nonsense"
            elif code in (1, 2) and told.count("\n") == 1 and not out.exists():
                found = "failed" if code == 1 else "refused"
            else:
                found = "traceback" if code not in (1, 2) or told.count("\n") != 1 else "left"
            counts[found] += 1
            so_far(k + 1, counts)
            if found not in ("ok", "failed"):
                report(f"scenario {k}", found, told, keep and keep / f"{seed}_{k}_run", {"case.toml": text})
    return counts


def call(main: Callable[[], None], words: list[str]) -> tuple[int, str]:
    """(exit code, standard error without warnings) of a command line in this process."""
    sys.argv = ["valvesim", *words]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:
            code, _ = 70, err.write(traceback.format_exc())
    lines = [line for line in err.getvalue().splitlines(True) if not line.startswith("warning: ")]
    return code, "".join(lines)


# ---------------------------------------------------------------- kills

SMALL = 'title = "Small"\nduration = "20 ms"\n[thermal]\nisothermal = true\n[command.current]\n' \
        'step = { after = "5 mA", time = "5 ms" }\n[outputs]\nrate = "10 kHz"\n'  # fmt: skip
LONG = SMALL.replace("20 ms", "60000 s").replace("10 kHz", "1 Hz").replace("5 ms", "1 s").replace(
    'step = { after = "5 mA", time = "1 s" }', 'sine = { amplitude = "2 mA", frequency = "10 Hz" }'
)  # fmt: skip
COMMANDS: dict[str, list[str]] = {
    "run": ["run", "small.toml"],
    "run, long": ["run", "long.toml", "--no-pictures"],
    "response": ["response", "--oil-temperature", "20 degC"],
    "bench": ["bench"],
    "datasheet": ["datasheet"],
    "reproduce": ["reproduce", "--starts", "1"],
    "diagnose": ["diagnose", "session"],
    "identify": ["identify", "page.toml"],
    "records": ["records", "session/a.csv"],
    "study": ["study", "study.toml", "--workers", "2"],
    "study, alone": ["study", "study.toml", "--workers", "0"],
    "plan": ["plan", "plan.toml"],
    "export fmu": ["export", "fmu", "small.toml"],
    "export c": ["export", "c", "small.toml"],
    "open": ["open", "session/a.csv", "--no-browser"],
}
ONE_FILE = {"identify": "valve.toml", "export fmu": "valve.fmu", "open": "page.html"}


def kills(cases: int, seed: int, keep: Path | None) -> collections.Counter[str]:
    """Signals at random moments of every command, with earlier results in the folder or none."""
    rng, counts = random.Random(seed), collections.Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        inputs_of_kills(place)
        environment = dict(os.environ, VALVESIM_CACHE_DIR=str(place / "cache"), VALVESIM_DATA_DIR=str(place / "data"))
        for k in range(cases):
            what = list(COMMANDS)[k % len(COMMANDS)]
            if rng.random() < 0.3:
                shutil.rmtree(place / "cache", ignore_errors=True)
            found, told = killed_once(rng, what, place, environment)
            for each in found or ["ok"]:
                counts[each] += 1
            if found:
                print(f"{k} {what}: {', '.join(found)}: {told}", flush=True)
    return counts


def inputs_of_kills(place: Path) -> None:
    """The files that the commands read."""
    (place / "session").mkdir()
    for name, text in (
        ("small.toml", SMALL), ("long.toml", LONG), ("page.toml", mutations.SPECIFICATION),
        ("study.toml", mutations.STUDY), ("plan.toml", mutations.PLAN), ("session/a.csv", mutations.columns()),
        ("session/b.csv", mutations.columns(100)), ("session/session.toml", "seed = 3\n"),
    ):  # fmt: skip
        (place / name).write_text(text, encoding="utf-8")


def killed_once(rng: random.Random, what: str, place: Path, environment: dict[str, str]) -> tuple[list[str], str]:
    """(what is wrong, what happened) after one signal at a random moment of a command."""
    number, wait = rng.choice(interrupted.SIGNALS), rng.uniform(0.05, interrupted.LONGEST)
    out = place / "out"
    shutil.rmtree(out, ignore_errors=True)
    one_file = what in ONE_FILE
    resumed = what.startswith("study")  # a study goes on where it was: its store stays
    earlier = not resumed and not one_file and rng.random() < 0.5
    if earlier:
        out.mkdir()
        results = {"earlier.txt": b"earlier"}
        command = COMMANDS[what][1 if what.startswith("export") else 0]
        listed = {name: interrupted.hash_of(data) for name, data in results.items()}
        for name, data in {**results, "manifest.json": json.dumps({"commands": {command: listed}}).encode()}.items():
            (out / name).write_bytes(data)
    before = interrupted.state(out)
    target = str(out / ONE_FILE[what]) if one_file else str(out)
    end = interrupted.killed([*COMMANDS[what], "-o", target], number, wait, environment, place)
    found = interrupted.judged(*end, number)
    after = interrupted.state(out)
    if not resumed and not (after == before or (out.exists() and (one_file or interrupted.whole(out)))):
        found.append("lost")
    if number != interrupted.signal.SIGKILL or end[0] is None:
        kept = {"session", "cache", "data", "out"} | {path.name for path in place.glob("*.toml")}
        hidden = [path for path in place.rglob(".*") if path.name.startswith((".valvesim-", ".new-", ".valve-"))]
        if {path.name for path in place.iterdir()} - kept or hidden or (out.exists() and not any(out.iterdir())):
            found.append("left")
    for path in [*place.glob(".valvesim-*"), *place.glob("cache/compiled/.new-*")]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return found, f"{interrupted.signal.Signals(number).name} after {wait:.2f} s: {end}"[:600]


# ---------------------------------------------------------------- caches


def caches(cases: int, seed: int, keep: Path | None) -> collections.Counter[str]:
    """A run from a damaged, missing, read-only or full cache, and four at once from an empty one: all give the same."""
    rng, counts = random.Random(seed), collections.Counter[str]()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / "small.toml").write_text(SMALL, encoding="utf-8")
        wanted = run_with(place, place / "cache")
        assert wanted is not None
        for k in range(cases):
            damaged = damage(rng, place / "cache")
            counts["ok" if run_with(place, place / "cache") == wanted else "bad"] += 1
            if counts["bad"]:
                print(f"{k}: {damaged}")
        for kind, cache in (
            ("a file", place / "small.toml"),
            ("/dev/full", Path("/dev/full")),
            ("nowhere", Path("/proc/x")),
        ):
            right = run_with(place, cache) == wanted
            counts["ok" if right else "bad"] += 1
            if not right:
                print(f"cache is {kind}")
        for _ in range(max(cases // 20, 1)):
            shutil.rmtree(place / "cache")
            counts["ok" if all(each == wanted for each in at_once(place, 4)) else "bad"] += 1
    return counts


def run_with(place: Path, cache: Path) -> bytes | None:
    """The figures that a run gives with a cache folder; None where it fails or says more than warnings."""
    return at_once(place, 1, cache)[0]


def at_once(place: Path, count: int, cache: Path | None = None) -> list[bytes | None]:
    """The figures of so many runs at the same time, into the same folder."""
    out = place / "out"
    environment = dict(os.environ, VALVESIM_CACHE_DIR=str(cache or place / "cache"))
    words = [sys.executable, "-m", "valvesim", "run", "small.toml", "-o", str(out), "--no-pictures", "--csv"]
    begun = [
        subprocess.Popen(words, cwd=place, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        for _ in range(count)
    ]
    found: list[bytes | None] = []
    for process in begun:
        _, err = process.communicate(timeout=300)
        lines = [line for line in err.decode().splitlines() if not line.startswith("warning: ")]
        good = process.returncode == 0 and not lines
        if not good:
            print(f"code {process.returncode}: {err.decode()[-500:]}")
        found.append((out / "result.csv").read_bytes() if good and interrupted.whole(out) else None)
    shutil.rmtree(out, ignore_errors=True)
    return found


def damage(rng: random.Random, cache: Path) -> str:
    """Damage a random file of the cache in a random way; what was done."""
    path = rng.choice(sorted(path for path in cache.rglob("*") if path.is_file()))
    data = path.read_bytes()
    at = rng.randrange(len(data) or 1)
    kind = rng.choice(["empty", "cut", "flipped", "gone", "folder", "junk", "swapped"])
    if kind == "empty":
        path.write_bytes(b"")
    elif kind == "cut":
        path.write_bytes(data[:at])
    elif kind == "flipped":
        path.write_bytes(data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)] if data else []) + data[at + 1 :])
    elif kind == "junk":
        path.write_bytes(rng.randbytes(rng.randrange(2000)))
    elif kind == "swapped":
        path.write_bytes(rng.choice([p for p in cache.rglob("*") if p.is_file()]).read_bytes())
    else:
        path.unlink()
        if kind == "folder":
            path.mkdir()
    return f"{kind}: {path.relative_to(cache)}"


PARTS = {"inputs": (inputs, 10_000), "scenarios": (scenarios, 1000), "kills": (kills, 200), "caches": (caches, 60)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--cases", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="Folder for the cases that were not answered well.")
    options = parser.parse_args()
    run, usual = PARTS[options.part]
    begin, cases = time.monotonic(), usual if options.cases is None else options.cases
    counts = run(cases, options.seed, options.keep)
    print(", ".join(f"{name} {count}" for name, count in sorted(counts.items())))
    print(f"{options.part}: {cases} cases, seed {options.seed}, {time.monotonic() - begin:.0f} s")
    raise SystemExit(any(count for name, count in counts.items() if name not in GOOD))


if __name__ == "__main__":
    main()
