"""Sensitivities of a record to free terms: a B-spline basis over each variable at each port."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.tangent_linear import ScaledForcing, first_order_response
from valvesim.valve.additive_term import LAG, NONE, PATH, TermHypothesis, linear_b_splines, term_effect

DIRECT = ("load_flow", "internal_leakage")


def term_sensitivities(
    linear: LinearisedRecord, terms: Sequence[TermHypothesis], spans: Sequence[tuple[float, float]], knots: int
) -> dict[str, np.ndarray]:
    """Sensitivities (n_samples, term hypotheses * knots) to each B-spline of each term hypothesis, whose knots go
    over its span.
    """
    record = linear.predictor.record
    out = {name: np.zeros((len(record.time), len(terms) * knots)) for name in record.outputs}
    for port in {hypothesis.port.name: hypothesis.port for hypothesis in terms}.values():
        if port.name in DIRECT and port.name not in record.outputs:
            continue
        own = [k for k, hypothesis in enumerate(terms) if hypothesis.port == port]
        unit = term_effect(port.name, "current", (0.0, 1.0), (1.0, 1.0), name="unit_term")
        whole = linear.forcing(linear.variant.with_effect(unit(share=1.0)))
        basis = np.column_stack([term_basis(linear, terms[k], spans[k], knots) for k in own])
        columns = [k * knots + j for k in own for j in range(knots)]
        if port.name in DIRECT:
            out[port.name][:, columns] = (whole.direct[port.name][:, None] * basis)[linear.course.samples]
            continue
        for name, moved in linear.forced_response((), scaled=ScaledForcing(whole, basis)).items():
            out[name][:, columns] = moved
    return out


def term_basis(
    linear: LinearisedRecord, hypothesis: TermHypothesis, over: tuple[float, float], count: int
) -> np.ndarray:
    """(n, count) linear B-splines of a hypothesis's variable along a linearised record's trajectory, times its
    direction where it has one.
    """
    u = argument(linear, hypothesis)
    basis = linear_b_splines(u, hypothesis.knots(*over, count))
    if hypothesis.memory != PATH:
        return basis
    step = np.diff(u, prepend=u[0]) / hypothesis.width  # Dahl's memory of a path of straight steps
    z = first_order_response(np.sign(step) * np.abs(step), np.abs(step), 1.0)
    return basis * z[:, None]


def argument(linear: LinearisedRecord, hypothesis: TermHypothesis) -> np.ndarray:
    """A hypothesis's variable (n,) along a linearised record's trajectory, lagged where it is."""
    u = linear.argument(hypothesis.variable, linear.active_states)
    if hypothesis.memory != LAG:
        return u
    b = np.full(len(u), 1.0 / hypothesis.time_constant)
    middle = np.concatenate([u[:1], (u[1:] + u[:-1]) / 2.0])
    return first_order_response(middle / hypothesis.time_constant, b, linear.course.steps)


def visited_values(linearised: Sequence[LinearisedRecord], hypothesis: TermHypothesis) -> np.ndarray:
    """What a hypothesis's variable, not lagged, is at the samples of linearised records (n,)."""
    plain = replace(hypothesis, memory=NONE)
    return np.concatenate([argument(linear, plain)[linear.course.samples] for linear in linearised])
