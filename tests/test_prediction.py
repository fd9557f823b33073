"""What a bench predicts of a record, against whole runs of `simulate` under the same measured inputs."""

import functools
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from valvesim.errors import InputError, SolveError
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.options import PredictorOptions
from valvesim.identification.predictor import ModelVariant, neutral, prepare_record
from valvesim.identification.record_scenario import record_scenario
from valvesim.identification.session_toml import load_session
from valvesim.inputs import Table, evaluate
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.equations import Model
from valvesim.valve.laws import lagged

HEADERS = {
    "spool_position": ("mm", 1e3), "armature_angle": ("mrad", 1e3), "nozzle_pressure_1": ("bar", 1e-5),
    "load_flow": ("L/min", 6e4), "internal_leakage": ("L/min", 6e4),
}  # fmt: skip
UNIVERSE = (CATALOGUE["spool_coulomb_friction"], CATALOGUE["magnetic_hysteresis"])
FRICTION = CATALOGUE["spool_coulomb_friction"](friction_force=2.0)
HYSTERESIS = CATALOGUE["magnetic_hysteresis"](coercive_current=2e-4)
LAG = 2e-3
SETTINGS = f"""
title = "small"
[sensors.load_flow]
lag = "{LAG} s"
range = ["-30 L/min", "30 L/min"]
[[records]]
file = "fast.csv"
[[records]]
file = "slow.csv"
"""


def trajectories():
    """(time s, current A, oil °C, load pressure Pa) of the records: a fast one with a cold start, and one of few Hz."""
    fast, slow = np.arange(151) / 1000.0, np.arange(61) / 50.0
    move = np.clip(fast - 0.02, 0.0, None)  # a hold first, and no corner where it ends
    swing = 3e-3 * np.sin(2 * np.pi * 15.0 * move) * (1.0 - np.exp(-move / 0.02))
    return {
        "fast": (fast, 1e-3 + swing, 20.0 + 200.0 * fast, 2e6 * fast / fast[-1]),
        "slow": (slow, 4e-3 * np.sin(2 * np.pi * 0.9 * slow), np.full(slow.size, 40.0), np.full(slow.size, 1e6)),
    }


def write(folder):
    """A session folder from runs of the nominal valve."""
    (folder / "session.toml").write_text(SETTINGS, encoding="utf-8")
    for name, (time, current, oil, load) in trajectories().items():
        given = [Table(times=tuple(time), values=tuple(values)) for values in (current, oil, load)]
        run = simulate(
            Scenario(
                duration=float(time[-1]), command=given[0], oil_temperature=given[1], load_pressure=given[2],
                output_rate=(len(time) - 1) / float(time[-1]),
            )
        )  # fmt: skip
        table = {"time [s]": time, "current [mA]": 1e3 * current, "oil_temperature [degC]": oil,
                 "load_pressure [bar]": 1e-5 * load}  # fmt: skip
        table |= {f"{name} [{unit}]": factor * run.values[name] for name, (unit, factor) in HEADERS.items()}
        rows = "\n".join(",".join(f"{v:.12g}" for v in row) for row in np.column_stack(list(table.values())))
        (folder / f"{name}.csv").write_text(",".join(table) + "\n" + rows + "\n", encoding="utf-8")


@functools.cache
def small_session():
    """The session, both records to learn from."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder))
        session = load_session(folder)
    return replace(session, records=tuple(replace(record, role="train") for record in session.records))


@functools.cache
def bench_of(name):
    """One of its records, prepared."""
    session = small_session()
    return prepare_record(
        session,
        next(record for record in session.records if record.name.startswith(name)),
        UNIVERSE,
        options=OPTIONS,
    )


@functools.cache
def course_of(name, variant):
    return bench_of(name).run(variant)


def read(name, variant):
    return bench_of(name).readings(course_of(name, variant), variant)


@functools.cache
def truth(name, *effects, valve=None, rate=None):
    """A run of `simulate` of a record's scenario."""
    session, record = small_session(), bench_of(name).record
    scenario = record_scenario(session, record, effects=effects, valve=valve, tolerance=1e-6)
    return simulate(scenario if rate is None else replace(scenario, output_rate=rate))


