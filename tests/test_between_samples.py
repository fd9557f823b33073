"""What inputs do between their samples: told by the readings, fitted where it can be, and no cause for an alarm."""

from dataclasses import replace
from types import SimpleNamespace
from zlib import crc32

import numpy as np
import pytest
from bench_plant import FINE, draw_bench, keep_every_second_sample, write_bench_session
from hidden_plant import _current, draw, write_session
from hypothesis import given
from hypothesis import strategies as st

import valvesim as vs
from valvesim.diagnosis.holdout_gain import _read_with_inputs
from valvesim.identification import nominal_fit
from valvesim.identification.between_samples import (
    EdgeTime,
    Held,
    InputDelay,
    InputShift,
    Smooth,
    Wave,
    added_input,
    added_on_grid,
    command_jumps,
    corners_of,
    deviating,
    deviating_command,
    piecewise_command,
    sampled_edges,
    smooth_command,
    undersampled_share,
)
from valvesim.identification.input_choice import HELD_NAME, are_delays, edge_parameter, input_choices
from valvesim.identification.input_waves import wave_parameters, with_parameters
from valvesim.identification.instrument_errors import input_delays, instrument_errors, is_of_bench
from valvesim.identification.linearised_record import linearise_record
from valvesim.identification.noise_estimation import initial_noise
from valvesim.identification.nominal_fit import (
    _at_nominal,
    _plain_choice,
    fit_nominal,
    has_implausible_delays,
    point_under,
    under_other_inputs,
    with_input_choice,
    with_inputs_reviewed,
)
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS
from valvesim.identification.predictor import ModelVariant, prepare_record
from valvesim.identification.session_toml import load_session
from valvesim.identification.study import prepare_session
from valvesim.inputs import Piecewise, Table, evaluate, piece_value, straight_pieces

TIME = np.arange(400) / 1e3
CHIRP = np.sin(2.0 * np.pi * (TIME + 199.0 * TIME**2 / 2.0))


def applied(deviation, values, amount=1.0, time=TIME):
    """The pieces of a record's samples with a deviation in them."""
    return deviation.apply(straight_pieces(time, values), (time, values), amount)


def value(pieces, times):
    return evaluate(Piecewise(pieces), times)


def test_an_edge_is_where_its_amount_says_and_slopes_go_on_to_it():
    values = np.where(TIME < 0.2, 1.0 + 2.0 * TIME, -3.0 * TIME)
    (edge,) = [EdgeTime("a", "current", int(k)) for k in command_jumps(values, options=OPTIONS)]
    assert edge.after == 199
    for amount in (-4e-4, 0.0, 3e-4):
        pieces, at = applied(edge, values, amount), 0.1995 + amount
        np.testing.assert_allclose(value(pieces, [at - 1e-6, at + 1e-6]), [1.0 + 2.0 * at, -3.0 * at], atol=1e-4)
        np.testing.assert_allclose(value(pieces, TIME), values, atol=1e-12)
    assert np.all(np.diff(applied(edge, values)[1:, 0]) > 0.0)  # held within its interval


@given(st.integers(0, 10_000))
def test_edges_together_are_edges_one_by_one(seed):
    """In any order, next to each other too; one that is applied again takes the place of what it was."""
    dice = np.random.default_rng(seed)
    values = dice.normal(size=400)
    after = dice.choice(np.arange(1, 398) if seed % 2 else np.arange(50, 60), 8, replace=False)
    edges = tuple((EdgeTime("a", "current", int(k)), float(dice.normal(0.0, 2e-4))) for k in after)
    smooth = Smooth("a", "current", tuple(sorted(int(k) for k in after)))
    one_by_one = applied(smooth, values)
    for edge, amount in edges:
        one_by_one = edge.apply(edge.apply(one_by_one, (TIME, values), -amount), (TIME, values), amount)
    np.testing.assert_allclose(deviating((TIME, values), ((smooth, 1.0), *edges)), one_by_one, rtol=1e-12)


def ramps(dice, least, most, duration=0.4):
    """Times and values of corners: ramps, each so many seconds long, between levels that are held."""
    t, u = [0.0], [0.0]
    while t[-1] < duration:
        rise = dice.uniform(least, most)
        t += [t[-1] + dice.uniform(6e-3, 12e-3), t[-1] + rise]
        t[-1] = t[-2] + rise
        u += [u[-1], u[-1] + dice.choice((-1.0, 1.0)) * dice.uniform(0.3, 1.0)]
    return np.array(t), np.array(u)


