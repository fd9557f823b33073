"""Commands: each against its own definition, at and around its breaks; sums, merging, bounds, tables and speed."""

import math
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import InputError
from valvesim.inputs import (
    COMMANDS,
    Chirp,
    Constant,
    Extremes,
    Piecewise,
    Pulse,
    Ramp,
    Scaled,
    Sine,
    Staircase,
    Step,
    Sum,
    Table,
    evaluate,
    extremes,
    largest,
    merge,
    piece_motion,
    piece_value,
    read_table,
)

END = 2.0

values = st.floats(-10.0, 10.0)
moments = st.one_of(st.sampled_from([0.0, END]), st.floats(0.0, 2.5))
durations = st.floats(0.01, 2.0)
frequencies = st.floats(0.1, 20.0)


@st.composite
def pulses(draw):
    width = draw(durations)
    period = draw(st.one_of(st.just(np.inf), st.floats(1.001, 3.0).map(lambda factor: factor * width)))
    return Pulse(base=draw(values), height=draw(values), width=width, time=draw(moments), period=period)


@st.composite
def tables(draw):
    ticks = draw(st.lists(st.integers(-500, 2500), min_size=2, max_size=8, unique=True))
    return Table(times=tuple(k / 1000 for k in sorted(ticks)), values=tuple(draw(values) for _ in ticks))


def chirps(logarithmic):
    return st.builds(
        Chirp, amplitude=values, start_frequency=frequencies, end_frequency=frequencies, duration=durations,
        offset=values, time=moments, logarithmic=logarithmic,
    )  # fmt: skip


@st.composite
def cubics(draw):
    count = draw(st.integers(1, 6))
    starts = [0.0, *sorted(draw(st.lists(st.floats(0.01, 2.5), min_size=count, max_size=count, unique=True)))]
    return Piecewise(np.array([[start, *(draw(values) for _ in range(4))] for start in starts]))


straight = {
    "constant": st.builds(Constant, value=values),
    "step": st.builds(Step, before=values, after=values, time=moments),
    "ramp": st.builds(Ramp, start_value=values, end_value=values, rate=st.floats(0.1, 100.0), time=moments),
    "pulse": pulses(),
    "staircase": st.builds(
        Staircase, start_value=values, end_value=values, steps=st.integers(1, 20), hold=st.floats(0.01, 1.0)
    ),
    "table": tables(),
}
curved = {
    "cubics": cubics(),
    "sine": st.builds(
        Sine, amplitude=values, frequency=frequencies, phase=st.floats(-7.0, 7.0), offset=values, time=moments
    ),
    "linear chirp": chirps(st.just(False)),
    "logarithmic chirp": chirps(st.just(True)),
}
every = {**straight, **curved}
commands = st.one_of(*every.values())
mixtures = st.lists(commands, min_size=1, max_size=5)
of_every_kind = pytest.mark.parametrize("kind", every)


def breaks(*several):
    return np.unique(np.concatenate([command.pieces(END)[:, 0] for command in several]))


def watched(*several):
    """Times from 0 to END: an even grid, every break of some commands, and the nearest floats around each."""
    at = breaks(*several)
    times = np.concatenate([np.linspace(0.0, END, 57), at, np.nextafter(at, -1.0), np.nextafter(at, 9.0), [END]])
    return np.unique(times[(times >= 0.0) & (times <= END)])


