"""What valvesim's solver costs and how exact it is, beside its peers within the same run; writes docs/benchmarks.md.

    .venv/bin/python benchmarks/solvers.py

Claims: the 83 s launch ramp, a 5 s chirp, both and a batch beside C by hand (needs gcc), the cold start of the command
line, 1000 scattered valves, the linearised modes, and that the held dynamic model settles on the static root. `NOTES`
says how each figure is taken. It runs for some three minutes; another file than docs/benchmarks.md is named with -o.
"""

from __future__ import annotations

import argparse
import functools
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import date
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from hand_written import hand_written

import valvesim as vs
from valvesim import inputs as commands
from valvesim.simulation.batch import cores
from valvesim.simulation.run import integrate_batch, integrate_member, prepare
from valvesim.solver.codegen import trace
from valvesim.valve.equilibrium import follow_branch

ROOT = Path(__file__).resolve().parent.parent
LAUNCH = ROOT / "scenarios" / "launch_shock.toml"
SCALE = np.array([channel.scale for channel in vs.Model().state_channels])
SPOOL = [channel.name for channel in vs.Model().state_channels].index("spool_position")
ISOTHERMAL = vs.Thermal(network=None)
TOLERANCES = (1e-3, 3e-4, 1e-4, 1e-5)
LADDER = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 1e-7)
BOUND = 1e-4  # on the spool error
ABSOLUTE = 0.01  # absolute tolerance over the relative one, scaled states
STRETCH = 5.0  # s of the ramp that scipy's solvers get
WINDOW = 5.0  # s over which the coefficients are one polynomial for CVODES
DEGREE = 10  # of that polynomial: relative error 1e-10
MEMBERS = 10  # valves of the scattered ones that scipy's solvers get

NOTES = {
    "error": "largest spool error at the output samples over the largest spool position. The references run at "
    "tolerance 1e-7; that of the ramp takes its coefficients at knots 2 ms apart, so that an error holds that of the "
    "usual knots too",
    "seconds": "of processor, of the solver, without compilation and preparation unless a row says so; the best of "
    "five runs, or of as many as fit in two seconds. Where the load is above the cores they are larger than on a quiet "
    "machine, of all alike; what is on the wall clock counts the waiting too",
    "peers": "each at the loosest relative tolerance (of 1e-3, 3e-4, 1e-4 ... 1e-7) whose error meets the bound; their "
    "absolute tolerance is a hundredth of it on scaled states, ours three thousandths. scipy's get valvesim's machine "
    "code for right-hand side and Jacobian unless a row says otherwise, and CasADi's CVODES the traced right-hand side",
    "C by hand": "benchmarks/hand_written.c, Rodas4, by gcc -O3 -march=native -ffast-math, with the same knots, "
    "tolerances and measure of the error",
    "ratio": "peer over valvesim: above 1 valvesim is faster",
}


class Row(NamedTuple):
    """A line of the table."""

    claim: str
    target: str
    measured: str
    peer: str = ""
    ratio: str = ""


def say(text: str) -> None:
    """A progress line."""
    print(text, flush=True)


def best(
    work: Callable[[], Any], *, repeats: int = 5, budget: float = 2.0, clock: Callable[[], float] = time.process_time
) -> tuple[float, Any]:
    """(least seconds, value) of a piece of work, repeated while `budget` seconds are not spent."""
    seconds: list[float] = []
    value = None
    while not seconds or (len(seconds) < repeats and sum(seconds) < budget):
        begin = clock()
        value = work()
        seconds.append(clock() - begin)
    return min(seconds), value


def error_of(spool: np.ndarray, reference: np.ndarray) -> float:
    """Largest error over the amplitude."""
    return float(np.max(np.abs(spool - reference)) / np.max(np.abs(reference)))


# ---------------------------------------------------------------- the same work for the peers


@dataclass(frozen=True)
class Case:
    """A scenario as the peers take it, set up apart from `simulation.run`: at rest until `times[0]`, then one input.

    start (6,) scaled; rows: one piece an input; knot_times (m,), knots (m, n_c): coefficients, evenly spaced.
    """

    times: np.ndarray
    rate: float
    start: np.ndarray
    rows: np.ndarray
    knot_times: np.ndarray
    knots: np.ndarray

    @property
    def arguments(self) -> tuple:
        """What the right-hand sides take after (t, y)."""
        return self.rows, self.knot_times, self.knots