def off_by(t, u, deviation, values):
    """By how much at most a command lies off one of corners (t, u), but for its first and last samples."""
    fine = np.linspace(TIME[4], TIME[-5], 20 * 391 + 1)
    pieces = straight_pieces(TIME, values) if deviation is None else applied(deviation, values)
    return np.abs(value(pieces, fine) - np.interp(fine, t, u)).max()


@given(st.integers(0, 10_000))
def test_ramps_of_which_two_intervals_are_known_are_known_with_their_corners(seed):
    t, u = ramps(np.random.default_rng(seed), 3.05e-3, 8e-3)
    values = np.interp(TIME, t, u)
    found = corners_of(record_of(values), options=OPTIONS)
    assert off_by(t, u, None, values) > 0.02 and off_by(t, u, found, values) < 0.007  # of those taken to be at a sample
    np.testing.assert_allclose(value(applied(found, values), TIME), values, atol=1e-12)


@given(st.integers(0, 10_000))
def test_a_smooth_command_bends_at_its_corners_and_goes_straight_beside_them(seed):
    t, u = ramps(np.random.default_rng(seed), 3.05e-3, 8e-3)
    values = np.interp(TIME, t, u)
    found, smooth = (of(record_of(values), options=OPTIONS) for of in (corners_of, smooth_command))
    assert set(found.within) <= set(smooth.straight)
    pieces = found.apply(applied(smooth, values), (TIME, values), 1.0)
    assert np.all(np.diff(pieces[1:, 0]) > 0.0)
    k = np.array(found.within)
    within = (TIME[k, None] + np.linspace(0.0, 1e-3, 9)[None, :-1]).ravel()
    np.testing.assert_allclose(value(pieces, within), value(applied(found, values), within), atol=1e-9)


@given(st.floats(0.05, 0.45), st.floats(0.55, 0.95))
def test_a_ramp_of_which_one_interval_is_known_is_known_between_levels(early, late):
    t, u = np.array([0.0, 0.2 + 1e-3 * early, 0.202 + 1e-3 * late, 0.4]), np.array([0.0, 0.0, 1.0, 1.0])
    values = np.interp(TIME, t, u)
    assert off_by(t, u, corners_of(record_of(values), options=OPTIONS), values) < 1e-9


@given(st.integers(0, 10_000))
def test_edges_within_which_samples_were_taken_are_what_they_were_by_their_duration(seed):
    dice = np.random.default_rng(seed)
    at, lasting, share = np.arange(4, 390, dice.integers(5, 9)), dice.uniform(5e-5, 9e-4), dice.uniform(0.1, 0.9)
    start, level = TIME[at] - share * lasting, np.cumsum(dice.choice((-1.0, 1.0), len(at)) * dice.uniform(0.2, 1.0))
    t = np.column_stack([start, start + lasting]).ravel()
    u = np.column_stack([np.append(0.0, level[:-1]), level]).ravel()
    values, fine = np.interp(TIME, t, u), np.linspace(0.0, TIME[-1], 20 * 399 + 1)
    found = sampled_edges(record_of(values), options=OPTIONS)
    assert found.at == tuple(at)
    exact = value(applied(found, values, lasting - 0.5e-3), fine)
    np.testing.assert_allclose(exact, np.interp(fine, t, u), atol=1e-9)
    for amount in (-1.0, 0.0, 1.0):  # held within a step, whatever it is
        assert np.all(np.diff(applied(found, values, amount)[1:, 0]) > 0.0)


@given(st.floats(-4e-3, 4e-3), st.integers(0, 10_000))
def test_an_input_that_was_read_late_has_been_before(late, seed):
    values = np.random.default_rng(seed).normal(size=400)
    pieces, at = applied(InputDelay("a", "supply_pressure"), values, late), np.linspace(0.005, 0.39, 777)
    np.testing.assert_allclose(value(pieces, at), np.interp(at + late, TIME, values), atol=1e-9)
    np.testing.assert_allclose(value(pieces, [-1.0, 1.0]), values[[0, -1]])
    assert pieces[0, 0] <= 0.0 and np.all(np.diff(pieces[:, 0]) >= 0.0)