def off(found, expected):
    """Largest difference as a share of the span."""
    return np.abs(found - expected).max() / np.ptp(expected)


def nominal_variant():
    return ModelVariant(small_session().valve)


# ---------------------------------------------------------------- the grid


def test_a_fast_record_is_refined_and_a_slow_one_kept():
    fast, slow = bench_of("fast"), bench_of("slow")
    for predictor in (fast, slow):
        assert predictor.times[:: predictor.oversampling] == pytest.approx(predictor.record.time)
        assert predictor.fine_times[:: predictor.sensor_oversampling] == pytest.approx(predictor.times)
    for times, finest in (
        (fast.times, OPTIONS.predictor.grid_spacing),
        (fast.fine_times, OPTIONS.predictor.sensor_spacing),
    ):
        assert np.diff(times).max() <= finest * (1 + 1e-9)
    assert 1.0 / slow.record.rate > OPTIONS.predictor.quasi_static_step and (
        slow.oversampling,
        slow.sensor_oversampling,
    ) == (1, 1)


def test_a_coarse_bench_reads_the_same_and_is_seen_at_the_samples_alone():
    for name in ("fast", "slow"):
        predictor, variant = bench_of(name), nominal_variant().with_effect(FRICTION)
        without_oversampling = predictor.without_oversampling()
        assert (
            without_oversampling.times == pytest.approx(predictor.record.time)
            and without_oversampling.oversampling == 1
        )
        trajectory = without_oversampling.run(variant)
        assert len(trajectory.states) == len(without_oversampling.inputs) == len(predictor.record.time)
        for channel, column in without_oversampling.readings(trajectory, variant).items():
            assert np.array_equal(column, read(name, variant)[channel])


def test_a_repeat_runs_like_its_record_and_nothing_else_does():
    session, fast = small_session(), bench_of("fast")

    def like(**changed):
        values = {**fast.record.values, **changed}
        return prepare_record(
            session, replace(fast.record, name="again", values=values), UNIVERSE, options=OPTIONS
        ).runs_as(fast)

    assert like(spool_position=fast.record.values["spool_position"] + 1e-6)  # what was read does not matter
    assert not like(current=1.001 * fast.record.values["current"])
    assert not like(oil_temperature=fast.record.values["oil_temperature"] + 1.0)
    assert not like(load_pressure=fast.record.values["load_pressure"] + 1e5)
    assert not bench_of("slow").runs_as(fast)


def test_courses_of_long_records_are_kept_at_wider_spacing():
    session = small_session()
    fast = next(record for record in session.records if record.name.startswith("fast"))

    def grid(count):  # the record and as many as long
        return prepare_record(replace(session, records=(fast,) * count), fast, (), options=OPTIONS)

    step = 1.0 / fast.rate
    assert grid(1).oversampling == round(step / OPTIONS.predictor.grid_spacing) > 1
    many = int(OPTIONS.predictor.most_points * 2 * OPTIONS.predictor.grid_spacing / fast.duration) + 1
    assert grid(many).oversampling == grid(1).oversampling // 2 and grid(100 * many).oversampling == 1
    for count in (1, many, 100 * many):
        assert np.diff(grid(count).fine_times).max() <= OPTIONS.predictor.sensor_spacing * (1 + 1e-9)


def test_the_inputs_are_the_records_own():
    predictor = bench_of("fast")
    time, current, _, load = trajectories()["fast"]
    assert predictor.inputs[:: predictor.oversampling, 0] == pytest.approx(current)
    assert predictor.inputs[:: predictor.oversampling, 4] == pytest.approx(load)
    assert predictor.inputs[:, 0] == pytest.approx(np.interp(predictor.times, time, current))
    assert predictor.inputs[1:, 1] == pytest.approx(np.gradient(predictor.inputs[:, 0], predictor.times)[1:])
    assert predictor.inputs[0, 1] == 0.0  # at rest
    assert predictor.inputs[:, 2] == pytest.approx(np.full(len(predictor.times), small_session().valve.supply_pressure))
    assert predictor.inputs == pytest.approx(
        predictor.fine_inputs[:: predictor.sensor_oversampling], rel=1e-6, abs=3.0
    )  # but for corners' rates