def defined(c, t):
    """The value of a command at one time, read from its definition in words."""
    match c:
        case Constant():
            return c.value
        case Step():
            return c.after if t >= c.time else c.before
        case Ramp():
            way = c.end_value - c.start_value
            return c.start_value + math.copysign(min(max(t - c.time, 0.0) * c.rate, abs(way)), way)
        case Sine():
            wave = c.amplitude * math.sin(2 * math.pi * c.frequency * (t - c.time) + c.phase)
            return c.offset + (wave if t >= c.time else 0.0)
        case Chirp():
            if not c.time <= t < c.time + c.duration:
                return c.offset
            first, last, tau = c.start_frequency, c.end_frequency, t - c.time
            turns = first * tau + (last - first) * tau**2 / (2 * c.duration)
            if c.logarithmic and first != last:
                octaves = math.log(last / first)
                turns = first * c.duration / octaves * math.expm1(octaves * tau / c.duration)
            return c.offset + c.amplitude * math.sin(2 * math.pi * turns)
        case Pulse():
            starts = [c.time] if c.period == np.inf else [c.time + k * c.period for k in range(int(END / c.period) + 2)]
            return c.base + (c.height if any(start <= t < start + c.width for start in starts) else 0.0)
        case Staircase():
            jumps = sum(k * c.hold <= t for k in range(1, int(c.steps) + 1))
            return c.start_value + (c.end_value - c.start_value) * jumps / c.steps
        case Table():
            return float(np.interp(t, c.times, c.values))
        case Piecewise():
            start, *figures = next(row for row in c.rows[::-1] if row[0] <= t)
            return sum(figure * (t - start) ** k for k, figure in enumerate(figures))


