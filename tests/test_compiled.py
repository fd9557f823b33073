"""The traced and compiled model against `Model.rhs`, finite differences and the oracle, and where its code is kept."""

import functools
import sys
import tempfile
from dataclasses import replace

import numpy as np
import oracle
import pytest
from elimination import step_functions
from hypothesis import given, settings
from hypothesis import strategies as st

from valvesim.channels import INPUT_CHANNELS, Inputs, State
from valvesim.errors import ValidityWarning
from valvesim.inputs import Constant, Sine, Step, Table, merge
from valvesim.simulation.scenario import Scenario
from valvesim.simulation.scenario_toml import load_scenario
from valvesim.simulation.temperature_knots import KNOT_ERROR, temperature_knots
from valvesim.solver import codegen as compiled
from valvesim.solver import rodas5p as rosenbrock
from valvesim.solver.codegen import compile_model, derivatives
from valvesim.solver.straight_line import as_python
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.effect import Effect, Parameter, Ports
from valvesim.valve.equations import NOMINAL, Model, VoltageDrive
from valvesim.valve.equilibrium import static_solution
from valvesim.valve.parameters import Valve, reference_valve

valve = reference_valve()
sharp = Valve(transition_pressure=1.0)  # roots of the oracle
C20 = valve.at(PartTemperatures.uniform(20.0))
U_SCALE = np.array([channel.scale for channel in INPUT_CHANNELS])


ACTING = tuple(e for e in CATALOGUE.values() if e.balance is not None)


def active_effects(only=None):
    """Every effect with a balance, at a tenth of its largest amplitude; all but `only` neutral where one is named.

    A pinch is felt from 4 um on: the clearance of the reference valve, 3 um, is where the default of it has its kink.
    """
    off_kink = {"spool_thermal_pinch": {"free_clearance": 4e-6}}
    return tuple(
        e(
            **{e.amplitude.name: 0.1 * e.amplitude.bounds[1] if only in (None, e.name) else e.amplitude.neutral},
            **off_kink.get(e.name, {}),
        )
        for e in ACTING
    )


FULL = Model(drive=VoltageDrive(), effects=ACTING)
CASES = {
    "nominal": (NOMINAL, ()),
    "voltage": (Model(drive=VoltageDrive()), ()),
    "all effects": (Model(effects=FULL.effects), active_effects()),
    "voltage and all effects": (FULL, active_effects()),
}
ALL = "voltage and all effects"
WAYS = [("nominal", "compiled"), (ALL, "printed"), pytest.param(ALL, "compiled", marks=pytest.mark.slow)]
"""The code of a model as it is printed, run by Python, and compiled: what takes long for every term there is."""


def flat(name, temperature=20.0):
    model, active = CASES[name]
    return np.array(model.flat_coefficients(valve.at(PartTemperatures.uniform(temperature)), active), dtype=float)


def random_point(model, seed):
    """State and inputs away from kinks: open nozzles, spool off its stops, every memory within its range."""
    rng = np.random.default_rng(seed)
    low, high = State(-3e-3, -3.0, 2e6, 2e6, 1e-5, 1e-3), State(3e-3, 3.0, 19e6, 19e6, 4e-4, 0.3)
    extra = len(model.state_channels) - 6
    state = np.append(rng.uniform(low, high), rng.uniform(-0.8, 0.8, extra))
    state *= np.where(rng.random(len(state)) < 0.5, -1, 1) * np.array([1, 1, 0, 0, 1, 1, *[1] * extra]) + np.array(
        [0, 0, 1, 1, 0, 0, *[0] * extra]
    )
    state[6:] *= [channel.scale for channel in model.state_channels[6:]]
    command = 1e-2 if model.drive.command_unit == "A" else 6.0
    inputs = np.array([rng.uniform(0.1, 1) * command, rng.uniform(0.1, 1.0), 21e6, 0.5e6, rng.uniform(-8e6, 8e6)])
    return state, inputs


def differences(f, at, size):
    """Central differences of a vector function, one column an argument."""
    columns = []
    for k, scale in enumerate(size):
        step = np.zeros(len(at))
        step[k] = 1e-5 * scale
        columns.append((f(at + step) - f(at - step)) / (2e-5 * scale))
    return np.array(columns).T


