"""Measures the studies: throughput, kill and resume, a real scheduler with a killed worker, a million members.

    python benchmarks/studies.py throughput     one process, two, a loop of scipy, CasADi's map: processor time a member
    python benchmarks/studies.py launch         a member of the launch shock beside the solver's time of a single run
    python benchmarks/studies.py kill           killed at random moments, started again, compared byte for byte
    python benchmarks/studies.py scheduler      dask scheduler and two workers as processes, one of them killed
    python benchmarks/studies.py sobol          Ishigami by the whole path against its closed form and SALib alone
    python benchmarks/studies.py members N      N members of the step study in one process: time and memory

Each prints what docs/studies.md holds. Times are of the processor, side by side in one run.
"""

from __future__ import annotations

import filecmp
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import valvesim as vs
from valvesim.inputs import evaluate
from valvesim.simulation.run import integrate_member, prepare
from valvesim.studies.designs import Design, saltelli_problem
from valvesim.studies.distributions import Distribution
from valvesim.studies.members import make_plan, run_block
from valvesim.studies.parameter_study import ChannelPercentiles, FigureOptions, ParameterStudy
from valvesim.studies.sensitivity_indices import sensitivity_indices
from valvesim.studies.study import study
from valvesim.studies.variables import Varied, find_quantity, tolerated

STEP = vs.Scenario(
    title="step of half the rated current", duration=0.1, thermal=vs.Thermal(network=None),
    command=vs.Step(after=5e-3, time=0.01), tolerance=1e-5, output_rate=1000.0,
)  # fmt: skip

VELOCITY = 5  # place of the spool's velocity among the states


def step_study(members: int, *, block: int | None = None, percentiles: bool = True) -> ParameterStudy:
    """Tolerance draws of a step of 0.1 s: three figures of the run, percentiles of the spool over time."""
    return ParameterStudy(
        title="step within tolerances", case=STEP, variables=tolerated(STEP), design=Design(members=members, seed=1),
        keep=("run.spool_position.end", "run.spool_position.highest", "run.spool_velocity.highest"), block=block,
        percentiles=ChannelPercentiles(channels=("spool_position",)) if percentiles else None,
    )  # fmt: skip


