"""Plans of tests: what is promised follows from the formulas of the diagnosis; files, structure, session folder."""

import json
from dataclasses import replace

import numpy as np
import pytest

from valvesim.diagnosis.experiments import experiment_values
from valvesim.diagnosis.options import DEFAULT_DIAGNOSIS, SelectionOptions
from valvesim.diagnosis.power import asked_difference, detected_amplitude, separated_share, separation_power
from valvesim.errors import InputError
from valvesim.identification.session import Sensor
from valvesim.identification.session_toml import load_session
from valvesim.io import read_toml
from valvesim.measurement.recording import read_recording
from valvesim.planning.bench import AddedSensor
from valvesim.planning.options import DEFAULT_PLANNING
from valvesim.planning.outlook import (
    CandidateScores,
    ParameterOutlook,
    cause_groups,
    level_of,
    outlook,
    parameter_outlooks,
)
from valvesim.planning.plan import plan_tests
from valvesim.planning.plan_toml import load_plan, read_plan
from valvesim.planning.selection import Chooser, Goal, SensorAdvice, _cheapest
from valvesim.planning.sensitivities import planned_sensitivities
from valvesim.planning.session_folder import write_session_folder
from valvesim.planning.structure import StructuralModel, isolability, overdetermined, structural_model
from valvesim.reports.plan import parameter_row
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import THERMAL_NODES

PLAN = """
title = "friction or play"
[thermal]
isothermal = true
[sensors.spool_position]
noise = "1 um"
[added_sensors.load_flow]
noise = "0.05 L/min"
cost = 2
[bench]
rate = "500 Hz"
setup = "10 s"
tests = ["slow small triangle about null"]
[[tests]]
name = "sine"
duration = "0.4 s"
command.current = { sine = { amplitude = "4 mA", frequency = "10 Hz" } }
[aim]
causes = ["spool_coulomb_friction", "feedback_ball_backlash", "spool_lap"]
parameters.feedback_rod_stiffness = "2 %"
"""


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found(plan_file):
    return plan_tests(plan_file)


@pytest.fixture(scope="module")
def bench(found):
    return found.bench


@pytest.fixture(scope="module")
def planned(found):
    return found.planned


# ---------------------------------------------------------------- the plan


def test_a_plan_names_the_tests_the_causes_and_what_is_missed(found):
    labels = [cause.label for cause in found.outlook.causes]
    assert labels == ["spool_coulomb_friction", "feedback_ball_backlash", "spool_lap"]
    friction = found.outlook.causes[0]
    assert friction.limit < friction.size and friction.power > DEFAULT_PLANNING.choice.power
    lap = found.outlook.causes[2]
    assert lap.limit is None and lap.power < 0.01  # the spool's position does not tell where its lands are
    missed = {(goal.kind, goal.of) for goal in found.selection.missed}
    assert ("detect", "spool_lap") in missed and ("detect", "spool_coulomb_friction") not in missed
    (advice,) = found.selection.advice
    assert found.selection.added == advice and advice.channels == ("load_flow",)
    assert advice.cost == 2.0 and Goal(kind="detect", of="spool_lap") in advice.reached
    assert found.with_added.causes[2].power > DEFAULT_PLANNING.choice.power


def test_what_is_asked_goes_by_the_options(bench, planned, found):
    sure = replace(DEFAULT_PLANNING, choice=replace(DEFAULT_PLANNING.choice, power=1.1))
    chooser = Chooser(bench, planned, sure)
    assert not any(goal.kind == "detect" for goal in chooser.reached([16] * 2, chooser.channels()))
    gram = planned.gram([1] * len(planned.experiments), ("spool_position",))
    options = replace(DEFAULT_PLANNING.outlook, hardly=0.0, known=0.0)
    told = {one.verdict for one in parameter_outlooks(planned, gram, options=options)}
    assert told <= {"hardly", "unseen", "combination"} and "hardly" in told


def test_no_test_of_the_list_can_be_left_out_or_run_less(bench, planned, found):
    chooser = Chooser(bench, planned, DEFAULT_PLANNING)
    repeats, channels = found.selection.repeats, chooser.channels()
    reached = chooser.reached(repeats, channels)
    assert reached == chooser.reached([16] * len(repeats), channels)
    for k, n in enumerate(repeats):
        if n:
            less = [0 if j == k else m for j, m in enumerate(repeats)]
            assert not any(less) or not chooser.reached(less, channels) >= reached