def test_a_transducer_that_is_slow_is_found_where_its_pressure_moves(stepped):
    _, session = stepped
    first = session.training[0]
    assert input_delays(session, "supply_pressure", OPTIONS) == ()  # it stays
    t, dice = first.time, np.random.default_rng(4)
    sag = np.interp(t, np.linspace(0.0, t[-1], 25), dice.uniform(0.0, 0.2, 25))
    supply = session.valve.supply_pressure * (1.0 - sag)
    record = replace(first, values={**first.values, "supply_pressure": supply})
    session = replace(session, records=(record,))
    (delay,) = input_delays(session, "supply_pressure", OPTIONS)
    predictor = prepare_record(session, record, (), options=OPTIONS)
    true = delay.with_value(ModelVariant(session.valve), 2e-3)
    read = predictor.readings(predictor.run(true), true)
    noise = {name: 3e-3 * np.ptp(column) + 1e-12 for name, column in read.items()}
    noisy = {name: column + dice.normal(0.0, noise[name], len(t)) for name, column in read.items()}
    session = replace(session, records=(replace(record, values={**record.values, **noisy}),))
    nominal = fit_nominal(with_parameters(prepare_session(session), [delay]))
    fitted = dict(zip(nominal.study.nominal.parameters, nominal.fit.point, strict=True))
    found = next(p.at(amount) for p, amount in fitted.items() if isinstance(p.input, InputDelay))
    assert found == pytest.approx(2e-3, abs=3e-4) and is_of_bench(delay)


@given(st.floats(0.0, 200.0), st.floats(20.0, 400.0), st.floats(0.0, 7.0), st.booleans())
def test_a_chirp_has_no_corners_though_some_of_its_samples_are_in_line(first, last, phase, bent):
    """Corners in the fastest part of one made a healthy valve unknown (1080012 of the sixteenth bench set)."""
    turns = first * TIME + (last - first) * TIME**2 / (2.0 * TIME[-1] * (1.0 + bent * np.sin(5.0 * TIME)))
    record = record_of(np.sin(2.0 * np.pi * turns + phase))
    assert abs(last - first) < 20.0 or corners_of(record, options=OPTIONS) is None
    assert abs(last - first) < 20.0 or sampled_edges(record, options=OPTIONS) is None


def test_smooth_commands_jumps_and_levels_have_neither_corners_nor_edges_through_samples():
    jump = np.where(TIME < 0.2, 0.0, 1.0)
    for values in (CHIRP, jump, np.zeros(400), np.round(5.0 * TIME), 3.0 * TIME, CHIRP[:3]):
        record = SimpleNamespace(name="a", command="current", time=TIME[: len(values)], values={"current": values})
        assert corners_of(record, options=OPTIONS) is None and sampled_edges(record, options=OPTIONS) is None


def test_held_samples_stay_and_smooth_ones_go_through_the_samples():
    held = applied(Held("a", "current"), CHIRP)
    np.testing.assert_allclose(value(held, TIME[:-1] + 9e-4), CHIRP[:-1])
    read_back = applied(Held("a", "current", read_back=True), CHIRP)
    np.testing.assert_allclose(value(read_back, TIME[:-1] + 1e-4), CHIRP[1:])
    smooth, fine = applied(Smooth("a", "current"), CHIRP), np.linspace(0.0, TIME[-1], 8 * 399 + 1)
    exact = np.sin(2.0 * np.pi * (fine + 199.0 * fine**2 / 2.0))
    straight = np.abs(np.interp(fine, TIME, CHIRP) - exact).max()
    assert np.abs(value(smooth, fine) - exact).max() < 0.03 * straight  # of a cubic spline: 0.05
    assert np.abs(value(smooth, TIME) - CHIRP).max() < 1e-3 * straight
    for row, following in zip(smooth[1:-2], smooth[2:-1], strict=True):  # no corners
        np.testing.assert_allclose(piece_value(row, following[0]), following[1:3], atol=1e-6)


@given(st.lists(st.tuples(st.floats(1e-6, 1.0), st.floats(-1e3, 1e3)), min_size=2, max_size=20), st.floats(-1.0, 2.0))
def test_pieces_through_points_go_as_a_table_of_them(steps, late):
    t, u = np.cumsum([step for step, _ in steps]) + late, np.array([value for _, value in steps])
    at = np.linspace(t[0] - 0.1, t[-1] + 0.1, 97)
    table = Table(times=tuple(t.tolist()), values=tuple(u.tolist()))
    np.testing.assert_array_equal(value(straight_pieces(t, u), at), evaluate(table, at))
    assert table == Table(times=tuple(t.tolist()), values=tuple(u.tolist())) and not table.points[0].flags.writeable


