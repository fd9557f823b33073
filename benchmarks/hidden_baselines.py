"""What simpler methods answer in the sessions of hidden_effects.py: beside the diagnosis, in the same run.

largest residual   the channel of the largest error of the base model, in noise deviations; it names no cause
lowest RMSE        a dozen candidates refitted, the one of least error named, whatever it gains
AIC                the same with the base model among them, two for each figure that is fitted
PySINDy            where angle, pressures and spool are measured: a sparse polynomial fitted to what the measured
                   rates have beyond the model's; the balance of the largest term is named
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from valvesim.answer import Diagnosis
from valvesim.channels import STATE_CHANNELS
from valvesim.scene import Scene
from valvesim.study import BaseFit, Extra, Fit, refit

REFITTED, LOOKS = 12, 1  # candidates, the best by score first; looks at those the diagnosis left out
SPARSITY = 0.05  # threshold of the sparse fit, on scaled terms
MEASURED = ("armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "spool_position")


def baselines(base: BaseFit | None, scene: Scene | None, fits: Sequence[Fit], found: Diagnosis) -> dict[str, Any]:
    """Their answers: a channel, two labels (None: nothing), and a balance or the reason why there is none."""
    answers: dict[str, Any] = {"largest_residual": largest_residual(found)}
    if base is None or scene is None:
        return answers
    refitted = refit_all(base, scene, fits)
    if refitted:
        answers["lowest_rmse"] = min(refitted, key=lambda fit: fit.residual @ fit.residual).extras[0].candidate.family
        best = min(refitted, key=_aic)
        answers["aic"] = best.extras[0].candidate.family if _aic(best) < base.fit.deviance else None
    answers["pysindy"] = discrepancy_fit(base)
    return answers


def largest_residual(found: Diagnosis) -> str:
    """The channel of the largest root mean square error over all records."""
    pooled: dict[str, float] = {}
    for errors in found.errors.values():
        for channel, error in errors.items():
            pooled[channel] = pooled.get(channel, 0.0) + error**2
    return max(pooled, key=lambda channel: pooled[channel])


def refit_all(base: BaseFit, scene: Scene, fits: Sequence[Fit]) -> list[Fit]:
    """One fit a family for the best by score; those that the diagnosis has refitted are taken from it."""
    done = {fit.extras[0].candidate.family: fit for fit in fits if len(fit.extras) == 1 and np.isfinite(fit.deviance)}
    z, projected, chosen = scene.z(), scene.projected, {}
    for k in np.argsort(-z, kind="stable"):
        family = scene.candidates[k].family
        if z[k] > 0.0 and len(chosen) < REFITTED and family not in chosen:
            chosen[family] = done.get(family) or refit(base, (_start(scene, int(k), projected),), looks=LOOKS)
    return [fit for fit in chosen.values() if np.isfinite(fit.deviance)]


def _start(scene: Scene, k: int, projected: Any) -> Extra:
    candidate, amount = scene.candidates[k], projected.score[k] / projected.overlap[k, k]
    low, high = candidate.limits
    fixed = dict(candidate.fixed)
    shapes = tuple((p.name, fixed.get(p.name, p.default)) for p in candidate.shapes())
    return Extra(candidate, float(np.clip(amount * scene.sizes[k], 0.9 * low, 0.9 * high)), shapes)


def _aic(fit: Fit) -> float:
    return fit.deviance + 2.0 * sum(1 + len(extra.shapes) for extra in fit.extras)


def discrepancy_fit(base: BaseFit) -> dict[str, str]:
    """{"balance": name} of the largest term that a sparse polynomial finds, or {"skipped": reason}."""
    records = [bench.record for bench in base.study.benches]
    if any(set(MEASURED) - set(record.outputs) for record in records):
        return {"skipped": "angle, pressures and spool are not all measured"}
    if any(record.command != "current" for record in records):
        return {"skipped": "voltage drive: the current would be a state of its own"}
    try:
        import pysindy as ps
    except ImportError:
        return {"skipped": "pysindy is not installed (pip install valvesim[bench])"}
    names = [channel.name for channel in STATE_CHANNELS]
    scales = np.array([channel.scale for channel in STATE_CHANNELS])
    differ = ps.SmoothedFiniteDifference(smoother_kws={"window_length": 11, "polyorder": 3})
    states, inputs, missing, rates = [], [], [], []
    for seen in base.views:
        record, every = seen.bench.record, seen.bench.refinement
        x = np.column_stack([seen.course.states[::every, k] for k in range(len(names))])
        for name in MEASURED:
            x[:, names.index(name)] = record.values[name]
        for slow, fast in (("armature_angle", "armature_rate"), ("spool_position", "spool_velocity")):
            x[:, names.index(fast)] = differ(x[:, [names.index(slow)]], record.time)[:, 0]
        measured = differ(x, record.time)
        model = seen.model if not seen.model.effects else None
        if model is None:
            return {"skipped": "the base model has effects of its own"}
        along = [v[::every] if len(v) > 1 else v for v in seen.bench.coefficients_along(seen.variant, model)]
        u = seen.bench.inputs[::every]
        own = model.rhs(tuple(x.T), tuple(u.T), tuple(along))
        own = np.column_stack([np.broadcast_to(rate, len(x)) for rate in own])
        states.append(x / scales)
        inputs.append(u[:, :1] / 1e-2)
        missing.append(measured - own)
        rates.append(measured)
    spread = np.std(np.concatenate(rates), axis=0)
    model = ps.SINDy(optimizer=ps.STLSQ(threshold=SPARSITY), feature_library=ps.PolynomialLibrary(degree=2))
    model.fit(states, t=records[0].time[1], x_dot=[m / spread for m in missing], u=inputs)
    size = np.abs(model.coefficients()) * np.std(np.asarray(model.feature_library.transform(
        np.concatenate([np.column_stack(pair) for pair in zip(states, inputs, strict=True)]))), axis=0)  # fmt: skip
    balances = {
        "armature_rate": "armature torque", "nozzle_pressure_1": "pilot flow", "nozzle_pressure_2": "pilot flow",
        "spool_velocity": "spool force",
    }  # fmt: skip
    largest = max(balances, key=lambda name: float(np.max(size[names.index(name)])))
    return {"balance": balances[largest]}