def test_more_tests_repeats_or_sensors_never_show_less(bench, planned):
    rng = np.random.default_rng(0)
    for _ in range(2):
        few = rng.integers(0, 3, len(planned.experiments))
        more = few + rng.integers(0, 2, len(few))
        for channels in (("spool_position",), ("spool_position", "load_flow")):
            choices = ((few, channels), (more, channels), (few, ("spool_position", "load_flow")))
            judged = [CandidateScores(planned, _scores(planned, n, c), 4.0, DEFAULT_PLANNING) for n, c in choices]
            limits = [np.array([one.limit(k) for k in range(len(planned.candidates))]) for one in judged]
            assert (limits[1] <= limits[0] * (1 + 1e-6)).all() and (limits[2] <= limits[0] * (1 + 1e-6)).all()


def _scores(planned, repeats, channels):
    from valvesim.identification.projection import project

    return project(planned.gram(list(repeats), channels), 0, len(planned.candidates))


def test_parameters_are_known_as_the_fisher_information_says(planned):
    gram = planned.gram([1] * len(planned.experiments), ("spool_position",))
    p = gram.parameters
    covariance = np.linalg.inv(gram.total[1 : 1 + p, 1 : 1 + p] + np.eye(p))
    found = {one.name: one for one in parameter_outlooks(planned, gram, options=DEFAULT_PLANNING.outlook)}
    for k, parameter in enumerate(planned.nominal.parameters):
        if parameter.sensor is None:
            expected = np.sqrt(covariance[k, k]) * parameter.deviation
            assert found[parameter.name].posterior == pytest.approx(expected, rel=1e-6)
    assert found["coil_resistance"].verdict == "unseen"  # driven by current
    assert found["port_flow_coefficient"].verdict == "unseen"  # without the flow


@pytest.mark.slow
def test_a_smaller_noise_lowers_every_limit(bench, planned):
    quiet = replace(bench, sensors=tuple(replace(s, noise=s.noise / 4.0) for s in bench.sensors))
    finer = planned_sensitivities(quiet)
    repeats = [1] * len(planned.experiments)
    for one, other in zip(*(outlook(p, bench.aim, repeats, ("spool_position",)).causes for p in (planned, finer)),
                          strict=True):  # fmt: skip
        assert other.limit is None or one.limit is None or other.limit < one.limit


# ---------------------------------------------------------------- power


def test_what_is_told_apart_nine_times_in_ten_has_that_power():
    options = SelectionOptions()
    rng = np.random.default_rng(1)
    for _ in range(200):
        whole = 10.0 ** rng.uniform(-1.0, 2.0)
        left = whole * rng.uniform(0.0, 1.0)
        share = separated_share(whole, left, 0.0, options=options)
        if np.isfinite(share):
            asked = asked_difference((share * whole) ** 2, 0.0, options=options)
            assert separation_power(share * left, asked) == pytest.approx(0.9, abs=1e-3)
        else:
            assert left <= 0.2 * whole  # of a twentieth of what it explains, no size is enough
    assert separated_share(1.0, 0.0, 0.0, options=options) == np.inf
    assert detected_amplitude(2.0, 0.1, 3.0) == pytest.approx(0.1 * 4.2816 / 2.0)


# ---------------------------------------------------------------- structure


TOY = {"e1": {"x1", "x2"}, "e2": {"x2", "f1"}, "e3": {"x1", "f2"}, "e4": {"x1"}, "e5": {"x2"},
       "n1": {"f1"}, "n2": {"f2"}, "free": {"x3", "x4"}}  # fmt: skip


def test_the_overdetermined_part_and_isolability_of_a_small_model():
    toy = {name: frozenset(own) for name, own in TOY.items()}
    assert overdetermined(toy) == frozenset(toy) - {"free"}
    names, found = isolability(StructuralModel(toy, {"f1": "n1", "f2": "n2"}))
    assert names == ("f1", "f2") and found.all()
    less = {name: own for name, own in toy.items() if name not in ("e4", "e5")}
    _, found = isolability(StructuralModel(less, {"f1": "n1", "f2": "n2"}))
    assert found.diagonal().all() and not found[0, 1] and not found[1, 0]


def test_more_sensors_isolate_no_less_in_structure():
    effects = {name: effect for name, effect in CATALOGUE.items() if effect.reading is None}
    before = None
    for channels in (
        ["spool_position"],
        ["spool_position", "load_flow"],
        ["spool_position", "load_flow", "nozzle_pressure_1", "nozzle_pressure_2", "armature_angle"],
    ):
        names, matrix = isolability(structural_model(Valve(), channels, effects))
        now = {(a, b) for a, row in zip(names, matrix, strict=True) for b, yes in zip(names, row, strict=True) if yes}
        assert before is None or before <= now
        before = now
    assert ("spool_lap", "spool_coulomb_friction") in before


