"""The plant of the tests: it agrees with the model while nothing is hidden, hides what it says, and tells nothing."""

import ast
from dataclasses import replace
from pathlib import Path

import hidden_plant
import numpy as np
import pytest
from hidden_plant import (
    AMPLITUDE,
    EFFECTS,
    KINDS,
    OUTPUTS,
    OUTSIDE,
    PARAMETERS,
    SENSOR_FAULTS,
    Meter,
    distance,
    draw,
    noisy,
    responses,
    shortened,
    truth,
    write_session,
)  # fmt: skip
from marks import slow_but

from valvesim.inputs import Constant, Table
from valvesim.io import read_columns
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import CurrentDrive, VoltageDrive
from valvesim.valve.parameters import Valve


def short(case, samples=250, runs=1):
    """The case with its first runs cut short."""
    return shortened(replace(case, runs=case.runs[:runs]), samples)


def model_of(case, run):
    """The model's scenario of a run, of the very valve on the bench."""
    temperature = Table(times=tuple(run.time), values=tuple(run.oil)) if np.ptp(run.oil) else Constant(value=run.oil[0])
    return Scenario(
        duration=run.time[-1],
        valve=case.valve,
        thermal=Thermal(network=None) if case.isothermal else Thermal(),
        oil_temperature=temperature,
        command=Table(times=tuple(run.time), values=tuple(run.command)),
        drive=VoltageDrive() if case.drive == "voltage" else CurrentDrive(),
        supply_pressure=Constant(value=run.supply),
        load_pressure=Constant(value=run.load),
        output_rate=run.rate,
        tolerance=1e-6,
    )


@pytest.mark.parametrize("scatter", [False, True])
@pytest.mark.parametrize("name", ["magnet_demagnetization", "coil_resistance_drift", "thermal_lag"])
def test_with_nothing_hidden_plant_and_model_agree_far_below_the_noise(name, scatter):
    """Also in a valve off the line, where the model is told its figures."""
    case = draw(1, "effect", name=name)
    channels = (*OUTPUTS, "current") if case.drive == "voltage" else OUTPUTS
    electronics = {channel: 0.0 if channel == "internal_leakage" else 4e3 for channel in channels}
    meters = tuple(Meter(each, 0.003 * AMPLITUDE[each], 0.0, electronics=electronics[each]) for each in channels)
    case = short(replace(case, unit=case.unit if scatter else {}, meters=meters), samples=1001, runs=2)
    for run, record in zip(case.runs, responses(case, 0.0), strict=True):
        result = simulate(model_of(case, run))
        for meter in meters:
            error = record[meter.channel] - result.values[meter.channel]
            assert np.sqrt(np.mean(error**2)) < 0.1 * meter.noise, (run.shape, meter.channel)


@pytest.mark.parametrize(
    "kind, name",
    slow_but(
        [("effect", "spool_coulomb_friction"), ("outside", "cubic_spool_spring"), ("parameter", "spool_area"),
         ("sensor", "sensor_bias")],
        [("effect", name) for name in EFFECTS] + [("outside", name) for name in OUTSIDE]
        + [("parameter", name) for name in PARAMETERS] + [("sensor", name) for name in SENSOR_FAULTS],
    ),
)  # fmt: skip
def test_what_is_hidden_shows_and_grows_with_its_strength(kind, name):
    case = draw(4, kind, name=name, noise=0.003)
    low = tuple(run for run in case.runs if run.supply < 100e5)  # where air shows
    case = replace(case, runs=low or case.runs)
    case = short(case, 400 if case.runs[0].rate > 600.0 else 900)
    assert distance(case, 0.0) == 0.0
    weak, strong = distance(case, 0.5), distance(case, 1.0)
    assert weak > 1.0 and strong > 1.05 * weak, (weak, strong)


def test_the_effects_are_those_of_the_catalogue_by_name_and_parameters_within_bounds():
    assert set(EFFECTS) | set(SENSOR_FAULTS) == set(CATALOGUE)
    for name in EFFECTS:
        ((_, figures),) = draw(3, "effect", name=name).hidden
        CATALOGUE[name](**figures)  # refuses unknown names and figures out of bounds
    for name in SENSOR_FAULTS:
        ((_, figures),) = draw(3, "sensor", name=name).hidden
        figures = dict(figures)
        CATALOGUE[name].on(figures.pop("channel"))(**figures)


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_draws_the_same_case_and_another_seed_another(kind):
    one, same, other = (draw(seed, kind) for seed in (11, 11, 12))
    assert (one.hidden, one.meters, one.unit, one.drive) == (same.hidden, same.meters, same.unit, same.drive)
    assert all(np.array_equal(a.command, b.command) for a, b in zip(one.runs, same.runs, strict=True))
    assert one.unit != other.unit and len(one.hidden) == {"none": 0, "pair": 2}.get(kind, 1)


