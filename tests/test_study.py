"""Fits of a session: the base inside its tolerances, refits from the linear equations."""

import numpy as np
import pytest
from hidden_plant import draw, write_session

from valvesim.session import load_session
from valvesim.study import SETTLED, TOLERANCE, Extra, fit_base, predict, prepare_study, refit, within_tolerance


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


def test_views_of_a_repeat_have_its_own_readings(biased):
    base = biased[0]
    for seen, bench in zip(base.views, base.study.benches, strict=True):
        assert seen.bench is bench
        for name, left in seen.residual().items():
            assert np.array_equal(left, bench.record.values[name] - seen.readings[name])
