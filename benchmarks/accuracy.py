"""How right a run is, at every sample, over random scenarios: the default tolerance against a far tighter run.

    .venv/bin/python benchmarks/accuracy.py [--seed 1] [--count 1000] [--workers 2] [--write]

The reference runs at a tolerance of `TIGHT`, on coefficient knots with a tenth of the error, with idle breaks added at
random; `INDEPENDENT` of the scenarios without memory are compared with scipy's Radau over `Model.rhs` as well. An
error is the largest over all samples as a share of the channel's span. Wherever a held, isothermal valve without
effects has had time, it must rest on the static solution. Batches are compared with their members run alone.

`--write` puts the table into docs/accuracy.md and the rows into benchmarks/results/accuracy.jsonl.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from random_scenarios import scenarios

import valvesim as vs
from valvesim.channels import Channel
from valvesim.errors import InputError, SolveError
from valvesim.inputs import evaluate, merge
from valvesim.valve.equilibrium import solve_rest

KNOTS = import_module("valvesim.simulation.temperature_knots")
ROOT = Path(__file__).parents[1]
TIGHT = 1e-7
INDEPENDENT = 50
MOST_PIECES = 40
SCALES = {"load_flow": 1e-4, "internal_leakage": 1e-5}
"""m^3/s, of the signals; the states' stand in their channels."""
GOALS = {
    "spool_position": (1e-4, 1e-3), "nozzle_pressure_1": (1e-4, 1e-3), "nozzle_pressure_2": (1e-4, 1e-3),
    "load_flow": (1e-4, 1e-3), "armature_angle": (1e-3, None), "internal_leakage": (1e-3, None),
    "spool_velocity": (1e-2, None), "armature_rate": (1e-2, None), "memory": (1e-2, None),
}  # fmt: skip
"""Channel -> the error that 99 % of the scenarios stay below, and the one that all do."""


def with_idle_breaks(command: vs.Command, duration: float, seed: int) -> vs.Command:
    """The command plus a table of zeros, whose points end steps at times of their own."""
    rng = np.random.default_rng(seed)
    times = np.unique(rng.uniform(0.0, duration, int(rng.integers(20, 200))))
    return vs.Sum((command, vs.Table(times=tuple(times), values=(0.0,) * len(times))))


def reference_of(scenario: vs.Scenario, seed: int) -> vs.Result:
    """The same scenario, far tighter."""
    with patch.multiple(KNOTS, KNOT_ERROR=KNOTS.KNOT_ERROR / 10.0, MOST_KNOTS=4 * KNOTS.MOST_KNOTS):
        return vs.simulate(
            replace(scenario, tolerance=TIGHT, command=with_idle_breaks(scenario.command, scenario.duration, seed))
        )


def span(channel: Channel, values: np.ndarray) -> float:
    """What an error is a share of: the channel's range in the run, or 1 % of its size or scale where it is quiet."""
    scale = SCALES.get(channel.name, channel.scale)
    return max(float(np.ptp(values)), 1e-2 * max(float(np.max(np.abs(values))), scale))


def errors(result: vs.Result, reference: vs.Result) -> dict[str, float]:
    """Largest error by channel; the memory of effects and drives under one name."""
    own = {channel.name for channel in result.scenario.model.state_channels[6:]}
    found: dict[str, float] = {}
    for channel in result.channels:
        name = "memory" if channel.name in own else channel.name
        if name in GOALS:
            values = reference.values[channel.name]
            error = float(np.max(np.abs(result.values[channel.name] - values))) / span(channel, values)
            found[name] = max(found.get(name, 0.0), error)
    return found


def held_since(scenario: vs.Scenario) -> float | None:
    """Since when nothing has driven the valve, s; None where something still does."""
    commands = (scenario.command, *scenario.pressures(), scenario.oil_temperature)
    starts, intervals = merge(commands, scenario.duration)
    last = intervals.rows[-1]
    still = np.all(last[:, 2] == 0.0) and np.all(last[:, 3::5] == 0.0)
    return float(starts[-1]) if still else None