def case_of(scenario: vs.Scenario) -> Case:
    """A scenario for the peers; coefficients at knots a millisecond apart where the temperature changes."""
    starts, intervals = commands.merge((scenario.command, *scenario.pressures()), scenario.duration)
    varies = scenario.thermal.network is not None
    path = vs.temperature_path(
        scenario.oil_temperature, scenario.duration, network=scenario.thermal.network,
        spacing=1e-3 if varies else scenario.duration,
    )  # fmt: skip
    c = scenario.valve.at(path.parts, oil=scenario.oil, routes=scenario.thermal.routes)
    knots = np.stack(np.broadcast_arrays(*c), axis=-1).astype(float)
    oil = float(path.parts.oil[0])
    rest = vs.static_solution(scenario.valve, current=0.0, temperature=oil)
    pressures = float(rest.nozzle_pressure_1), float(rest.nozzle_pressure_2)
    start = np.array([0.0, 0.0, *pressures, 0.0, 0.0]) / SCALE
    times = np.arange(int(scenario.duration * scenario.output_rate * (1 + 1e-12)) + 1) / scenario.output_rate
    times = times[times >= starts[-1] * (1 - 1e-12)]
    if not varies:
        path_times, knots = path.times[:1], knots[:1]
    else:
        path_times = path.times
    return Case(times, scenario.output_rate, start, intervals.rows[-1].copy(), path_times, knots)


@functools.cache
def machine_code() -> tuple[Any, Any]:
    """(rate, slope): scaled right-hand side and Jacobian of (t, y, *case.arguments) as machine code, for scipy."""
    from numba import njit

    compiled = vs.compile_model(vs.Model())
    derivative, jacobians = compiled.derivative, compiled.jacobians
    piece_value, on_line = njit(commands.piece_value), njit(coefficients_on_line)

    @njit(error_model="numpy")
    def conditions(t, rows, knot_times, knots):
        u, c = np.empty(rows.shape[0] + 1), np.empty(knots.shape[1])
        u[0], u[1] = piece_value(rows[0], t)
        for k in range(1, rows.shape[0]):
            u[k + 1] = piece_value(rows[k], t)[0]
        on_line(t, knot_times, knots, c)
        return u, c

    @njit(error_model="numpy")
    def rate(t, y, rows, knot_times, knots):
        u, c = conditions(t, rows, knot_times, knots)
        out = np.empty(len(y))
        derivative(y, u, c, out)
        return out

    @njit(error_model="numpy")
    def slope(t, y, rows, knot_times, knots):
        u, c = conditions(t, rows, knot_times, knots)
        out = np.empty((1, len(y), len(y)))
        jacobians(y.reshape((1, -1)), u.reshape((1, -1)), c.reshape((1, -1)), out)
        return out[0]

    nothing = np.zeros((4, commands.PIECE_WIDTH)), np.zeros(1), np.ones((1, len(vs.Coefficients._fields)))
    for function in (rate, slope):  # compiled here and not within a measurement
        function(0.0, np.zeros(len(SCALE)), *nothing)
    return rate, slope


def plain_rate(case: Case) -> Callable:
    """Scaled right-hand side (t, y) by `Model.rhs` on floats, as a user of scipy would write it."""
    model, scale, constant = vs.Model(), SCALE.tolist(), case.knots[0].tolist()
    held = held_pressures(case)

    def rate(t, y):
        c = constant if len(case.knots) == 1 else coefficients_at(case, t).tolist()
        u = (float(commands.piece_value(case.rows[0], t)[0]), 0.0, *held)
        rates = model.rhs([a * b for a, b in zip(y.tolist(), scale, strict=True)], u, c)
        return [a / b for a, b in zip(rates, scale, strict=True)]

    return rate


def plain_slope(case: Case) -> Callable:
    """Scaled Jacobian (t, y) by CasADi."""
    slopes = vs.derivatives(vs.Model())
    held = held_pressures(case)

    def slope(t, y):
        u = [float(commands.piece_value(case.rows[0], t)[0]), 0.0, *held]
        return np.array(slopes(y * SCALE, u, coefficients_at(case, t))[0]) * SCALE / SCALE[:, None]

    return slope


def held_pressures(case: Case) -> list[float]:
    """Supply, return and load pressure, which these scenarios hold."""
    return [float(commands.piece_value(row, 0.0)[0]) for row in case.rows[1:]]


def coefficients_at(case: Case, t: float) -> np.ndarray:
    """Coefficients (n_c,) at time t."""
    c = np.empty(case.knots.shape[1])
    coefficients_on_line(t, case.knot_times, case.knots, c)
    return c


