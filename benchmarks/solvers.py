"""Solver benchmarks on the reference valve, as ratios against peers within one run; writes docs/benchmarks.md.

    .venv/bin/python benchmarks/solvers.py

Errors are largest differences over the largest value, of the spool position. Peers get the same right-hand side.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import valvesim as vs
from valvesim.channels import Inputs
from valvesim.compiled import trace
from valvesim.static import follow_branch

ROOT = Path(__file__).parent.parent
ROWS: list[tuple[str, str, str, str]] = []
ISOTHERMAL = vs.Thermal(network=None)


def row(claim: str, target: str, measured: str, peer: str = "") -> None:
    """Keep a row of the table and tell it."""
    ROWS.append((claim, target, measured, peer))
    print(f"{claim}: {measured}  [{target}]  {peer}", flush=True)


def timed(scenario: vs.Scenario, repeats: int = 3) -> tuple[float, vs.Result]:
    """(least solver seconds of some runs, last result)."""
    results = [vs.simulate(scenario) for _ in range(repeats)]
    return min(result.statistics["solver_seconds"] for result in results), results[-1]


def error(result: np.ndarray, reference: np.ndarray) -> float:
    return float(np.max(np.abs(result - reference)) / np.max(np.abs(reference)))


def by_scipy(
    scenario: vs.Scenario, method: str, rtol: float, end: float, *, atol: float = 1e-3
) -> tuple[float, np.ndarray]:
    """(seconds, spool position at the output times up to `end`) by scipy with the plain right-hand side."""
    path = vs.temperature_path(scenario.oil_temperature, end, network=scenario.thermal.network, spacing=0.02)
    knots = np.column_stack(
        [np.broadcast_to(k, path.times.shape) for k in scenario.valve.at(path.parts, oil=scenario.oil)]
    )
    pieces = scenario.command.pieces(end)
    scale = np.array([channel.scale for channel in scenario.model.state_channels])
    result = vs.simulate(replace(scenario, duration=1.0 / scenario.output_rate))
    start = np.array([result.values[c.name][0] for c in scenario.model.state_channels]) / scale
    pressures = (scenario.valve.supply_pressure, scenario.valve.return_pressure, 0.0)
    held = knots[0].tolist() if np.ptp(knots, axis=0).max() == 0.0 else None
    from valvesim.commands import piece_value

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        if held is None:
            k = min(int(np.searchsorted(path.times, t, side="right")) - 1, len(path.times) - 2)
            share = (t - path.times[k]) / (path.times[k + 1] - path.times[k])
            c = (knots[k] + share * (knots[k + 1] - knots[k])).tolist()
        else:
            c = held
        row_ = pieces[max(int(np.searchsorted(pieces[:, 0], t, side="right")) - 1, 0)]
        u = Inputs(float(piece_value(row_, t)[0]), 0.0, *pressures)
        return np.array(vs.Model().rhs((y * scale).tolist(), u, c)) / scale

    times = np.arange(int(end * scenario.output_rate) + 1) / scenario.output_rate
    begin = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solve_ivp(rate, (0.0, end), start, method, times, rtol=rtol, atol=atol * rtol)
    return time.perf_counter() - begin, solution.y[4] * scale[4]


def launch_and_chirp() -> None:
    launch = replace(vs.load_scenario(ROOT / "scenarios" / "launch_shock.toml"), duration=250.0 / 3.0)
    chirp = vs.Scenario(
        duration=5.0, thermal=ISOTHERMAL, output_rate=1e4,
        command=vs.Chirp(amplitude=1e-3, start_frequency=1.0, end_frequency=500.0, duration=5.0),
    )  # fmt: skip
    for name, scenario, limit, stretch in (
        ("83 s launch ramp, 10 Hz, 1 mA", launch, 0.2, 2.0),
        ("5 s chirp 1-500 Hz", chirp, 0.1, 0.5),
    ):
        tight = vs.simulate(replace(scenario, tolerance=1e-7)).values["spool_position"]
        seconds, reference = by_scipy(scenario, "Radau", 1e-9, stretch)
        row(f"{name}: our reference (tolerance 1e-7) against scipy Radau 1e-9, first {stretch:g} s", "-",
            f"{error(tight[: len(reference)], reference):.1e}")  # fmt: skip
        ours = 0.0
        for tolerance in (1e-3, 3e-4, 1e-4, 1e-5):
            took, result = timed(replace(scenario, tolerance=tolerance), 5)
            ours = took if tolerance == 3e-4 else ours
            mark = " (default)" if tolerance == 3e-4 else ""
            row(f"{name}: tolerance {tolerance:g}{mark}", f"error < 1e-4 in <= {limit} s",
                f"error {error(result.values['spool_position'], tight):.1e} in {took:.3f} s")  # fmt: skip
        for method, rtol in (("Radau", 1e-3), ("LSODA", 1e-6)):
            took, found = by_scipy(scenario, method, rtol, stretch)
            whole = took * scenario.duration / stretch
            text = f"error {error(found, tight[: len(found)]):.1e}" if len(found) else "failed"
            row(f"{name}: scipy {method} rtol {rtol:g}, first {stretch:g} s scaled up", "-", f"{text} in {whole:.1f} s",
                f"{whole / ours:.0f} times ours")  # fmt: skip


def by_cvodes() -> None:
    """CasADi's CVODES on the 5 mA step at 20 °C, a second independent library."""
    import casadi

    scenario = vs.Scenario(duration=0.02, thermal=ISOTHERMAL, command=vs.Step(after=5e-3), output_rate=1e5)
    rates, at = trace(vs.Model())
    c = np.array(vs.Valve().at(vs.PartTemperatures.uniform(20.0)), dtype=float)
    u = np.array([5e-3, 0.0, 21e6, 0.5e6, 0.0])
    scale = np.array([channel.scale for channel in vs.Model().state_channels])
    y = casadi.SX.sym("y", 6)
    scaled = casadi.substitute(
        casadi.substitute(rates, at["state"], y * casadi.DM(scale)) / casadi.DM(scale), at["inputs"], casadi.DM(u)
    )
    scaled = casadi.substitute(scaled, at["coefficients"], casadi.DM(c))
    result = vs.simulate(replace(scenario, tolerance=1e-7))
    times = result.time
    start = np.array(
        [
            vs.simulate(replace(scenario, command=vs.Constant(value=0.0))).values[k.name][0]
            for k in vs.Model().state_channels
        ]
    )
    solver = casadi.integrator(
        "s", "cvodes", {"x": y, "ode": scaled}, 0.0, times[1:].tolist(), {"reltol": 1e-9, "abstol": 1e-11}
    )
    found = np.array(solver(x0=start / scale)["xf"])[4] * scale[4]
    row(
        "5 mA step, 20 ms: ours (1e-7) against CasADi CVODES (1e-9)",
        "-",
        f"{error(result.values['spool_position'][1:], found):.1e}",
    )
    _, radau = by_scipy(scenario, "Radau", 1e-9, 0.02)
    row(
        "5 mA step, 20 ms: ours (1e-7) against scipy Radau (1e-9)",
        "-",
        f"{error(result.values['spool_position'], radau):.1e}",
    )


