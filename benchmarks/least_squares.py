"""Our Levenberg-Marquardt with priors against `scipy.optimize.least_squares` with the priors as rows of their own.

    .venv/bin/python benchmarks/least_squares.py

Both fit the same studies from the same starts under the same noise: the nominal model from its nominal parameters, and
one hypothesis (what is hidden, at its typical amplitude) from the nominal fit. Told are the penalised chi-square that
is reached, how many simulations of all training records and how many linearisations that took, and the seconds.
A linearisation costs as much as some six simulations. scipy's method is `trf` (bounds), its `ftol` our own over the
chi-square that noise alone would leave.
"""

from __future__ import annotations

import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

import numpy as np  # noqa: E402
from answers import session as write  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

from valvesim.errors import InputError, SolveError  # noqa: E402
from valvesim.identification import hypothesis_fit, nominal_fit  # noqa: E402
from valvesim.identification import least_squares as own_least_squares  # noqa: E402
from valvesim.identification.fit import (  # noqa: E402
    Fit,
    FittedCandidate,
    evaluate_fit,
    moved_candidates,
    shapes_and_defaults,
    step_limits,
)
from valvesim.identification.fit_jacobian import jacobian_of, linearise_fit  # noqa: E402
from valvesim.identification.nominal_fit import fit_nominal, linearise_nominal  # noqa: E402
from valvesim.identification.session_toml import load_session  # noqa: E402
from valvesim.identification.study import Study, prepare_session  # noqa: E402

CASES = {  # session of benchmarks/answers.py -> label of what is hidden
    "sensor_bias": "sensor_bias@",
    "stiffness_loss": "flexure_stiffness_loss",
    "parameter_off": "parameter:feedback_rod_stiffness",
}


@dataclass
class Counts:
    """Simulations of all training records, and linearisations."""

    simulations: int = 0
    linearisations: int = 0


def counted(counts: Counts, job: Callable[[], Fit]) -> tuple[Fit, float]:
    """(fit, seconds) of a job of ours, its work counted."""
    modules, kept = (hypothesis_fit, own_least_squares, nominal_fit), []

    def simulate(*given):
        counts.simulations += 1
        return evaluate_fit(*given)

    def linearise(*given):
        counts.linearisations += 1
        return linearise_fit(*given)

    for module in modules:
        for name, other in (("evaluate_fit", simulate), ("linearise_fit", linearise)):
            if hasattr(module, name):
                kept.append((module, name, getattr(module, name)))
                setattr(module, name, other)
    begin = time.perf_counter()
    try:
        return job(), time.perf_counter() - begin
    finally:
        for module, name, other in kept:
            setattr(module, name, other)


def by_scipy(study: Study, start: Fit, ftol: float, counts: Counts) -> tuple[Fit, float]:
    """(fit, seconds) by scipy: residuals and Jacobian of the records, then the rows of the priors."""
    p, options = len(start.point), study.options
    x0 = start.vector
    sizes = np.array([1.0] * p + [1.0 if shape else e.candidate.typical for e, shape in start.layout])
    low, high = step_limits(start, study.nominal, options=options)
    shaped = [k for k, (_, shape) in enumerate(start.layout) if shape]
    known: dict[bytes, Fit] = {}

    def at(x: np.ndarray) -> Fit:
        if x.tobytes() not in known:
            counts.simulations += 1
            known[x.tobytes()] = evaluate_fit(study, x[:p], moved_candidates(start, (x - x0)[p:], options=options))
        return known[x.tobytes()]

    def residual(x: np.ndarray) -> np.ndarray:
        try:
            fit = at(x)
        except (SolveError, InputError):
            return np.full(len(start.residual) + p + len(shaped), 1e6)
        logs = [np.log(v / d) for member in fit.fitted for v, d in shapes_and_defaults(member)]
        return np.concatenate([-fit.residual, fit.point, np.array(logs) / options.fit.shape_deviation])

    def jacobian(x: np.ndarray) -> np.ndarray:
        counts.linearisations += 1
        fit = at(x)
        J = jacobian_of(study, fit, *linearise_fit(study, fit))
        prior = np.zeros((p + len(shaped), len(x)))
        prior[:p, :p] = np.eye(p)
        for row, k in enumerate(shaped):
            prior[p + row, p + k] = 1.0 / options.fit.shape_deviation
        return np.vstack([J, prior])

    begin = time.perf_counter()
    solved = least_squares(
        residual, x0, jacobian, bounds=(x0 + low, x0 + high), method="trf", x_scale=sizes,
        ftol=ftol / start.rows, xtol=None, gtol=None, max_nfev=60,
    )  # fmt: skip
    return at(solved.x), time.perf_counter() - begin


def told(name: str, start: Fit, results: dict[str, tuple[Fit, float, Counts]]) -> None:
    """A line for each."""
    for method, (fit, seconds, counts) in results.items():
        print(
            f"{name:34} {method:6} {start.chi_square:12.1f} -> {fit.chi_square:10.1f}  {counts.simulations:3d} "
            f"simulations, {counts.linearisations:2d} linearisations, {seconds:6.1f} s",
            flush=True,
        )


def compare(name: str, label: str) -> None:
    """Nominal fit and refit of a session by both."""
    with tempfile.TemporaryDirectory() as place:
        write(name, Path(place) / "session")
        final = fit_nominal(prepare_session(load_session(Path(place) / "session")))
    study, options = final.study.unweighted(), final.study.options.fit
    start = evaluate_fit(study, np.zeros(len(final.fit.point)), ())
    ours, theirs = Counts(), Counts()
    found, seconds = counted(
        ours, lambda: nominal_fit._converge(nominal_fit.linearise_nominal(study, start), options.nominal_ftol).fit
    )
    told(
        f"{name}: nominal", start,
        {"ours": (found, seconds, ours), "scipy": (*by_scipy(study, start, options.nominal_ftol, theirs), theirs)},
    )  # fmt: skip
    nominal = linearise_nominal(study, found)
    candidate = next(c for c in study.candidates if c.label.startswith(label))
    shapes = tuple((p.name, dict(candidate.fixed).get(p.name, p.default)) for p in candidate.shapes())
    begun = evaluate_fit(study, found.point, (FittedCandidate(candidate, candidate.typical, shapes),))
    ours, theirs = Counts(), Counts()

    def refit() -> Fit:
        jacobian = jacobian_of(study, begun, *hypothesis_fit.linearise_fit(study, begun))
        worthwhile = hypothesis_fit._worthwhile(nominal)
        return hypothesis_fit._iterate(
            study, begun, jacobian, options.hypothesis_ftol, options.most_linearisations, worthwhile
        )

    refitted, seconds = counted(ours, refit)
    told(
        f"{name}: {candidate.label}"[:34], begun,
        {
            "ours": (refitted, seconds, ours),
            "scipy": (*by_scipy(study, begun, options.hypothesis_ftol, theirs), theirs),
        },
    )  # fmt: skip


def main() -> None:
    """All cases."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, label in CASES.items():
            compare(name, label)


if __name__ == "__main__":
    main()