def close(exact, numeric, rates, size):
    """Largest difference of two Jacobians (rates, arguments), as a share of each rate's largest dependence."""
    weight = np.abs(numeric * size).max(axis=1, keepdims=True) + 1e-12 * np.abs(rates)[:, None] + 1e-30
    return np.abs((exact - numeric) * size / weight).max()


# ---------------------------------------------------------------- traced derivatives


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("seed", range(6))
def test_traced_derivatives_match_finite_differences(name, seed):
    model, _ = CASES[name]
    c = flat(name, temperature=20.0 + 40.0 * seed)
    state, inputs = random_point(model, seed)
    exact = derivatives(model)(state, inputs, c)
    rates = np.array(model.rhs(state, inputs, c))

    def rhs(x=state, u=inputs, p=c):
        return np.array(model.rhs(x, u, p), dtype=float)

    sizes = (
        np.array([channel.scale for channel in model.state_channels]) * 0.1,
        U_SCALE * 0.1,
        np.where(c == 0.0, 1e-5, np.abs(c)),  # zero: the overlap of the lands, m
    )
    changes = (lambda x: rhs(x=x), lambda u: rhs(u=u), lambda p: rhs(p=p))
    for matrix, change, at, size in zip(exact, changes, (state, inputs, c), sizes, strict=True):
        assert matrix.shape == (len(state), len(at))
        assert close(np.array(matrix), differences(change, at, size), rates, size) < 1e-5


def test_traced_derivatives_are_named_by_their_argument():
    function = derivatives(NOMINAL)
    assert [function.name_out(k) for k in range(3)] == ["by_state", "by_inputs", "by_coefficients"]
    assert derivatives(NOMINAL) is function  # kept


def test_open_loop_modes_are_those_of_the_oracle_and_about_the_published():
    rest = static_solution(sharp, current=2e-3)
    state = [rest.armature_angle, 0.0, rest.nozzle_pressure_1, rest.nozzle_pressure_2, rest.spool_position, 0.0]
    state = np.array(state, dtype=float)
    c = sharp.at(PartTemperatures.uniform(20.0))._replace(bulk_modulus_at_zero=1.63e9, bulk_modulus_slope=0.0)
    A = np.array(derivatives(NOMINAL)(state, Inputs(2e-3, 0.0, 21e6, 0.5e6, 0.0), c)[0])
    theirs = oracle.coefficients(*[20.0] * 5)
    B = differences(
        lambda x: np.array(oracle.derivatives(x, 2e-3, theirs, c.density, 1.63e9, 1.63e9)), state,
        [channel.scale for channel in NOMINAL.state_channels],
    )  # fmt: skip
    modes = np.sort_complex(np.linalg.eigvals(A))
    assert np.abs(modes / np.sort_complex(np.linalg.eigvals(B)) - 1).max() < 1e-6
    # model.md section 5, "about", rad/s at 20 °C and 2 mA with beta 1.63e9 Pa; the oracle itself is up to 10 % away
    for published in (-3041 + 50600j, -2806 + 3370j, -1056, -5931):
        assert np.abs(modes - published).min() < 0.11 * abs(published)


# ---------------------------------------------------------------- compiled functions


@functools.cache
def code(name, way):
    """`derivative` and `jacobian` of a model."""
    model, _ = CASES[name]
    if way == "compiled":
        machine = compile_model(model)
        return machine.derivative, machine.jacobian
    equations = compiled.print_equations(model)
    printed = as_python(equations.lines)

    def derivative(y, u, c, out):
        prepared = np.empty(equations.coefficients)
        printed["prepare"](c, prepared)
        printed["rates"](y, u, prepared, out)

    def jacobian(y, u, c, out):
        prepared, n = np.empty(equations.coefficients), len(y)
        printed["prepare"](c, prepared)
        out[:] = 0.0
        printed["linearise"](y, u, np.zeros(len(u)), prepared, 0.0 * prepared, np.empty(n), out, np.empty(n))

    return derivative, jacobian


def values(name, way, state, inputs, c):
    """Rates and Jacobian in SI from the scaled functions."""
    derivative, slope = code(name, way)
    scale = np.array([channel.scale for channel in CASES[name][0].state_channels])
    rates, jacobian = np.empty(len(scale)), np.empty((len(scale), len(scale)))
    derivative(state / scale, inputs, c, rates)
    slope(state / scale, inputs, c, jacobian)
    return rates * scale, jacobian * scale[:, None] / scale