def refusal(function, *arguments, **options):
    """The message of the InputError, of exactly that type, that a call ends in."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    assert type(caught.value) is InputError
    return str(caught.value)


# ---------------------------------------------------------------- values and rates


@of_every_kind
@given(data=st.data())
def test_a_command_is_what_its_definition_says(kind, data):
    command = data.draw(every[kind])
    times = watched(command)
    assert evaluate(command, times) == pytest.approx(np.array([defined(command, t) for t in times]), abs=1e-9)


@of_every_kind
@given(data=st.data())
def test_the_rate_is_the_slope_of_the_value(kind, data):
    command, h = data.draw(every[kind]), 1e-6
    rows = command.pieces(END)
    for row, stop in zip(rows, [*rows[1:, 0], rows[-1, 0] + 1.0], strict=True):
        for t in row[0] + np.array([0.0, 0.3, 0.8]) * (stop - row[0]):
            slope = (piece_value(row, t + h)[0] - piece_value(row, t - h)[0]) / (2 * h)
            assert piece_value(row, t)[1] == pytest.approx(slope, rel=1e-6, abs=2e-3)  # waves reach 1000 a second


@of_every_kind
@given(data=st.data())
def test_pieces_are_sorted_and_the_first_starts_at_or_before_zero(kind, data):
    starts = data.draw(every[kind]).pieces(END)[:, 0]
    assert starts[0] <= 0.0 and (np.diff(starts) >= 0.0).all()


@pytest.mark.parametrize(
    "command, at",
    [
        (Constant(value=3.0), [0.0]),
        (Step(time=0.7), [0.0, 0.7]),
        (Ramp(start_value=1.0, end_value=-1.0, rate=4.0, time=0.25), [0.0, 0.25, 0.75]),
        (Sine(time=0.3), [0.0, 0.3]),
        (Chirp(time=0.5, duration=1.25), [0.0, 0.5, 1.75]),
        (Pulse(time=0.5, width=0.25), [0.0, 0.5, 0.75]),
        (Staircase(steps=3, hold=0.5), [0.0, 0.5, 1.0, 1.5]),
        (Table(times=(0.5, 1.0), values=(1.0, 2.0)), [0.0, 0.5, 1.0]),
        (Table(times=(-1.0, 1.0), values=(1.0, 2.0)), [-1.0, 1.0]),
        (Sum((Step(time=0.7), Sine(time=0.3), Step(time=END))), [0.0, 0.3, 0.7, END]),
    ],
)
def test_breaks_stand_where_they_should(command, at):
    assert breaks(command).tolist() == at


def test_a_train_of_pulses_reaches_the_end():
    command = Pulse(height=1.0, width=0.25, time=0.5, period=0.5)
    assert set(breaks(command)) >= {0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0}
    assert evaluate(command, [0.49, 0.5, 0.75, 1.0, 1.75, 2.0]).tolist() == [0, 1, 0, 1, 0, 1]


JUMPS = [
    (Step(before=1.0, after=5.0, time=0.7), 0.7, 1.0, 5.0),
    (Pulse(base=1.0, height=4.0, width=0.1, time=0.7), 0.7, 1.0, 5.0),
    (Pulse(base=1.0, height=4.0, width=0.1, time=0.7), 0.7 + 0.1, 5.0, 1.0),
    (Pulse(base=1.0, height=4.0, width=0.1, time=0.7, period=0.3), 0.7 + 3 * 0.3, 1.0, 5.0),
    (Staircase(start_value=0.0, end_value=10.0, steps=10, hold=0.1), 3 * 0.1, 2.0, 3.0),
    (Sine(amplitude=4.0, phase=math.pi / 2, offset=1.0, time=0.7), 0.7, 1.0, 5.0),
    (Chirp(amplitude=4.0, start_frequency=1.25, end_frequency=1.25, duration=1.0, offset=1.0), 1.0, 5.0, 1.0),
]


@pytest.mark.parametrize("command, at, before, after", JUMPS)
@pytest.mark.parametrize("wrap", [lambda c: c, lambda c: Sum((c,)), lambda c: Sum((Constant(), Sum((c, Sine()))))])
def test_a_jump_takes_effect_exactly_at_its_time(command, at, before, after, wrap):
    just_before = evaluate(wrap(command), [np.nextafter(at, 0.0), END])[0]
    assert just_before == pytest.approx(before, abs=1e-9)
    assert evaluate(wrap(command), [at, END])[0] == pytest.approx(after, abs=1e-9)
    assert evaluate(wrap(command), [at])[0] == pytest.approx(after, abs=1e-9)  # also where it is the last time asked


def test_a_step_at_zero_has_happened_at_zero():
    assert evaluate(Step(before=1.0, after=5.0), [0.0, 1.0]).tolist() == [5.0, 5.0]


def test_a_ramp_falls_towards_a_smaller_value():
    command = Ramp(start_value=3.0, end_value=-1.0, rate=2.0, time=1.0)
    assert evaluate(command, [1.0, 2.0, 3.0, 4.0]) == pytest.approx(np.array([3.0, 1.0, -1.0, -1.0]), abs=1e-12)


def test_a_ramp_to_its_own_value_stays_there():
    assert evaluate(Ramp(start_value=3.0, end_value=3.0), [0.0, 1.0]).tolist() == [3.0, 3.0]


def test_pulses_that_almost_touch_stay_in_order():
    width = 0.1
    command = Pulse(height=1.0, width=width, time=0.3, period=float(np.nextafter(width, 1.0)))
    assert (np.diff(command.pieces(50.0)[:, 0]) >= 0.0).all()


def test_a_table_is_held_outside_its_times():
    command = Table(times=(-1.0, 0.0, 1.0), values=(2.0, 5.0, 3.0))
    assert evaluate(command, [-9.0, -1.0, -0.5, 0.0, 0.5, 1.0, 9.0]).tolist() == [2.0, 2.0, 3.5, 5.0, 4.0, 3.0, 3.0]


# ---------------------------------------------------------------- chirps


@pytest.mark.parametrize("first, last", [(2.0, 8.0), (8.0, 2.0)])
@pytest.mark.parametrize("logarithmic", [False, True])
def test_a_chirp_has_its_frequencies_at_both_ends(first, last, logarithmic):
    turns = 5  # a whole number, so that the rate at each end is 2 pi frequency amplitude
    mean = (last - first) / math.log(last / first) if logarithmic else (first + last) / 2
    sweep = {"start_frequency": first, "end_frequency": last, "duration": turns / mean, "logarithmic": logarithmic}
    command = Chirp(amplitude=3.0, time=0.4, **sweep)
    wave = command.pieces(END)[1]
    for t, frequency in ((0.4, first), (0.4 + command.duration, last)):
        value, rate = piece_value(wave, t)
        assert value == pytest.approx(0.0, abs=1e-9)
        assert rate == pytest.approx(2 * math.pi * frequency * 3.0, rel=1e-9)


@pytest.mark.parametrize("first, last", [(2.0, 8.0), (8.0, 2.0)])
@pytest.mark.parametrize("logarithmic", [False, True])
def test_a_chirp_runs_evenly_in_hertz_or_in_octaves(first, last, logarithmic):
    command = Chirp(amplitude=3.0, start_frequency=first, end_frequency=last, duration=2.0, logarithmic=logarithmic)
    for share in np.linspace(0.0, 1.0, 41):
        frequency = first * (last / first) ** share if logarithmic else first + (last - first) * share
        value, rate = piece_value(command.pieces(END)[1], 2.0 * share)
        assert value**2 + (rate / (2 * math.pi * frequency)) ** 2 == pytest.approx(9.0, rel=1e-9)


@pytest.mark.parametrize("logarithmic", [False, True])
def test_a_chirp_that_hardly_sweeps_is_a_sine(logarithmic):
    times = np.linspace(0.0, 1.9, 201)
    chirp = Chirp(
        amplitude=1.0, start_frequency=500.0, end_frequency=500.0 * (1 + 1e-13), duration=END, logarithmic=logarithmic
    )
    assert evaluate(chirp, times) == pytest.approx(evaluate(Sine(amplitude=1.0, frequency=500.0), times), abs=1e-8)


# ---------------------------------------------------------------- bounds


@given(mixtures)
def test_nothing_exceeds_the_largest_value(several):
    for command in (*several, Sum(tuple(several))):
        assert np.abs(evaluate(command, watched(command))).max() <= largest(command, END) * (1 + 1e-12) + 1e-12


@pytest.mark.parametrize("kind", straight)
@given(data=st.data())
def test_the_largest_value_of_a_straight_command_is_reached(kind, data):
    command = data.draw(straight[kind])
    assert largest(command, END) == pytest.approx(np.abs(evaluate(command, watched(command))).max(), abs=1e-9)


@pytest.mark.parametrize(
    "command, bound",
    [
        (Sine(amplitude=-3.0, offset=-1.0), 4.0),
        (Chirp(amplitude=3.0, offset=1.0, time=0.5), 4.0),
        (Sum((Sine(amplitude=3.0), Step(before=-1.0, after=2.0, time=1.0))), 5.0),
        (Sine(amplitude=3.0, time=2.5), 0.0),  # not yet
        (Step(after=3.0, time=END), 3.0),
        (Step(after=3.0, time=2.5), 0.0),
        (Step(before=3.0), 0.0),  # no longer
        (Table(times=(0.0, 1.0, 5.0, 5.5), values=(1.0, 1.0, 1.0, 90.0)), 1.0),
        (Table(times=(-2.0, -1.0, 0.0, 1.0), values=(0.0, 90.0, 1.0, 1.0)), 1.0),
        (Ramp(end_value=1.0, rate=1e-320), 0.0),  # takes for ever
    ],
)
def test_the_largest_value_counts_only_what_happens_until_the_end(command, bound):
    assert largest(command, END) == pytest.approx(bound, abs=1e-12)


@pytest.mark.parametrize("shape", [(4, 3), (4, 8), (5,), (1, 0)])
def test_pieces_of_another_width_are_refused_wherever_they_are_asked_for(shape):
    """Commands of one's own had three columns once."""
    own = Piecewise(np.zeros(shape))
    for ask in (lambda: evaluate(own, [0.0, 1.0]), lambda: extremes(own, END), lambda: merge([Constant(), own], END)):
        assert "each is a row of 5 numbers" in refusal(ask)