@pytest.mark.parametrize("frequency", [20.0, 100.0, 200.0])
def test_a_command_that_goes_on_smoothly_keeps_its_amplitude(frequency):
    fine = np.linspace(0.05, 0.35, 30_001)
    exact = np.sin(2.0 * np.pi * frequency * fine + 0.3)
    wave = np.sin(2.0 * np.pi * frequency * TIME + 0.3)
    between = value(applied(Smooth("a", "current"), wave), fine)
    assert abs(between @ exact / (exact @ exact) - 1.0) < 5e-5  # straight lines: 0.13 at 200 Hz, a cubic spline 7e-3


def test_a_piecewise_command_few_samples_between_corners_goes_on_smoothly_too():
    for count in (2, 3, 4, 6, 9):
        time = TIME[:count]
        pieces, fine = applied(Smooth("a", "current"), time**2, time=time), np.linspace(0.0, time[-1], 97)
        assert np.abs(value(pieces, fine) - fine**2).max() < (3e-7 if count < 4 else 1e-15)


def record_of(current):
    moves = bool(np.ptp(current) > 0.0)
    return SimpleNamespace(
        name="a", command="current", time=TIME, values={"current": current}, moves=lambda column: moves
    )


@pytest.mark.parametrize("share, told", [(0.05, True), (0.2, True), (0.35, False), (0.45, False)])
def test_samples_tell_a_sine_up_to_some_share_of_their_rate(share, told):
    """Splines of degree 7 and 5 differ by 2e-4 at a fifth of the rate, by 2 % at 0.35 of it."""
    record = record_of(np.sin(2.0 * np.pi * share * np.arange(400.0) + 0.3))
    assert (undersampled_share(record, options=OPTIONS) == 0.0) == told


@pytest.mark.parametrize("command", [
    np.repeat([1.0, -1.0, 1.0, 0.5], 100), np.repeat(np.tile([1.0, -1.0], 20), 10),
    np.abs((np.arange(400.0) % 80.0) - 40.0), np.full(400, 3e-3),
])  # fmt: skip
def test_jumps_and_corners_are_no_motion_too_fast_for_its_samples(command):
    assert undersampled_share(record_of(command), options=OPTIONS) == 0.0


def test_readings_count_less_where_samples_do_not_tell_a_command(tmp_path):
    """A chirp to 175 Hz logged at 500: readings of a healthy valve are off by several deviations of their noise."""
    case, bench = draw_bench(3_830_002, "none", imperfections=("edges",))
    write_bench_session(case, bench, tmp_path)
    keep_every_second_sample(tmp_path)
    session = load_session(tmp_path)
    told = fit_nominal(prepare_session(session))
    assert told.fit.chi_square < 1.1 * told.fit.rows
    assert any("too fast for its samples" in note and "1500 Hz" in note for note in told.study.session.notes)
    unaware = replace(OPTIONS, input=replace(OPTIONS.input, undersampled=1e9))
    left = fit_nominal(prepare_session(session, options=unaware)).fit
    assert left.chi_square > 1.3 * left.rows


def test_a_command_that_was_read_back_before_it_changed_is_held_from_the_sample_before(tmp_path):
    """As a digital controller logs it: with a hold until the next sample the sensors seem a sample early."""
    case, bench = draw_bench(3_850_000, "none", imperfections=("hold",), duration=0.4)
    write_bench_session(case, bench, tmp_path)
    session = load_session(tmp_path)
    late = tuple(
        replace(record, values=record.values | {record.command: np.roll(record.values[record.command], 1)})
        for record in session.records
    )
    for record in late:
        record.values[record.command][0] = record.values[record.command][1]
    fitted = with_inputs_reviewed(fit_nominal(prepare_session(replace(session, records=late))))
    assert {one.read_back for one, _ in fitted.study.nominal.variant.deviations if isinstance(one, Held)} == {True}
    assert fitted.fit.chi_square < 1.1 * fitted.fit.rows
    assert not has_implausible_delays(fitted.study, fitted.fit.point)


def test_smooth_commands_are_straight_in_the_intervals_of_their_corners():
    pieces = applied(Smooth("a", "current", (0, 199, 200, 398)), CHIRP)
    for k in (0, 199, 200, 398):
        assert value(pieces, TIME[k] + 5e-4) == pytest.approx(CHIRP[k : k + 2].mean(), abs=1e-9)