def test_a_bench_knows_its_sensors():
    predictor = bench_of("fast")
    assert predictor.lags["load_flow"] == LAG and predictor.lags["spool_position"] == 0.0
    assert set(predictor.lags) == set(predictor.record.outputs) == set(HEADERS)


def test_effects_without_a_balance_have_no_place_in_the_universe():
    session = small_session()
    predictor = prepare_record(
        session,
        session.records[0],
        (*UNIVERSE, CATALOGUE["spool_edge_wear"], CATALOGUE["thermal_lag"]),
        options=OPTIONS,
    )
    assert predictor.universe == UNIVERSE


# ---------------------------------------------------------------- the model that runs


def test_one_effect_with_a_balance_runs_alone_and_several_in_the_universe():
    predictor = bench_of("fast")
    assert predictor.model(()) == Model() == predictor.model((CATALOGUE["spool_edge_wear"](rounding=1e-6),))
    assert predictor.model((FRICTION,)) == Model(effects=(FRICTION.effect,))
    assert predictor.model((HYSTERESIS, FRICTION)) == Model(effects=UNIVERSE)
    stranger = CATALOGUE["feedback_ball_backlash"](half_play=1e-6)
    assert predictor.model((FRICTION, stranger)) == Model(effects=(FRICTION.effect, stranger.effect))


def test_memories_of_absent_effects_are_switched_off():
    predictor, model = bench_of("fast"), Model(effects=UNIVERSE)
    assert predictor.switched_off(model, (FRICTION,)).tolist() == [False] * 7 + [True]
    assert predictor.switched_off(model, (HYSTERESIS, FRICTION)).tolist() == [False] * 8
    variant = nominal_variant().with_effect(HYSTERESIS)
    trajectory = replace(course_of("fast", variant), model=model)
    reduced, own = predictor.reduced(trajectory.model, variant)
    assert reduced == Model(effects=(HYSTERESIS.effect,)) and own.tolist() == [0, 1, 2, 3, 4, 5, 7]


# ---------------------------------------------------------------- readings


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_the_nominal_valve_reads_as_simulate_says(name):
    found, run = read(name, nominal_variant()), truth(name)
    assert set(found) == set(HEADERS)
    for channel, values in found.items():
        assert values.shape == bench_of(name).record.time.shape
        if channel != "load_flow":  # its sensor lags
            assert off(values, run.values[channel]) < 2e-4, channel


def test_a_stated_lag_of_a_sensor_is_in_its_readings():
    run = truth("fast", rate=20_000.0)
    late = lagged(run.time, run.values["load_flow"], LAG)[::20]
    found = read("fast", nominal_variant())["load_flow"]
    assert off(found, late) < 1e-3
    assert off(found, run.values["load_flow"][::20]) > 0.05


@pytest.mark.parametrize(
    "active, other",
    [(FRICTION, HYSTERESIS), (HYSTERESIS, FRICTION)],
    ids=["spool_coulomb_friction", "magnetic_hysteresis"],
)
def test_an_effect_with_memory_reads_as_simulate_says(active, other):
    """The run of `simulate` has the other effect too, at its neutral amplitude: one model less to compile."""
    ordered = sorted((active, neutral(other.effect)), key=lambda a: UNIVERSE.index(a.effect))
    found, run, without = read("fast", nominal_variant().with_effect(active)), truth("fast", *ordered), truth("fast")
    for channel in ("spool_position", "armature_angle", "nozzle_pressure_1", "internal_leakage"):
        shown = np.abs(run.values[channel] - without.values[channel]).max()
        assert np.abs(found[channel] - run.values[channel]).max() < 0.02 * shown, channel