# ---------------------------------------------------------------- the session folder


@pytest.mark.slow
def test_the_command_plans(plan_file, tmp_path, call, found):
    code, out, err = call("plan", plan_file, "-o", tmp_path / "out")
    assert code == 0, err
    assert "feedback_ball_backlash" in out and "goals more with the sensor load flow (cost 2)" in out
    folder = tmp_path / "out"
    assert {"plan.html", "plan.json", "isolability.png", "session"} <= {path.name for path in folder.iterdir()}


def test_the_session_folder_is_a_session_once_its_records_are_there(plan_file, tmp_path, found):
    told = json.loads(found.to_json(tmp_path / "plan.json").read_text())
    assert told["duration"] == found.selection.duration and told["added"]["channels"] == ["load_flow"]
    folder = tmp_path
    write_session_folder(found, read_toml(plan_file)[1], folder)
    rng = np.random.default_rng(0)
    for path in (folder / "commands").iterdir():
        command = read_recording([path], ("current", "oil_temperature", "supply_pressure", "load_pressure"))
        spool = 4e-2 * command.values["current"] + 1e-6 * rng.normal(size=len(command.time))
        rows = zip(*(column.tolist() for column in (command.time, command.values["current"], spool)), strict=True)
        text = "".join(f"{t!r},{i!r},{x!r}\n" for t, i, x in rows)
        (folder / "session" / path.name).write_text("time [s],current [A],spool_position [m]\n" + text)
    session = load_session(folder / "session")
    assert len(session.training) == len(found.tests) and session.sensors["spool_position"].noise == 1e-6
    experiment = found.tests[0].experiment
    record = session.training[0]
    expected = experiment_values(found.bench.session, experiment)["current"]
    assert record.values["current"] == pytest.approx(expected, abs=2e-9 * np.max(np.abs(expected)))


# ---------------------------------------------------------------- plan files that make no sense


def test_with_thermometers_at_the_parts_no_figure_of_their_heat_paths_is_left_open(tmp_path):
    ramp = {"start_value": "20 degC", "end_value": "40 degC", "rate": "10 degC/s"}
    oil = {"oil_temperature": {"ramp": ramp}}
    warming = {"name": "w", "duration": "2 s", "command": {"current": "1 mA"}} | oil
    table = {"sensors": {"spool_position": {"noise": "0.01 um"}}, "bench": {"rate": "50 Hz", "tests": []},
             "tests": [warming], "aim": {"causes": ["spool_lap"]}}  # fmt: skip
    shown = []
    for thermometers in ([], list(THERMAL_NODES)):
        plan = read_plan(tmp_path, table | {"bench": table["bench"] | {"thermometers": thermometers}})
        planned = planned_sensitivities(plan)
        names = [p.name for p in planned.nominal.parameters]
        own = [1 + k for k, name in enumerate(names) if name.startswith("thermal.")]
        G = planned.gram([1] * len(planned.experiments), ["spool_position"]).total
        shown.append(float(np.max(np.diag(G)[own])))
    assert shown[0] > 1.0 and shown[1] < 1e-12 * shown[0]


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"sensors": {}}, "sensors: a bench needs sensors"),
        ({"sensors": {"spool_position": {}}}, "sensors.spool_position: its noise is missing"),
        ({"sensors": {"spool": {"noise": "1 um"}}}, "sensors: unknown output channel 'spool'"),
        ({"added_sensors": {"spool_position": {"noise": "1 um"}}}, "added_sensors.spool_position: the bench has it"),
        ({"added_sensors": {"load_flow": {"noise": "1 L/min", "cost": 0}}}, "added_sensors.load_flow.cost: expected a"),
        ({"added_sensors": {"load_flow": {"noise": "1 bar"}}}, "added_sensors.load_flow.noise: 'bar' has the wrong"),
        ({"records": []}, "records: belongs to a session that was measured"),
        ({"bench": {"rate": "0 Hz"}}, "bench.rate: '0 Hz' must be positive"),
        ({"bench": {"rate": "5e+14 Hz"}}, "bench.rate = 5e+14 Hz is above 100000 Hz"),
        ({"bench": {"oil_temperature": ["60 degC", "20 degC"]}}, "bench.oil_temperature: expected one temperature"),
        ({"bench": {"tests": ["slow triangle"]}}, "bench.tests: unknown test 'slow triangle'"),
        ({"bench": {"thermometers": ["lid"]}}, "bench.thermometers: unknown part 'lid'"),
        ({"bench": {"command": "force"}}, "bench.command: unknown command 'force'"),
        ({"bench": {"command": {}}}, "bench.command: unknown command"),
        ({"tests": {}}, "tests: expected [[tests]]"),
        ({"tests": [{"name": "a"}]}, "tests.1: a test needs a duration and a command"),
        ({"tests": [{"name": "a", "duration": "1 ms", "command": {"current": "1 mA"}}]}, "tests.1.duration: 1 sampl"),
        ({"tests": [{"name": "a", "duration": "1 s", "command": {"voltage": "1 V"}}]}, "tests.1.command: give command"),
        ({"tests": [{"name": "a", "duration": "1 s", "command": {"current": "-21 mA"}}]},
         "tests.1.command.current: 21 mA is beyond 2 times the rated 10 mA"),
        ({"aim": {"causes": ["friction"]}}, "aim.causes: unknown cause 'friction'"),
        ({"aim": {"causes": ["nozzle_erosion"], "sizes": {"spool_lap": "1 um"}}}, "aim.sizes.spool_lap: is not among"),
        ({"aim": {"sizes": {"spool_lap": "0 mm"}}}, "aim.sizes.spool_lap: '0 mm' is where the effect vanishes"),
        ({"aim": {"sizes": {"spool_lap": "1 N"}}}, "aim.sizes.spool_lap: 'N' has the wrong dimension"),
        ({"aim": {"parameters": {"null_gp": "1 %"}}}, "aim.parameters: unknown valve parameter 'null_gp'"),
        ({"aim": {"isolate": 1}}, "aim.isolate: expected true or false"),
        ({"plan": 1}, "session: unknown key 'plan'"),
    ],
)  # fmt: skip
def test_a_plan_that_makes_no_sense_is_refused(tmp_path, changed, message):
    table = {"sensors": {"spool_position": {"noise": "1 um"}}, **changed}
    with pytest.raises(InputError) as caught:
        read_plan(tmp_path, table)
    assert str(caught.value).startswith(message)