@given(mixtures)
def test_extremes_are_bounds_that_are_reached(several):
    command = Sum(tuple(several))
    reach, rows = extremes(command, END), command.pieces(END)
    times = np.unique(np.concatenate([watched(command), np.linspace(0.0, END, 20_001)]))
    seen = evaluate(command, times)
    size = 1.0 + max(abs(reach.lowest), abs(reach.highest))
    assert reach.lowest - 1e-9 * size <= seen.min() and seen.max() <= reach.highest + 1e-9 * size
    for value, at in ((reach.lowest, reach.lowest_at), (reach.highest, reach.highest_at)):
        ends = [piece_value(row, at)[0] for row in rows[:, :] if row[0] <= at]  # at a jump both sides count
        assert 0.0 <= at <= END and min(abs(value - end) for end in ends) <= 1e-8 * size


@pytest.mark.parametrize("logarithmic", [False, True])
def test_the_extremes_of_a_chirp_on_a_line_are_where_its_rate_vanishes(logarithmic):
    chirp = Chirp(
        amplitude=2.0, start_frequency=0.3, end_frequency=9.0, duration=2.0, time=0.1, logarithmic=logarithmic
    )
    command = Sum((chirp, Ramp(end_value=6.0, rate=3.0)))
    reach, h = extremes(command, END), 1e-7
    for value, at in ((reach.lowest, reach.lowest_at), (reach.highest, reach.highest_at)):
        before, here, after = evaluate(command, [at - h, at, at + h])
        assert here == pytest.approx(value, abs=1e-9)
        assert at == 0.0 or abs(after - before) / (2 * h) < 1e-2  # rates reach 100 a second
    assert reach.highest < 8.0 and reach.lowest > -2.0  # less than line and amplitude together


