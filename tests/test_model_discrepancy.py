"""What the law of a cause may err by: noise in proportion to what the cause does, where nothing comes near."""

from dataclasses import replace

import numpy as np
import pytest
from bench_plant import draw_bench, write_bench_session

import valvesim as vs
from valvesim.diagnosis import model_discrepancy
from valvesim.diagnosis.model_discrepancy import with_discrepancy_of, with_model_discrepancy
from valvesim.diagnosis.model_selection import FittedHypothesis
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS as DIAGNOSIS
from valvesim.errors import SolveError
from valvesim.identification.candidates import Candidate
from valvesim.identification.fit import FittedCandidate, evaluate_fit, rescored
from valvesim.valve.catalogue import CATALOGUE

HYSTERESIS = FittedCandidate(
    Candidate("magnetic_hysteresis", CATALOGUE["magnetic_hysteresis"], fixed=(("turning_current", 2e-3),)), 2e-4
)
FRICTION = FittedCandidate(Candidate("spool_coulomb_friction", CATALOGUE["spool_coulomb_friction"]), 1.0)


def hypothesis(nominal, *members):
    return FittedHypothesis(evaluate_fit(nominal.study, nominal.fit.point, members), options=DIAGNOSIS)


def test_readings_may_be_off_by_a_share_of_what_the_erring_law_alone_does_to_them(biased_fit):
    both, friction = hypothesis(biased_fit, HYSTERESIS, FRICTION), hypothesis(biased_fit, FRICTION)
    wider = with_discrepancy_of(biased_fit.study, both, options=DIAGNOSIS)
    share, samples = DIAGNOSIS.selection.discrepancy_share, DIAGNOSIS.selection.discrepancy_samples
    for predictor, with_it, without in zip(
        wider.predictors, both.fit.readings, friction.fit.readings, strict=True
    ):
        for name, read in with_it.items():
            does = np.abs(read - without[name])
            may_err = wider.discrepancy[predictor.record.name, name]
            assert np.all(may_err >= share * does)
            k = int(np.argmax(does))
            assert may_err[max(k - samples, 0)] == pytest.approx(share * does[k])
            assert may_err.max() == pytest.approx(share * does.max())


def test_of_an_exact_law_nothing_is_added_and_the_fit_leaves_as_much_as_before(biased_fit):
    friction = hypothesis(biased_fit, FRICTION)
    study = with_discrepancy_of(biased_fit.study, friction, options=DIAGNOSIS)
    assert not any(deviation.any() for deviation in study.discrepancy.values())
    assert rescored(study, friction.fit).chi_square == friction.fit.chi_square


def test_a_sample_counts_by_its_noise_and_its_discrepancy(biased_fit):
    study, predictor = biased_fit.study, biased_fit.study.predictors[0]
    name = predictor.record.outputs[0]
    innovation = study.noise[name, predictor.record.pace].innovation
    off = {each: np.ones_like(predictor.record.time) for each in predictor.record.outputs}
    plain = study.whiten(predictor, {each: values[:, None] for each, values in off.items()})
    as_much = study.with_discrepancy({(predictor.record.name, name): np.sqrt(3.0) * innovation * off[name]})
    wider = as_much.whiten(predictor, {each: values[:, None] for each, values in off.items()})
    np.testing.assert_allclose(wider[0], 0.5 * plain[0])
    half = {(predictor.record.name, name): np.sqrt(1.5) * innovation * off[name]}
    twice = replace(study, spread=half, discrepancy=half)
    both = twice.whiten(predictor, {each: values[:, None] for each, values in off.items()})
    np.testing.assert_allclose(both[0], 0.5 * plain[0])  # their variances add up
    for same, before in zip(wider[1:], plain[1:], strict=True):
        np.testing.assert_array_equal(same, before)


@pytest.mark.parametrize(
    "members, ratio, before, taken",
    [
        ([HYSTERESIS], 1e-9, False, True),
        ([FRICTION], 1e-9, False, False),  # its law is known
        ([HYSTERESIS], 1e9, False, False),  # it comes near
        ([HYSTERESIS], 1e-9, True, False),  # once
    ],
)
def test_the_discrepancy_is_thought_of_once_where_nothing_comes_near(
    biased_fit, monkeypatch, members, ratio, before, taken
):
    found = [hypothesis(biased_fit, member) for member in members]
    far = replace(
        DIAGNOSIS, identification=replace(DIAGNOSIS.identification, fit=replace(
            DIAGNOSIS.identification.fit, inadequate_ratio=ratio
        ))
    )  # fmt: skip
    study = biased_fit.study.with_discrepancy({("record_1", "load_flow"): np.zeros(1)} if before else {})
    nominal, asked = replace(biased_fit, study=study), []
    monkeypatch.setattr(model_discrepancy, "fit_nominal_from", lambda study, fit: asked.append(study) or "fitted")
    assert with_model_discrepancy(nominal, found, options=far) == ("fitted" if taken else None)
    assert bool(asked) is taken and all(one.discrepancy for one in asked)


def test_where_the_nominal_valve_cannot_be_run_so_there_is_none(biased_fit, monkeypatch):
    def fails(study, fit):
        raise SolveError("cannot be run", "start elsewhere")

    strict = replace(DIAGNOSIS.identification, fit=replace(DIAGNOSIS.identification.fit, inadequate_ratio=1e-9))
    monkeypatch.setattr(model_discrepancy, "fit_nominal_from", fails)
    found = [hypothesis(biased_fit, HYSTERESIS)]
    assert with_model_discrepancy(biased_fit, found, options=replace(DIAGNOSIS, identification=strict)) is None


@pytest.mark.slow
def test_a_strong_hysteresis_is_named_though_its_law_errs_by_hundreds_of_noise_deviations(tmp_path):
    """A session of the third set, in which a pair with silting had been more likely."""
    bench = ("hold", "ripple", "warming", "gap", "corrupt", "skew", "drift", "saturation")
    case, drawn = draw_bench(820139, "effect", name="magnetic_hysteresis", imperfections=bench)
    write_bench_session(case, drawn, tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.candidates[0].names == ("magnetic_hysteresis",)