@pytest.mark.parametrize("column, values", [("supply_pressure", np.full(400, 2e7)), ("current", CHIRP)])
def test_waves_and_shifts_are_added(column, values):
    command = piecewise_command(straight_pieces(TIME, values))
    if isinstance(command, Piecewise):
        command = Table(times=tuple(TIME), values=tuple(values))
    both = ((Wave("a", column, 50.0, 0.3), 0.1), (InputShift("a", column), 1.0))
    moved = deviating_command(command, TIME[-1], both)
    wave = 0.1 * np.cos(2.0 * np.pi * 50.0 * TIME - 0.3)
    np.testing.assert_allclose(evaluate(moved, TIME), values + wave + 1.0, rtol=1e-12)
    assert deviating_command(command, TIME[-1], ()) is command
    for one in (straight_pieces(TIME, values), applied(Smooth("a", column), values)):
        grown = InputShift("a", column, growing=True).apply(one, (TIME, values), 2.0)
        fine = np.linspace(0.0, TIME[-1], 777)
        np.testing.assert_allclose(value(grown, fine) - value(one, fine), 2.0 * fine / TIME[-1], atol=1e-7)
    added = added_input(command, TIME[-1], both, both[1:], TIME)
    np.testing.assert_allclose(added, wave * np.sinc(0.05) ** 2, atol=1e-12)


def test_a_wave_on_a_grid_is_what_its_points_would_add():
    wave, fine = Wave("a", "current", 210.0, 1.1), np.linspace(0.0, TIME[-1], 40_001)
    pieces = straight_pieces(fine, 0.3 * np.cos(2.0 * np.pi * 210.0 * fine - 1.1))
    added = added_on_grid(pieces, straight_pieces(TIME[[0, -1]], np.zeros(2)), TIME)
    np.testing.assert_allclose(added[1:-1], 0.3 * wave.on_grid(TIME)[1:-1], atol=1e-5)


def test_what_is_added_on_a_grid_has_its_area_and_its_moment_whatever_the_grid():
    times = np.linspace(0.0, 0.399, 1 + 399 * 2)
    values = np.where(TIME < 0.2, 0.0, 1.0)
    edge = EdgeTime("a", "current", 199)
    new, old = (applied(edge, values, amount) for amount in (2e-4, -1e-4))
    added = added_on_grid(new, old, times)
    assert np.sum(added) * times[1] == pytest.approx(-3e-4, rel=1e-4)  # of height 1, later by 0.3 ms
    assert np.sum(added * times) / np.sum(added) == pytest.approx(0.19955, abs=1e-6)
    assert np.count_nonzero(np.abs(added) > 1e-9) <= 4


@given(st.integers(0, 10_000), st.integers(2, 30))
def test_what_is_added_on_a_grid_is_the_mean_over_hats_of_any_pieces(seed, count):
    dice, h = np.random.default_rng(seed), 0.01
    times = h * np.arange(21)
    new, old = (np.column_stack([np.sort(dice.uniform(0.0, 0.2, count)), dice.normal(size=(count, 4))])
                for _ in range(2))  # fmt: skip
    new[0, 0] = old[0, 0] = 0.0
    new[0, 2:], old[0, 2:], new[-1, 2:], old[-1, 2:] = 0.0, 0.0, 0.0, 0.0
    new[:, 3:] *= [1e2, 1e4]
    added = added_on_grid(new, old, times)
    shares = (np.arange(4000) + 0.5) / 2000 - 1.0  # of the hat's half width
    for k in range(2, 19):
        at = times[k] + h * shares
        apart = value(new, at) - value(old, at)
        mean = 2.0 * np.mean(apart * (1.0 - np.abs(shares)))  # errs by a jump's part of one of 4000 steps
        assert added[k] == pytest.approx(mean, abs=1e-3 * np.abs(apart).max() + 1e-9)


def test_jumps_are_found_and_fast_commands_have_none():
    noise = np.random.default_rng(0).normal(size=400)
    for values in (CHIRP, CHIRP + 1e-3 * noise, 0.0 * TIME, np.abs(TIME % 0.1 - 0.05)):
        assert not len(command_jumps(values, options=OPTIONS))
    stairs = np.floor(TIME * 20.0) / 20.0
    assert command_jumps(stairs, options=OPTIONS).tolist() == [49, 99, 149, 199, 249, 299, 349]
    for seed in range(5):  # steps that a filter has rounded
        for shape in ("steps", "chirp", "multisine"):
            values = _current(np.random.default_rng(seed), shape, np.arange(1000) / 1e3, 1.0)
            assert not len(command_jumps(values, options=OPTIONS))


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    """(case, session) of a healthy valve under ideal steps and smooth commands between the samples."""
    case, bench = draw_bench(505, "none", imperfections=("edges",), duration=0.3)
    folder = tmp_path_factory.mktemp("stepped")
    write_bench_session(case, bench, folder)
    return case, load_session(folder)


