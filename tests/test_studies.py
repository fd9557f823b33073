"""Studies of many valves: what varies, the same answer on any number of processes, and what is kept of each member."""

import copy
import filecmp
import random
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import valvesim as vs
from valvesim.errors import InputError
from valvesim.studies import channel_histogram, engine, store
from valvesim.studies.criteria import FigureLimit, criteria_of, figures_for
from valvesim.studies.designs import Correlation, Design, correlate
from valvesim.studies.distributions import Distribution, OptionChoice, tolerance_distribution
from valvesim.studies.figures import KeptFigure
from valvesim.studies.findings import find
from valvesim.studies.local_sensitivity import local_sensitivity
from valvesim.studies.members import make_plan, run_block
from valvesim.studies.parameter_study import ChannelPercentiles, FigureOptions, ParameterStudy, WholeChannels
from valvesim.studies.sensitivity_indices import sensitivity_indices
from valvesim.studies.store import STORE_NAME
from valvesim.studies.study import study
from valvesim.studies.study_result import capability_of, open_result, yield_of
from valvesim.studies.study_toml import load_study, read_study
from valvesim.studies.tolerance_tightening import TightenedYields, tightening_plan
from valvesim.studies.variables import Varied, apply, find_quantity, tolerated, variable_of

ISOTHERMAL = vs.Thermal(network=None)
BASE = vs.Scenario(duration=0.02, thermal=ISOTHERMAL, command=vs.Step(after=5e-3, time=2e-3), output_rate=2000.0)


def of(*keys, case=BASE):
    return tuple(variable_of(find_quantity(case, key)) for key in keys)


