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

from valvesim.channels import STATE_CHANNELS
from valvesim.diagnosis.result import Diagnosis
from valvesim.diagnosis.score_test import ScoreTest
from valvesim.identification.fit import Fit, FittedCandidate
from valvesim.identification.hypothesis_fit import fit_hypothesis
from valvesim.identification.nominal_fit import NominalFit

REFITTED, LOOKS = 12, 1  # candidates, the best by score first; looks at those the diagnosis left out
SPARSITY = 0.05  # threshold of the sparse fit, on scaled terms
MEASURED = ("armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "spool_position")


def baselines(
    nominal: NominalFit | None, scores: ScoreTest | None, fits: Sequence[Fit], found: Diagnosis
) -> dict[str, Any]:
    """Their answers: a channel, two labels (None: nothing), and a balance or the reason why there is none."""
    answers: dict[str, Any] = {"largest_residual": largest_residual(found)}
    if nominal is None or scores is None:
        return answers
    refitted = refit_all(nominal, scores, fits)
    if refitted:
        answers["lowest_rmse"] = min(refitted, key=lambda fit: fit.residual @ fit.residual).fitted[0].candidate.label
        best = min(refitted, key=_aic)
        answers["aic"] = best.fitted[0].candidate.label if _aic(best) < nominal.fit.chi_square else None
    answers["pysindy"] = discrepancy_fit(nominal)
    return answers


def largest_residual(found: Diagnosis) -> str:
    """The channel of the largest root mean square error over all records."""
    pooled: dict[str, float] = {}
    for errors in found.errors.values():
        for channel, error in errors.items():
            pooled[channel] = pooled.get(channel, 0.0) + error**2
    return max(pooled, key=lambda channel: pooled[channel])


def refit_all(nominal: NominalFit, scores: ScoreTest, fits: Sequence[Fit]) -> list[Fit]:
    """One fit a family for the best by score; those that the diagnosis has refitted are taken from it."""
    done = {fit.fitted[0].candidate.label: fit for fit in fits if len(fit.fitted) == 1}
    z, projected, chosen = scores.z(), scores.projected, {}
    for k in np.argsort(-z, kind="stable"):
        hypothesis = scores.candidates[k].label
        if z[k] > 0.0 and len(chosen) < REFITTED and hypothesis not in chosen:
            chosen[hypothesis] = done.get(hypothesis) or fit_hypothesis(
                nominal, (_start(scores, int(k), projected),), linearisations=LOOKS
            )
    return [fit for fit in chosen.values() if fit is not None]


def _start(scores: ScoreTest, k: int, projected: Any) -> FittedCandidate:
    candidate, amount = scores.candidates[k], projected.score[k] / projected.overlap[k, k]
    low, high = candidate.limits
    fixed = dict(candidate.fixed)
    shapes = tuple((p.name, fixed.get(p.name, p.default)) for p in candidate.shapes())
    return FittedCandidate(candidate, float(np.clip(amount * scores.sizes[k], 0.9 * low, 0.9 * high)), shapes)


def _aic(fit: Fit) -> float:
    return fit.chi_square + 2.0 * sum(1 + len(member.shapes) for member in fit.fitted)


def discrepancy_fit(nominal: NominalFit) -> dict[str, str]:
    """{"balance": name} of the largest term that a sparse polynomial finds, or {"skipped": reason}."""
    records = [predictor.record for predictor in nominal.study.predictors]
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
    for seen in nominal.linearised:
        record, every = seen.predictor.record, seen.predictor.oversampling
        x = np.column_stack([seen.trajectory.states[::every, k] for k in range(len(names))])
        for name in MEASURED:
            x[:, names.index(name)] = record.values[name]
        for slow, fast in (("armature_angle", "armature_rate"), ("spool_position", "spool_velocity")):
            x[:, names.index(fast)] = differ(x[:, [names.index(slow)]], record.time)[:, 0]
        measured_channels = differ(x, record.time)
        model = seen.model if not seen.model.effects else None
        if model is None:
            return {"skipped": "the base model has effects of its own"}
        along = [v[::every] if len(v) > 1 else v for v in seen.predictor.coefficients_along(seen.variant, model)]
        u = seen.predictor.inputs[::every]
        own = model.rhs(tuple(x.T), tuple(u.T), tuple(along))
        own = np.column_stack([np.broadcast_to(rate, len(x)) for rate in own])
        states.append(x / scales)
        inputs.append(u[:, :1] / 1e-2)
        missing.append(measured_channels - own)
        rates.append(measured_channels)
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