def processor_time() -> float:
    own, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def _peak() -> float:
    """Memory of this process at most, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


# ---------------------------------------------------------------- throughput


def throughput() -> None:
    """Processor time a member, and how far each is from tight runs."""
    own = step_study(2000, block=500, percentiles=False)
    plan, draws = make_plan(own), own.draws()
    run_block(own, plan, 0, draws[:10])
    tight = np.array([_tight(own.member(draw)) for draw in draws[:20]])
    begin = time.process_time()
    figures = np.vstack([run_block(own, plan, k, draws[500 * k : 500 * (k + 1)]).figures for k in range(4)])
    ours = (time.process_time() - begin) / len(draws)
    print(f"study, one process: {1e6 * ours:.0f} us a member, error {_error(figures[:20, 2], tight):.1e}")
    for name, run, rtol in (
        ("scipy LSODA", _scipy, 1e-5),
        ("scipy Radau", _scipy, 1e-4),
        ("CasADi map, CVODES", _casadi, 1e-6),
    ):
        seconds, got = run(own, draws[:20], rtol, name)
        told = f"{1e6 * seconds:.0f} us a member ({seconds / ours:.0f} x), error {_error(got, tight):.1e}"
        print(f"{name}, rtol {rtol:g}: {told}")
    _two_processes()


def _two_processes() -> None:
    """The same study on one and on two worker processes, and its processor time: linear where that stays."""
    many = step_study(40_000, block=2500, percentiles=False)
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            before, begin = processor_time(), time.perf_counter()
            study(many, folder, workers=workers)
            spent, wall = processor_time() - before, time.perf_counter() - begin
        print(
            f"{workers} workers: {1e6 * spent / many.members:.0f} us of processor a member, {wall:.1f} s of the clock"
        )


def _tight(case: vs.Scenario) -> float:
    return float(vs.simulate(replace(case, tolerance=1e-9))["spool_velocity"].values.max())


def _error(got: np.ndarray, exact: np.ndarray) -> float:
    return float(np.max(np.abs(got - exact)) / np.max(np.abs(exact)))


def _members(own: ParameterStudy, draws: np.ndarray) -> list:
    return [prepare(own.member(draw)) for draw in draws]


def _scipy(own: ParameterStudy, draws: np.ndarray, rtol: float, name: str) -> tuple[float, np.ndarray]:
    """A loop over solve_ivp with the compiled derivative and Jacobian, begun again at the jump."""
    from scipy.integrate import solve_ivp

    problems, got = _members(own, draws), []
    begin = time.process_time()
    for problem in problems:
        compiled, flat = problem.compiled, problem.knots[0, 0]
        n = len(compiled.scale)
        highest, y, start = -np.inf, problem.initial[0], 0.0
        for end in (STEP.command.time, STEP.duration):
            u = np.array([0.0 if start == 0.0 else STEP.command.after, 0.0, 21e6, 0.5e6, 0.0])

            def rates(t, y, u=u, flat=flat, out=compiled, n=n):
                f = np.empty(n)
                out.derivative(np.ascontiguousarray(y), u, flat, f)
                return f

            def jacobian(t, y, u=u, flat=flat, out=compiled, n=n):
                J = np.empty((n, n))
                out.jacobian(np.ascontiguousarray(y), u, flat, J)
                return J

            times = problem.times[(problem.times >= start) & (problem.times <= end)]
            solved = solve_ivp(
                rates, (start, end), y, method=name.split()[1], t_eval=np.unique(np.append(times, end)), jac=jacobian,
                rtol=rtol, atol=0.01 * rtol,
            )  # fmt: skip
            y, start = solved.y[:, -1], end
            highest = max(highest, float(solved.y[VELOCITY].max() * compiled.scale[VELOCITY]))
        got.append(highest)
    return (time.process_time() - begin) / len(draws), np.array(got)


def _casadi(own: ParameterStudy, draws: np.ndarray, rtol: float, name: str) -> tuple[float, np.ndarray]:
    """CVODES for all members by one map over their coefficients, in two pieces with the jump between them."""
    import casadi

    from valvesim.solver.codegen import trace

    problems = _members(own, draws)
    compiled, model = problems[0].compiled, problems[0].compiled.model
    rates, at = trace(model)
    scale = casadi.DM(compiled.scale.tolist())
    y, p = casadi.SX.sym("y", len(compiled.scale)), casadi.vertcat(at["inputs"], at["coefficients"])
    scaled = casadi.substitute(rates, at["state"], y * scale) / scale
    options = {"reltol": rtol, "abstol": 0.003 * rtol, "max_num_steps": 100_000}
    times, jump = problems[0].times, STEP.command.time
    grids = ((0.0, times[(times > 0.0) & (times <= jump)]), (jump, times[times > jump]))
    ode = {"x": y, "p": p, "ode": scaled}
    before, after = (casadi.integrator("piece", "cvodes", ode, at, grid.tolist(), options) for at, grid in grids)
    flats = np.column_stack([problem.knots[0, 0] for problem in problems])
    inputs = [[float(evaluate(STEP.command, t)), 0.0, 21e6, 0.5e6, 0.0] for t in (0.0, 0.05)]
    driven = [np.vstack([np.tile(np.array(u)[:, None], len(draws)), flats]) for u in inputs]
    initial = np.column_stack([problem.initial[0] for problem in problems])
    maps = [piece.map(len(draws)) for piece in (before, after)]
    begin = time.process_time()
    first = np.array(maps[0](x0=initial, p=driven[0])["xf"]).reshape(len(compiled.scale), len(draws), -1)
    last = np.array(maps[1](x0=first[:, :, -1], p=driven[1])["xf"]).reshape(len(compiled.scale), len(draws), -1)
    seconds = (time.process_time() - begin) / len(draws)
    return seconds, last[VELOCITY].max(axis=1) * compiled.scale[VELOCITY]


def launch() -> None:
    """A member of a batch over the launch's oil ramp, all of it, over the solver's time of a single run."""
    shock = vs.load_scenario("launch_shock")
    scenario = replace(shock, duration=84.0)
    own = ParameterStudy(
        case=scenario, variables=tolerated(scenario), design=Design(members=184), keep=("run.spool_position.*",),
        block=184,
    )  # fmt: skip
    plan, draws, problem = make_plan(own), own.draws(), prepare(scenario)
    run_block(own, plan, 0, draws[:8])
    integrate_member(problem, 0, None)
    begin = time.process_time()
    for _ in range(5):
        integrate_member(problem, 0, None)
    single = (time.process_time() - begin) / 5
    for what, some in (("46", draws[:46]), ("184", draws)):
        begin = time.process_time()
        failed = sum(reason != "" for reason in run_block(own, plan, 0, some).reasons)
        member = (time.process_time() - begin) / len(some)
        told = f"{member / single:.2f} of a single run's solver, {failed} failed, {_peak():.0f} MB at most"
        print(f"{what}: {1e3 * member:.1f} ms a member, {told}")


# ---------------------------------------------------------------- kill and resume


SCRIPT = """
import sys
sys.path.insert(0, {here!r})
from studies import step_study
from valvesim.studies.study import study
if __name__ == "__main__":
    study(step_study({members}, block={block}), {folder!r}, workers={workers}, scheduler={scheduler!r})