def small(**changes):
    """A study of a dozen members in blocks of five."""
    figures = dict(
        case=BASE, variables=of("valve.null_gap", "valve.spring_tube_stiffness", "valve.null_gap_difference"),
        design=Design(kind="random", members=12, seed=3), keep=("run.spool_position.*", "drift.*"), block=5,
        percentiles=ChannelPercentiles(channels=("spool_position",), points=9),
        whole=WholeChannels(members=(4, 11), channels=("spool_position", "load_flow")),
    )  # fmt: skip
    return ParameterStudy(**(figures | changes))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The small study, run in this process."""
    folder = tmp_path_factory.mktemp("study")
    return study(small(), folder, workers=0)


def same_files(one: Path, other: Path) -> bool:
    names = sorted(str(p.relative_to(one)) for p in one.rglob("*") if p.is_file())
    if names != sorted(str(p.relative_to(other)) for p in other.rglob("*") if p.is_file()):
        return False
    return not any(filecmp.cmpfiles(one, other, names, shallow=False)[1:])


# ---------------------------------------------------------------- members


def test_a_member_of_a_study_is_the_same_valve_run_alone(finished):
    for number in (0, 4, 11):
        alone = vs.simulate(finished.member(number))["spool_position"].values
        assert finished.column("run.spool_position.highest")[number] == pytest.approx(alone.max(), rel=1e-9)
        assert finished.column("run.spool_position.end")[number] == pytest.approx(alone[-1], rel=1e-9)


def test_whole_channels_of_a_member_are_those_of_its_run(finished):
    alone = vs.simulate(finished.member(11))
    kept = finished.dataset["run"].sel(kept_member=11)
    for name in ("spool_position", "load_flow"):
        assert np.allclose(kept.sel(kept_channel=name), alone[name].values, rtol=1e-9, atol=0.0)


def test_members_differ_and_the_nominal_one_is_told(finished):
    assert np.ptp(finished.column("run.spool_position.end")) > 1e-6
    nominal = vs.simulate(BASE)["spool_position"].values
    k = [f.name for f in finished.figures].index("run.spool_position.end")
    assert finished.nominal[k] == nominal[-1]


def test_the_draws_are_kept_and_repeat_with_the_seed(finished):
    assert np.array_equal(finished.draws, small().draws())
    assert not np.array_equal(finished.draws, small(design=Design(kind="random", members=12, seed=4)).draws())


def test_what_varies_in_no_figure_of_the_equations_runs_apart_and_the_same():
    case = replace(BASE, supply_pressure=vs.Constant(value=21e6))
    variables = (*of("valve.null_gap"), variable_of(find_quantity(case, "pressures.supply"), 1e6))
    mixed = small(case=case, variables=variables, percentiles=None, whole=None, keep=("run.spool_position.end",))
    plan, draws = make_plan(mixed), mixed.draws()
    got = run_block(mixed, plan, 0, draws[:4]).figures[:, 0]
    alone = [vs.simulate(mixed.member(draw))["spool_position"].values[-1] for draw in draws[:4]]
    assert np.allclose(got, alone, rtol=1e-9)


def test_members_have_knots_of_their_own_where_their_temperatures_differ():
    """The base rests at 20 °C throughout; members in warmer air warm up, and shift by what each does alone."""
    case = vs.Scenario(duration=0.5, thermal=vs.Thermal(), command=vs.Constant(value=5e-3), output_rate=200.0)
    ambient = Varied(find_quantity(case, "thermal.ambient_temperature"), Distribution("uniform", 100.0, 200.0))
    own = small(case=case, variables=(ambient,), percentiles=None, whole=None, keep=("run.body_temperature.end",))
    plan = make_plan(own)
    assert plan.knot_times is None
    got = run_block(own, plan, 0, np.array([[150.0], [300.0]])).figures[:, 0]
    alone = [vs.simulate(own.member(np.array([t])))["body_temperature"].values[-1] for t in (150.0, 300.0)]
    assert got == pytest.approx(alone, rel=1e-9) and np.all(got > 20.01)
    still = small(case=case, percentiles=None, whole=None, keep=("run.spool_position.end",))
    assert np.isfinite(run_block(still, make_plan(still), 0, still.draws()).figures).all()


def test_a_member_that_fails_is_a_row_with_its_reason(tmp_path):
    """A flapper that expands more than the null gap closes it at 150 °C: half of the members cannot run."""
    hot = replace(BASE, oil_temperature=vs.Constant(value=150.0))
    rows = np.array([[11e-6, 0.6e-3], [9e-5, 10e-3], [11e-6, 0.7e-3], [9e-5, 20e-3]])
    variables = [find_quantity(hot, f"valve.{name}") for name in ("pilot_expansion", "flapper_length")]
    variables = tuple(Varied(q, Distribution("uniform", 1e-7, 0.04)) for q in variables[1:])
    first = Varied(find_quantity(hot, "valve.pilot_expansion"), Distribution("uniform", 1e-7, 9.9e-5))
    failing = small(
        case=hot, variables=(first, *variables), design=Design(kind="table", members=4, rows=rows), block=4, whole=None,
        keep=("run.spool_position.end",),
    )  # fmt: skip
    result = study(failing, tmp_path, workers=0)
    assert result.finished and list(np.isfinite(result.values[:, 0])) == [True, False, True, False]
    assert list(result.reasons == "") == [True, False, True, False]
    assert "closes" in result.reasons[1] and "pilot" in result.reasons[3]
    assert list(result.passes) == [True, False, True, False]


# ---------------------------------------------------------------- the store


def test_a_study_that_was_killed_goes_on_and_ends_byte_for_byte_the_same(finished, tmp_path, monkeypatch):
    real, calls = engine.run_block, []

    def dies(*arguments):
        calls.append(arguments[2])
        if len(calls) == 2:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(engine, "run_block", dies)
    with pytest.raises(KeyboardInterrupt):
        study(small(), tmp_path, workers=0)
    half = open_result(small(), tmp_path)
    assert half.ran.sum() == 5 and not half.finished
    monkeypatch.setattr(engine, "run_block", real)
    told = []
    study(small(), tmp_path, workers=0, progress=lambda done, of: told.append((done, of)))
    assert told[0] == (5, 12) and told[-1] == (12, 12)
    assert same_files(finished.folder / STORE_NAME, tmp_path / STORE_NAME)


def test_blocks_in_any_order_give_the_same_store(finished, tmp_path, monkeypatch):
    pending = engine.StudyStore.pending
    monkeypatch.setattr(engine.StudyStore, "pending", property(lambda store: pending.fget(store)[::-1]))
    study(small(), tmp_path, workers=0)
    assert same_files(finished.folder / STORE_NAME, tmp_path / STORE_NAME)


def test_a_store_of_another_study_is_refused_and_left_as_it_is(finished, tmp_path):
    before = {p: p.stat().st_mtime_ns for p in finished.folder.rglob("*")}
    for other in (small(keep=("drift.*",)), small(design=Design(kind="random", members=12, seed=4))):
        with pytest.raises(InputError, match="holds another study"):
            study(other, finished.folder, workers=0)
    with pytest.raises(InputError, match="holds another study"):
        open_result(small(case=replace(BASE, tolerance=1e-6)), finished.folder)
    assert before == {p: p.stat().st_mtime_ns for p in finished.folder.rglob("*")}


def test_another_study_has_another_identity_and_the_same_one_the_same():
    def own(case):
        return {"x": case.valve.spool_mass}

    def other(case):
        return {"x": case.valve.spool_damping}

    base = small()
    assert (
        base.identity() == small().identity() == small(title="other words", limits=(FigureLimit("x", 0.0),)).identity()
    )
    changes = [
        {"block": 4}, {"keep": ("drift.*",)}, {"percentiles": None}, {"whole": None},
        {"case": replace(BASE, tolerance=1e-6)}, {"case": replace(BASE, valve=replace(BASE.valve, spool_mass=5e-3))},
        {"case": replace(BASE, command=vs.Step(after=5e-3, time=3e-3))}, {"case": replace(BASE, oil=vs.YH12_PAPER)},
        {"variables": of("valve.null_gap", "valve.spring_tube_stiffness")},
        {"design": Design(kind="random", members=12, seed=4)}, {"design": Design(kind="sobol", members=12, seed=3)},
        {"options": FigureOptions(start=1e-3)}, {"options": FigureOptions(functions=(own,))},
        {"options": FigureOptions(functions=(other,))},
    ]  # fmt: skip
    identities = [small(**change).identity() for change in changes]
    assert len({base.identity(), *identities}) == len(changes) + 1


def test_a_store_that_another_version_began_is_not_finished_by_this_one_but_read(finished, tmp_path, monkeypatch):
    own = store.versions()
    monkeypatch.setattr(store, "versions", lambda: {**own, "code": "other"})
    assert study(small(), finished.folder, workers=0).finished
    store.open_store(tmp_path, small(), make_plan(small()))
    monkeypatch.setattr(store, "versions", lambda: own)
    with pytest.raises(InputError, match="other versions: here code .* instead of other"):
        study(small(), tmp_path, workers=0)
    assert not open_result(small(), tmp_path).ran.any()


@pytest.mark.parametrize("array", ["figure", "draw", "counts", "done", "whole"])
def test_a_damaged_store_is_told_by_its_array(finished, tmp_path, array):
    shutil.copytree(finished.folder / STORE_NAME, tmp_path / STORE_NAME)
    for chunk in (tmp_path / STORE_NAME / array).iterdir():
        if chunk.name[0].isdigit():
            chunk.write_bytes(chunk.read_bytes()[:7])
    result = open_result(small(), tmp_path)
    with pytest.raises(InputError, match=f"array '{array}' cannot be read .*damaged"):
        _ = result.dataset


def test_what_is_no_store_is_refused(tmp_path):
    (tmp_path / STORE_NAME).write_text("no store")
    with pytest.raises(InputError, match="is no store of a study"):
        study(small(), tmp_path, workers=0)
    assert (tmp_path / STORE_NAME).read_text() == "no store"
    with pytest.raises(InputError, match="is no store of a study"):
        open_result(small(), tmp_path / "nowhere")


def test_a_worker_of_another_version_runs_nothing():
    other = {**engine.versions(), "numba": "0.1"}
    with pytest.raises(InputError, match="a worker has numba .* instead of 0.1"):
        engine.checked_block(other, small(), None, 0, None)


class Workers:
    """A client whose workers answer with their versions."""

    def __init__(self, **answers):
        self.answers = answers

    def run(self, function, on_error):
        return self.answers


def test_workers_that_are_missing_or_others_are_refused_by_their_address():
    own = engine.versions()
    engine.check_workers(Workers(one=own, two=dict(own)))
    for client, message in (
        (Workers(), "no worker; start one"),
        (Workers(one=own, two={**own, "code": "x", "numpy": "1.0"}), "worker two has code x instead of .*, numpy 1.0"),
        (Workers(one=ModuleNotFoundError("No module named 'valvesim'")), "worker one cannot run a study: ModuleNot"),
    ):
        with pytest.raises(InputError, match=message):
            engine.check_workers(client)


@pytest.mark.parametrize(
    "address", ["nonsense", "tcp://host", "tcp://host:99999", "tcp://a b:8786", "http://host:8786/x"]
)
def test_what_is_no_address_of_a_scheduler_is_told_at_once_and_nothing_is_written(address, tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match="is no address such as"):
        study(small(), tmp_path / "new", scheduler=address)
    assert not (tmp_path / "new").exists()


def test_the_forecast_counts_members_and_bytes():
    told = engine.forecast(small(), seconds=0.0)
    assert (told.members, told.blocks, told.block_size) == (12, 3, 5)
    assert told.seconds_a_member > 0.0 and told.bytes > 12 * 8 * 3


# ---------------------------------------------------------------- percentiles


def test_percentiles_over_time_are_those_of_the_members(tmp_path):
    many = small(design=Design(kind="random", members=150), block=50, whole=None)
    result = study(many, tmp_path, workers=0)
    told = result.percentiles.sel(channel="spool_position").isel(sample_time=-1)
    exact = np.percentile(result.column("run.spool_position.end"), told.level)
    span = np.ptp(exact)
    assert np.abs(told.values - exact).max() < 0.08 * span  # of 150 members, between two of them


def test_percentiles_of_a_window_stand_at_its_samples():
    asked = ChannelPercentiles(channels=("spool_position",), points=5, start=4e-3, end=8e-3)
    plan = make_plan(small(percentiles=asked))
    assert np.allclose(plan.times[plan.samples], [4e-3, 5e-3, 6e-3, 7e-3, 8e-3])


@pytest.mark.parametrize("law", [stats.norm(3.0, 2.0), stats.lognorm(1.5), stats.uniform(-1.0, 4.0), stats.t(2)])
def test_percentiles_from_counts_are_within_a_bin_of_those_of_the_values(law):
    values = law.rvs(20_000, random_state=1)
    reference = channel_histogram.reference_of(np.array([[0.0, 3.0]]), np.array([1.0]))
    counts = np.zeros((1, 2, channel_histogram.BINS), dtype=np.uint32)
    for value in values:
        channel_histogram.count(counts, reference, np.array([[value, value]]))
    levels = np.array([0.0, 1.0, 25.0, 50.0, 99.0, 100.0])
    low, high = np.full((1, 2), values.min()), np.full((1, 2), values.max())
    told = channel_histogram.percentiles(counts, reference, low, high, levels)
    for t, about in enumerate((0.0, 3.0)):
        exact = np.percentile(values, levels)
        assert np.all(np.abs(told[0, :, t] - exact) <= 0.045 * np.abs(exact - about) + 1e-3)
        assert told[0, 0, t] == values.min() and told[0, -1, t] == values.max()


def test_what_is_no_number_is_counted_nowhere():
    reference = channel_histogram.reference_of(np.zeros((1, 1)), np.ones(1))
    counts = np.zeros((1, 1, channel_histogram.BINS), dtype=np.uint32)
    channel_histogram.count(counts, reference, np.array([[np.nan]]))
    assert counts.sum() == 0
    assert np.isnan(
        channel_histogram.percentiles(counts, reference, np.zeros((1, 1)), np.ones((1, 1)), np.array([50.0]))
    )


# ---------------------------------------------------------------- distributions and designs


@pytest.mark.parametrize("kind", ["random", "latin_hypercube", "sobol"])
def test_every_design_gives_each_quantity_its_distribution(kind):
    variables = (
        Varied(find_quantity(BASE, "valve.null_gap"), Distribution("norm", 35e-6, 1e-6, lowest=34e-6, highest=36e-6)),
        Varied(find_quantity(BASE, "valve.spool_mass"), Distribution("lognorm", 0.0, 4e-3, (("s", 0.1),))),
        Varied(find_quantity(BASE, "oil.density_at_20"), Distribution("uniform", 850.0, 30.0)),
    )
    own = small(variables=variables, design=Design(kind=kind, members=512, seed=2), whole=None)
    draws = own.draws()
    for k, variable in enumerate(variables):
        law = variable.distribution
        assert stats.kstest(draws[:, k], law.probability).pvalue > 1e-3
        assert np.allclose(law.quantile(law.probability(draws[:, k])), draws[:, k], rtol=1e-9)
    assert draws[:, 0].min() >= 34e-6 and draws[:, 0].max() <= 36e-6


def test_a_correlation_shows_in_the_ranks_and_leaves_the_distributions():
    keys = ("valve.null_gap", "valve.nozzle_diameter", "valve.spool_mass")
    design = Design(kind="random", members=4000, correlations=(Correlation(keys[0], keys[2], -0.7),))
    draws = small(variables=of(*keys), design=design, whole=None).draws()
    rank = stats.spearmanr(draws).statistic
    assert rank[0, 2] == pytest.approx(6.0 / np.pi * np.arcsin(-0.35), abs=0.03)  # of a Gaussian copula
    assert abs(rank[0, 1]) < 0.05
    for k, variable in enumerate(of(*keys)):
        assert stats.kstest(draws[:, k], variable.distribution.probability).pvalue > 1e-3


def test_correlations_that_no_quantities_have_are_refused():
    keys = ("valve.null_gap", "valve.nozzle_diameter", "valve.spool_mass")
    pairs = [(0, 1, 0.9), (1, 2, 0.9), (0, 2, -0.9)]
    design = Design(members=4, correlations=tuple(Correlation(keys[i], keys[j], r) for i, j, r in pairs))
    with pytest.raises(InputError, match="not positive definite"):
        small(variables=of(*keys), design=design, whole=None).draws()


def test_correlated_probabilities_stay_uniform():
    u = np.random.default_rng(1).random((5000, 2))
    own = correlate(u, np.array([[1.0, 0.95], [0.95, 1.0]]))
    assert stats.kstest(own[:, 1], "uniform").pvalue > 1e-3
    assert np.array_equal(own[:, 0], correlate(u, np.array([[1.0, 0.2], [0.2, 1.0]]))[:, 0])


def test_a_tolerance_is_a_normal_distribution_within_it():
    law = tolerance_distribution(10.0, 0.4, (0.0, 10.3))
    assert (law.lowest, law.highest, law.scale) == (9.6, 10.3, 0.2)
    assert law.quantile(np.array([0.0, 1.0])) == pytest.approx([9.6, 10.3])
    assert law.outside((0.0, 10.3)) == 0.0 and law.outside((9.7, 10.3)) > 0.01


def test_a_distribution_that_leaves_the_bounds_of_its_quantity_is_refused():
    gap = find_quantity(BASE, "valve.null_gap")
    with pytest.raises(InputError, match=r"vary\.valve\.null_gap: the distribution .* leaves .*truncate"):
        Varied(gap, Distribution("norm", 35e-6, 20e-6))
    Varied(gap, Distribution("norm", 35e-6, 20e-6, lowest=1e-6))
    with pytest.raises(InputError, match="leaves"):
        Varied(gap, Distribution("uniform", 0.9e-3, 0.2e-3))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Distribution("nrom", 0.0, 1.0), "did you mean 'norm'"),
        (lambda: Distribution("norm", 0.0, 0.0), "scale = 0 must be positive"),
        (lambda: Distribution("lognorm", 0.0, 1.0), "shape parameters s; given: none"),
        (lambda: Distribution("norm", 0.0, 1.0, (("a", 1.0),)), "no shape parameters; given: a"),
        (lambda: Distribution("uniform", 0.0, 1.0, lowest=2.0), "nothing of the distribution"),
        (lambda: OptionChoice((1, 2), ("a", "b"), (1.0,)), "1 weights for 2 choices"),
        (lambda: OptionChoice((1, 2), ("a", "b"), (0.0, 0.0)), "nor all of them zero"),
        (lambda: Design(kind="saltelli", members=100), "power of two"),
        (lambda: Design(kind="lhs"), "unknown design 'lhs'"),
        (lambda: Design(members=0), "design.members = 0"),
        (lambda: Design(seed=-1), "design.seed = -1"),
        (lambda: Design(kind="table", members=3), "a table has rows"),
        (lambda: small(keep=()), "nothing is kept"),
        (lambda: small(variables=()), "nothing varies"),
        (lambda: small(variables=of("valve.null_gap", "valve.null_gap")), "varies twice"),
        (lambda: small(keep=("runs.x.y",)), "unknown family of figures 'runs'; did you mean 'run'"),
        (lambda: small(block=0), "block = 0"),
        (lambda: small(whole=WholeChannels(members=(12,), channels=("spool_position",))), "12 is no member"),
        (lambda: small(percentiles=ChannelPercentiles(channels=("spool",))), "unknown channel 'spool'"),
        (lambda: ChannelPercentiles(channels=()), "percentiles.channels names no channel"),
        (lambda: WholeChannels(members=(0,), channels=()), "whole.channels names no channel"),
        (lambda: WholeChannels(members=(), channels=("spool_position",)), "whole.members names no member"),
        (lambda: ChannelPercentiles(channels=("spool_position",), levels=(101.0,)), "within 0 and 100"),
        (lambda: ChannelPercentiles(channels=("spool_position",), start=2.0, end=1.0), "start = 2 s must be before"),
        (lambda: small(percentiles=ChannelPercentiles(channels=("spool_position",), start=0.02)), "behind the end"),
        (lambda: small(options=FigureOptions(start=0.02)), "before the end of the run"),
        (lambda: make_plan(small(keep=("run.spool_position.larges",))), "did you mean 'run.spool_position.largest'"),
        (lambda: make_plan(small(keep=("bench.flows.lap",))), "unknown test of bench 'flows'; did you mean 'flow'"),
        (lambda: find_quantity(BASE, "valve.null_gpa"), "did you mean 'null_gap'"),
        (lambda: find_quantity(BASE, "valves.null_gap"), "unknown section 'valves'; did you mean 'valve'"),
        (lambda: find_quantity(BASE, "thermal.body_capacity"), "isothermal"),
        (lambda: find_quantity(BASE, "effects.spool_coulomb_friction.friction_force"), "scenario has no effects"),
        (lambda: find_quantity(BASE, "command.current.ramp.rate"), "which has: step"),
        (lambda: find_quantity(BASE, "command.current.step.afer"), "did you mean 'after'"),
        (lambda: find_quantity(BASE, "loop.mass"), "no \\[loop\\]"),
        (lambda: of("valve.supply_pressure"), "has no tolerance of its own"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_told(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_every_kind_of_key_finds_its_quantity_and_changes_it():
    friction = vs.effect("spool_coulomb_friction")(friction_force=1.0)
    case = vs.Scenario(
        duration=1.0, effects=(friction,), supply_pressure=vs.Constant(value=20e6),
        oil_temperature=vs.Sum((vs.Ramp(start_value=20.0, end_value=90.0, rate=30.0), vs.Sine(amplitude=2.0))),
        command=vs.Step(after=2e-3),
    )  # fmt: skip
    changes = {
        "valve.null_gap": 34e-6, "oil.density_at_20": 870.0, "thermal.body_capacity": 120.0,
        "thermal.ambient_temperature": 25.0, "effects.spool_coulomb_friction.friction_force": 2.0,
        "pressures.supply": 19e6, "command.current.step.after": 3e-3, "thermal.oil_temperature.ramp.rate": 25.0,
        "thermal.oil_temperature.sine.amplitude": 1.0, "pressures.return": 4e5,
    }  # fmt: skip
    changed = apply(case, changes)
    for key, value in changes.items():
        before, after = find_quantity(case, key), find_quantity(changed, key)
        assert after.nominal == value != before.nominal, key
        assert after == replace(before, nominal=value, tolerance=after.tolerance)
    back = apply(changed, {key: find_quantity(case, key).nominal for key in changes})
    assert replace(back, return_pressure=None) == case


# ---------------------------------------------------------------- yield and capability


def test_the_interval_of_a_yield_is_that_of_clopper_and_pearson():
    own = yield_of(np.arange(50) < 45)
    assert own.share == 0.9
    assert (own.low, own.high) == pytest.approx((stats.beta.ppf(0.025, 45, 6), stats.beta.ppf(0.975, 46, 5)))


def test_capability_of_a_normal_figure(finished):
    (criterion,), _ = criteria_of(
        finished.figures, finished.nominal, [FigureLimit("run.spool_position.end", 0.0, 4.0)], None
    )
    values = stats.norm(1.0, 0.25).ppf((np.arange(20_000) + 0.5) / 20_000)
    told = capability_of(criterion, values)
    assert told.index == pytest.approx(1.0 / 0.75, rel=1e-3) and told.low < told.index < told.high
    assert told.by_quantiles == pytest.approx(told.index, rel=1e-2)
    assert np.isnan(capability_of(criterion, np.ones(5)).index)


SPECIFICATION = """
title = "A class"
[conditions]
oil_temperature = "40 degC"
[figures]
hysteresis = { high = "3 %" }
null_bias = { high = "2 %" }
frequency_minus_90_deg = [{ low = "110 Hz", amplitude = "40 %" }, { low = "80 Hz", amplitude = "100 %" }]
coil_resistance = { value = "600 ohm", tolerance = "10 %" }
"""


def test_a_specification_says_what_is_kept_and_judges_it(tmp_path):
    (tmp_path / "spec.toml").write_text(SPECIFICATION, encoding="utf-8")
    specification = vs.load_specification(tmp_path / "spec.toml")
    names = figures_for(specification)
    assert names == (
        "bench.flow.hysteresis", "bench.flow.null_bias", "response.sine_40.frequency_minus_90_deg",
        "response.sine_100.frequency_minus_90_deg",
    )  # fmt: skip
    figures = [KeptFigure(name, "1", "") for name in names]
    criteria, unjudged = criteria_of(figures, np.array([0.01, -0.01, 150.0, 90.0]), [], specification)
    assert unjudged == ("coil_resistance",) and [c.figure.name for c in criteria] == list(names)
    assert [(c.low, c.high) for c in criteria] == [(-np.inf, 0.03), (-np.inf, 0.02), (110.0, np.inf), (80.0, np.inf)]
    bias = criteria[1]
    assert bias.either_way and list(bias.passes(np.array([-0.019, 0.019, -0.021, np.nan]))) == [
        True,
        True,
        False,
        False,
    ]
    assert bias.margin(np.array([-0.019, np.nan])) == pytest.approx([0.001, -np.inf])
    text = STUDY.replace('title = "Two tolerances"', 'title = "x"\nspecification = "spec.toml"')
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    own = load_study(tmp_path / "study.toml")
    assert own.keep == ("run.spool_position.end", *names) and own.options.bench_temperature == 40.0


# ---------------------------------------------------------------- files and the command line


STUDY = """
title = "Two tolerances"
[scenario]
duration = "20 ms"
thermal.isothermal = true
thermal.oil_temperature = "60 degC"
command.current.step = { after = "5 mA", time = "2 ms" }
outputs.rate = "2 kHz"
[design]
members = 8
[vary]
"valve.null_gap" = {}
valve.null_gap_difference.tolerance = "0.5 um"
"oil" = { values = ["mil_prf_5606", "mil_prf_83282"], weights = [3, 1] }
[[correlations]]
between = ["valve.null_gap", "valve.null_gap_difference"]
value = 0.5
[figures]
keep = ["run.spool_position.end"]
[limits]
run.spool_position.end = { low = "0.1 mm", high = "0.2 mm" }
"""


@pytest.fixture
def study_file(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


def test_a_study_file_is_read(study_file):
    own = load_study(study_file)
    assert own.keys == ("valve.null_gap", "valve.null_gap_difference", "oil") and own.members == 8
    assert own.variables[1].distribution.highest == 0.5e-6
    draws = own.draws()
    assert set(draws[:, 2]) == {0.0, 1.0} and own.member(draws[0]).oil.name in ("mil_prf_5606", "mil_prf_83282")
    assert load_study(study_file, settings=["design.members=5"]).members == 5
    assert len(load_study(study_file, settings=["vary.tolerances=true"]).variables) == len(tolerated(BASE)) + 1


def test_the_command_runs_a_study_and_a_member_of_it(call, study_file, tmp_path):
    folder = tmp_path / "out"
    code, out, err = call("study", study_file, "-o", folder, "--workers", "0", "--no-pictures")
    assert code == 0, err
    assert "run.spool_position.end" in out and "yield" in out and "8" in out
    value = open_result(load_study(study_file), folder).values[5, 0]
    code, text, err = call("study", study_file, "--member", "5")
    assert code == 0, err
    (tmp_path / "member.toml").write_text(text, encoding="utf-8")
    alone = vs.simulate(vs.load_scenario(tmp_path / "member.toml"))
    assert alone["spool_position"].values[-1] == pytest.approx(value, rel=1e-9)


def test_a_dry_run_writes_nothing(call, study_file, tmp_path):
    code, out, err = call("study", study_file, "-o", tmp_path / "out", "--dry-run")
    assert code == 0, err
    assert "members" in out and "MB" in out and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('["mil_prf_5606", "mil_prf_83282"]', "[1.5, true]", "expected the name of an oil, or its table, got 1.5"),
        ('"valve.null_gap" = {}', '"valve.nul_gap" = {}', r"line 12: vary\.valve: .*did you mean 'null_gap'"),
        ("members = 8", "members = 0", r"line 10: design\.members: 0 must be"),
        ("members = 8", 'kind = "saltelli"\nmembers = 8', "has base_samples"),
        ('tolerance = "0.5 um"', 'tolerance = "0.5 bar"', r"line 13: .*wrong dimension"),
        ('"mil_prf_83282"]', '"mil_prf_83292"]', r"line 14: .*mil_prf_83282"),
        ("weights = [3, 1]", "weights = [3]", r"line 14: vary\.oil\.weights: 1 weights"),
        ("value = 0.5", "value = 1.5", "within -1 and 1"),
        ('between = ["valve.null_gap", ', 'between = ["valve.nullgap", ', r"line 16: .*did you mean 'valve\.null_gap'"),
        ('keep = ["run.spool_position.end"]', 'keep = ["rum.x"]', "did you mean 'run'"),
        ('low = "0.1 mm"', 'low = "0.3 mm"', "needs low below high"),
        ('low = "0.1 mm"', 'low = "0.1 bar"', "wrong dimension"),
        ("run.spool_position.end = {", "run.spool_position.largest = {", "unknown figure of merit that is kept"),
        ("[design]", "[desing]", r"line 9: .*did you mean 'design'"),
        ("[scenario]\nduration", '[scenario]\nfile = "none.toml"\nduration', "no such file"),
    ],
)
def test_bad_study_files_are_refused_in_one_line(call, study_file, tmp_path, old, new, message):
    assert old in STUDY
    study_file.write_text(STUDY.replace(old, new), encoding="utf-8")
    code, out, err = call("study", study_file, "-o", tmp_path / "out", "--workers", "0")
    assert code == 2 and err.count("\n") == 1 and re.search(message, err), err


def test_a_table_of_ones_own(study_file, tmp_path):
    (tmp_path / "draws.csv").write_text(
        "valve.null_gap [um],pressures.supply [bar]\n34,200\n36,210\n", encoding="utf-8"
    )
    text = (
        STUDY[: STUDY.index("[design]")]
        + '[design]\nkind = "table"\ntable = "draws.csv"\n[figures]\nkeep=["drift.*"]\n'
    )
    study_file.write_text(text, encoding="utf-8")
    own = load_study(study_file)
    assert np.allclose(own.draws(), [[34e-6, 200e5], [36e-6, 210e5]])
    (tmp_path / "draws.csv").write_text("valve.null_gap [um]\n34\n1e6\n", encoding="utf-8")
    with pytest.raises(InputError, match="null_gap"):
        load_study(study_file)


# ---------------------------------------------------------------- sensitivities and tolerances


def ishigami(case):
    """Ishigami and Homma (1990) of three quantities of the valve, each over -pi to pi."""
    valve = case.valve
    x = [10.0 * np.pi * (v - 1.0) for v in (valve.null_gap / 35e-6, valve.spool_mass / 4e-3, valve.spool_damping)]
    return {"ishigami": np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])}


def ishigami_study(base_samples):
    sizes = {"valve.null_gap": 35e-6, "valve.spool_mass": 4e-3, "valve.spool_damping": 1.0}
    variables = (Varied(find_quantity(BASE, k), Distribution("uniform", 0.9 * n, 0.2 * n)) for k, n in sizes.items())
    return ParameterStudy(
        case=BASE, variables=tuple(variables), design=Design(kind="saltelli", members=base_samples),
        keep=("own.*",), options=FigureOptions(functions=(ishigami,)),
    )  # fmt: skip


def test_sobol_indices_of_ishigamis_function_are_those_of_its_closed_form(tmp_path):
    result = study(ishigami_study(256), tmp_path, workers=0)
    found = sensitivity_indices(result, "own.ishigami")
    a, b, pi = 7.0, 0.1, np.pi
    whole = a**2 / 8 + b * pi**4 / 5 + b**2 * pi**8 / 18 + 0.5
    first = np.array([0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, 0.0]) / whole
    both = b**2 * pi**8 * (1 / 18 - 1 / 50) / whole
    assert np.all(np.abs(found.first - first) < np.maximum(found.first_error, 0.02))
    assert np.all(np.abs(found.total - first - [both, 0.0, both]) < np.maximum(found.total_error, 0.02))
    assert list(found.order) == [0, 1, 2] and found.are_sobol and found.used == 256 * 5
    assert result.independent.sum() == 256 * 2


def test_sobol_indices_leave_out_base_samples_of_which_a_member_failed(tmp_path):
    result = study(ishigami_study(32), tmp_path, workers=0)
    whole = sensitivity_indices(result, "own.ishigami")
    result.values[7, 0] = np.nan
    fewer = sensitivity_indices(result, "own.ishigami")
    assert whole.used - fewer.used == 5 and np.allclose(fewer.total, whole.total, atol=0.3)
    result.values[:, 0] = 1.0
    with pytest.raises(InputError, match="does not vary"):
        sensitivity_indices(result, "own.ishigami")


def linear(case):
    """Known slopes over three quantities, and a fourth that does nothing."""
    valve = case.valve
    return {"sum": 3.0 * valve.null_gap / 35e-6 + 1.0 * valve.spool_mass / 4e-3 - 2.0 * valve.spool_damping}


def linear_study(**changes):
    sizes = {"valve.null_gap": 0.02, "valve.spool_mass": 0.1, "valve.spool_damping": 0.05, "valve.coil_turns": 0.02}
    variables = []
    for key, share in sizes.items():
        quantity = find_quantity(BASE, key)
        law = Distribution("norm", quantity.nominal, share * quantity.nominal / 2.0)
        variables.append(Varied(quantity, law))
    figures = dict(
        case=BASE, variables=tuple(variables), design=Design(kind="latin_hypercube", members=1000, seed=5),
        keep=("own.*",), options=FigureOptions(functions=(linear,)), block=1000,
        limits=(FigureLimit("own.sum", 1.92, 2.08),),
    )  # fmt: skip
    return ParameterStudy(**(figures | changes))


@pytest.fixture(scope="module")
def linear_result(tmp_path_factory):
    return study(linear_study(), tmp_path_factory.mktemp("linear"), workers=0)


PARTS = np.array([3.0 * 0.01, 1.0 * 0.05, 2.0 * 0.025, 0.0]) ** 2  # of the variance of `linear`


def test_shares_by_regression_and_local_ones_are_those_of_a_linear_figure(linear_result):
    found = sensitivity_indices(linear_result, "own.sum")
    assert found.explained == pytest.approx(1.0) and not found.are_sobol
    assert np.allclose(found.first, PARTS / PARTS.sum(), atol=1e-3)
    local = local_sensitivity(linear_result.study, make_plan(linear_result.study))
    assert np.allclose(local.slopes, [[3.0 / 35e-6, 250.0, -2.0, 0.0]], rtol=1e-8, atol=1e-8)
    assert np.allclose(local.shares, PARTS / PARTS.sum(), atol=2e-3) and not local.exact.any()


def test_what_a_tighter_tolerance_does_is_what_a_study_of_it_gives(linear_result, tmp_path):
    """A linear figure of normal quantities has a yield in closed form: by moved members to the scatter of 1000 of them,
    by weights to their standard error."""
    yields = TightenedYields(linear_result)
    for factors in ({}, {"valve.spool_damping": 0.5}, {"valve.null_gap": 0.6, "valve.spool_mass": 0.5}):
        share = np.array([factors.get(key, 1.0) for key in linear_result.study.keys])
        deviation = np.sqrt(np.sum(PARTS * share**2))
        exact = 2.0 * stats.norm.cdf(0.08 / deviation) - 1.0
        told = yields.at(factors)
        assert told.share == pytest.approx(exact, abs=0.03)
        assert abs(told.weighted - exact) < 4.0 * told.error + 1e-3 and told.effective > 200
    assert yields.at({"valve.coil_turns": 0.5}).share == yields.at({}).share


def test_the_plan_tightens_what_gains_most_first_and_stops_at_the_wanted_yield(linear_result):
    plan = tightening_plan(linear_result, 0.97)
    assert plan.reached and plan.steps[-1].share >= 0.97 > plan.steps[-2].share
    assert set(plan.steps[0].factors) <= {"valve.spool_mass", "valve.spool_damping"}
    assert "valve.coil_turns" not in plan.steps[-1].factors
    assert plan.halved[0].share > plan.halved[2].share > plan.halved[3].share == plan.now.share
    assert next(iter(plan.halved[-1].factors)) == "valve.coil_turns"
    assert not tightening_plan(linear_result, 0.9999999).reached or plan.now.share > 0.5
    assert tightening_plan(linear_result, 0.1).steps == ()


def test_weights_of_correlated_quantities_keep_their_correlation(tmp_path):
    pair = (Correlation("valve.spool_mass", "valve.spool_damping", 0.8),)
    own = linear_study(design=Design(kind="random", members=1000, seed=2, correlations=pair), block=1000)
    yields = TightenedYields(study(own, tmp_path, workers=0))
    told = yields.at({"valve.spool_mass": 0.5})
    a, b, c = 0.03, 0.05 * 0.5, -0.05
    exact = 2.0 * stats.norm.cdf(0.08 / np.sqrt(a**2 + b**2 + c**2 + 2.0 * 0.8 * b * c)) - 1.0
    assert abs(told.weighted - exact) < 4.0 * told.error and told.share == pytest.approx(exact, abs=0.04)


def test_slopes_by_the_tangent_equations_are_those_of_differences():
    """Of a state and of a signal, over valve, pressure and command; against central differences of tight runs."""
    case = replace(BASE, tolerance=1e-9)
    keys = ("valve.null_gap", "valve.armature_inertia", "valve.null_gap_difference")
    own = small(
        case=case, whole=None, percentiles=None, keep=("run.spool_position.*", "run.load_flow.highest"),
        variables=(*of(*keys), variable_of(find_quantity(case, "pressures.supply"), 1e5),
                   variable_of(find_quantity(case, "command.current.step.after"), 1e-4)),
    )  # fmt: skip
    plan = make_plan(own)
    local = local_sensitivity(own, plan)
    assert local.exact.all()
    for j, variable in enumerate(own.variables):
        step = 0.01 * local.deviation[j]
        rows = np.tile([v.quantity.nominal for v in own.variables], (2, 1))
        rows[:, j] += [step, -step]
        high, low = run_block(own, plan, 0, rows).figures
        size = np.abs(local.slopes * local.deviation).max(axis=1) / local.deviation[j]
        assert np.all(np.abs(local.slopes[:, j] - (high - low) / (2.0 * step)) < 2e-3 * size), variable.key


def test_a_function_of_ones_own_that_fails_fails_its_member_alone(tmp_path):
    def picky(case):
        return {"root": 1.0 / (case.valve.spool_mass < 4.05e-3)}

    own = linear_study(design=Design(members=40), options=FigureOptions(functions=(picky,)), limits=())
    result = study(own, tmp_path, workers=0)
    assert 0 < np.isnan(result.values).sum() < 40
    assert "picky fails with ZeroDivisionError" in result.reasons[np.flatnonzero(np.isnan(result.values[:, 0]))[0]]
    with pytest.raises(InputError, match="picky fails with"):
        make_plan(linear_study(case=replace(BASE, valve=replace(BASE.valve, spool_mass=5e-3)), options=own.options))


# ---------------------------------------------------------------- the page


def test_the_page_shows_yield_limits_and_sensitivities(linear_result, tmp_path):
    from datetime import date

    from valvesim.reports.study import study_report

    findings = find(linear_result)
    written = study_report(findings, tmp_path, valve="valve <1>", date=date(2026, 11, 24))
    assert [path.name for path in written] == [
        "study_figures.png",
        "study_sensitivity.png",
        "study_tightening.png",
        "study.html",
    ]
    page = (tmp_path / "study.html").read_text(encoding="utf-8")
    for text in ("Yield", "own.sum", "valve.spool_mass", "Which tolerance to tighten", "valve &lt;1&gt;"):
        assert text in page
    assert "valve.coil_turns" in page


# ---------------------------------------------------------------- several processes


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_two_processes_give_the_same_store_as_one(finished, tmp_path):
    pytest.importorskip("distributed")
    study(small(), tmp_path, workers=2)
    assert same_files(finished.folder / STORE_NAME, tmp_path / STORE_NAME)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(vs.CATALOGUE))
def test_every_effect_of_the_catalogue_varies_in_a_batch_as_it_does_alone(name):
    """All its parameters by a tenth, beside the null gap; a sensor's effect on the spool position."""
    effect = vs.CATALOGUE[name]
    effect = effect if effect.reading is None else effect.on("spool_position")
    warming = effect.temperatures is not None
    case = vs.Scenario(
        duration=0.03, thermal=vs.Thermal() if warming else ISOTHERMAL, output_rate=2000.0, tolerance=1e-7,
        oil_temperature=vs.Ramp(start_value=20.0, end_value=60.0, rate=500.0) if warming else vs.Constant(value=40.0),
        command=vs.Sine(amplitude=4e-3, frequency=50.0),
        effects=(effect(**{effect.amplitude.name: effect.amplitude.typical}),),
    )  # fmt: skip
    variables = list(of("valve.null_gap", case=case))
    for parameter in effect.parameters:
        quantity = find_quantity(case, f"effects.{name}.{parameter.name}")
        ends = np.clip(quantity.nominal * np.array([0.9, 1.1]), *quantity.bounds)
        if parameter.name != "side" and np.ptp(ends) > 0.0:
            variables.append(Varied(quantity, Distribution("uniform", min(ends), np.ptp(ends))))
    own = small(
        case=case, variables=tuple(variables), design=Design(members=9), percentiles=None, whole=None,
        keep=("run.spool_position.rms", "run.load_flow.rms"),
    )  # fmt: skip
    draws = own.draws()
    got = run_block(own, make_plan(own), 0, draws)
    assert got.reasons == ("",) * 9
    for draw, row in zip(draws[:2], got.figures, strict=False):
        alone = vs.simulate(own.member(draw))
        rms = [np.sqrt(np.mean(alone[channel].values ** 2)) for channel in ("spool_position", "load_flow")]
        assert row == pytest.approx(rms, rel=1e-6)


JUNK = (
    None, True, 0, -1, 2**70, 1.5, float("nan"), "", "x", "-5 bar", "1e400 m", [], [1], ["a"], [[]], [{}], {}, {"a": 1},
    {"tolerance": "1 %"}, {"values": []}, {"values": ["1 um"]}, {"distribution": "norm"}, {"file": 3}, "\x00",
)  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_a_study_with_anything_in_the_place_of_anything_is_read_or_refused_in_one_line(seed, tmp_path):
    more = (
        '[percentiles]\nchannels = ["spool_position"]\npoints = 7\n[whole]\nmembers = [0]\nchannels = ["load_flow"]\n'
    )
    table, dice, refused = tomllib.loads(STUDY + more), random.Random(seed), 0

    def places(inner, path=()):
        for key, value in inner.items() if isinstance(inner, dict) else enumerate(inner):
            yield (*path, key)
            if isinstance(value, (dict, list)):
                yield from places(value, (*path, key))

    for _ in range(60):
        changed = copy.deepcopy(table)
        path = dice.choice(list(places(changed)))
        inner = changed
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = copy.deepcopy(dice.choice(JUNK))
        try:
            read_study(changed, tmp_path)
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and str(error)
    assert refused > 30
