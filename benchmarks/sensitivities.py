"""How far linear answers are from differences of true runs, and what that moves a fit by.

    .venv/bin/python benchmarks/sensitivities.py 970187 970174 970073 970140

For bench sessions (by seed), at the likeliest hypothesis of a diagnosis, or at the nominal one where nothing is wrong:
the sensitivities of the readings to the valve's quantities by the linearised equations, with and without their fast
steps divided, against central differences of runs (0.05 prior deviations to either side, at a hundredth of the solver's
tolerance). Told are the relative errors of the worst column and of the armature's inertia, and the step of a fit that
the errors make with what the records leave: the furthest quantity in posterior deviations, and the chi-square of the
whole; at last by how much the chi-square of the fit errs by the solver's tolerance.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import replace
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: one core
    os.environ.setdefault(threads, "1")

import numpy as np  # noqa: E402
from bench_sessions import SETS, draw_bench, sessions, write_bench_session  # noqa: E402

import valvesim.diagnosis.diagnose as diagnose_module  # noqa: E402
from valvesim.diagnosis.isolation import Isolation  # noqa: E402
from valvesim.identification.fit import Fit, evaluate_fit  # noqa: E402
from valvesim.identification.fit_jacobian import jacobian_of, linearise_fit  # noqa: E402
from valvesim.identification.study import Study  # noqa: E402

STEP = 0.05  # prior deviations
TOLERANCE = 1e-6  # of the solver, for the differences


def isolation_of(seed: int) -> Isolation:
    """What a session was isolated to, before the answer is made of it."""
    name = next(name for name, (first, count) in SETS.items() if first <= seed < first + count)
    _, hidden, imperfections = next(one for one in sessions(name) if one[0] == seed)
    ends, isolate = list[Isolation](), diagnose_module.isolate

    def kept(*given: Any, **options: Any) -> Isolation:
        ends.append(isolate(*given, **options))
        return ends[-1]

    diagnose_module.isolate = kept
    try:
        with tempfile.TemporaryDirectory() as folder:
            case, bench = draw_bench(seed, "effect" if hidden else "none", name=hidden, imperfections=imperfections)
            write_bench_session(case, bench, folder)
            diagnose_module.diagnose(folder)
    finally:
        diagnose_module.isolate = isolate
    return ends[-1]


def with_options(study: Study, **changes: Any) -> Study:
    """A study whose options of sensitivities or of the predictor are others."""
    options = study.options
    own = {name: value for name, value in changes.items() if hasattr(options.sensitivity, name)}
    others = {name: value for name, value in changes.items() if name not in own}
    options = replace(
        options, sensitivity=replace(options.sensitivity, **own), predictor=replace(options.predictor, **others)
    )
    return replace(
        study, options=options, predictors=tuple(replace(one, options=options) for one in study.predictors)
    )


def central_differences(study: Study, fit: Fit, which: list[int]) -> np.ndarray:
    """(rows, len(which)) of the whitened readings, to one prior deviation of each nuisance parameter."""
    columns = []
    for k in which:
        by = STEP * np.eye(len(fit.point))[k]
        ends = [evaluate_fit(study, fit.point + sign * by, fit.fitted).residual for sign in (1.0, -1.0)]
        columns.append((ends[1] - ends[0]) / (2.0 * STEP))
    return np.column_stack(columns)


def main() -> None:
    heads = ("session", "linearised", "points", "worst column", "its error", "the inertia's", "furthest, deviations",
             "chi-square", "by the solver")  # fmt: skip
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    for seed in map(int, sys.argv[1:]):
        ended = isolation_of(seed)
        study, names = ended.nominal.study, [p.name for p in ended.nominal.study.nominal.parameters]
        fit = evaluate_fit(study, ended.final.fit.point, ended.final.fit.fitted)
        of_valve = [k for k, parameter in enumerate(study.nominal.parameters) if parameter.is_of_valve]
        fine = with_options(study, tolerance=TOLERANCE)
        by_solver = fit.chi_square - evaluate_fit(fine, fit.point, fit.fitted).chi_square
        true = central_differences(fine, fit, of_valve)
        sizes = np.linalg.norm(true, axis=0)
        seen = [k for k, size in enumerate(sizes) if size > 0.0]
        for words, share in (("undivided", 0.0), ("divided", study.options.sensitivity.most_divided)):
            way = with_options(study, most_divided=share)
            linearised, columns = linearise_fit(way, fit)
            J = jacobian_of(way, fit, linearised, columns)
            off = J[:, of_valve] - true
            J[:, of_valve] = true
            H = J.T @ J
            H[: len(names), : len(names)] += np.eye(len(names))
            covariance = np.linalg.inv(H)
            errors = np.linalg.norm(off, axis=0)[seen] / sizes[seen]
            worst, inertia = int(np.argmax(errors)), seen.index(of_valve.index(names.index("armature_inertia")))
            gradient = np.zeros(len(H))
            gradient[of_valve] = off.T @ fit.residual
            moved = covariance @ gradient
            furthest = float(np.max(np.abs(moved) / np.sqrt(np.diag(covariance))))
            points = sum(len(one.course.times) for one in linearised)
            print(
                f"| {seed} | {words} | {points} | {names[of_valve[seen[worst]]]} | {100.0 * errors[worst]:.0f} % "
                f"| {100.0 * errors[inertia]:.0f} % | {furthest:.2f} | {float(gradient @ moved):.2f} "
                f"| {by_solver:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