@pytest.mark.parametrize(
    "command, end, lowest, highest",
    [
        (Sine(amplitude=30.0, frequency=1e5, offset=21.0), 1e5, -9.0, 51.0),  # 1e10 periods
        (Sum((Sine(amplitude=3.0, frequency=1e5), Ramp(end_value=5.0, rate=5e-5))), 1e5, -3.0, 8.0),
        (Sum((Sine(amplitude=3.0, frequency=7.0), Scaled(Sine(amplitude=3.0, frequency=7.0), -1.0))), 50.0, 0.0, 0.0),
        (
            Sum((Sine(amplitude=3.0, frequency=7.0), Sine(amplitude=4.0, frequency=7.0, phase=math.pi / 2))),
            9.0,
            -5.0,
            5.0,
        ),
        (Sum((Sine(amplitude=1.0, frequency=1.0), Sine(amplitude=1.0, frequency=2.0))), 3.0, -1.7601725, 1.7601725),
    ],
)
def test_extremes_of_any_number_of_periods(command, end, lowest, highest):
    reach = extremes(command, end)
    assert (reach.lowest, reach.highest) == pytest.approx((lowest, highest), abs=1e-6)


def test_values_just_before_a_jump_and_at_the_end_count():
    command = Sum((Ramp(end_value=9.0, rate=1.0), Step(after=-5.0, time=1.0)))
    assert extremes(command, 1.5) == Extremes(-4.0, 1.0, 1.0, 1.0)
    assert extremes(Ramp(end_value=9.0, rate=1.0), 1.5) == Extremes(0.0, 0.0, 1.5, 1.5)


# ---------------------------------------------------------------- sums and merging


@given(mixtures)
def test_a_sum_equals_the_sum_of_its_terms_everywhere(several):
    times = watched(*several)
    assert evaluate(Sum(tuple(several)), times) == pytest.approx(sum(evaluate(c, times) for c in several), abs=1e-8)


@given(mixtures, commands)
def test_a_sum_of_sums_equals_the_sum_of_its_terms(several, last):
    times = watched(*several, last)
    nested = Sum((Sum(tuple(several)), last))
    assert evaluate(nested, times) == pytest.approx(sum(evaluate(c, times) for c in (*several, last)), abs=1e-8)


def test_waves_that_begin_at_different_times_go_on_undisturbed():
    terms = (
        Sine(amplitude=1.0, frequency=3.3, phase=0.4, time=0.11),
        Chirp(amplitude=2.0, start_frequency=1.0, end_frequency=15.0, duration=1.2, time=0.23),
        Chirp(amplitude=3.0, start_frequency=15.0, end_frequency=1.0, duration=0.9, time=0.37, logarithmic=True),
        Pulse(height=1.0, width=0.01, period=0.05),
    )
    times = np.linspace(0.0, END, 2001)
    expected = [sum(defined(c, t) for c in terms) for t in times]
    assert evaluate(Sum(terms), times) == pytest.approx(np.array(expected), abs=1e-9)


