"""What becomes of mutated scenario files: counts by outcome, and every file that was not answered well.

    .venv/bin/python benchmarks/robustness.py                          # 2,000 files from seed 0
    .venv/bin/python benchmarks/robustness.py --files 200 --seed 7 --keep /tmp/finds

Outcomes: `ok` (loaded and run, every sample finite), `refused` (InputError) and `failed` (SolveError) with one
printable line, `traceback` (any other exception, the end of the process included), `hang` (no answer within 10 s),
`nonsense` (samples that are not finite, or pressures below zero), `unclear` (a message of several lines, or
unprintable). What lasts beyond 0.1 s is loaded, not run. Files are read in a process that is ended when it hangs; its
first answers may take 60 s, for compilation, and are asked for again. The exit code is 1 where anything is bad.
"""

from __future__ import annotations

import argparse
import collections
import multiprocessing
import random
import resource
import tempfile
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

PATIENCE = 10.0  # s
MEMORY = 6_000_000_000  # bytes of address space; beyond it a MemoryError is a traceback
GOOD = ("ok", "refused", "failed")

SEEDS = [
    '[command.current]\nsine = { amplitude = "2 mA", frequency = "50 Hz", offset = "1 mA" }\n',
    '[command.current]\nstep = { before = "-1 mA", after = "5 mA", time = "5 ms" }\n[thermal]\nisothermal = true\n',
    '[command.current]\npulse = { base = "1 mA", height = "2 mA", width = "1 ms", time = "2 ms", period = "5 ms" }\n'
    '[thermal.oil_temperature]\nramp = { start_value = "20 degC", end_value = "100 degC", rate = "3 degC/s" }\n',
    '[command.voltage]\nconstant = "2 V"\n[pressures]\nsupply = "210 bar"\nreturn = "5 bar"\n'
    'load = { sine = { amplitude = "20 bar", frequency = "30 Hz" } }\n',
    '[command.current]\nchirp = { amplitude = "1 mA", start_frequency = "1 Hz", end_frequency = "200 Hz", '
    'duration = "20 ms", logarithmic = true }\n[thermal]\nroutes = ["flow", "mmf"]\nthrottling_heat = true\n'
    'initial_temperature = { body = "60 degC", spool = "20 degC" }\n',
    '[command.current.table]\ntimes = "0, 5, 10 ms"\nvalues = "0, 2, -1 mA"\n[valve]\nnull_gap = "0.03 mm"\n'
    'spool_mass = "5 g"\n[oil]\nname = "yh12_paper"\ndensity_at_20 = "850 kg/m^3"\n',
    '[command.current]\nstaircase = { end_value = "5 mA", steps = 4, hold = "4 ms" }\n[[effects.sensor_bias]]\n'
    'channel = "spool_position"\nbias = "5 um"\n[effects.coil_turns_loss]\nloss = "5 %"\n'
    '[effects.spool_coulomb_friction]\nfriction_force = "1 N"\n',
    '[command.current]\nconstant = "1 mA"\nsine = { amplitude = "1 mA", frequency = "20 Hz" }\n'
    '[thermal.oil_temperature]\nconstant = "40 degC"\npulse = { height = "30 K", width = "3 ms", time = "5 ms" }\n'
    '[outputs]\nrate = "5 kHz"\nchannels = ["spool_position"]\n[solver]\ntolerance = 1e-4\n',
]
WORDS = [
    "",
    "0",
    "-1",
    "1e999",
    "nan",
    "inf",
    "-inf bar",
    "1e308 bar",
    "1e-320 s",
    "20 C",
    "0,03 mm",
    "3000 psig",
    "80 K",
    "-300 degC",
    "1e9 degC",
    "1e300 mA",
    "1 A",
    "-5 V",
    "1e-9 s",
    "1e5 s",
    "1e5 Hz",
    "1e7 Hz",
    "210 bar",
    "\x1b[31mred",
    "\u202eabc",
    "9" * 5000 + " m",
    "é",
    "1 m**9**9",
    " " * 4000 + "x",
    "a" * 4000,
    "1 " + "(" * 500,
    "\x7f",
    "🔧",
    "/dev/zero",
    ".",
    "../..",
    "nowhere.csv",
    "1e-300 kg",
    "1e300 Hz",
    "5 um",
    "1 %",
]
BARE = [
    "true",
    "false",
    "0",
    "-1",
    "1e400",
    "nan",
    "inf",
    "1979-05-27",
    "[]",
    "{}",
    "[1, 2]",
    "[[[[[[1]]]]]]",
    '"""x\ny"""',
    "9" * 5000,
    "0x" + "f" * 5000,
    "[" * 900 + "]" * 900,
    "{ a = 1 }",
    "1979-05-27T07:32:00Z",
    "'x'",
]
LINES = [
    "[valve]",
    "[effects]",
    "[[valve]]",
    "[comand.current]",
    'duraton = "1 s"',
    "x" * 40_000 + ' = "1"',
    "a." * 3000 + "a = 1",
    '[effects.entrained_air]\nair_fraction = "2 %"',
    '[[effects.sensor_bias]]\nchannel = "load_flow"\nbias = "1 L/min"',
    '[effects.thermal_lag]\ntime_constant = "1 s"',
    'title = "\\u001b[31m"',
    'effects_files = ["/dev/zero"]',
    "\x00",
    "= 1",
    "[",
    "[command]",
    '[pressures]\nsupply = { sine = { amplitude = "300 bar", offset = "210 bar" } }',
    '[command.current]\ntable = { file = "/dev/zero" }',
    '[thermal.initial_temperature]\noil = "20 degC"',
]