def cold_start() -> None:
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "VALVESIM_CACHE_DIR": f"{folder}/cache"}
        program = str(Path(sys.executable).parent / "valvesim")
        words = [program, "run", str(ROOT / "scenarios" / "launch_shock.toml"), "-o", f"{folder}/out"]
        took = []
        for _ in range(6):
            begin = time.perf_counter()
            subprocess.run(words, env=environment, check=True, capture_output=True)
            took.append(time.perf_counter() - begin)
    row("`valvesim run` of the launch, pictures included, empty cache", "<= 10 s", f"{took[0]:.1f} s")
    row("the same again, median of five", "<= 3 s", f"{np.median(took[1:]):.2f} s")


def batch() -> None:
    count, some = 1000, 5
    rng = np.random.default_rng(0)
    names = ("null_gap", "nozzle_diameter", "feedback_rod_stiffness", "coil_turns")
    scatter = {name: getattr(vs.Valve(), name) * (1.0 + 0.02 * rng.standard_normal(count)) for name in names}
    step = vs.Scenario(duration=0.1, thermal=ISOTHERMAL, command=vs.Step(after=5e-3), output_rate=1e4, tolerance=1e-3)
    vs.simulate(step)
    begin = time.perf_counter()
    found = vs.simulate_batch(replace(step, valve=replace(step.valve, **scatter)))["spool_position"]
    ours = time.perf_counter() - begin
    ones = [
        replace(step, valve=replace(step.valve, **{n: float(v[k]) for n, v in scatter.items()})) for k in range(some)
    ]
    tight = [vs.simulate(replace(one, tolerance=1e-7)).values["spool_position"] for one in ones]
    own_error = max(error(found[k], tight[k]) for k in range(some))
    row("1000 valves, 5 mA step of 0.1 s, preparation included", "-", f"{ours:.2f} s, error {own_error:.1e}")
    for rtol in (1e-3, 1e-4, 1e-5):
        runs = [by_scipy(one, "LSODA", rtol, 0.1, atol=1e-2) for one in ones]
        took, worst = (
            sum(r[0] for r in runs) / some * count,
            max(error(r[1], t) for r, t in zip(runs, tight, strict=True)),
        )
        row(f"scipy LSODA loop, rtol {rtol:g}, {some} valves scaled up to 1000", "ours >= 200 times faster at equal error",
            f"{took:.0f} s, error {worst:.1e}", f"{took / ours:.0f} times ours")  # fmt: skip


