"""Penalised least squares: Levenberg-Marquardt with box constraints and Gaussian priors, and Broyden's update between
linearisations.

Symbols
    r whitened residual, J its Jacobian, t parameters;  H = J'J + prior precision, g = J'r - prior precision (t - t0)
Levenberg 1944, Marquardt 1963; Broyden 1965; Transtrum and Sethna 2012 (geodesic acceleration); Nocedal and Wright,
Numerical Optimization, ch. 10 (least squares) and 16 (active set). The Occam factor of a fit is that of MacKay 1992
(Laplace's approximation of the evidence).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from valvesim.errors import InputError, SolveError
from valvesim.identification.fit import Fit, evaluate_fit, moved_fit, shapes_and_defaults, step_limits
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.projection import inverse_of
from valvesim.identification.study import Study

SINGULAR = 1e-6  # of a Cholesky factor of scaled normal equations: below, some direction may not be seen


@dataclass(frozen=True, eq=False)
class SecantJacobian:
    """A Jacobian (rows, n) with Broyden's updates: the `first` one, to which `left` (k, rows) times `along` (k, n) add;
    and its `gram` J'J. A Jacobian of tens of megabytes is read at each step, and not written.
    """

    first: np.ndarray
    left: np.ndarray
    along: np.ndarray
    gram: np.ndarray

    @staticmethod
    def of(jacobian: np.ndarray) -> SecantJacobian:
        """A Jacobian not updated yet."""
        rows, n = jacobian.shape
        return SecantJacobian(jacobian, np.empty((0, rows)), np.empty((0, n)), jacobian.T @ jacobian)

    def times(self, step: np.ndarray) -> np.ndarray:
        """J times a step (n,)."""
        return self.first @ step + (self.along @ step) @ self.left

    def transposed_times(self, residual: np.ndarray) -> np.ndarray:
        """J' times a residual (rows,)."""
        return self.first.T @ residual + (self.left @ residual) @ self.along

    def updated(self, moved: np.ndarray, changed: np.ndarray, metric: np.ndarray) -> SecantJacobian:
        """The same after a step `moved` (n,) that has `changed` the residual (rows,) (Broyden 1965)."""
        along = metric * moved
        left = (changed - self.times(moved)) / float(moved @ along)
        crossed = np.outer(self.transposed_times(left), along)
        gram = self.gram + crossed + crossed.T + float(left @ left) * np.outer(along, along)
        return SecantJacobian(self.first, np.vstack([self.left, left]), np.vstack([self.along, along]), gram)


def levenberg_marquardt(study: Study, fit: Fit, jacobian: np.ndarray, enough: float) -> tuple[Fit, SecantJacobian]:
    """The fit after damped Gauss-Newton steps, damped in the metric of the priors (Marquardt 1963), and its
    Jacobian.

    It ends where the predicted reduction is below `ftol`, or where steps no longer bring what is predicted. Between
    linearisations the Jacobian (rows, n) is updated by each step (Broyden 1965). A first step that leads up tells how
    the valley bends: the next one follows that, and the linearisation is renewed where it arrives. Where it bends too
    much for that, one step uphill is allowed: the next may lead back into the valley, further down. Where no step of a
    fit with candidates has led down, a share of the first one is the last that is tried: amplitudes and shapes make
    narrow valleys, and what the records tell far better than the priors, damping in their metric does not shorten.
    """
    options, metric = study.options.fit, _metric_of(fit)
    J = SecantJacobian.of(jacobian)
    damping, failures, start, best = 0.0, 0, fit, fit  # away from its best a fit is on its one step uphill
    first, accelerated, has_accelerated = np.zeros(len(metric)), None, False
    for _ in range(options.steps):
        H, gradient = normal_equations(fit, J, options=study.options)
        limits = step_limits(fit, study.nominal, options=study.options)
        if fit is best:
            known = replace(fit, predicted_reduction=predict_reduction(H, gradient, limits))
            start, best, fit = known if best is start else start, known, known
            lasting = options.patience if study.is_long else 0
            stale = best.chi_square < start.chi_square and (
                failures > lasting or has_accelerated or _linearisation_expired(start, best, options=study.options)
            )
            if best.predicted_reduction < enough or stale or failures == options.failures:
                break
        damped = H + damping * np.diag(metric)
        step = accelerated if accelerated is not None else _step_within(study, damped, gradient, limits, metric)
        if fit is start and failures == 0:
            first = step
        elif best is start and fit.fitted and failures == options.failures - 1:
            step = options.short_step * first
        try:
            new = _moved_by(study, fit, step)
        except (SolveError, InputError):  # no valve can have these figures
            fit, accelerated, damping, failures = best, None, max(10.0 * damping, 0.1), failures + 1
            continue
        moved, changed = new.vector - fit.vector, fit.residual - new.residual
        gained = best.chi_square - new.chi_square
        if gained <= 0.0 and fit is best and failures == 0:
            accelerated = _accelerated_step(fit, J, damped, moved, changed, limits, metric, options=study.options)
            if accelerated is not None:
                failures = 1
                continue
        if moved.any() and float(changed @ changed) > options.update_threshold:
            J = J.updated(moved, changed, metric)
        if gained > 0.0:
            has_accelerated = accelerated is not None
            failures = 0 if gained > 0.5 * best.predicted_reduction else failures + 1
            damping = 0.0 if damping <= 0.1 or gained > 0.5 * best.predicted_reduction else damping / 10.0
            best = fit = new
        elif fit is best and failures == 0:
            fit = new  # a bent valley: the next step may lead back into it, further down
        else:
            fit, damping, failures = best, max(10.0 * damping, 0.1), failures + 1
        accelerated = None
    return best, J