@pytest.mark.parametrize("name, way", WAYS)
@pytest.mark.parametrize("seed", range(10))
def test_derivative_of_the_code_is_that_of_the_model(name, way, seed):
    model, _ = CASES[name]
    state, inputs = random_point(model, seed)
    c = flat(name)
    rates, _ = values(name, way, state, inputs, c)
    assert rates == pytest.approx(np.array(model.rhs(state, inputs, c), dtype=float), rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("way", ["printed", pytest.param("compiled", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [e.name for e in ACTING])
def test_each_effect_in_the_code_of_all_acts_as_in_a_model_of_its_own(name, way):
    (effect,) = (e for e in ACTING if e.name == name)
    own = Model(drive=VoltageDrive(), effects=(effect,))
    c20 = valve.at(PartTemperatures.uniform(20.0))
    state, inputs = random_point(FULL, 7)
    everything, alone = active_effects(name), [a for a in active_effects(name) if a.effect is effect]
    c = np.array(FULL.flat_coefficients(c20, everything), dtype=float)
    rates, _ = values(ALL, way, state, inputs, c)
    names = [channel.name for channel in FULL.state_channels]
    at = [names.index(channel.name) for channel in own.state_channels]
    expected = np.array(own.rhs(state[at], inputs, own.flat_coefficients(c20, alone)), dtype=float)
    assert rates[at] == pytest.approx(expected, rel=1e-8, abs=1e-9)
    nominal = np.array(Model(drive=VoltageDrive()).rhs(state[:7], inputs, c20), dtype=float)
    assert not np.allclose(rates[:7], nominal, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("name, way", WAYS)
@pytest.mark.parametrize("seed", range(10))
def test_jacobian_of_the_code_is_the_traced_one(name, way, seed):
    model, _ = CASES[name]
    state, inputs = random_point(model, seed)
    c = flat(name)
    _, jacobian = values(name, way, state, inputs, c)
    traced = np.array(derivatives(model)(state, inputs, c)[0])
    scale = np.array([channel.scale for channel in model.state_channels])
    assert close(jacobian, traced, np.zeros(len(state)), scale) < 1e-10


@pytest.mark.parametrize("name, way", WAYS)
@pytest.mark.parametrize("beyond", [-1.0, 1.0])
def test_derivative_of_the_code_is_that_of_the_model_on_its_stops(name, way, beyond):
    model, _ = CASES[name]
    state, inputs = random_point(model, 3)
    state[0], state[4] = beyond * 4.5e-3, beyond * 4.3e-4
    c = flat(name)
    rates, jacobian = values(name, way, state, inputs, c)
    assert rates == pytest.approx(np.array(model.rhs(state, inputs, c), dtype=float), rel=1e-8, abs=1e-9)
    scale = np.array([channel.scale for channel in model.state_channels])
    numeric = differences(lambda x: np.array(model.rhs(x, inputs, c), dtype=float), state, 0.1 * scale)
    assert close(jacobian, numeric, rates, 0.1 * scale) < 1e-5


@settings(max_examples=10)
@given(st.floats(-9e-3, 9e-3), st.floats(-9e-3, 9e-3))
def test_compiled_run_is_the_plain_run(before, amplitude):
    machine = compile_model(NOMINAL)
    commands = [Sine(offset=before, amplitude=amplitude, frequency=50.0), *(Constant(value=p) for p in (21e6, 5e5, 0))]
    _, intervals = merge(commands, 2e-3)
    knot_times, knots = np.array([0.0, 2e-3]), np.array([flat("nominal"), flat("nominal", 60.0)])
    rest = static_solution(valve, current=before)
    state = [rest.armature_angle, 0.0, rest.nozzle_pressure_1, rest.nozzle_pressure_2, rest.spool_position, 0.0]
    start = (np.array(state, dtype=float) / machine.scale)[:, None]
    t_out = np.linspace(0.0, 2e-3, 5)

    def run(integrate, *functions, rtol, breaks):
        y, clock, out, count = start.copy(), np.array([0.0, 1e-5, 0.0]), np.empty((5, 6, 1)), np.zeros(2, np.int64)
        rows = np.repeat(intervals.rows, len(breaks), axis=0)
        status = integrate(
            *functions, y, clock, 2e-3, breaks, rows, knot_times, knots[:, :, None], t_out, out, rtol,
            np.full(6, 1e-2 * rtol), start, 10_000, count,
        )  # fmt: skip
        assert status == rosenbrock.DONE
        return out, count

    equations = compiled.print_equations(NOMINAL)
    printed = as_python(equations.lines)
    functions = step_functions(6, printed["rates"], printed["linearise"], printed["prepare"])
    same = {"rtol": 1e9, "breaks": np.linspace(0.0, 2e-3, 40, endpoint=False)}  # the same steps
    fast, _ = run(machine.run, **same)
    plain, _ = run(rosenbrock.integrate, *functions, equations.coefficients, True, **same)
    assert fast == pytest.approx(plain, abs=1e-9)  # in scaled states
    own = {"rtol": 1e-5, "breaks": np.zeros(1)}  # steps of its own, which rounding has a say in
    fast, fast_count = run(machine.run, **own)
    plain, plain_count = run(rosenbrock.integrate, *functions, equations.coefficients, True, **own)
    assert fast == pytest.approx(plain, abs=1e-4)
    assert np.abs(fast_count - plain_count).max() <= 1


def test_what_is_computed_ahead_is_as_straight_between_knots_as_the_coefficients():
    scenario = load_scenario("cold_start")
    path, c = temperature_knots(scenario)
    knots = np.stack(np.broadcast_arrays(*c), axis=-1)
    equations = compiled.print_equations(NOMINAL)
    prepare = as_python(equations.lines)["prepare"]
    at, between = np.empty((len(knots), equations.coefficients)), np.empty((len(knots) - 1, equations.coefficients))
    for k, flat_coefficients in enumerate(knots):
        prepare(flat_coefficients, at[k])
    for k in range(len(between)):
        prepare((knots[k] + knots[k + 1]) / 2.0, between[k])
    bend = np.abs(between - (at[1:] + at[:-1]) / 2.0) / np.maximum(np.abs(at).max(axis=0), 1e-300)
    assert len(path.times) > 100 and bend.max() < 3 * KNOT_ERROR


@pytest.mark.parametrize("lag, known", [(0.0, False), (0.2, False), (0.2, True)])
@pytest.mark.parametrize(
    "oil",
    [
        Step(before=20.0, after=90.0, time=0.7),
        Table(times=(0.0, 0.31, 0.77, 2.0), values=(20.0, 90.0, -10.0, 40.0)),
        Sine(offset=40.0, amplitude=20.0, frequency=3.0),
    ],
    ids=["step", "table", "sine"],
)
def test_straight_lines_between_knots_hold_the_coefficients_wherever_a_course_bends(oil, lag, known):
    """Against a path with nine more points between any two knots; also from the knots known without the lag."""
    effects = (CATALOGUE["thermal_lag"](time_constant=lag),) if lag else ()
    scenario = Scenario(duration=2.0, oil_temperature=oil, effects=effects)
    first = temperature_knots(replace(scenario, effects=()))[0].times if known else None
    path, c = temperature_knots(scenario, first=first)
    assert not known or np.isin(first, path.times).all()
    apart, shares = np.flatnonzero(np.diff(path.times) > 0.0), np.linspace(0.0, 1.0, 10)
    finer = (path.times[apart, None] + np.diff(path.times)[apart, None] * shares).ravel()
    _, exact = temperature_knots(scenario, knot_times=finer)
    for line, own in zip(c, exact, strict=True):
        line, own = (np.broadcast_to(values, np.shape(x)) for values, x in ((line, path.times), (own, finer)))
        between = (line[apart, None] + np.diff(line)[apart, None] * shares).ravel()
        assert np.abs(between - own).max() <= 3.0 * KNOT_ERROR * np.abs(own).max()


def test_model_is_compiled_once():
    assert compile_model(NOMINAL) is compile_model(Model())


# ---------------------------------------------------------------- where the code is kept


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A temporary folder of its own, to see what is written there; modules loaded meanwhile are forgotten again."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    known = {name: module for name, module in sys.modules.items() if name.startswith("valvesim_cache")}
    yield folder
    for name in [name for name in sys.modules if name.startswith("valvesim_cache")]:
        del sys.modules[name]
    sys.modules.update(known)


def user_effect(factor, name="own"):
    return Effect(
        name=name, doc="d", location="l", signature="s",
        parameters=(Parameter(name="size", unit="1", doc="size", default=0.0, bounds=(0.0, 1.0), neutral=0.0),),
        balance=lambda s, p, memory: (Ports(spool_force=factor * p.size), ()),
    )  # fmt: skip


def entries(folder):
    return sorted(path.name for path in (folder / "compiled").iterdir() if path.is_dir())


def test_code_is_kept_in_the_named_folder_and_found_again(tmp_path, monkeypatch, temporary):
    folder = tmp_path / "new" / "cache"
    monkeypatch.setenv("VALVESIM_CACHE_DIR", str(folder))
    first = compiled._load(NOMINAL)
    kept = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    monkeypatch.setattr(compiled.machine_code, "object_code", None)  # nothing is compiled again
    again = compiled._load(Model())
    assert first.layout == again.layout and first.addresses.keys() == again.addresses.keys()
    assert len(entries(folder)) == 1
    assert kept == {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert not list(temporary.iterdir())
    monkeypatch.setattr(compiled.cache, "_package_text", lambda: b"an edit of an effect that this model does not have")
    assert compiled._load(NOMINAL).layout == first.layout and len(entries(folder)) == 1


def test_loops_are_kept_and_found_again(tmp_path, monkeypatch, temporary):
    folder = tmp_path / "cache"
    monkeypatch.setenv("VALVESIM_CACHE_DIR", str(folder))
    first, again = (compiled._load_loops.__wrapped__(1) for _ in range(2))
    assert first.__name__ == again.__name__ and len(entries(folder)) == 1
    assert first.run.stats.cache_misses and again.run.stats.cache_hits and not again.run.stats.cache_misses


@pytest.mark.parametrize("below", [pytest.param("", marks=pytest.mark.slow), "below"])
def test_folder_that_cannot_be_written_falls_back_to_memory(tmp_path, monkeypatch, temporary, below):
    file = tmp_path / "file"
    file.write_text("not a folder")
    monkeypatch.setenv("VALVESIM_CACHE_DIR", str(file / below))
    with pytest.warns(ValidityWarning, match="not kept"):
        code = compiled._load(NOMINAL)
    assert file.read_text() == "not a folder" and not list(temporary.iterdir())
    assert all(code.addresses[name] for name in compiled.CALLED_IN_A_STEP)


def test_models_that_differ_have_files_of_their_own(tmp_path, monkeypatch, temporary):
    monkeypatch.setenv("VALVESIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(compiled.machine_code, "object_code", lambda printed: b"")  # nothing is compiled
    monkeypatch.setattr(compiled.machine_code, "load_object_code", lambda printed, code: printed)
    models = [NOMINAL, Model(drive=VoltageDrive()), *(Model(effects=(e,)) for e in ACTING[:3])]
    models += [Model(effects=(user_effect(1.0),)), Model(effects=(user_effect(2.0),))]
    models += [Model(effects=(user_effect(3.0, name="entrained_air"),))]  # not the one of the catalogue
    assert len({compiled._load(model) for model in models}) == len(models) == len(entries(tmp_path / "cache"))


def test_source_is_the_same_text_for_the_same_model():
    # the name of the cached file is its hash: text that varied would be compiled again every time
    assert compiled.source(NOMINAL) == compiled.source(Model())
    assert compiled.source(NOMINAL) != compiled.source(Model(drive=VoltageDrive()))


def test_valve_figures_are_no_part_of_the_compiled_code():
    # one compiled model serves every valve: a wider nozzle changes the coefficients only
    wider = np.array(Valve(nozzle_diameter=0.33e-3).at(PartTemperatures.uniform(20.0)), dtype=float)
    state, inputs = random_point(NOMINAL, 1)
    rates, _ = values("nominal", "compiled", state, inputs, wider)
    assert rates == pytest.approx(np.array(NOMINAL.rhs(state, inputs, wider), dtype=float), rel=1e-8, abs=1e-9)