def test_a_plan_file_is_refused_with_its_line(tmp_path):
    (tmp_path / "p.toml").write_text("[sensors.spool_position]\nnoise = '1 bar'\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_plan(tmp_path / "p.toml")
    assert str(caught.value).startswith(f"{tmp_path / 'p.toml'}, line 2: sensors.spool_position.noise: 'bar'")


def test_every_cause_of_the_catalogue_is_sought_where_none_is_named(bench, planned):
    level = level_of(planned, _scores(planned, [1] * len(planned.experiments), ("spool_position",)),
                     options=DEFAULT_DIAGNOSIS)  # fmt: skip
    assert 3.0 < level < 5.0
    aim = replace(bench.aim, causes=(), parameters={})
    labels = [one.label for one in outlook(planned, aim, [1] * len(planned.experiments), ("spool_position",)).causes]
    assert set(labels) <= set(cause_groups(planned.candidates)) and "nozzle_erosion[side=1]" in labels


def test_the_cheapest_sensors_together_are_found():
    costs = {"a": 1.0, "b": 2.0, "c": 2.5, "d": 6.0}
    sensors = [AddedSensor(sensor=Sensor(name, "m"), cost=cost) for name, cost in costs.items()]
    goals = {name: Goal(kind="detect", of=name) for name in "xyz"}
    shown = {"a": "x", "b": "xy", "c": "z", "d": "xy"}

    def brings(some):
        names = tuple(one.sensor.channel for one in some)
        reached = tuple(goals[g] for g in sorted(set("".join(shown[name] for name in names))))
        return SensorAdvice(channels=names, cost=sum(one.cost for one in some), reached=reached)

    added = _cheapest(sensors, [brings((one,)) for one in sensors], brings)
    assert added.channels == ("b", "c") and added.cost == 4.5 and len(added.reached) == 3
    assert _cheapest(sensors[:2], [brings((one,)) for one in sensors[:2]], brings).channels == ("b",)
    assert _cheapest([], [], brings) is None


def test_figures_of_a_plan_are_written_in_units_that_people_use():
    mmf = ParameterOutlook(name="polarization_mmf", unit="A", nominal=2980.0, prior=29.8, posterior=26.2,
                           verdict="combination", partners=())  # fmt: skip
    assert parameter_row(mmf)[1:4] == ("2980 A", "29.8 A", "26.2 A")