@given(mixtures)
def test_merging_keeps_every_break_before_the_end_and_adds_none_but_zero(several):
    at = breaks(*several)
    starts, intervals = merge(several, END)
    assert starts.tolist() == [0.0, *at[(at > 0.0) & (at < END)]]
    assert intervals.starts is starts


@given(mixtures)
def test_each_merged_row_is_its_command_from_break_to_break(several):
    starts, intervals = merge(several, END)
    for k, (start, stop) in enumerate(zip(starts, [*starts[1:], END], strict=True)):
        for t in (start, 0.5 * (start + stop)):
            for row, command in zip(intervals.rows[k], several, strict=True):
                assert piece_value(row, t)[0] == pytest.approx(evaluate(command, [t, END])[0], abs=1e-9)


# ---------------------------------------------------------------- evaluation


@given(mixtures, st.lists(st.floats(0.0, END), min_size=1, max_size=20))
def test_many_times_at_once_equal_one_by_one(several, times):
    for command in (*several, Sum(tuple(several))):
        one_by_one = [float(evaluate(command, t)) for t in times]
        assert evaluate(command, times) == pytest.approx(np.array(one_by_one), abs=1e-9)


@pytest.mark.parametrize("command", [Step(after=1.0, time=0.5), Sine(amplitude=1.0)])
@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 3), (2, 0)])
def test_the_shape_of_the_times_is_kept(command, shape):
    assert np.shape(evaluate(command, np.full(shape, 0.25))) == shape


@pytest.mark.parametrize("pulse", [Constant(), Pulse(height=1.0, width=1e-3, period=4e-3)])
def test_a_hundred_thousand_times_are_no_hundred_thousand_calls(pulse):
    command = Sum((pulse, *(Sine(amplitude=1.0, frequency=f, time=f / 100) for f in (3.0, 5.0, 7.0))))
    times, calls, before = np.linspace(0.0, END, 100_000), [], sys.getprofile()
    sys.setprofile(lambda frame, event, argument: calls.append(event) if event in ("call", "c_call") else None)
    try:
        evaluate(command, times)
    finally:
        sys.setprofile(before)
    assert 0 < len(calls) < len(times)


def test_a_piece_compiles_as_it_stands_and_agrees():
    from numba import njit

    compiled = njit(piece_motion)
    command = Sum((
        Ramp(end_value=2.0, rate=3.0, time=0.1),
        Sine(amplitude=1.0, frequency=3.0, time=0.2),
        Chirp(amplitude=2.0, end_frequency=9.0),
        Chirp(amplitude=2.0, end_frequency=9.0, time=0.3, logarithmic=True),
    ))  # fmt: skip
    for row in command.pieces(END):
        for t in row[0] + np.linspace(0.0, 0.5, 11):
            assert compiled(row, t) == pytest.approx(piece_motion(row, t), rel=1e-12, abs=1e-12)


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "kind, figures, message",
    [
        (Constant, {"value": math.nan}, "constant.value = nan value is outside (-inf, inf) value (value)"),
        (Step, {"after": math.inf}, "step.after = inf value is outside (-inf, inf) value (value after)"),
        (Step, {"time": -1.0}, "step.time = -1 s is outside [0, inf) s (time of the jump)"),
        (Ramp, {"rate": 0.0}, "ramp.rate = 0 value/s is outside (0, inf) value/s (size of the slope)"),
        (Ramp, {"end_value": -math.inf}, "ramp.end_value = -inf value is outside (-inf, inf) value (value after)"),
        (Sine, {"frequency": -5.0}, "sine.frequency = -5 Hz is outside (0, 100000] Hz (frequency)"),
        (Sine, {"frequency": 2e5}, "sine.frequency = 200000 Hz is outside (0, 100000] Hz (frequency)"),
        (Chirp, {"duration": 0.0}, "chirp.duration = 0 s is outside (0, inf) s (duration)"),
        (Chirp, {"end_frequency": math.nan}, "chirp.end_frequency = nan Hz is outside (0, 100000] Hz (last frequency)"),
        (Pulse, {"width": 0.0}, "pulse.width = 0 s is outside (0, inf) s (duration)"),
        (Pulse, {"width": 2.0, "period": 2.0}, "pulse.period = 2 s must be longer than pulse.width = 2 s"),
        (Staircase, {"steps": 0}, "staircase.steps = 0 - is outside [1, 1e+06] - (number of jumps)"),
        (Staircase, {"steps": 2.5}, "staircase.steps = 2.5 must be a whole number in [1, 1e+06]"),
        (Staircase, {"hold": -0.1}, "staircase.hold = -0.1 s is outside (0, inf) s (duration of a level)"),
    ],
)
def test_a_figure_that_makes_no_sense_is_refused(kind, figures, message):
    assert refusal(kind, **figures) == message