"""


def _start(
    folder: Path, *, members: int, block: int, workers: int | None, scheduler: str | None = None
) -> subprocess.Popen:
    """A process that runs the step study; its parts go with it when it is killed."""
    text = SCRIPT.format(
        here=str(Path(__file__).parent), members=members, block=block, folder=str(folder), workers=workers,
        scheduler=scheduler,
    )  # fmt: skip
    script = folder.with_suffix(".py")
    script.write_text(text, encoding="utf-8")
    return subprocess.Popen([sys.executable, str(script)], start_new_session=True)


def _same(one: Path, other: Path) -> bool:
    names = sorted(str(p.relative_to(one)) for p in one.rglob("*") if p.is_file())
    others = sorted(str(p.relative_to(other)) for p in other.rglob("*") if p.is_file())
    return names == others and not any(filecmp.cmpfiles(one, other, names, shallow=False)[1:])


def _done(store: Path) -> int:
    """How many blocks of a store are done."""
    folder = store / "done"
    return sum(1 for p in folder.iterdir() if p.name.isdigit()) if folder.is_dir() else 0


def kill() -> None:
    """Kills a study at random moments (SIGKILL) until it ends, and compares its store with one that nobody killed."""
    folder = Path(tempfile.mkdtemp())
    size = {"members": 6000, "block": 500, "workers": 0}
    _start(folder / "whole", **size).wait()
    dice, kills, store = random.Random(1), 0, folder / "killed" / "study.zarr"
    while True:
        process, before = _start(folder / "killed", **size), _done(store)
        while process.poll() is None and _done(store) == before:
            time.sleep(0.01)
        try:
            process.wait(timeout=dice.uniform(0.0, 0.3))  # at any moment of the next block
            break
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
    same = _same(folder / "whole" / "study.zarr", folder / "killed" / "study.zarr")
    print(f"killed {kills} times, finished: store {'the same byte for byte' if same else 'DIFFERS'}")
    shutil.rmtree(folder)


# ---------------------------------------------------------------- a scheduler of its own


def scheduler() -> None:
    """`dask scheduler`, two `dask worker`s, one of them killed on the way; the store against that of this process."""
    folder = Path(tempfile.mkdtemp())
    size = {"members": 12_000, "block": 500}
    _start(folder / "alone", workers=0, **size).wait()
    dask, address = str(Path(sys.executable).with_name("dask")), "tcp://127.0.0.1:18786"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    parts = [subprocess.Popen([dask, "scheduler", "--host", "127.0.0.1", "--port", "18786", "--no-dashboard"], **quiet)]
    worker = [dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--memory-limit", "2GiB"]
    parts += [subprocess.Popen([*worker, "--local-directory", str(folder / f"w{k}")], **quiet) for k in range(2)]
    try:
        time.sleep(8.0)
        process = _start(folder / "served", workers=None, scheduler=address, **size)
        store = folder / "served" / "study.zarr"
        while _done(store) < 4:
            time.sleep(0.1)
        os.killpg(parts[2].pid, signal.SIGKILL)  # with its nanny, so that none takes its place
        print(f"killed one of two workers after {_done(store)} of {size['members'] // size['block']} blocks")
        print(f"the study ended with code {process.wait(timeout=600)}")
        same = _same(folder / "alone" / "study.zarr", folder / "served" / "study.zarr")
        print(f"store {'the same byte for byte as that of one process' if same else 'DIFFERS'}")
    finally:
        for part in parts:
            if part.poll() is None:
                os.killpg(part.pid, signal.SIGKILL)
        shutil.rmtree(folder, ignore_errors=True)


# ---------------------------------------------------------------- Sobol indices


def ishigami(case: vs.Scenario) -> dict[str, float]:
    """Ishigami and Homma (1990) of three quantities of the valve, each over -pi to pi."""
    valve = case.valve
    x = [10.0 * np.pi * (v - 1.0) for v in (valve.null_gap / 35e-6, valve.spool_mass / 4e-3, valve.spool_damping)]
    return {"ishigami": float(_ishigami(np.array(x)))}


def _ishigami(x: np.ndarray) -> np.ndarray:
    return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


def sobol() -> None:
    """Ishigami by the whole path (draw, members, store, indices) against its closed form, and SALib on its own."""
    from SALib.analyze import sobol as analyze
    from SALib.sample import sobol as sample

    sizes = {"valve.null_gap": 35e-6, "valve.spool_mass": 4e-3, "valve.spool_damping": 1.0}
    variables = (Varied(find_quantity(STEP, k), Distribution("uniform", 0.9 * n, 0.2 * n)) for k, n in sizes.items())
    own = ParameterStudy(
        case=STEP, variables=tuple(variables), design=Design(kind="saltelli", members=4096), keep=("own.*",),
        options=FigureOptions(functions=(ishigami,)),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        found = sensitivity_indices(study(own, folder, workers=0), "own.ishigami")
    u = sample.sample(saltelli_problem(own.keys), 4096, calc_second_order=False, scramble=True, seed=1)
    alone = analyze.analyze(
        saltelli_problem(own.keys), _ishigami(np.pi * (2.0 * u.T - 1.0)), calc_second_order=False, seed=1
    )
    a, b, pi = 7.0, 0.1, np.pi
    whole, both = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5, b**2 * pi**8 * (1 / 18 - 1 / 50)
    first = np.array([0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, 0.0]) / whole
    total = first + np.array([both, 0.0, both]) / whole
    for k in range(3):
        print(f"x{k + 1}: first {found.first[k]:.4f} (exact {first[k]:.4f}, SALib alone {alone['S1'][k]:.4f}), "
              f"total {found.total[k]:.4f} (exact {total[k]:.4f}, SALib alone {alone['ST'][k]:.4f})")  # fmt: skip
    print(f"{found.used} members")


# ---------------------------------------------------------------- many members


def members(count: int) -> None:
    """So many members in this process: processor time, memory, size of the store; goes on where it was stopped."""
    folder = Path("results") / f"step_study_{count}"
    own = step_study(count)
    begin, told = time.process_time(), [0]

    def progress(done: int, of: int) -> None:
        if done >= told[0]:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            print(
                f"{done} of {of} members, {time.process_time() - begin:.0f} s of processor, {peak:.0f} MB", flush=True
            )
            told[0] += count // 10

    result = study(own, folder, workers=0, progress=progress)
    size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
    print(f"store {size / 1e6:.0f} MB; 1, 50, 99 % of the end: "
          f"{np.percentile(result.column('run.spool_position.end'), [1, 50, 99]) * 1e3} mm")  # fmt: skip
    print(f"percentiles from counts at the end: {result.percentiles.values[0, [0, 3, 6], -1] * 1e3} mm")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    what, *rest = sys.argv[1:] or ["throughput"]
    {"throughput": throughput, "launch": launch, "kill": kill, "scheduler": scheduler, "sobol": sobol,
     "members": lambda: members(int(rest[0]) if rest else 100_000)}[what]()  # fmt: skip