def _metric_of(fit: Fit) -> np.ndarray:
    """(n,): the precisions of the priors, of the nuisance parameters and then of the fitted candidates."""
    return np.array([1.0] * len(fit.point) + [1.0 if shape else e.candidate.typical**-2 for e, shape in fit.layout])


def _step_within(
    study: Study, damped: np.ndarray, gradient: np.ndarray, limits: np.ndarray, metric: np.ndarray
) -> np.ndarray:
    """The step of damped normal equations, damped further until no nuisance parameter goes too far."""
    longest, more = study.nominal.longest_step, 0.0
    step = bounded_step(damped, gradient, limits)
    while np.any(np.abs(step[: len(longest)]) > longest):
        more = max(2.0 * more, 0.01)
        step = bounded_step(damped + more * np.diag(metric), gradient, limits)
    return step


def _moved_by(study: Study, fit: Fit, step: np.ndarray) -> Fit:
    """The fit at a step from another one, simulated."""
    moved = moved_fit(fit, step, options=study.options)
    return evaluate_fit(study, moved.point, moved.fitted, fit.trajectories)


def _accelerated_step(
    fit: Fit,
    jacobian: SecantJacobian,
    damped: np.ndarray,
    moved: np.ndarray,
    changed: np.ndarray,
    limits: np.ndarray,
    metric: np.ndarray,
    *,
    options: IdentificationOptions,
) -> np.ndarray | None:
    """The best step along the parabola that a step `moved` (n,) tells of which `changed` the residual (rows,)
    otherwise than the linearised equations say (geodesic acceleration, Transtrum and Sethna 2012).

    None where the acceleration is more than a given share of the step: the equations are of second order no longer.
    """
    straight, p = jacobian.times(moved), len(fit.point)
    curvature = changed - straight
    acceleration = -solve_normal(damped, jacobian.transposed_times(curvature))
    if acceleration @ (metric * acceleration) > options.fit.acceleration_ratio**2 * (moved @ (metric * moved)):
        return None
    square = curvature + jacobian.times(acceleration)

    def left(share: float) -> float:
        residual = fit.residual - share * straight - share**2 * square
        point = fit.point + share * moved[:p] + share**2 * acceleration[:p]
        return float(residual @ residual + point @ point)

    best = min(np.linspace(0.05, 1.0, 20), key=left)
    return np.clip(best * moved + best**2 * acceleration, *limits)


def predict_reduction(H: np.ndarray, gradient: np.ndarray, limits: np.ndarray) -> float:
    """By how much the linearised equations would lower the penalised chi-square."""
    step = bounded_step(H, gradient, limits)
    return max(float((2.0 * gradient - H @ step) @ step), 0.0)


def _linearisation_expired(start: Fit, fit: Fit, *, options: IdentificationOptions) -> bool:
    """Whether the Jacobian taken at `start` is of a valve too far from where the fit is now."""
    far = float(np.max(np.abs(fit.point - start.point)))
    return start.chi_square - fit.chi_square > 50.0 and far > options.fit.linearisation_radius


