"""The fit of a hypothesis: candidates together with the nuisance parameters of the nominal model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.down_weighting import down_weight_peaks, robust_weights
from valvesim.identification.fit import (
    Fit,
    FittedCandidate,
    amplitude_limits,
    evaluate_fit,
    is_adequate,
    largest_adequate,
    rescored,
    step_limits,
)
from valvesim.identification.fit_jacobian import all_candidate_sensitivities, jacobian_of, linearise_fit
from valvesim.identification.least_squares import (
    bounded_step,
    levenberg_marquardt,
    normal_equations,
    predict_reduction,
    solve_normal,
    with_posterior,
)
from valvesim.identification.nominal_fit import NominalFit, clipped_to_tolerance, robust_start
from valvesim.identification.predictor import Trajectory
from valvesim.identification.study import Study


def fit_hypothesis(
    nominal: NominalFit,
    start: Sequence[FittedCandidate],
    point: np.ndarray | None = None,
    linearisations: int | None = None,
    worthwhile: float | None = None,
) -> Fit | None:
    """Candidates and nuisance parameters fitted together from `start`; None where that cannot be simulated.

    The first Jacobian is that of the nominal fit. Starts that lie far off are shrunk. A fit above the chi-square
    `worthwhile` (if it is not given, one that is neither adequate nor better than the nominal fit) is given up after
    few linearisations.
    """
    linearisations = nominal.study.options.fit.most_linearisations if linearisations is None else linearisations
    tried = list[Fit]()
    for shrink in (1.0, 0.3, 0.1):
        try:
            fitted = tuple(replace(e, above_neutral=e.above_neutral * shrink) for e in start)
            at = nominal.fit.point if point is None else point
            tried.append(evaluate_fit(nominal.study, at, fitted, nominal.fit.trajectories))
        except (SolveError, InputError):
            continue
        if tried[-1].chi_square < _worthwhile(nominal):
            break
    if not tried:
        return None
    near = min(tried, key=lambda one: one.chi_square)
    try:
        fit = _fit_from_start(nominal, near, start, linearisations, worthwhile)
    except (SolveError, InputError):
        fit = None
    if near is tried[0] or (
        fit is not None
        and (
            worthwhile is not None
            or (fit.predicted_reduction < unconverged(nominal, fit) and fit.chi_square < _worthwhile(nominal))
        )
    ):
        return fit
    try:  # small beginnings may crawl along a bent valley: the great one jumps it
        afar = _fit_robustly(nominal, tried[0], linearisations, worthwhile)
    except (SolveError, InputError):
        return fit
    return afar if fit is None else min(fit, afar, key=lambda one: one.chi_square)


def _fit_from_start(
    nominal: NominalFit, fit: Fit, start: Sequence[FittedCandidate], linearisations: int, worthwhile: float | None
) -> Fit | None:
    """A fit from a start, or from the solution of the linearised equations, whichever predicts the lower end; where
    that is no better than the nominal fit, from a part of the way to that solution. None where no valve has the
    candidates at the nominal parameters.
    """
    start, step = tuple(start), _linear_step(nominal, start)
    leapt = _after_step(nominal, start, step) or _after_step(nominal, fit.fitted, _linear_step(nominal, fit.fitted))
    end = _fit_from_best_of(nominal, (fit, leapt), linearisations, worthwhile)
    if end is None or end.chi_square < _worthwhile(nominal):
        return end
    for share in (0.3, 0.1):  # a whole step may lead to where the valve oscillates, say
        part = _after_step(nominal, start, step, share)
        if part is not None and part.chi_square < min(fit.chi_square, end.chi_square):
            other = _fit_from_best_of(nominal, (part,), linearisations, worthwhile)
            return end if other is None else min(end, other, key=lambda one: one.chi_square)
    return end


def _fit_from_best_of(
    nominal: NominalFit, starts: Sequence[Fit | None], linearisations: int, worthwhile: float | None
) -> Fit | None:
    """A fit from whichever of some starts predicts the lowest end; None where no valve has the candidates of one."""
    study = nominal.study
    begun = [pair for at in starts if at and (pair := _with_jacobian(nominal, at))]
    if not begun:
        return None

    def predicted(fit: Fit, jacobian: np.ndarray) -> float:
        H, gradient = normal_equations(fit, jacobian, options=study.options)
        promised = predict_reduction(H, gradient, step_limits(fit, study.nominal, options=study.options))
        return fit.chi_square - 0.5 * promised  # promises are half kept

    fit, jacobian = min(begun, key=lambda pair: predicted(*pair))
    if not is_adequate(fit, options=study.options):
        return _fit_robustly(nominal, fit, linearisations, worthwhile)
    good = _worthwhile(nominal) if worthwhile is None else worthwhile
    return _iterate_to_end(study, fit, jacobian, _ending(nominal), linearisations, good)


def fit_from_prior(
    nominal: NominalFit,
    start: Sequence[FittedCandidate],
    linearisations: int | None = None,
    worthwhile: float | None = None,
) -> Fit | None:
    """The same restarted from the prior: no nuisance parameter beyond its tolerance, nothing kept of the nominal
    fit. A fit above the chi-square `worthwhile`, if it is given, is given up after few linearisations.

    Where that has moved parameters to where no valve runs, or none that has the cause besides, there is no way back
    from there.
    """
    try:
        return _fit_robustly(
            nominal,
            evaluate_fit(nominal.study, clipped_to_tolerance(nominal), tuple(start), nominal.fit.trajectories),
            nominal.study.options.fit.most_linearisations if linearisations is None else linearisations,
            worthwhile,
        )
    except (SolveError, InputError):
        return None


def continue_fit(nominal: NominalFit, fit: Fit) -> Fit | None:
    """A fit continued from where it is, with a Jacobian of its own; None where it cannot be simulated."""
    try:
        return continue_from(nominal, evaluated_beside(nominal, fit))
    except (SolveError, InputError):
        return None


def evaluated_beside(nominal: NominalFit, fit: Fit) -> Fit:
    """A fit evaluated in the study of a nominal one, whose figures it has where that has more. Raises SolveError,
    InputError where it cannot be simulated.
    """
    point = np.append(fit.point[: len(nominal.fit.point)], nominal.fit.point[len(fit.point) :])
    return evaluate_fit(nominal.study, point, fit.fitted, nominal.fit.trajectories).with_posterior_of(fit)


def continue_from(nominal: NominalFit, fit: Fit, worthwhile: float | None = None) -> Fit | None:
    """The same for a fit that has been simulated in the same study; `worthwhile` as in `fit_hypothesis`."""
    study = nominal.study
    try:
        jacobian = jacobian_of(study, fit, *linearise_fit(study, fit))
    except (SolveError, InputError):
        return None
    return _iterate_to_end(
        study,
        fit,
        jacobian,
        _ending(nominal),
        nominal.study.options.fit.most_linearisations,
        _worthwhile(nominal) if worthwhile is None else worthwhile,
    )


def reductions_from_prior(nominal: NominalFit, starts: Sequence[tuple[FittedCandidate, ...]]) -> np.ndarray:
    """(2, len(starts)) reduction of the chi-square by each start, from the same point; -inf where it cannot be
    simulated. The first row is with samples far off down-weighted, also those that what is sought has moved; the second
    with all in full.

    Each is simulated, and the nuisance parameters follow by the linearised equations.
    """
    study = nominal.study.without_oversampling().unweighted()
    fit = evaluate_fit(study, clipped_to_tolerance(nominal), (), nominal.fit.trajectories)
    columns = linearise_fit(study, fit)[1]

    def falls(weighted: Study, begun: Sequence[Fit | None]) -> list[float]:
        J = weighted.stack(columns)
        H = J.T @ J + np.eye(len(fit.point))

        def left(one: Fit) -> float:
            scored = rescored(weighted, one)
            gradient = J.T @ scored.residual - scored.point
            return float(scored.chi_square - gradient @ solve_normal(H, gradient))

        before = left(fit)
        return [before - left(one) if one is not None else -np.inf for one in begun]

    begun = [_evaluated(study, fit.point, start, fit.trajectories) for start in starts]
    return np.array([falls(weighted, begun) for weighted in (robust_weights(study, fit.readings), study)])


def _evaluated(
    study: Study, point: np.ndarray, fitted: tuple[FittedCandidate, ...], near: tuple[Trajectory, ...]
) -> Fit | None:
    """Candidates evaluated at a point (p,); None where that cannot be simulated."""
    try:
        return evaluate_fit(study, point, fitted, near)
    except (SolveError, InputError):
        return None


def _fit_robustly(nominal: NominalFit, fit: Fit, linearisations: int, worthwhile: float | None = None) -> Fit:
    """A fit as the nominal one is made: a robust start at the samples alone, peaks down-weighted, then as the study
    is. One that ends above a chi-square `worthwhile` with peaks down-weighted is not continued.
    """
    study, without_oversampling = nominal.study, nominal.study.without_oversampling()
    fit, linearised, columns = robust_start(without_oversampling, fit)
    if not study.weights:
        between = down_weight_peaks(without_oversampling, linearised)
        start = rescored(between, fit)
        near = _iterate(
            between,
            start,
            jacobian_of(between, fit, linearised, columns),
            lambda fit: nominal.study.options.fit.preliminary_ftol,
            linearisations,
            np.inf if worthwhile is None else worthwhile,
        )
        fit = rescored(study, near)
        if worthwhile is not None and near.chi_square > worthwhile:
            promised = near.predicted_reduction
            return replace(fit.with_posterior_of(near), predicted_reduction=promised, trajectories=())
        linearised, columns = linearise_fit(study, fit)
    return _iterate_to_end(
        study,
        fit,
        jacobian_of(study, fit, linearised, columns),
        _ending(nominal),
        linearisations,
        _worthwhile(nominal) if worthwhile is None else worthwhile,
    )


def _worthwhile(nominal: NominalFit) -> float:
    """The chi-square below which a fit is worth more linearisations."""
    return max(nominal.fit.chi_square, largest_adequate(nominal.fit, options=nominal.study.options))


def unconverged(nominal: NominalFit, fit: Fit) -> float:
    """The predicted reduction from which the fit of a hypothesis has not converged."""
    return 2.0 * _ending(nominal)(fit)


def _ending(nominal: NominalFit) -> Callable[[Fit], float]:
    """The reduction of the chi-square that ends a fit: of much that is explained a share tells no hypotheses apart, nor
    does one of what is left far from the records.
    """
    options = nominal.study.options.fit

    def enough(fit: Fit) -> float:
        explained = min(nominal.fit.chi_square - fit.chi_square, options.most_explained * fit.rows)
        far_off = nominal.study.negligible_far_off(fit.chi_square, fit.rows)
        return max(options.hypothesis_ftol, options.relative_ftol * explained, far_off)

    return enough


def _iterate_to_end(
    study: Study, fit: Fit, jacobian: np.ndarray, ending: Callable[[Fit], float], linearisations: int, good: float
) -> Fit:
    """The end of a fit by `_iterate`. Its trajectories are not kept: of hundreds of fits they fill the memory."""
    return replace(_iterate(study, fit, jacobian, ending, linearisations, good), trajectories=())


def _iterate(
    study: Study, fit: Fit, jacobian: np.ndarray, ending: Callable[[Fit], float], linearisations: int, good: float
) -> Fit:
    """Levenberg-Marquardt with the Jacobian taken anew where it no longer holds; with the Occam factor in the end.

    It ends as well where no valve can have figures a little further on.
    """
    for iteration in range(1, linearisations + 1):
        new, updated = levenberg_marquardt(study, fit, jacobian, ending(fit))
        enough = ending(new)  # far off, where a fit begins, more is negligible
        stuck, fit = iteration > 1 and new.chi_square > fit.chi_square - enough, new
        hoped = study.options.fit.predicted_reductions if iteration < study.options.fit.linearisations else 0.0
        hopeless = iteration > 1 and fit.chi_square - hoped * fit.predicted_reduction > good
        if fit.predicted_reduction < enough or stuck or hopeless or iteration == linearisations:
            break
        try:
            jacobian = jacobian_of(study, fit, *linearise_fit(study, fit))
        except (SolveError, InputError):
            break
    H, _ = normal_equations(fit, updated, options=study.options)
    return with_posterior(H, fit, options=study.options)


def _linear_step(nominal: NominalFit, start: Sequence[FittedCandidate]) -> np.ndarray | None:
    """Solution (p + candidates,) of the linearised equations for all parameters at once: what the cause has moved goes
    back at once. None where no valve has the candidates at the nominal parameters.
    """
    absent = nominal.fit.with_fitted(start)  # its residual is that without the fitted candidates
    try:
        S = added_jacobian(nominal, absent)
        own = [k for k, (_, shape) in enumerate(absent.layout) if not shape]
        plain = nominal.fit.with_fitted([replace(e, shapes=()) for e in start])
        H, gradient = normal_equations(plain, np.column_stack([nominal.J, S[:, own]]), options=nominal.study.options)
        limits = np.transpose(
            [*np.transpose(nominal.study.nominal.limits - nominal.fit.point)]
            + [amplitude_limits(e.candidate, options=nominal.study.options) for e in start]
        )
        return bounded_step(H, gradient, limits)
    except (SolveError, InputError):
        return None


def _after_step(
    nominal: NominalFit, start: Sequence[FittedCandidate], step: np.ndarray | None, share: float = 1.0
) -> Fit | None:
    """The fit after a share of a `_linear_step` from the nominal one; None where there is none or it cannot be run."""
    if step is None:
        return None
    p = len(nominal.fit.point)
    fitted = tuple(replace(e, above_neutral=share * float(a)) for e, a in zip(start, step[p:], strict=True))
    return _evaluated(nominal.study, nominal.fit.point + share * step[:p], fitted, nominal.fit.trajectories)


def _with_jacobian(nominal: NominalFit, fit: Fit) -> tuple[Fit, np.ndarray] | None:
    """A fit with the nominal fit's Jacobian; None where no valve has its candidates at the nominal parameters."""
    try:
        return fit, np.column_stack([nominal.J, added_jacobian(nominal, fit)])
    except InputError:
        return None