@pytest.mark.parametrize(
    "times, table, message",
    [
        ((0.0,), (1.0,), "needs two or more points, with as many times as values"),
        ((), (), "needs two or more points, with as many times as values"),
        ((0.0, 1.0), (1.0, 2.0, 3.0), "needs two or more points, with as many times as values"),
        (((0.0, 1.0),), ((0.0, 1.0),), "needs two or more points, with as many times as values"),
        ((0.0, 1.0, 2.0), (1.0, math.nan, 3.0), "row 2 of the data is not a number"),
        ((0.0, 1.0, math.inf), (1.0, 2.0, 3.0), "row 3 of the data is not a number"),
        ((math.nan, 1.0), (1.0, 2.0), "row 1 of the data is not a number"),
        ((0.0, 2.0, 1.0), (1.0, 2.0, 3.0), "times must rise, but row 3 (1 s) is before row 2 (2 s)"),
        ((0.0, 1.5, 1.5), (1.0, 2.0, 3.0), "times must rise, but row 3 (1.5 s) repeats row 2 (1.5 s)"),
    ],
)
@pytest.mark.parametrize("options, where", [({}, "table"), ({"where": "shock.csv"}, "shock.csv")])
def test_a_table_that_is_no_function_of_time_is_refused(times, table, message, options, where):
    assert refusal(Table, times=times, values=table, **options) == f"{where}: {message}"


def test_a_table_is_read_from_a_file(tmp_path):
    path = tmp_path / "shock.csv"
    path.write_text("time [ms],oil [degF],note [1]\n0,-40,1\n500,212,2\n", encoding="utf-8")
    command = read_table(path, "oil", "degC")
    assert evaluate(command, [0.0, 0.25, 0.5, 9.0]) == pytest.approx(np.array([-40.0, 30.0, 100.0, 100.0]), abs=1e-9)


@pytest.mark.parametrize(
    "text, message",
    [
        ("time [s],oil [degC]\n0,1\n0,2\n", ": times must rise, but row 2 (0 s) repeats row 1 (0 s)"),
        ("time [s],oil [degC]\n0,1\n", ": needs two or more points, with as many times as values"),
        ("t [s],oil [degC]\n0,1\n1,2\n", ", line 1: no column 'time'; valid names: oil, t"),
        ("time [s],oil [bar]\n0,1\n1,2\n",
         ", line 1: column 'oil': 'bar' has the wrong dimension; expected a unit that converts to 'degC'"),
        ("time [s],oil [degC]\n0,1\n1,\n", ", line 3: gap in column 'oil'"),
    ],
)  # fmt: skip
def test_a_file_that_makes_no_table_is_refused_by_name(tmp_path, text, message):
    path = tmp_path / "shock.csv"
    path.write_text(text, encoding="utf-8")
    assert refusal(read_table, path, "oil", "degC") == f"{path}{message}"


def test_every_command_has_its_name_in_scenario_files():
    assert COMMANDS == {kind.__name__.lower(): kind for kind in (Constant, Step, Ramp, Sine, Chirp, Pulse, Staircase)}