def bounded_step(H: np.ndarray, gradient: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The step that lowers the chi-square most inside the box, by block principal pivoting (Judice and Pires 1994).

    All components beyond their limits are held there, and all those let go again whose gradient leads back inside; one
    at a time where that goes round in circles.
    """
    low, high = limits
    step, held = solve_normal(H, gradient), np.zeros(len(gradient), dtype=bool)
    fewest, patience = len(gradient) + 1, 3
    for _ in range(4 * len(gradient)):  # far more than it needs
        beyond = ~held & ((step < low) | (step > high))
        pull = gradient - H @ step
        inwards = held & np.where(step <= low, pull > 0.0, pull < 0.0)
        wrong = np.flatnonzero(beyond | inwards)
        if not len(wrong):
            break
        if len(wrong) < fewest:
            fewest, patience = len(wrong), 3
        elif patience:
            patience -= 1
        else:
            wrong = wrong[-1:]
        held[wrong] ^= True
        step = np.where(held, np.clip(step, low, high), 0.0)
        step[~held] = solve_normal(H[np.ix_(~held, ~held)], (gradient - H @ step)[~held])
    return np.clip(step, low, high)


def solve_normal(H: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """The solution of scaled normal equations; directions that the data do not see are left out. Raises SolveError
    where there is none.
    """
    scale = np.sqrt(np.where(np.diag(H) > 0.0, np.diag(H), 1.0))
    scaled, right = H / np.outer(scale, scale), gradient / scale
    if not len(right):
        return right
    factor, failed = dpotrf(scaled, lower=True)
    if not failed and np.diag(factor).min() > SINGULAR:
        return dpotrs(factor, right, lower=True)[0] / scale
    if not (np.isfinite(scaled).all() and np.isfinite(right).all()):
        raise SolveError("the normal equations of a fit cannot be solved: its sensitivities are not finite")
    try:
        return np.linalg.lstsq(scaled, right, rcond=SINGULAR**2)[0] / scale
    except np.linalg.LinAlgError as error:
        raise SolveError(f"the normal equations of a fit cannot be solved: {error}") from error


def normal_equations(
    fit: Fit, jacobian: np.ndarray | SecantJacobian, *, options: IdentificationOptions
) -> tuple[np.ndarray, np.ndarray]:
    """(H, gradient) of the nuisance parameters, then of the fitted candidates, with their priors."""
    p, J = len(fit.point), jacobian if isinstance(jacobian, SecantJacobian) else SecantJacobian.of(jacobian)
    H, gradient = J.gram.copy(), J.transposed_times(fit.residual)
    prior = np.array([1.0] * p + [0.0 if not shape else options.fit.shape_deviation**-2 for _, shape in fit.layout])
    gradient[:p] -= fit.point
    for at, (member, shape) in enumerate(fit.layout):
        if shape:
            value, default = dict(zip((n for n, _ in member.shapes), shapes_and_defaults(member), strict=True))[shape]
            gradient[p + at] -= np.log(value / default) / options.fit.shape_deviation**2
    H[np.diag_indices_from(H)] += prior
    return H, gradient


def with_posterior(H: np.ndarray, fit: Fit, *, options: IdentificationOptions) -> Fit:
    """A fit with what its normal equations tell of the fitted candidates, nuisance parameters marginalised: the Occam
    factor, ln det of their posterior precision in units of their priors (MacKay 1992), what of it the shapes add, and
    the Wald statistic of each.
    """
    p, layout = len(fit.point), fit.layout
    scale = np.array([3.0 * e.candidate.typical if not shape else options.fit.shape_deviation for e, shape in layout])
    left = H[p:, p:] - H[p:, :p] @ np.linalg.solve(H[:p, :p], H[:p, p:])
    amplitude = np.array([not shape for _, shape in layout], dtype=bool)
    variance = np.diag(inverse_of(left))[amplitude]
    known = zip(fit.fitted, variance, strict=True)
    across, among = left[np.ix_(amplitude, ~amplitude)], left[np.ix_(~amplitude, ~amplitude)]
    of_amplitudes = left[np.ix_(amplitude, amplitude)] - across @ np.linalg.solve(among, across.T)

    def occam_factor(precision: np.ndarray, which: np.ndarray) -> float:
        scaled = precision * np.outer(scale[which], scale[which]) + np.diag(amplitude[which].astype(float))
        sign, value = np.linalg.slogdet(scaled)
        return float(value) if sign > 0 else 0.0

    whole = occam_factor(left, np.ones_like(amplitude))
    return replace(
        fit,
        occam_factor=whole,
        shape_occam_factor=whole - occam_factor(of_amplitudes, amplitude),
        wald_statistics=tuple(
            member.above_neutral**2 / float(own) if own > 0.0 else 0.0 for member, own in known
        ),
    )
