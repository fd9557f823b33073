"""How long a diagnosis of ten minutes of records takes: ten of 60 s at 1 kHz, with nothing or an effect hidden.

    .venv/bin/python benchmarks/long_session.py                                 # nothing
    .venv/bin/python benchmarks/long_session.py magnetic_hysteresis "0.3 mA"    # an effect and its amplitude

Triangles, steps and sweeps, two of them repeated and two locked away; spool position, load flow and noise of 0.1 %.
The valve is valvesim's own with a null gap 1 % wide: this measures time, `hidden_effects.py` what is found.
"""

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import valvesim as vs
from valvesim.inputs import Table
from valvesim.simulation.batch import cores
from valvesim.units import parse
from valvesim.valve.catalogue import CATALOGUE

CLOCK = np.arange(60_001) / 1e3  # s
HEADERS = {"spool_position": ("mm", 1e3), "load_flow": ("L/min", 6e4)}


def commands() -> dict[str, np.ndarray]:
    """Current (A) of each record over the clock, by name."""
    rng, t = np.random.default_rng(0), CLOCK
    triangle = 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * t / 20.0))
    steps = [rng.uniform(-1.0, 1.0, 31)[(t / 2.0).astype(int)] for _ in range(3)]
    sweeps = [np.sin(2.0 * np.pi * (0.1 * t + (top - 0.1) * t**2 / 120.0)) for top in (5.0, 20.0)]
    shapes = {"triangle": 8e-3 * triangle, "small": 2e-3 * triangle, "sweep": 4e-3 * sweeps[0]}
    shapes |= {"fast": 1e-3 * sweeps[1], "sweep_small": 2e-3 * sweeps[0]}
    shapes |= {f"steps_{k}": 5e-3 * one for k, one in enumerate(steps)}
    return shapes | {"triangle_again": shapes["triangle"], "steps_again": shapes["steps_0"]}


def write(folder: Path, effects: tuple[vs.ActiveEffect, ...]) -> None:
    """The session's folder, of a valve with these effects."""
    rng, valve = np.random.default_rng(1), vs.Valve()
    valve = replace(valve, null_gap=1.01 * valve.null_gap)
    lines = ['title = "Ten minutes"', "[thermal]", "isothermal = true"]
    for name, current in commands().items():
        repeats = {"triangle_again": "triangle", "steps_again": "steps_0"}.get(name, name)
        role = "test" if name in ("small", "steps_2") else "train"
        lines += ["[[records]]", f'file = "{name}.csv"', f'role = "{role}"', f'repeats = "{repeats}"']
        run = vs.simulate(vs.Scenario(
            duration=float(CLOCK[-1]), valve=valve, effects=effects, output_rate=1000.0,
            thermal=vs.Thermal(network=None), command=Table(times=tuple(CLOCK), values=tuple(current)),
        ))  # fmt: skip
        table = {"time [s]": CLOCK, "current [mA]": 1e3 * current}
        for channel, (unit, factor) in HEADERS.items():
            column = factor * run.values[channel]
            table[f"{channel} [{unit}]"] = column + rng.normal(0.0, 1e-3 * np.ptp(column), len(column))
        rows = np.column_stack(list(table.values()))
        np.savetxt(folder / f"{name}.csv", rows, "%.9g", ",", header=",".join(table), comments="")
    (folder / "session.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("effect", nargs="?", choices=list(CATALOGUE), metavar="effect", help="of the catalogue")
    parser.add_argument("amplitude", nargs="?", help='with its unit: "0.3 mA"')
    options, effects = parser.parse_args(), ()
    if options.effect:
        amplitude = CATALOGUE[options.effect].amplitude
        value = parse(options.amplitude, amplitude.unit, "amplitude")
        effects = (CATALOGUE[options.effect](**{amplitude.name: value}),)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), effects)
        begin, last = time.perf_counter(), ""

        def tell(stage: str, share: float) -> None:
            nonlocal last
            if stage != last:
                print(f"{time.perf_counter() - begin:8.1f} s  {stage}", file=sys.stderr, flush=True)
            last = stage

        found = vs.diagnose(folder, progress=tell)
        print(f"{time.perf_counter() - begin:.0f} s on {cores()} cores: {found.summary}")


if __name__ == "__main__":
    main()