def test_an_effect_on_coefficients_reads_as_simulate_says():
    active = CATALOGUE["fixed_orifice_clogging"](clogged_share=0.1, side=2.0)
    found, run = read("fast", nominal_variant().with_effect(active)), truth("fast", active)
    assert off(run.values["spool_position"], truth("fast").values["spool_position"]) > 0.01
    for channel in ("spool_position", "nozzle_pressure_1"):
        assert off(found[channel], run.values[channel]) < 2e-4, channel


def test_a_thermal_lag_under_an_oil_ramp_reads_as_simulate_says():
    active = CATALOGUE["thermal_lag"](time_constant=0.05)
    found, run, without = read("fast", nominal_variant().with_effect(active)), truth("fast", active), truth("fast")
    shown = np.abs(run.values["internal_leakage"] - without.values["internal_leakage"]).max()
    assert shown > 1e-5 * np.ptp(run.values["internal_leakage"])
    for channel in ("spool_position", "internal_leakage"):
        shown = np.abs(run.values[channel] - without.values[channel]).max()
        reached = read("fast", nominal_variant())[channel] - found[channel]
        assert reached == pytest.approx(without.values[channel] - run.values[channel], abs=0.05 * shown), channel


def test_another_valve_reads_as_simulate_says():
    valve = replace(small_session().valve, null_gap=1.1 * small_session().valve.null_gap)
    found, run = read("fast", ModelVariant(valve)), truth("fast", valve=valve)
    assert off(found["nozzle_pressure_1"], run.values["nozzle_pressure_1"]) < 2e-4
    assert off(run.values["nozzle_pressure_1"], truth("fast").values["nozzle_pressure_1"]) > 0.01


def test_faults_of_a_sensor_act_on_its_channel_alone_and_in_turn():
    gain = CATALOGUE["sensor_gain"].on("spool_position")(gain_error=0.1)
    bias = CATALOGUE["sensor_bias"].on("spool_position")(bias=1e-5)
    drift = CATALOGUE["sensor_temperature_drift"].on("nozzle_pressure_1")(drift=1e3)
    plain = read("fast", nominal_variant())
    found = read("fast", nominal_variant().with_effect(gain).with_effect(bias).with_effect(drift))
    assert found["spool_position"] == pytest.approx(1.1 * plain["spool_position"] + 1e-5, rel=1e-9)
    oil = trajectories()["fast"][2]
    moved = found["nozzle_pressure_1"] - plain["nozzle_pressure_1"]
    assert moved == pytest.approx(1e3 * (oil - 20.0), abs=200.0)  # the oil is followed to 0.1 K
    for channel in ("armature_angle", "load_flow", "internal_leakage"):
        assert found[channel] == pytest.approx(plain[channel], rel=1e-12)


def test_a_delayed_sensor_shows_what_was_a_while_ago():
    delay = CATALOGUE["sensor_delay"].on("spool_position")(delay=3e-3)
    found = read("fast", nominal_variant().with_effect(delay))["spool_position"]
    assert found[3:] == pytest.approx(read("fast", nominal_variant())["spool_position"][:-3], abs=1e-9)


@pytest.mark.parametrize("name", ["fast", "slow"])
def test_an_effect_at_its_neutral_value_is_none(name):
    plain = read(name, nominal_variant())
    for effect in (FRICTION.effect, CATALOGUE["spool_edge_wear"], CATALOGUE["oil_viscosity_grade"]):
        found = read(name, nominal_variant().with_effect(neutral(effect)))
        for channel, values in plain.items():
            assert off(found[channel], values) < 1e-4, (effect.name, channel)


def test_readings_are_the_same_each_time():
    again = bench_of("fast").run(nominal_variant())
    for channel, values in bench_of("fast").readings(again, nominal_variant()).items():
        assert np.array_equal(values, read("fast", nominal_variant())[channel])


