"""What a new user waits for: install, first runs, an own valve, looking things up; and the sizes of what is left.

    python benchmarks/new_user.py FOLDER [--installed VENV]

Builds the wheel from this checkout, installs it into a fresh virtual environment in FOLDER (from the package index that
pip is set to) and runs the commands with an empty cache. Processor seconds of the command and its children are told,
for they depend least on what else the machine does; wall seconds stand beside them.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VALVE = 'title = "Own valve"\n[valve]\nnull_gap = { value = "33 um", source = "drawing" }\n'
STEPS = (
    "--help", "scenarios", "run step -o first", "run step -o second", "run launch_shock -o launch",
    "run step --valve my_valve.toml -o own", "parameters", "static --current 1mA --oil-temperature 20degC",
    "bench -o bench", "response -o response", "open first --no-browser",
)  # fmt: skip


def timed(words, **options):
    """(processor seconds, wall seconds) of a command that must succeed."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--installed", type=Path, help="a virtual environment that has the wheel already")
    given = parser.parse_args()
    folder = given.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    rows, venv = [], given.installed and given.installed.resolve()
    if venv is None:
        venv = folder / "venv"
        code = f"import setuptools.build_meta as build; build.build_wheel({str(folder)!r})"
        rows.append(("build the wheel", *timed([sys.executable, "-c", code], cwd=ROOT)))
        (wheel,) = folder.glob("*.whl")
        rows.append(("make a virtual environment", *timed([sys.executable, "-m", "venv", venv])))
        rows.append(("pip install the wheel", *timed([venv / "bin" / "pip", "install", "-q", wheel])))
    with tempfile.TemporaryDirectory(dir=folder) as place:
        user = Path(place)
        (user / "my_valve.toml").write_text(VALVE)
        environment = os.environ | {"XDG_CACHE_HOME": str(user / "cache")}
        for step in STEPS:
            words = [venv / "bin" / "valvesim", *step.split()]
            rows.append((f"valvesim {step}", *timed(words, cwd=user, env=environment)))
        print("| step | processor s | wall s |\n|---|---|---|")
        for name, spent, wall in rows:
            print(f"| `{name}` | {spent:.1f} | {wall:.1f} |")
        print("\n| page | kB |\n|---|---|")
        for page in sorted(user.glob("*/*.html")):
            print(f"| {page.relative_to(user)} | {page.stat().st_size / 1e3:.0f} |")


if __name__ == "__main__":
    main()