def test_the_runs_are_four_for_training_with_a_repeat_and_two_tests_within_the_rated_current():
    for seed in range(20):
        case = draw(seed, "none")
        assert [run.role for run in case.runs] == ["train"] * 4 + ["test"] * 2
        twins = [run for run in case.runs if run.repeats]
        assert len(twins) == 2 and np.array_equal(twins[0].command, twins[1].command)
        largest = 10e-3 * (Valve().coil_resistance if case.drive == "voltage" else 1.0)
        assert all(np.max(np.abs(run.command)) <= largest for run in case.runs)
        assert {"spool_position", "load_flow"} & set(case.channels)


def test_the_unit_scatters_within_tolerance():
    nominal, shares = Valve(), []
    for seed in range(40):
        unit = draw(seed, "none").unit
        shares.append(unit["feedback_rod_stiffness"] / nominal.feedback_rod_stiffness - 1.0)
    assert np.max(np.abs(shares)) <= 0.02 + 1e-12 and 0.005 < np.std(shares) < 0.015


def test_noise_has_the_size_and_colour_of_the_meter_and_stands_on_its_grid():
    case = short(draw(2, "none"), samples=1001)
    meter = replace(case.meters[0], noise=1e-6, resolution=2e-7, colour=0.9)
    case = replace(case, meters=(replace(meter, channel="spool_position"),))
    clean, dirty = responses(case)[0]["spool_position"], noisy(case)[0]["spool_position"]
    noise = dirty - clean
    assert 0.6e-6 < np.std(noise) < 1.5e-6
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.9, abs=0.08)
    assert np.allclose(dirty / 2e-7, np.round(dirty / 2e-7), atol=1e-6)


def test_a_session_holds_its_records_and_nothing_of_the_answer(tmp_path):
    case = draw(5, "pair", name="spool_coulomb_friction+magnetic_saturation")
    write_session(short(case, 60, 6), tmp_path)
    texts = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert sorted(texts) == [*(f"record_{k}.csv" for k in range(1, 7)), "session.toml"]
    for secret in (*EFFECTS, *OUTSIDE, *SENSOR_FAULTS, *PARAMETERS, "seed", "pair", "strength"):
        assert not any(secret in text for text in texts.values()), secret
    clean = responses(short(case, 60, 6))[0]
    columns = read_columns(tmp_path / "record_1.csv", {"time": "s", "current": "A", "oil_temperature": "degC"})
    assert columns["current"] == pytest.approx(clean["current"], abs=1e-12)


def test_the_truth_scales_with_the_strength():
    case = draw(6, "effect", name="oil_viscosity_grade")
    full = truth(case)["parameters"]["oil_viscosity_grade"]["viscosity_factor"]
    assert truth(case, 0.5)["parameters"]["oil_viscosity_grade"]["viscosity_factor"] == pytest.approx((1.0 + full) / 2)
    case = draw(6, "parameter", name="spool_area")
    (cause,) = truth(case)["causes"]
    figures = truth(case)["parameters"][cause]
    assert cause == "parameter:spool_area"
    assert figures["value"] == pytest.approx(case.unit["spool_area"] * (1.0 + figures["offset"]))
    assert truth(draw(6, "outside", name="spool_detent"))["causes"] == ["outside:spool_detent"]


@pytest.mark.parametrize("kind, name", [("effects", None), ("effect", "spool_detent"), ("none", "spool_lap")])
def test_an_unknown_kind_or_name_is_refused(kind, name):
    with pytest.raises(ValueError, match="is none of"):
        draw(0, kind, name=name)


def test_the_plant_borrows_no_equation_of_the_model():
    tree = ast.parse(Path(hidden_plant.__file__).read_text(encoding="utf-8"))
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    own = {name for name in modules if name.startswith("valvesim")}
    # coefficients: the names of the parts alone
    assert own == {f"valvesim.valve.{name}" for name in ("coefficients", "parameters", "thermal_network")}