def added_jacobian(nominal: NominalFit, fit: Fit) -> np.ndarray:
    """The whitened Jacobian (rows, n) at the nominal fit with respect to the candidates of another fit."""
    study, origin = nominal.study, nominal.linearised[0].variant
    candidates, changed, divide = [], [], []
    for member in fit.fitted:
        size = (
            member.above_neutral
            if abs(member.above_neutral) > 1e-3 * member.candidate.typical
            else 1e-3 * member.candidate.typical
        )
        for name, value in (("", 0.0), *member.shapes):
            shapes = dict(member.shapes) | (
                {name: value * nominal.study.options.sensitivity.shape_ratio} if name else {}
            )
            candidates.append(member.candidate)
            changed.append(member.candidate.apply_to(origin, size, **shapes))
            divide.append(0.0 if name else size)
    columns = study.stack(all_candidate_sensitivities(study, nominal.linearised, nominal.columns, candidates, changed))
    out = np.empty_like(columns)
    own = 0
    for k, by in enumerate(divide):
        if by != 0.0:
            own = k
            out[:, k] = columns[:, k] / by
        else:
            out[:, k] = (columns[:, k] - columns[:, own]) / np.log(nominal.study.options.sensitivity.shape_ratio)
    if len(fit.fitted) == 1 and abs(fit.fitted[0].above_neutral) > 0.05 * fit.fitted[0].candidate.typical:
        # what the fit has really gained by its one effect, over what the linearised equations say of the nominal model
        moved = nominal.fit.residual - nominal.J @ (fit.point - nominal.fit.point) - fit.residual
        secant = moved / fit.fitted[0].above_neutral
        if float(secant @ out[:, 0]) > 0.25 * float(out[:, 0] @ out[:, 0]):
            out[:, 0] = secant
    return out
