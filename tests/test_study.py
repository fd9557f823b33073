"""Fits of a session: the base inside its tolerances, refits from the linear equations."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_plant import draw, write_session
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

import valvesim.study as engine
from valvesim.errors import SolveError
from valvesim.prediction import Bench
from valvesim.session import load_session
from valvesim.study import (
    SETTLED,
    SHAPE_STRIDE,
    TOLERANCE,
    Extra,
    Fit,
    _moved,
    _promise,
    _room,
    _step,
    falls_afresh,
    find_noise,
    fit_base,
    fit_base_from,
    predict,
    prepare_study,
    refit,
    refit_from,
    within_tolerance,
)


@pytest.fixture(scope="module")
def biased(tmp_path_factory):
    """The base fit of a session in which the load flow sensor is far off, and its true bias."""
    folder = tmp_path_factory.mktemp("biased")
    case = draw(9, "sensor", name="sensor_bias")
    write_session(case, folder)
    return fit_base(prepare_study(load_session(folder))), dict(case.hidden)["sensor_bias"]["bias"]


def at(base, name):
    return [parameter.name for parameter in base.study.base.parameters].index(name)


def test_the_base_fit_is_a_minimum(biased):
    base, _ = biased
    gradient = base.J.T @ base.fit.residual - base.fit.point
    H = base.J.T @ base.J + np.eye(len(gradient))
    assert gradient @ np.linalg.solve(H, gradient) < 2.0 * SETTLED  # of the deviance is all that a step promises
    assert base.fit.deviance == pytest.approx(base.fit.residual @ base.fit.residual + base.fit.point @ base.fit.point)


def test_the_base_fitted_from_elsewhere_comes_to_the_same_minimum(biased):
    base, bias = biased
    point = base.fit.point.copy()
    point[at(base, "null_gap")] += 1.0
    away = engine.evaluate(base.study, point, ())
    assert away.deviance > base.fit.deviance + 10.0
    assert fit_base_from(base, away).fit.deviance == pytest.approx(base.fit.deviance, abs=2.0 * SETTLED)


def test_a_refit_goes_on_from_where_it_is_with_a_cause_that_is_not_there_yet(biased):
    base, bias = biased
    (candidate,) = [c for c in base.study.candidates if c.family == "sensor_bias@load_flow"]
    within = within_tolerance(base)
    on = refit_from(base, replace(within, extras=(Extra(candidate, 0.0),)))
    assert on.extras[0].excess == pytest.approx(bias, rel=0.1)
    assert on.deviance < base.fit.deviance - 100.0


def test_held_within_tolerance_no_parameter_is_beyond_it_and_the_fit_is_worse(biased):
    base, _ = biased
    bias = at(base, "sensor_bias@load_flow")
    assert abs(base.fit.point[bias]) > 5.0
    held = within_tolerance(base)
    assert np.abs(held.point).max() <= TOLERANCE + 1e-12
    assert held.point[bias] == pytest.approx(np.sign(base.fit.point[bias]) * TOLERANCE)
    assert held.residual @ held.residual > base.fit.residual @ base.fit.residual + 100.0


def test_a_refit_takes_the_stretched_parameter_back_and_finds_the_bias(biased):
    base, bias = biased
    (candidate,) = [c for c in base.study.candidates if c.family == "sensor_bias@load_flow"]
    fit = refit(base, (Extra(candidate, 0.1 * bias),))
    assert abs(fit.point[at(base, "sensor_bias@load_flow")]) < 0.5
    assert fit.extras[0].excess == pytest.approx(bias, rel=0.1)
    assert fit.deviance < base.fit.deviance - 100.0


def test_a_refit_begun_where_a_nozzle_would_be_closed_shrinks_its_start(biased):
    base, _ = biased
    (gap,) = [c for c in base.study.candidates if c.family == "parameter:null_gap_difference"]
    null_gap = base.fit.variant(base.study.base).valve.null_gap
    assert 2.5 * null_gap < gap.limits[1]  # inside its own bounds, and none of this valve
    fit = refit(base, (Extra(gap, 2.5 * null_gap),))
    assert abs(fit.extras[0].excess) < null_gap
    assert fit.deviance < base.fit.deviance + engine.ENOUGH  # it is not there: less is not worth a step


def test_a_refit_begun_far_off_begins_small_and_great_where_the_small_does_not_settle(biased, monkeypatch):
    base, bias = biased
    (candidate,) = [c for c in base.study.candidates if c.family == "sensor_bias@load_flow"]
    asked, begun, promised = [], [], 0.0

    def evaluate(study, point, extras):
        asked.append(extras[0].excess / bias)
        return replace(base.fit, extras=extras, deviance=base.fit.deviance * (30.0 if asked[-1] > 0.5 else 0.9))

    def ended(base, fit, *more):
        begun.append(fit.extras[0].excess / bias)
        return replace(fit, promised=promised)

    monkeypatch.setattr(engine, "evaluate", evaluate)
    monkeypatch.setattr(engine, "_refitted", ended)
    monkeypatch.setattr(engine, "_led_near", ended)
    refit(base, (Extra(candidate, bias),))
    assert asked == pytest.approx([1.0, 0.3]) and begun == pytest.approx([0.3])
    begun.clear()
    promised = 2.0 * engine.UNSETTLED
    least = refit(base, (Extra(candidate, bias),))
    assert begun == pytest.approx([0.3, 1.0]) and least.extras[0].excess == pytest.approx(0.3 * bias)
    asked.clear()
    begun.clear()
    refit(base, (Extra(candidate, 0.4 * bias),))
    assert asked == begun == pytest.approx([0.4])


def test_at_typical_amplitudes_the_hidden_bias_explains_most(biased, monkeypatch):
    base, bias = biased
    named = {c.family: c for c in base.study.candidates}
    right = (Extra(named["sensor_bias@load_flow"], bias),)
    others = [(Extra(named[name], named[name].typical),) for name in ("coil_turns_loss", "spool_coulomb_friction")]
    falls = falls_afresh(base, [right, *others])
    assert falls[0] > 100.0 and falls[0] > 2.0 * falls[1:].max()
    assert falls_afresh(base, [(*right, *others[0])])[0] > 0.5 * falls[0]  # two at once

    def evaluate(study, point, extras):
        if extras:
            raise SolveError("no such valve")
        return base.fit

    monkeypatch.setattr(engine, "evaluate", evaluate)
    assert falls_afresh(base, others).tolist() == [-np.inf, -np.inf]


def test_what_runs_alike_is_worked_out_once_and_reads_as_each_alone(biased):
    study, asked = biased[0].study, []
    names = [bench.record.name for bench in study.benches]
    assert study.firsts == (0, 1, 2, 0)  # the fourth repeats the first
    found = study.each(lambda bench: asked.append(bench.record.name) or bench.record.name, study.benches)
    assert sorted(asked) == sorted(names[:3]) and found == [names[k] for k in study.firsts]
    variant = study.base.variant
    for read, bench in zip(predict(study, variant), study.benches, strict=True):
        alone = bench.readings(bench.run(variant), variant)
        assert all(np.array_equal(read[name], alone[name]) for name in alone)


@pytest.mark.parametrize("cores", [1, 3])
def test_work_on_the_records_is_the_same_on_one_core_and_on_more(cores, monkeypatch):
    monkeypatch.setattr(engine, "cores", lambda: cores)
    assert engine.each(lambda a, b: a - b, [5, 7, 9, 11], [1, 2, 3, 4]) == [4, 5, 6, 7]


def test_what_a_fit_has_run_is_not_run_again_to_see_from_it(biased, monkeypatch):
    study = biased[0].study
    fit = engine.evaluate(study, biased[0].fit.point, ())
    variant, asked, run = fit.variant(study.base), [], Bench.run
    for at_spacing in (study, study.coarse()):
        _, columns = engine.see(at_spacing, variant)
        with monkeypatch.context() as patch:
            patch.setattr(Bench, "run", lambda bench, other: asked.append(other) or run(bench, other))
            _, same = engine.see_from(at_spacing, fit)
        assert variant not in asked
        for mine, others in zip(same, columns, strict=True):
            assert all(np.array_equal(mine[name], others[name]) for name in others)
    assert asked  # what acts within a step is run on its own, see `hypotheses.RUN`


def test_a_refit_keeps_no_courses_and_nor_does_a_long_session(biased):
    base, _ = biased
    (candidate,) = [c for c in base.study.candidates if c.family == "sensor_bias@load_flow"]
    assert refit(base, [Extra(candidate, candidate.typical)]).courses == ()
    assert engine.evaluate(replace(base.study, is_long=True), base.fit.point, ()).courses == ()


def test_views_of_a_repeat_have_its_own_readings(biased):
    base = biased[0]
    for seen, bench in zip(base.views, base.study.benches, strict=True):
        assert seen.bench is bench
        for name, left in seen.residual().items():
            assert np.array_equal(left, bench.record.values[name] - seen.readings[name])


# ---------------------------------------------------------------- steps inside limits

NUMBERS = st.floats(-3.0, 3.0)


@given(st.lists(NUMBERS, min_size=20, max_size=20), st.lists(NUMBERS, min_size=8, max_size=8), st.floats(0.01, 2.0))
def test_a_step_to_a_limit_is_the_least_squares_step_inside_it(entries, residual, limit):
    J = np.vstack([np.reshape(entries, (5, 4)), np.eye(4)])
    r = np.array([*residual, 0.0])
    room = np.array([[-np.inf, -np.inf, -np.inf, -limit], [np.inf, np.inf, np.inf, limit]])
    step = _step(J.T @ J, J.T @ r, room)
    best = lsq_linear(J, r, (room[0], room[1]), tol=1e-14).x
    left = np.sum((r - J @ step) ** 2)
    assert abs(step[3]) <= limit and left == pytest.approx(np.sum((r - J @ best) ** 2), rel=1e-6, abs=1e-9)
    assert _promise(J.T @ J, J.T @ r, room) == pytest.approx(r @ r - left, abs=1e-9)


def test_room_is_up_to_the_limits_of_an_amplitude_and_a_stride_of_a_shape(biased):
    hysteresis = next(c for c in biased[0].study.candidates if c.family == "magnetic_hysteresis")
    (shape,) = hysteresis.shapes()
    low, high = shape.bounds
    extra = Extra(hysteresis, hysteresis.typical, ((shape.name, 1.1 * low),))
    fit = Fit(np.zeros(2), (extra,), 0.0, (), np.zeros(0), 0.0)
    room = _room(fit)
    assert room.shape == (2, 4) and np.all(np.isinf(room[:, :2]))
    for step in room[:, 2:]:
        (moved,) = _moved(fit, step)
        assert 0.0 < moved.excess < hysteresis.limits[1] and low <= dict(moved.shapes)[shape.name] <= high
    assert np.exp(room[:, 3]) == pytest.approx([1.0 / 1.1, SHAPE_STRIDE])
    assert _moved(fit, room[1, 2:])[0].excess == pytest.approx(0.98 * hysteresis.limits[1])


def test_what_a_saturated_sensor_lost_is_no_part_of_its_noise(tmp_path):
    """Repeats agree where both stand at the sensor's end: as noise that would make all other samples an alarm."""
    case = draw(0, "none")
    write_session(case, tmp_path)
    study = prepare_study(load_session(tmp_path))
    nothing = [dict.fromkeys(bench.record.outputs, 0.0) for bench in study.benches]
    name = study.benches[0].record.outputs[0]
    records = []
    for record in study.session.records:
        values, top = record.values[name], np.quantile(record.values[name], 0.6)
        clipped = {**record.values, name: np.minimum(values, top)}
        records.append(replace(record, values=clipped, usable={**record.usable, name: values < top}))
    lossy = prepare_study(replace(study.session, records=tuple(records)))
    rate = study.benches[0].record.pace
    whole, rest = (find_noise(each, nothing)[name, rate] for each in (study, lossy))
    assert whole.verified and rest.verified
    assert rest.deviation == pytest.approx(whole.deviation, rel=0.1)


def test_repeats_of_one_record_do_not_keep_the_noise_of_others_at_what_the_nominal_valve_leaves(tmp_path):
    case = draw(0, "none")
    write_session(case, tmp_path)
    session = load_session(tmp_path)
    last = next(record for record in session.training if record.repeats is None)
    others = [record for record in session.training if record is not last]
    slow = replace(
        last, time=last.time[::2], values={name: column[::2] for name, column in last.values.items()},
        usable={name: column[::2] for name, column in last.usable.items()}, repeats=None,
    )  # fmt: skip
    base = fit_base(prepare_study(replace(session, records=(*others, slow))))
    rates = {noise.verified: rate for (_, rate), noise in base.study.noise.items()}
    assert rates == {True: others[0].pace, False: slow.pace}
    nominal = find_noise(base.study, predict(base.study, base.study.base.at(np.zeros(len(base.study.base.parameters)))))
    for name in slow.outputs:
        own, true = base.study.noise[name, rates[False]].deviation, base.study.noise[name, rates[True]].deviation
        assert 0.8 * true < own < 0.8 * nominal[name, rates[False]].deviation