def test_the_linearised_answer_to_the_time_of_an_edge_is_the_simulated_one(stepped):
    _, session = stepped
    record = session.training[1]
    predictor = prepare_record(session, record, (), options=OPTIONS)
    (edge, *_) = [p for p in input_choices(session, options=OPTIONS)[-1].parameters if p.input.record == record.name]
    middle = ModelVariant(session.valve, deviations=((edge.input, 0.0),))
    linear, later = linearise_record(predictor, middle), edge.moved(middle, 0.2)
    exact = linear.simulated_difference(later)
    for name, columns in linear.linear_difference([later]).items():
        assert np.abs(columns[:, 0] - exact[name]).max() < 0.1 * np.abs(exact[name]).max()


def test_readings_tell_how_the_command_went_and_when_it_jumped_and_a_healthy_valve_stays_healthy(stepped):
    case, session = stepped
    nominal = fit_nominal(prepare_session(session))
    assert any("joined smoothly, with edges at fitted times" in note for note in nominal.study.session.notes)
    assert nominal.fit.chi_square < 1.1 * nominal.fit.rows
    fitted = zip(nominal.study.nominal.parameters, nominal.fit.point, strict=True)
    edges = {p.input: p.at(t) for p, t in fitted if p.input}
    run = next(run for run in case.runs if run.shape == "steps" and run.role == "train")
    true = (np.flatnonzero(np.abs(np.diff(run.command)) > 5e-4) + 1) / (1e3 * FINE)
    found = [1e-3 * (edge.after + 0.5) + amount for edge, amount in edges.items() if edge.record == run.name]
    np.testing.assert_allclose(found, true, atol=1e-4)


def test_after_jumps_that_are_too_many_to_be_fitted_noise_counts_as_larger(stepped):
    _, session = stepped
    few = replace(OPTIONS, input=replace(OPTIONS.input, most_edges=1))
    every, one = (
        with_input_choice(prepared, input_choices(session, options=prepared.options)[-1])
        for prepared in (prepare_session(session, options=options) for options in (OPTIONS, few))
    )
    record = next(r for r in session.training if len(command_jumps(r.values[r.command], options=OPTIONS)) > 2)
    first, second, *_ = command_jumps(record.values[record.command], options=OPTIONS)
    own, wider = (prepared.spread[record.name, record.outputs[0]] for prepared in (every, one))
    np.testing.assert_allclose(wider[: second + 1], own[: second + 1])
    assert np.max(wider[second + 1 : second + 5]) > 2.0 * np.max(own) > 0.0
    assert any("more jumps are too many to fit" in note for note in one.session.notes)
    assert not any("too many" in note for note in every.session.notes) and first < second


def test_what_readings_hang_on_the_way_of_the_commands_is_the_same_beside_waves_and_errors_of_instruments(stepped):
    """So that a study in which they go so tells it, see `with_input_choice`."""
    _, session = stepped
    plain = prepare_session(session)
    wave = wave_parameters(session.training, "supply_pressure", 37.0, 1e6)
    more = with_parameters(plain, (*wave, *instrument_errors(session, options=OPTIONS)))
    for choice in input_choices(session, options=OPTIONS)[1:]:
        anew, other = (with_input_choice(prepared, choice) for prepared in (plain, more))
        assert len(other.nominal.parameters) > len(anew.nominal.parameters) and anew.spread
        for key, spread in anew.spread.items():
            np.testing.assert_allclose(other.spread[key], spread, rtol=1e-6, atol=1e-6 * np.max(spread))
        assert with_input_choice(more, choice, other.with_noise({})).spread is other.spread


def test_a_command_that_goes_straight_is_left_as_it_is(tmp_path):
    case, bench = draw_bench(505, "none", duration=0.3)
    write_bench_session(case, bench, tmp_path)
    nominal = fit_nominal(prepare_session(load_session(tmp_path)))
    assert not nominal.study.nominal.variant.deviations and not nominal.study.spread
    assert not any("taken as" in note for note in nominal.study.session.notes)