def coefficients_on_line(t, knot_times, knots, c):
    """Coefficients at time t on the straight line between evenly spaced knots. Compiled as it stands."""
    at, share = 0, 0.0
    if len(knot_times) > 1:
        at = min(int(t / knot_times[1]), len(knot_times) - 2)
        share = (t - knot_times[at]) / (knot_times[at + 1] - knot_times[at])
    for k in range(len(c)):
        c[k] = knots[at, k] + (share * (knots[at + 1, k] - knots[at, k]) if len(knot_times) > 1 else 0.0)


# ---------------------------------------------------------------- the peers: (case, rtol) -> run() -> spool positions


def radau(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """scipy's `solve_ivp(method="Radau")`."""
    return _solve_ivp(case, "Radau", rtol, *machine_code(), case.arguments)


def lsoda(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """scipy's `solve_ivp(method="LSODA")`: a Python loop over steps."""
    return _solve_ivp(case, "LSODA", rtol, *machine_code(), case.arguments)


def plain_lsoda(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """The same on `Model.rhs` with floats, without a Jacobian."""
    return _solve_ivp(case, "LSODA", rtol, plain_rate(case), None, ())


def plain_radau(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """Radau on `Model.rhs` with floats: shares nothing with our integrator, its machine code or its knots."""
    return _solve_ivp(case, "Radau", rtol, plain_rate(case), plain_slope(case), ())


def _solve_ivp(case: Case, method: str, rtol: float, rate: Any, slope: Any, arguments: tuple) -> Callable:
    from scipy.integrate import solve_ivp

    options = {"rtol": rtol, "atol": ABSOLUTE * rtol, "args": arguments}
    if slope is not None:
        options["jac"] = slope

    def run() -> np.ndarray:
        solution = solve_ivp(rate, (case.times[0], case.times[-1]), case.start, method, case.times, **options)
        if solution.status != 0:
            raise RuntimeError(f"{method} at rtol {rtol:g}: {solution.message}")
        return solution.y[SPOOL] * SCALE[SPOOL]

    return run


def odeint(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """LSODA by scipy's `odeint`, which steps in compiled code: its fastest interface."""
    from scipy.integrate import odeint as solve

    rate, slope = machine_code()

    def run() -> np.ndarray:
        states = solve(
            rate, case.start, case.times, case.arguments, slope, rtol=rtol, atol=ABSOLUTE * rtol, mxstep=10**7,
            tfirst=True,
        )  # fmt: skip
        return states[:, SPOOL] * SCALE[SPOOL]

    return run


def cvodes(case: Case, rtol: float) -> Callable[[], np.ndarray]:
    """SUNDIALS' CVODES by CasADi, begun anew every `WINDOW` seconds; coefficients are polynomials in time there."""
    import casadi

    per_window = round(WINDOW * case.rate)
    lengths = [min(per_window, len(case.times) - k) for k in range(1, len(case.times), per_window)]
    y, tau = casadi.SX.sym("y", len(SCALE)), casadi.SX.sym("tau")
    varying = np.flatnonzero(np.ptp(case.knots, axis=0) > 0.0)
    p = casadi.SX.sym("p", 1 + len(varying) * (DEGREE + 1))  # start of the window, then highest powers first
    c = [casadi.SX(value) for value in case.knots[0]]
    for place, k in enumerate(varying):
        powers = [p[1 + place * (DEGREE + 1) + power] for power in range(DEGREE + 1)]
        c[k] = functools.reduce(lambda total, next_one: total * (tau / WINDOW) + next_one, powers)
    u = [commands.piece_value(row, p[0] + tau)[0] for row in case.rows]
    u.insert(1, 0.0)
    rates, at = trace(vs.Model())
    for symbol, value in zip(at.values(), (y * SCALE, casadi.vertcat(*u), casadi.vertcat(*c)), strict=True):
        rates = casadi.substitute(rates, symbol, value)
    problem = {"x": y, "t": tau, "p": p, "ode": casadi.cse(rates / SCALE)}
    options = {"reltol": rtol, "abstol": ABSOLUTE * rtol, "max_num_steps": 10**8}
    solvers = {
        n: casadi.integrator("solve", "cvodes", problem, 0.0, list(np.arange(1, n + 1) / case.rate), options)
        for n in set(lengths)
    }
    figures = []
    for begin in case.times[0] + WINDOW * np.arange(len(lengths)):
        inside = (case.knot_times >= begin - 1e-9) & (case.knot_times <= begin + WINDOW + 1e-9)
        share = (case.knot_times[inside] - begin) / WINDOW
        fits = np.polyfit(share, case.knots[inside][:, varying], DEGREE) if len(varying) else np.empty((0, 0))
        figures.append(np.append(begin, fits.T.ravel()))

    def run() -> np.ndarray:
        state, spool = case.start, [case.start[SPOOL : SPOOL + 1]]
        for n, figure in zip(lengths, figures, strict=True):
            states = np.array(solvers[n](x0=state, p=figure)["xf"])
            state = states[:, -1]
            spool.append(states[SPOOL])
        return np.concatenate(spool) * SCALE[SPOOL]

    return run


def loosest(
    peer: Callable, case: Case, reference: np.ndarray, name: str, bound: float = BOUND
) -> tuple[float, float, float]:
    """(seconds, error, rtol) of a peer at the loosest tolerance of the ladder that meets an error bound."""
    for rtol in LADDER:
        run = peer(case, rtol)
        begin = time.process_time()
        spool = run()
        seconds, error = time.process_time() - begin, error_of(spool, reference)
        say(f"  {name}, rtol {rtol:g}: {seconds:.3g} s, error {error:.1e}")
        if error < bound:
            return (min(seconds, best(run)[0]) if seconds < 2.0 else seconds), error, rtol
    raise RuntimeError(f"{name} meets an error of {bound:g} at no tolerance of the ladder")


# ---------------------------------------------------------------- our own runs


class Own(NamedTuple):
    """A run of ours."""

    tolerance: float
    seconds: float
    error: float


def tight(scenario: vs.Scenario) -> np.ndarray:
    """Spool positions of the reference: tolerance 1e-7, coefficients at the closest knots that valvesim lays."""
    with patch.object(import_module("valvesim.simulation.temperature_knots"), "KNOT_ERROR", 1e-8):
        return vs.simulate(replace(scenario, tolerance=1e-7)).values["spool_position"]


def own_runs(scenario: vs.Scenario, reference: np.ndarray) -> list[Own]:
    """Our solver at each tolerance."""
    runs = []
    for tolerance in TOLERANCES:
        seconds, spool = best(own_run(scenario, tolerance))
        runs.append(Own(tolerance, seconds, error_of(spool, reference)))
        say(f"  valvesim, tolerance {tolerance:g}: {seconds:.3g} s, error {runs[-1].error:.1e}")
    return runs


def own_rows(what: str, runs: Sequence[Own], target: float) -> list[Row]:
    """A row a tolerance: met where both error and seconds are."""
    rows = []
    for run in runs:
        met = "met" if run.error < BOUND and run.seconds <= target else "missed"
        usual = " (default)" if run.tolerance == vs.Scenario().tolerance else ""
        figures = f"{run.seconds:.3g} s, error {run.error:.1e}: {met}"
        rows.append(Row(f"{what}, tolerance {run.tolerance:g}{usual}", f"< {BOUND:g} in {target:g} s", figures))
    return rows


def peer_row(
    what: str, name: str, own: Own, peer: tuple[float, float, float], *, scaled: float = 1.0, bound: float = BOUND
) -> Row:
    """A row against a peer, whose seconds are scaled up."""
    seconds, error, rtol = peer
    note = f" ({seconds:.3g} s on a {STRETCH:g} s stretch, scaled)" if scaled != 1.0 else ""
    return Row(
        f"{what} against {name}, fastest with error < {bound:.2g}",
        "",
        f"{own.seconds:.3g} s, error {own.error:.1e}, tolerance {own.tolerance:g}",
        f"{scaled * seconds:.3g} s{note}, error {error:.1e}, rtol {rtol:g}",
        f"{scaled * seconds / own.seconds:.3g}",
    )


def fastest(runs: Sequence[Own]) -> Own:
    """The fastest of our runs that meets the error bound."""
    return min((run for run in runs if run.error < BOUND), key=lambda run: run.seconds)


# ---------------------------------------------------------------- the claims


def launch_scenario() -> vs.Scenario:
    """83 s of oil from 20 to 270 °C under a 10 Hz command."""
    return replace(vs.load_scenario(LAUNCH), duration=83.333)


CHIRP = "5 s chirp 1-500 Hz, 1 mA, 20 °C"


def chirp_scenario() -> vs.Scenario:
    """1 to 500 Hz in 5 s at 20 °C."""
    command = vs.Chirp(amplitude=1e-3, start_frequency=1.0, end_frequency=500.0, duration=5.0)
    return vs.Scenario(duration=5.0, thermal=ISOTHERMAL, command=command, output_rate=5000.0)


def scattered_valves() -> vs.Scenario:
    """1000 valves with scattered figures under a 5 mA step of 0.1 s."""
    rng, valve, count = np.random.default_rng(1), vs.reference_valve(), 1000
    scattered: dict[str, Any] = {
        name: getattr(valve, name) * (1.0 + 0.02 * rng.standard_normal(count)) for name in SCATTERED
    }
    step = vs.Step(after=5e-3, time=1e-3)
    return vs.Scenario(duration=0.1, valve=replace(valve, **scattered), thermal=ISOTHERMAL, command=step)


SCATTERED = ("null_gap", "nozzle_diameter", "feedback_rod_stiffness", "coil_turns")


def launch_ramp() -> list[Row]:
    """83 s of oil from 20 to 270 °C under a 10 Hz command."""
    what = "83 s launch ramp"
    scenario = launch_scenario()
    reference = tight(scenario)
    short = case_of(replace(scenario, duration=2.0))
    apart = error_of(plain_radau(short, 1e-10)(), reference[: len(short.times)])
    say(f"  reference against Radau at rtol 1e-10 over 2 s: {apart:.1e}")
    runs = own_runs(scenario, reference)
    rows = [
        Row(f"{what}: reference against scipy Radau, first 2 s", "", f"apart by {apart:.1e}", "Model.rhs, rtol 1e-10"),
        *own_rows(what, runs, 0.2),
    ]
    stretch = case_of(replace(scenario, duration=STRETCH))
    for peer, name in ((radau, "scipy Radau"), (odeint, "scipy LSODA (odeint)")):
        found = loosest(peer, stretch, reference[: len(stretch.times)], name)
        rows.append(peer_row(what, name, fastest(runs), found, scaled=scenario.duration / STRETCH))
    whole, own, name = case_of(scenario), fastest(runs), "CasADi CVODES (coefficients as polynomials)"
    for bound in (BOUND, 1.05 * own.error):  # the second: at about our error
        rows.append(peer_row(what, name, own, loosest(cvodes, whole, reference, name, bound), bound=bound))
    return rows


def chirp() -> list[Row]:
    """1 to 500 Hz in 5 s at 20 °C."""
    what, scenario = CHIRP, chirp_scenario()
    reference, case = tight(scenario), case_of(scenario)
    short = replace(case, times=case.times[case.times <= 0.3])
    apart = error_of(plain_radau(short, 1e-10)(), reference[: len(short.times)])
    apart_whole = error_of(cvodes(case, 1e-10)(), reference)
    say(f"  reference against Radau over 0.3 s: {apart:.1e}, against CVODES over all: {apart_whole:.1e}")
    runs = own_runs(scenario, reference)
    rows = [
        Row(f"{what}: reference against scipy Radau, first 0.3 s", "", f"apart by {apart:.1e}",
            "Model.rhs, rtol 1e-10"),
        Row(f"{what}: reference against CasADi CVODES", "", f"apart by {apart_whole:.1e}", "rtol 1e-10"),
        *own_rows(what, runs, 0.1),
    ]  # fmt: skip
    for peer, name in ((radau, "scipy Radau"), (odeint, "scipy LSODA (odeint)"), (cvodes, "CasADi CVODES")):
        rows.append(peer_row(what, name, fastest(runs), loosest(peer, case, reference, name)))
    return rows


def cold_start() -> list[Row]:
    """The command line on the launch scenario, with an empty and a filled cache of compiled models."""
    program = Path(sys.executable).parent / "valvesim"

    def run(cache: Path, output: Path) -> tuple[float, float]:
        """(wall, processor) seconds."""
        used, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        environment = os.environ | {"VALVESIM_CACHE_DIR": str(cache)}
        subprocess.run([program, "run", LAUNCH, "-o", output], env=environment, check=True, capture_output=True)
        wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        return wall, after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime

    with tempfile.TemporaryDirectory() as folder:
        runs = [run(Path(folder) / "cache", Path(folder) / f"run{k}") for k in range(4)]
    say("  wall (processor) seconds: " + ", ".join(f"{wall:.3g} ({used:.3g})" for wall, used in runs))
    rows = []
    for name, some, target in (
        ("empty cache", runs[:1], 4.0), ("filled cache, median of three", runs[1:], 1.2)
    ):  # fmt: skip
        wall, used = np.median(some, axis=0)
        met = "met" if wall <= target else "missed"
        figures = f"{wall:.3g} s ({used:.3g} s of processor): {met}"
        rows.append(Row(f"`valvesim run scenarios/launch_shock.toml`, {name}", f"<= {target:g} s", figures))
    return rows


def batch() -> list[Row]:
    """1000 valves with scattered figures under a 5 mA step of 0.1 s."""
    scenario, valve, count = scattered_valves(), vs.reference_valve(), 1000
    scattered = {name: getattr(scenario.valve, name) for name in SCATTERED}
    reference = vs.simulate_batch(replace(scenario, tolerance=1e-7))["spool_position"]
    wall, wall_lone = (
        best(lambda n=n: vs.simulate_batch(scenario, workers=n), budget=10.0, clock=time.perf_counter)[0]
        for n in (None, 1)
    )
    seconds, result = best(lambda: vs.simulate_batch(scenario, workers=1), budget=10.0)
    errors = [error_of(*pair) for pair in zip(result["spool_position"], reference, strict=True)]
    error, same = max(errors), max(errors[:MEMBERS])
    say(f"  valvesim: {seconds:.3g} s of one thread, error {error:.1e} (of the first ten {same:.1e})")

    def member(k: int) -> vs.Valve:
        figures: dict[str, Any] = {name: float(values[k]) for name, values in scattered.items()}
        return replace(valve, **figures)

    few = [case_of(replace(scenario, valve=member(k))) for k in range(MEMBERS)]

    def loop(peer: Callable, rtol: float) -> tuple[float, float]:
        """(seconds a thousand valves, worst error) of a loop over the first ten."""
        runs = [peer(case, rtol) for case in few]
        begin = time.process_time()
        spools = [run() for run in runs]
        spent = (time.process_time() - begin) * count / MEMBERS
        starts = [reference.shape[1] - len(case.times) for case in few]
        return spent, max(error_of(x, reference[k, starts[k] :]) for k, x in enumerate(spools))

    found = {rtol: loop(odeint, rtol)[1] for rtol in LADDER[:-1]}
    rtol = min(found, key=lambda tolerance: abs(np.log(found[tolerance] / same)))
    what = f"{count} valves, 5 mA step, 0.1 s"
    measured = f"{seconds:.3g} s, error {same:.1e}"
    rows = [
        Row(f"{what}, preparation included, one thread", "", f"{seconds:.3g} s, worst error {error:.1e}"),
        Row(
            f"{what}, on {cores()} threads, wall clock",
            "",
            f"{wall:.3g} s",
            f"{wall_lone:.3g} s on one",
            f"{wall_lone / wall:.3g}",
        ),
    ]
    for peer, name, target in (
        (plain_lsoda, "solve_ivp LSODA on Model.rhs with floats", 200.0),
        (lsoda, "solve_ivp LSODA on machine code with Jacobian", 200.0),
        (odeint, "odeint (LSODA) on machine code with Jacobian", None),
    ):
        spent, apart = loop(peer, rtol)
        say(f"  {name}, rtol {rtol:g}: {spent:.3g} s, error {apart:.1e}")
        ratio = spent / seconds
        peer_text = f"{spent:.3g} s (ten valves, scaled), error {apart:.1e}, rtol {rtol:g}"
        wanted, verdict = "", f"{ratio:.3g}"
        if target is not None:
            wanted, verdict = f"{target:g} times faster", f"{ratio:.3g}: {'met' if ratio >= target else 'missed'}"
        rows.append(Row(f"{what} against a loop of {name}", wanted, measured, peer_text, verdict))
    return rows


def beside_c() -> list[Row]:
    """The same work in C by hand (Rodas4 along the Jacobian's pattern), at the same error within the same run."""
    rows = []
    for what, scenario in (("83 s launch ramp", launch_scenario()), (CHIRP, chirp_scenario())):
        reference = tight(scenario)
        found = [
            loosest(peer, scenario, reference, name, C_BOUND) for peer, name in ((own_run, "valvesim"), (c_run, "C"))
        ]
        rows.append(row_beside_c(f"{what}, fastest with error < {C_BOUND:g}", *found))
    scenario = scattered_valves()
    reference = vs.simulate_batch(replace(scenario, tolerance=1e-7))["spool_position"]
    batches = [loosest_batch(run, scenario, reference, name) for run, name in ((own_batch, "valvesim"), (c_batch, "C"))]
    what = f"a valve of {len(reference)}, 5 mA step, 0.1 s, one thread, prepared, worst error < {BATCH_BOUND:g}"
    return [*rows, row_beside_c(what, *batches, least=33.0 / 20.0)]


C_BOUND, BATCH_BOUND = 1e-6, 1e-5  # a valve of a batch: 20 us where C takes 33


def row_beside_c(
    what: str, own: tuple[float, float, float], peer: tuple[float, float, float], least: float = 1.0
) -> Row:
    """A row from (seconds, error, tolerance) of both; the target is the ratio `least`."""
    ratio = peer[0] / own[0]
    told = [f"{time_text(seconds)}, error {error:.1e}, tolerance {rtol:g}" for seconds, error, rtol in (own, peer)]
    verdict = f"{ratio:.3g}: {'met' if ratio >= least else 'missed'}"
    return Row(f"{what}: against C by hand", f"{least:.3g} times as fast", told[0], told[1], verdict)


def time_text(seconds: float) -> str:
    """Seconds, or microseconds below a millisecond."""
    return f"{seconds:.3g} s" if seconds > 1e-3 else f"{seconds * 1e6:.3g} us"


def own_run(scenario: Any, rtol: float) -> Callable[[], np.ndarray]:
    """The integrator on a prepared scenario."""
    problem = prepare(replace(scenario, tolerance=rtol))
    return lambda: integrate_member(problem, 0, None)[0][:, SPOOL]


def c_run(scenario: Any, rtol: float) -> Callable[[], np.ndarray]:
    """C by hand on the same, with the same knots."""
    run = hand_written(prepare(replace(scenario, tolerance=rtol)), 0, rtol)
    return lambda: run()[0][:, SPOOL]


def own_batch(problem: Any, rtol: float) -> Callable[[], list[np.ndarray]]:
    """The members of a prepared batch."""
    return lambda: [np.asarray(states)[:, SPOOL] for states in integrate_batch(problem, range(len(problem.knots)))]


def c_batch(problem: Any, rtol: float) -> Callable[[], list[np.ndarray]]:
    """C by hand, one member after the other."""
    runs = [hand_written(problem, member, rtol) for member in range(len(problem.knots))]
    return lambda: [run()[0][:, SPOOL] for run in runs]


def loosest_batch(
    peer: Callable, scenario: vs.Scenario, reference: np.ndarray, name: str
) -> tuple[float, float, float]:
    """(seconds a valve, worst error, rtol) at the loosest tolerance of the ladder that meets `BATCH_BOUND`."""
    for rtol in LADDER:
        run = peer(prepare(replace(scenario, tolerance=rtol)), rtol)
        seconds, spools = best(run)
        error = max(error_of(*pair) for pair in zip(spools, reference, strict=True))
        say(f"  {name}, rtol {rtol:g}: {time_text(seconds / len(reference))} a valve, error {error:.1e}")
        if error < BATCH_BOUND:
            return seconds / len(reference), error, rtol
    raise RuntimeError(f"{name} meets an error of {BATCH_BOUND:g} at no tolerance of the ladder")


PRINTED_MODES = np.array([-3041 + 50600j, -3041 - 50600j, -2806 + 3370j, -2806 - 3370j, -1056, -5931])  # model.md 5
PRINTED_OIL = 1.63e9, 860.0  # bulk modulus Pa as printed there, and the usual density kg/m^3
FITTING_OIL = 1.80e9, 860.0  # that with which the printed modes come out


def modes() -> list[Row]:
    """Eigenvalues of the exact Jacobian at rest."""
    rows: list[Row] = []
    noted = 2 * 0.4 * np.sqrt(1.78e-7 * 12)  # ratio 0.4 on 12 N m/rad, model.md 5
    own = vs.Valve().armature_damping
    for damping, oil in ((own, None), (noted, None), (noted, PRINTED_OIL), (noted, FITTING_OIL)):
        valve = replace(vs.reference_valve(), armature_damping=damping)
        c = valve.at(vs.PartTemperatures.uniform(20.0))
        if oil is not None:
            c = c._replace(bulk_modulus_at_zero=oil[0], bulk_modulus_slope=0.0, density=oil[1])
        rest = vs.static_solution(valve, current=2e-3, temperature=20.0)  # the oil has no say in it
        bulk_modulus = float(c.bulk_modulus_at_zero + c.bulk_modulus_slope * rest.nozzle_pressure_1)
        given = f"armature damping {damping:.4g} N·m·s/rad, {'our oil: ' if oil is None else ''}"
        given += f"{bulk_modulus:.4g} Pa, {float(c.density):.4g} kg/m³"
        pressures = rest.nozzle_pressure_1, rest.nozzle_pressure_2
        state = [float(x) for x in (rest.armature_angle, 0.0, *pressures, rest.spool_position, 0.0)]
        inputs = [2e-3, 0.0, valve.supply_pressure, valve.return_pressure, valve.load_pressure]
        jacobian = vs.derivatives(vs.Model())(state, inputs, [float(value) for value in c])[0]
        values = np.linalg.eigvals(np.array(jacobian))
        found = np.array([values[np.argmin(np.abs(values - mode))] for mode in PRINTED_MODES])
        worst = float(np.max(np.abs(found / PRINTED_MODES - 1.0)))
        say(f"  {given}: {modes_text(found)}, apart by {worst:.1e}")
        printed = "model.md: " + modes_text(PRINTED_MODES)
        rows.append(
            Row(f"modes at 20 °C, 2 mA (rad/s), {given}", "", modes_text(found), printed, f"apart by {worst:.1e}")
        )
    return rows


def modes_text(values: np.ndarray) -> str:
    """Conjugate pairs and real eigenvalues."""
    return ", ".join(
        f"{value.real:.0f}" + (f" ± {value.imag:.0f}j" if value.imag else "") for value in values if value.imag >= 0.0
    )


def settling() -> list[Row]:
    """The held dynamic model against the static root, and the polynomial root against the balances."""
    valve = vs.reference_valve()
    worst_settled, worst_root, worst_eigenvalue = 0.0, 0.0, 0.0
    pressures = (valve.supply_pressure, valve.return_pressure, valve.load_pressure)
    for temperature in (20.0, 40.0, 100.0, 200.0, 270.0):
        c = valve.at(vs.PartTemperatures.uniform(temperature))
        for current in (1e-3 * sign * size for size in (0.1, 1.0, 5.0, 10.0) for sign in (1.0, -1.0)):
            rest = vs.static_solution(valve, current=current, temperature=temperature)
            scenario = vs.Scenario(
                duration=0.5, thermal=ISOTHERMAL, oil_temperature=vs.Constant(value=temperature),
                command=vs.Step(after=current, time=1e-3), output_rate=10.0,
            )  # fmt: skip
            values = vs.simulate(scenario).values
            for name in ("armature_angle", "spool_position"):
                settled = abs(values[name][-1] / float(getattr(rest, name)) - 1.0)
                worst_settled = max(worst_settled, settled)
            angle = float(follow_branch(c, current, pressures))
            worst_root = max(worst_root, abs(float(rest.armature_angle) / angle - 1.0))
            worst_eigenvalue = max(
                worst_eigenvalue, float(np.nanmin(np.abs(np.asarray(rest.real_roots) / angle - 1.0)))
            )
    say(f"  settled {worst_settled:.1e}, polynomial root {worst_root:.1e}, as an eigenvalue {worst_eigenvalue:.1e}")
    where = "20, 40, 100, 200, 270 °C, ±0.1, ±1, ±5, ±10 mA"
    claims = (
        ("angle and spool 0.5 s after a step from rest", worst_settled, "static root"),
        ("angle: root of the polynomial by Newton", worst_root, "follow_branch"),
        ("angle: nearest eigenvalue of the polynomial's companion", worst_eigenvalue, "follow_branch"),
    )
    return [Row(f"{claim}, {where}", "", f"apart by {worst:.1e}", peer) for claim, worst, peer in claims]


CLAIMS = (launch_ramp, chirp, beside_c, cold_start, batch, modes, settling)


# ---------------------------------------------------------------- the table


def processor() -> str:
    """Model of the CPU."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        return next(line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown processor"


def document(rows: Sequence[Row], loads: tuple[float, float], seconds: float) -> str:
    """docs/benchmarks.md."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "numba", "casadi"))
    lines = [
        "# Benchmarks",
        "",
        f"Made by `.venv/bin/python benchmarks/solvers.py` on {date.today()} in {seconds:.0f} s.",
        f"Machine: {os.cpu_count()} cores, {processor()}; load average {loads[0]:.1f} before and {loads[1]:.1f} after "
        "(the script itself makes about one).",
        f"Python {platform.python_version()}, {packages}.",
        "",
        *(f"- **{name}**: {note}." for name, note in NOTES.items()),
        "",
        "| claim | target | measured | peer | ratio |",
        "|---|---|---|---|---|",
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure every claim and write the table."""
    parser = argparse.ArgumentParser(description="Measure valvesim's solver against its peers.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "docs" / "benchmarks.md", help="the table's file")
    output = parser.parse_args().output
    warnings.simplefilter("ignore", vs.ValidityWarning)  # the oil goes beyond its rating on purpose
    begin, load = time.perf_counter(), os.getloadavg()[0]
    rows = []
    for claim in CLAIMS:
        say(f"{time.perf_counter() - begin:5.0f} s  {claim.__name__}: {claim.__doc__}")
        rows += claim()
    seconds = time.perf_counter() - begin
    output.write_text(document(rows, (load, os.getloadavg()[0]), seconds), encoding="utf-8")
    say(f"{seconds:5.0f} s  wrote {output}")


if __name__ == "__main__":
    main()