def test_columns_are_sensed_as_each_alone():
    predictor, variant = (
        bench_of("fast"),
        nominal_variant().with_effect(CATALOGUE["sensor_gain"].on("load_flow")(gain_error=0.2)),
    )
    trajectory = course_of("fast", nominal_variant())
    columns = np.column_stack([np.sin(50.0 * predictor.times), predictor.times])
    together = predictor.apply_sensors({"load_flow": columns}, trajectory, variant)["load_flow"]
    alone = [predictor.apply_sensors({"load_flow": column}, trajectory, variant)["load_flow"] for column in columns.T]
    assert together == pytest.approx(np.column_stack(alone), abs=1e-12)
    perfect = predictor.apply_sensors({"spool_position": columns}, trajectory, variant)["spool_position"]
    assert np.array_equal(perfect, columns[:: predictor.oversampling])


def test_the_course_is_kept_on_both_grids():
    predictor, trajectory = bench_of("fast"), course_of("fast", nominal_variant())
    assert np.array_equal(trajectory.states, trajectory.fine[:: predictor.sensor_oversampling])
    oil = evaluate(predictor.scenario.oil_temperature, predictor.fine_times)
    assert trajectory.oil == pytest.approx(oil, abs=0.2)


def test_a_course_is_put_on_another_grid_as_if_it_had_been_run_there():
    predictor, fine = bench_of("fast"), course_of("fast", nominal_variant())
    without_oversampling = predictor.without_oversampling()
    preliminary = without_oversampling.run(nominal_variant())
    for put, own in ((without_oversampling.on_grid(fine), preliminary), (predictor.on_grid(preliminary), fine)):
        for name in ("states", "knots", "fine", "oil"):
            assert np.array_equal(getattr(put, name), getattr(own, name)), name


# ---------------------------------------------------------------- failures


def test_a_clearance_that_closes_is_named():
    impossible = ModelVariant(replace(small_session().valve, radial_clearance=1e-9))
    with pytest.raises(InputError, match="clearance"):
        bench_of("fast").run(impossible)


def test_a_record_that_starts_beyond_the_spools_stop_starts_at_rest_on_it():
    predictor = bench_of("slow")
    inputs = predictor.inputs.copy()
    inputs[:, 0] = 0.014
    pushed = replace(predictor, inputs=inputs)
    switched_off = nominal_variant().with_effect(neutral(CATALOGUE["spool_coulomb_friction"]))
    plain, with_neutral = (pushed.run(variant).states[0, :6] for variant in (nominal_variant(), switched_off))
    stroke = nominal_variant().valve.spool_stroke
    assert stroke < plain[4] < 1.05 * stroke
    assert plain == pytest.approx(with_neutral, rel=1e-6, abs=1e-9)


def test_dimensions_that_a_record_makes_impossible_name_the_record():
    with pytest.raises(InputError, match="record fast: .*clearance"):
        bench_of("fast").run(ModelVariant(replace(small_session().valve, radial_clearance=1e-9)))


def test_a_run_that_fails_says_which_record_when_and_what_to_ask():
    options = replace(OPTIONS, predictor=PredictorOptions(most_steps=3, steps_per_point=0))
    with pytest.raises(SolveError, match=r"record fast.*t = [0-9.e-]+ s.*session\.toml"):
        replace(bench_of("fast"), options=options).run(nominal_variant())


def test_a_run_that_fails_says_in_which_record_when_and_in_which_state():
    predictor = bench_of("fast")
    few = replace(predictor.options, predictor=replace(predictor.options.predictor, most_steps=2, steps_per_point=0))
    told = r"record fast.*: the simulation failed at t = \S+ s in \w+ .*: more than 2 steps.*Is the valve of"
    with pytest.raises(SolveError, match=told):
        replace(predictor, options=few).run(nominal_variant())


def test_a_valve_without_rest_says_which_record(monkeypatch):
    predictor = bench_of("fast")
    spoiled = replace(predictor, inputs=np.full_like(predictor.inputs, np.nan))
    monkeypatch.setattr("valvesim.valve.equilibrium.solve_rest", lambda *_: type("Rest", (), dict.fromkeys(
        ("armature_angle", "nozzle_pressure_1", "nozzle_pressure_2", "spool_position"), 0.0)))  # fmt: skip
    with pytest.raises(SolveError, match="record fast.*no rest"):
        spoiled.run(nominal_variant().with_effect(FRICTION))