def test_where_straight_lines_come_near_their_robust_start_goes_on_and_ways_are_asked_for_twice(tmp_path, monkeypatch):
    case, bench = draw_bench(505, "none", duration=0.3)
    write_bench_session(case, bench, tmp_path)
    prepared, asked, robust = prepare_session(load_session(tmp_path)), [], []
    choose, start = nominal_fit.choose_inputs, nominal_fit.robust_start
    monkeypatch.setattr(nominal_fit, "choose_inputs", lambda *args: asked.append(1) or choose(*args))

    def begun(study, fit, *rest, **known):
        robust.append(fit.point)
        return start(study, fit, *rest, **known)

    monkeypatch.setattr(nominal_fit, "robust_start", begun)
    fit_nominal(prepared)
    assert len(asked) == 2 and not robust[0].any() and all(point.any() for point in robust[1:])


def test_a_strong_ripple_of_the_supply_is_fitted_with_its_frequency(tmp_path):
    case, bench = draw_bench(505, "none", imperfections=("ripple",), duration=0.3)
    write_bench_session(case, bench, tmp_path)
    nominal = fit_nominal(prepare_session(load_session(tmp_path)))
    (found,) = {p.input.frequency for p in nominal.study.nominal.parameters if isinstance(p.input, Wave)}
    frequency = next(run.ripple[1] for run in case.runs)
    assert abs(found - frequency) < 0.5 / 0.3  # half of what records of 0.3 s tell apart
    assert nominal.fit.chi_square < 1.2 * nominal.fit.rows


def test_held_commands_are_told_beside_a_ripple_before_anything_is_fitted(tmp_path):
    case, bench = draw_bench(505, "none", imperfections=("hold", "ripple"), duration=0.3)
    write_bench_session(case, bench, tmp_path)
    prepared = prepare_session(load_session(tmp_path))
    choice, start, robust = _plain_choice(prepared)
    assert choice.name == HELD_NAME and start.study.nominal.variant.deviations and robust is None
    far = replace(OPTIONS, fit=replace(OPTIONS.fit, inadequate_ratio=1e-6))  # by robust starts instead
    assert _plain_choice(replace(prepared, options=far))[0].name == HELD_NAME


def test_a_fit_is_looked_at_under_each_other_way_of_its_commands_with_edges_where_they_jump(stepped):
    _, session = stepped
    nominal = _at_nominal(prepare_session(session), {})
    nominal = replace(nominal, fit=replace(nominal.fit, point=nominal.fit.point + 5.0))
    others = under_other_inputs(nominal)
    kinds = [{type(one).__name__ for one, _ in other.study.nominal.variant.deviations} for other in others]
    assert kinds == [{"Held"}, {"Corners"}, {"Corners", "Smooth"}]
    p = len(nominal.fit.point)
    for other, edges in zip(others, (False, True, True), strict=True):
        assert (len(other.fit.point) > p) is edges
        assert np.all(np.abs(other.fit.point) <= OPTIONS.fit.tolerance_deviations)
    beside = replace(nominal.fit, point=np.full(p, -0.5))  # of causes: its figures, and no sensor is late
    delays = are_delays(nominal.study.nominal)
    for other in under_other_inputs(nominal, beside):
        assert np.array_equal(other.fit.point[:p], np.where(delays, 0.0, -0.5)) and delays.any()


def test_a_point_under_another_way_keeps_its_figures_and_takes_the_edges_as_they_were_fitted(stepped):
    _, session = stepped
    nominal = _at_nominal(prepare_session(session), {})
    beside = np.arange(1.0, len(nominal.fit.point) + 1.0)  # of a fit of causes
    for other in under_other_inputs(nominal):
        other = replace(other, fit=replace(other.fit, point=np.full(len(other.fit.point), 0.25)))
        point = point_under(other, nominal, beside)
        assert np.array_equal(point[: len(beside)], beside)
        assert np.all(point[len(beside) :] == 0.25)
        assert np.array_equal(point_under(nominal, other, point), beside)  # and back


def test_commands_of_records_too_slow_to_show_the_valve_s_motion_go_straight(stepped):
    _, session = stepped
    slow = replace(session, records=tuple(replace(one, time=10.0 * one.time) for one in session.records))
    assert [choice.name for choice in input_choices(slow, options=OPTIONS)] == ["straight"]
    mixed = replace(session, records=(*slow.records[:1], *session.records[1:]))
    first = session.records[0].name
    for choice in input_choices(mixed, options=OPTIONS)[1:]:
        told = {one.record for one, _ in choice.deviations} | {p.input.record for p in choice.parameters}
        assert told and first not in told