def mutated(rng: random.Random) -> str:
    """A scenario of the seeds with one to three faults or changes."""
    text = 'title = "fuzz"\nduration = "20 ms"\n' + rng.choice(SEEDS)
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3])):
        lines = text.split("\n")
        k = rng.randrange(len(lines))
        match rng.randrange(9):
            case 0:
                del lines[k]
            case 1:
                lines.insert(k, rng.choice(LINES))
            case 2:
                lines.insert(k, lines[rng.randrange(len(lines))])
            case 3:  # a quoted figure becomes another
                parts = lines[k].split('"')
                if len(parts) > 2:
                    parts[rng.randrange(1, len(parts), 2)] = (
                        rng.choice(WORDS).replace("\x1b", "\\u001b").replace("\x7f", "\\u007f")
                    )
                lines[k] = '"'.join(parts)
            case 4:  # a value becomes one of another type
                key, equals, _ = lines[k].partition("=")
                lines[k] = f"{key}= {rng.choice(BARE)}" if equals else lines[k]
            case 5:  # a number is scaled
                parts = lines[k].split('"')
                if len(parts) > 2:
                    at = rng.randrange(1, len(parts), 2)
                    number, _, unit = parts[at].partition(" ")
                    try:
                        parts[at] = f"{float(number) * rng.choice([-1, 0, 1e-6, 1e-3, 10, 1e3, 1e6, 1e12]):g} {unit}"
                    except ValueError:
                        pass
                lines[k] = '"'.join(parts)
            case 6:  # a letter is lost, doubled or exchanged
                if lines[k]:
                    at = rng.randrange(len(lines[k]))
                    lines[k] = (
                        lines[k][:at]
                        + rng.choice(["", lines[k][at] * 2, chr(rng.randrange(32, 700))])
                        + lines[k][at + 1 :]
                    )
            case 7:
                lines = [*lines[:k], *lines[k:][: rng.randint(0, 3)]]
            case 8:
                lines[k] = lines[k].replace("=", rng.choice(["==", ":", " = = ", "= \n"]), 1)
        text = "\n".join(lines)
    return text


def outcome(path: Path) -> tuple[str, str]:
    """(outcome, message) of one file, in this process."""
    import numpy as np

    from valvesim.errors import InputError, SolveError
    from valvesim.simulation.result import check_channels
    from valvesim.simulation.run import simulate
    from valvesim.simulation.scenario_toml import load_scenario

    try:
        case = load_scenario(path)
        check_channels(case)
        if case.duration > 0.1:
            return "ok", "too long to be run"
        result = simulate(case)
    except (InputError, SolveError) as error:
        told = str(error)
        clear = told and "\n" not in told and told.isprintable() and len(told) < 2000
        return ("unclear" if not clear else "refused" if isinstance(error, InputError) else "failed"), told
    except Exception:
        return "traceback", traceback.format_exc()
    for name, values in result.values.items():
        if not np.isfinite(values).all():
            return "nonsense", f"{name} is not finite"
        if name in ("supply_pressure", "return_pressure") and (values < 0.0).any():
            return "nonsense", f"{name} below zero"
    return "ok", ""


def work(pipe: Connection) -> None:
    """Answer files by their outcome until the pipe ends."""
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    while True:
        try:
            pipe.send(outcome(Path(pipe.recv())))
        except EOFError:
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="Folder for the files that were not answered well.")
    options = parser.parse_args()
    rng, counts = random.Random(options.seed), collections.Counter[str]()
    context = multiprocessing.get_context("spawn")
    worker: Any = None
    slowest = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for k in range(options.files):
            path = Path(folder) / "case.toml"
            path.write_bytes(mutated(rng).encode("utf-8", "surrogatepass"))
            for fresh in (True, False):  # a compilation may take longer, once: then the file is tried again
                if worker is None:
                    pipe, other = context.Pipe()
                    worker = context.Process(target=work, args=(other,), daemon=True)
                    worker.start()
                    other.close()
                    patience = 60.0
                else:
                    patience = 60.0 if fresh else PATIENCE
                begin = time.monotonic()
                pipe.send(str(path))
                try:
                    found, told = pipe.recv() if pipe.poll(patience) else ("hang", f"more than {patience:g} s")
                except EOFError:
                    found, told = "traceback", "the process ended"
                seconds = time.monotonic() - begin
                if found == "hang" or told == "the process ended":
                    worker.kill()
                    worker.join()
                    worker = None
                if seconds <= PATIENCE or found == "hang":
                    break
            slowest = max(slowest, seconds)
            if seconds > PATIENCE and found != "hang":
                found, told = "hang", f"{seconds:.1f} s, twice"
            counts[found] += 1
            if found not in GOOD:
                print(f"file {k}: {found}: {told.strip().splitlines()[-1] if told else ''}"[:300], flush=True)
                if options.keep is not None:
                    options.keep.mkdir(parents=True, exist_ok=True)
                    (options.keep / f"{options.seed}_{k}.toml").write_bytes(path.read_bytes())
                    (options.keep / f"{options.seed}_{k}.txt").write_text(told, encoding="utf-8")
    if worker is not None:
        pipe.close()
        worker.join(5.0)
    print(", ".join(f"{name} {counts[name]}" for name in (*GOOD, "traceback", "hang", "nonsense", "unclear")))
    print(f"slowest answer {slowest:.1f} s, {options.files} files, seed {options.seed}")
    raise SystemExit(any(count for name, count in counts.items() if name not in GOOD))


if __name__ == "__main__":
    main()