def distance_from_rest(scenario: vs.Scenario, result: vs.Result) -> float | None:
    """How far the last sample is from the static solution, of the larger of both; None where it need not be there."""
    held = held_since(scenario)
    thermal = scenario.thermal
    if held is None or scenario.effects or thermal.network is not None or scenario.duration - held < 0.5:
        return None
    _, c = KNOTS.temperature_knots(scenario)
    c = type(c)(*(np.asarray(v).ravel()[-1] for v in c))
    current = float(result.values["current"][-1])
    rest = solve_rest(c, current, 0.0, *(float(evaluate(p, scenario.duration)) for p in scenario.pressures()))
    x, theta = float(rest.spool_position), float(rest.armature_angle)
    inside = abs(x) < c.spool_stroke and abs(theta) * c.nozzle_arm < min(c.null_gap_1, c.null_gap_2)
    moving = np.ptp(result.values["spool_position"][-max(len(result.time) // 50, 3) :])
    if not inside or moving > 1e-3 * max(abs(x), 1e-5):  # on a stop, or a valve that oscillates of itself
        return None
    return max(
        abs(result.values["spool_position"][-1] - x) / max(abs(x), 1e-5),
        abs(result.values["armature_angle"][-1] - theta) / max(abs(theta), 1e-5),
    )


def by_radau(scenario: vs.Scenario) -> float:
    """Largest error of a tight run's states against scipy's Radau over `Model.rhs`, interval by interval.

    Both on the usual knots: how well these hold the coefficients is for the reference to say.
    """
    from scipy.integrate import solve_ivp

    model = scenario.model
    reference = vs.simulate(replace(scenario, tolerance=TIGHT))
    path, c = KNOTS.temperature_knots(scenario)
    flat = model.flat_coefficients(c, scenario.effects, path.parts)
    knots = np.stack(np.broadcast_arrays(*flat), axis=-1).astype(float)
    knots = np.broadcast_to(np.atleast_2d(knots), (len(path.times), knots.shape[-1]))
    commands = (scenario.command, *scenario.pressures())
    starts, _ = merge(commands, scenario.duration)
    edges = np.unique(np.concatenate([starts, path.times[:-1], [scenario.duration]]))
    scale = np.array([channel.scale for channel in model.state_channels])
    names = [channel.name for channel in model.state_channels]
    y = np.array([reference.values[name][0] for name in names]) / scale
    worst = 0.0
    spans = np.array(
        [span(ch, reference.values[ch.name]) / s for ch, s in zip(model.state_channels, scale, strict=True)]
    )
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        inside = (reference.time >= a) & (reference.time < b)
        k = max(int(np.searchsorted(path.times, a, side="right")) - 1, 0)
        k = min(k, max(len(path.times) - 2, 0))

        def rates(t: float, y: np.ndarray, a: float = a, b: float = b, k: int = k) -> np.ndarray:
            at = min(max(t, a), float(np.nextafter(b, a)))
            u = [float(evaluate(command, at)) for command in commands]
            slope = (float(evaluate(commands[0], min(at + 1e-9, np.nextafter(b, a)))) - u[0]) / 1e-9
            now = knots[k]
            if len(path.times) > 1:
                share = (t - path.times[k]) / (path.times[k + 1] - path.times[k])
                now = knots[k] + share * (knots[k + 1] - knots[k])
            return np.array(model.rhs(tuple(y * scale), (u[0], slope, *u[1:]), tuple(now)), dtype=float) / scale

        times = np.append(reference.time[inside], b)
        solved = solve_ivp(rates, (a, b), y, "Radau", np.unique(times), rtol=1e-6, atol=1e-8)
        y = solved.y[:, -1]
        for name, column, s, size in zip(names, solved.y, scale, spans, strict=True):
            expected = reference.values[name][inside] / s
            if len(expected):
                worst = max(worst, float(np.max(np.abs(column[: len(expected)] - expected))) / size)
    return worst


@functools.cache
def drawn(seed: int, count: int) -> list[vs.Scenario]:
    """The scenarios, drawn by each process for itself: effects are functions, which do not travel."""
    return list(scenarios(seed, count))


def case(job: tuple[int, int, int, bool]) -> dict:
    """One row: errors, steps, solver time; `failed` with its message where a run did not end."""
    seed, count, number, independent = job
    scenario = drawn(seed, count)[number]
    warnings.simplefilter("ignore")
    row: dict = {
        "number": number, "effects": [a.effect.name for a in scenario.effects], "oil": scenario.oil.name,
        "command": type(scenario.command).__name__, "oil_temperature": type(scenario.oil_temperature).__name__,
        "supply": type(scenario.supply_pressure).__name__, "drive": type(scenario.drive).__name__,
        "duration": scenario.duration, "isothermal": scenario.thermal.network is None,
    }  # fmt: skip
    try:
        result = vs.simulate(scenario)
        row |= result.statistics
        reference = reference_of(scenario, number)
        row["errors"] = errors(result, reference)
        row["finite"] = all(bool(np.isfinite(values).all()) for values in result.values.values())
        row["on_stop"] = bool(
            np.max(np.abs(result.values["spool_position"])) > np.min(scenario.valve.spool_stroke)
            or np.max(np.abs(result.values["flapper_position"])) > 0.99 * np.min(scenario.valve.null_gap)
        )
        row["from_rest"] = distance_from_rest(scenario, result)
        if independent:
            row["radau"] = by_radau(scenario)
    except (SolveError, InputError) as error:
        row["failed"] = str(error)
    return row


def pieces(scenario: vs.Scenario) -> int:
    """Into how many pieces breaks and knots divide the run: each is a new start for Radau."""
    commands = (scenario.command, *scenario.pressures())
    return len(merge(commands, scenario.duration)[0]) + len(KNOTS.temperature_knots(scenario)[0].times)


def jobs(seed: int, count: int) -> list[tuple[int, int, int, bool]]:
    """The scenarios by number, the first short ones without memory marked to be run by Radau as well."""
    made, left = [], INDEPENDENT
    for number, scenario in enumerate(drawn(seed, count)):
        plain = not any(a.effect.memory or a.effect.reading for a in scenario.effects)
        independent = left > 0 and scenario.duration < 0.2 and plain and pieces(scenario) <= MOST_PIECES
        left -= independent
        made.append((seed, count, number, independent))
    return made


def batches(seed: int) -> float:
    """Largest difference between members of a batch and the same valves run alone, of their span."""
    rng, worst = np.random.default_rng(seed), 0.0
    plain = [s for s in scenarios(seed, 40) if not s.effects][:8]
    for scenario in plain:
        gaps = rng.uniform(0.030e-3, 0.040e-3, 4)
        together = vs.simulate_batch(replace(scenario, valve=replace(scenario.valve, null_gap=gaps)))
        for k, gap in enumerate(gaps):
            alone = vs.simulate(replace(scenario, valve=replace(scenario.valve, null_gap=float(gap))))
            for channel in scenario.model.state_channels:
                values = alone.values[channel.name]
                worst = max(worst, float(np.max(np.abs(together[channel.name][k] - values))) / span(channel, values))
    return worst


def table(rows: list[dict], batch: float | None) -> str:
    """The figures as Markdown."""
    ran = [row for row in rows if "errors" in row]
    lines = [
        f"{len(rows)} random scenarios, {len(rows) - len(ran)} of them refused; "
        f"{sum(row['on_stop'] for row in ran)} with a stop struck, {sum(bool(row['effects']) for row in ran)} with an "
        f"effect, {sum(row['drive'] == 'VoltageDrive' for row in ran)} on a voltage, "
        f"{sum(row['isothermal'] for row in ran)} isothermal.",
        "",
        "| channel | median | 95 % below | 99 % below | worst | goal (99 %, all) | |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (most, all_below) in GOALS.items():
        own = np.array([row["errors"][name] for row in ran if name in row["errors"]])
        if not len(own):
            continue
        p50, p95, p99 = np.percentile(own, [50, 95, 99])
        met = p99 <= most and (all_below is None or own.max() <= all_below)
        goal = f"{most:.0e}" + (f", {all_below:.0e}" if all_below else "")
        lines.append(
            f"| {name} | {p50:.1e} | {p95:.1e} | {p99:.1e} | {own.max():.1e} | {goal} | {'met' if met else 'missed'} |"
        )
    rest = np.array([row["from_rest"] for row in ran if row.get("from_rest") is not None])
    radau = np.array([row["radau"] for row in ran if "radau" in row])
    seconds = sum(row["solver_seconds"] for row in ran)
    steps = sum(row["accepted_steps"] + row["rejected_steps"] for row in ran)
    lines += ["", f"Held valves: {len(rest)} compared with the static solution, worst {rest.max(initial=0.0):.1e}."]
    if len(radau):
        lines.append(
            f"Reference against Radau over `Model.rhs`: {len(radau)} scenarios, median {np.median(radau):.1e}, "
            f"worst {radau.max():.1e}."
        )
    if batch is not None:
        lines.append(f"Batches against their members run alone: worst {batch:.1e}.")
    lines.append(f"Solver: {steps:.4g} steps in {seconds:.3g} s.")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--rows", type=Path)
    options = parser.parse_args()
    begin = time.perf_counter()
    todo = jobs(options.seed, options.count)
    rows_path = options.rows or (ROOT / "benchmarks" / "results" / "accuracy.jsonl" if options.write else None)
    rows = []
    with ProcessPoolExecutor(options.workers) as pool, open(rows_path or os.devnull, "w", encoding="utf-8") as file:
        for row in pool.map(case, todo):  # row by row, so that a run that is stopped has left what it had
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
    text = table(rows, batches(options.seed))
    print(text)
    print(f"{time.perf_counter() - begin:.0f} s", file=sys.stderr)
    for row in sorted(rows, key=lambda row: -max(row.get("errors", {"": 1.0}).values()))[:12]:
        print(row, file=sys.stderr)
    if options.write:
        command = f"`.venv/bin/python benchmarks/accuracy.py --seed {options.seed} --count {options.count} --write`"
        (ROOT / "docs" / "accuracy.md").write_text(
            f"# How right a run is, at every sample\n\nMade by {command}; what is compared with what stands at the top "
            f"of that file.\n\n{text}\n",
            encoding="utf-8",
        )


if __name__ == "__main__":
    main()