def test_an_edge_may_be_anywhere_in_its_interval_and_nowhere_else(stepped):
    _, session = stepped
    record = session.training[0]
    parameter = edge_parameter(record, EdgeTime(record.name, record.command, 10))
    assert parameter.at(99.0) == pytest.approx(5e-4) and parameter.at(-99.0) == pytest.approx(-5e-4)
    assert parameter.deviation == pytest.approx(1e-3 / np.sqrt(12.0))


def with_command(case, command_of):
    """A case with other commands, of its times, its runs' largest current each, and dice: repeats have the same."""
    runs = []
    for run in case.runs:
        t, dice = np.arange(len(run.command)) / (1e3 * FINE), np.random.default_rng(crc32(run.command.tobytes()))
        runs.append(replace(run, command=command_of(t, float(np.abs(run.command).max()), dice)))
    return replace(case, runs=tuple(runs))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["ramps", "edges"])
def test_a_healthy_valve_under_ramps_between_samples_or_edges_through_them_stays_healthy(tmp_path, command):
    """A stranger's sessions: ramps of 2 ms raised alarms, edges of 50 us at the sample named the armature's inertia."""
    case, bench = draw_bench(505, "none", imperfections=("edges",), duration=0.5)

    def command_of(t, most, dice):
        if command == "ramps":
            corners, level = ramps(dice, 2.1e-3, 2.1e-3, t[-1])
            return most * np.interp(t, corners, np.clip(level - np.round(level), -0.5, 0.5))
        at = np.arange(0.02, t[-1], 0.01)
        level = most * dice.uniform(-0.5, 0.5, len(at))
        corners = np.column_stack([at - 2e-5, at + 3e-5]).ravel()
        return np.interp(t, corners, np.column_stack([np.append(0.0, level[:-1]), level]).ravel())

    write_bench_session(with_command(case, command_of), bench, tmp_path)
    assert vs.diagnose(tmp_path).verdict == "no_discrepancy"


@pytest.mark.slow
@pytest.mark.parametrize("imperfection", ["edges", "hold"])
@pytest.mark.parametrize("name", [None, "spool_coulomb_friction"])
def test_a_session_whose_command_goes_otherwise_between_samples_is_diagnosed(tmp_path, imperfection, name):
    case, bench = draw_bench(505, "effect" if name else "none", name=name, imperfections=(imperfection,))
    write_bench_session(case, bench, tmp_path)
    found = vs.diagnose(tmp_path)
    if name is None:
        assert found.verdict == "no_discrepancy"
    else:
        assert found.candidates[0].names == (name,)


def test_variants_that_differ_in_an_edge_differ(stepped):
    _, session = stepped
    record = session.training[1]
    parameter = edge_parameter(record, EdgeTime(record.name, record.command, 10))
    variant = parameter.with_value(ModelVariant(session.valve), 1e-4)
    assert parameter.value_in(variant) == 1e-4 and parameter.value_in(replace(variant, deviations=())) == 0.0
    assert parameter.moved(variant, 1.0).deviations == ((parameter.input, 1e-4 + parameter.deviation),)


@pytest.mark.slow
def test_linear_answers_from_far_off_do_not_take_a_command_for_held(tmp_path):
    """At 10 kHz a hold is 50 us late, by which figures of the armature went five deviations off: a healthy valve was
    named for its inertia.
    """
    write_session(draw(3100005, "none", noise=0.02, rate=1e4, duration=0.2), tmp_path)
    found = vs.diagnose(tmp_path)
    assert found.verdict == "no_discrepancy"
    assert not any(HELD_NAME in note for note in found.notes)


def test_inputs_of_a_record_that_is_held_out_are_found_from_those_of_another_variant_as_from_nothing(stepped):
    _, session = stepped
    prepared = prepare_session(session)
    edges = next(choice for choice in input_choices(session, options=OPTIONS) if choice.parameters)
    study = with_input_choice(prepared, edges).with_noise(initial_noise(prepared))
    record = next(r for r in session.records if len(command_jumps(r.values[r.command], options=OPTIONS)) > 2)
    predictor = prepare_record(session, record, (), options=OPTIONS)
    plain = study.nominal.variant
    other = replace(plain, valve=replace(plain.valve, spool_area=1.01 * plain.valve.spool_area))
    _, near = _read_with_inputs(study, predictor, plain)
    (anew, point), (read, found) = (_read_with_inputs(study, predictor, other, start) for start in (None, near))
    assert np.abs(point).max() > 0.1 and not np.array_equal(near, point)
    for name, expected in anew.items():
        np.testing.assert_allclose(read[name], expected, atol=2e-3 * np.ptp(expected))
    np.testing.assert_allclose(found, point, atol=0.05)