def modes() -> None:
    """Beside model.md section 5: -3041 ± 50600j, -2806 ± 3370j, -1056, -5931 at 20 °C, 2 mA."""
    for text, damping, oil in (
        ("as printed, default oil", 1.24e-3, vs.MIL_PRF_5606),
        ("damping from model.md's ratio 0.4 on 12 N·m/rad, beta 1.80e9 Pa, rho 858.7", 2 * 0.4 * np.sqrt(1.78e-7 * 12),
         replace(vs.MIL_PRF_5606, bulk_modulus_at_20=1.80e9, bulk_modulus_slope=0.0, density_at_20=858.7 / np.exp(10.75e6 / 1.80e9))),
    ):  # fmt: skip
        valve = vs.Valve(armature_damping=damping)
        rest = vs.static_solution(valve, current=2e-3, oil=oil)
        state = [
            float(v)
            for v in (rest.armature_angle, 0, rest.nozzle_pressure_1, rest.nozzle_pressure_2, rest.spool_position, 0)
        ]
        c = np.array(valve.at(vs.PartTemperatures.uniform(20.0), oil=oil), dtype=float)
        A = vs.derivatives(vs.Model())(state, [2e-3, 0, 21e6, 0.5e6, 0], c)[0]
        found = sorted(np.linalg.eigvals(np.array(A)), key=lambda v: (-abs(v.imag), v.real))
        shown = ", ".join(
            f"{v.real:.0f} ± {v.imag:.0f}j" if v.imag > 0 else f"{v.real:.0f}" for v in found if v.imag >= 0
        )
        row(f"modes at 20 °C, 2 mA, rad/s: {text}", "-3041 ± 50600j, -2806 ± 3370j, -1056, -5931", shown)


def statics() -> None:
    currents = np.array([-10, -5, -1, -0.1, 0.1, 1, 5, 10]) * 1e-3
    worst = 0.0
    for temperature in (20.0, 40.0, 100.0, 200.0, 270.0):
        for current in currents:
            case = vs.Scenario(
                duration=1.0, thermal=ISOTHERMAL, oil_temperature=vs.Constant(value=temperature), tolerance=1e-6,
                command=vs.Step(after=float(current)), output_rate=1.0,
            )  # fmt: skip
            rest = vs.static_solution(vs.Valve(), current=float(current), temperature=temperature)
            values = vs.simulate(case).values
            worst = max(
                worst, *(abs(values[n][-1] / float(getattr(rest, n)) - 1) for n in ("armature_angle", "spool_position"))
            )
    row("held at 5 temperatures x 8 currents: settled run against the static root", "<= 1e-6", f"{worst:.1e}")
    temperatures = np.linspace(-40, 270, 63)
    root = vs.static_solution(vs.Valve(), current=currents[:, None], temperature=temperatures).armature_angle
    c = vs.Valve().at(vs.PartTemperatures.uniform(temperatures))
    direct = follow_branch(c, currents[:, None], (21e6, 0.5e6, 0.0))
    row("polynomial's root against the three balances, 8 x 63", "<= 1e-9", f"{np.max(np.abs(direct / root - 1)):.1e}")


def mirror() -> None:
    up, down = (
        vs.simulate(
            vs.Scenario(duration=0.1, thermal=ISOTHERMAL, command=vs.Step(after=sign * 5e-3), output_rate=1e4)
        ).values
        for sign in (1, -1)
    )
    row("mirror symmetry of a 5 mA step", "<= 1e-9", f"{error(-down['spool_position'], up['spool_position']):.1e}")


def main() -> None:
    warnings.simplefilter("ignore", vs.ValidityWarning)
    for measure in (statics, mirror, modes, by_cvodes, cold_start, launch_and_chirp, batch):
        measure()
    cpu = (
        next(
            (x.split(":")[1].strip() for x in open("/proc/cpuinfo") if x.startswith("model name")), platform.processor()
        )
        if os.path.exists("/proc/cpuinfo")
        else platform.processor()
    )
    head = [
        "# Benchmarks", "",
        "Made by `.venv/bin/python benchmarks/solvers.py`; ratios are within one run. Errors are of the spool position,",
        "relative to its largest value.", "",
        f"{date.today()}, {os.cpu_count()} cores, {cpu}, Python {platform.python_version()}.", "",
        "| claim | target | measured | peer |", "|---|---|---|---|",
    ]  # fmt: skip
    table = [f"| {' | '.join(cells)} |" for cells in ROWS]
    (ROOT / "docs" / "benchmarks.md").write_text("\n".join([*head, *table, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
