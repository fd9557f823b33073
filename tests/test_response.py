"""Responses: closed-form systems through the record functions, then the valve against its own linearisation."""

import dataclasses
import datetime

import numpy as np
import pytest
from picture_texts import check_texts
from scipy import signal

import valvesim as vs
from valvesim.channels import Inputs
from valvesim.characterisation.class_figures import class_figures
from valvesim.characterisation.figure_of_merit import Absent
from valvesim.characterisation.frequency_response import FrequencyResponse, frequency_response, join_points
from valvesim.characterisation.held_scenario import held, rated_command
from valvesim.characterisation.lumped_figures import beside_class, lumped_figures
from valvesim.characterisation.options import ResponseOptions
from valvesim.characterisation.response_set import ResponseSet, measure_responses
from valvesim.characterisation.sine_point import SinePoint, sine_point
from valvesim.characterisation.spectral_response import chirp_response, spectral_response
from valvesim.characterisation.step_response import step_figures, step_response
from valvesim.errors import InputError, ValidityWarning
from valvesim.reports.response import draw_responses, response_report
from valvesim.valve.equations import NOMINAL
from valvesim.valve.thermal_network import THERMAL_NODES

valve = vs.reference_valve()
DAY = datetime.date(2026, 1, 2)
TAU = 2e-3  # s, of the first-order system


def rng():
    """The same dice in every test, whatever ran before it."""
    return np.random.default_rng(5)


def figures(of):
    return {figure.name: figure for figure in of}


def value(of, name):
    return figures(of)[name].value


def reason(of, name):
    figure = figures(of)[name]
    assert isinstance(figure, Absent)
    return figure.reason


# ---------------------------------------------------------------- step figures of closed-form systems


def step_record(rate=100e3, end=0.05, at=0.01):
    t = np.arange(int(end * rate)) / rate
    return t, np.where(t >= at - 1e-12, 1.0, 0.0), np.maximum(t - at, 0.0)


def first_order(rate=100e3, end=0.05):
    t, u, late = step_record(rate, end)
    return t, u, 1.0 - np.exp(-late / TAU)


def test_first_order_step_has_its_closed_form_figures():
    of = step_figures(*first_order(), unit="m")
    # s = 1 - exp(-t/tau); the end of the record is 20 tau away
    assert value(of, "time_to_90_percent") == pytest.approx(TAU * np.log(10), rel=1e-4)
    assert value(of, "rise_time") == pytest.approx(TAU * np.log(9), rel=1e-4)
    assert value(of, "settling_time") == pytest.approx(TAU * np.log(20), rel=1e-4)
    assert value(of, "dead_time") == pytest.approx(-TAU * np.log(0.98), rel=1e-3)
    assert value(of, "overshoot") == pytest.approx(0.0, abs=1e-5)
    assert value(of, "mean_rate") == pytest.approx(0.8 / (TAU * np.log(9)), rel=1e-4)
    assert figures(of)["mean_rate"].unit == "m/s"


def test_step_figures_do_not_depend_on_sign_scale_or_offset():
    t, u, y = first_order()
    plain, turned = step_figures(t, u, y), step_figures(t, 5.0 - 2e-3 * u, 3.0 - 4e-4 * y)
    for name in ("time_to_90_percent", "rise_time", "settling_time", "dead_time"):
        assert value(turned, name) == pytest.approx(value(plain, name), rel=1e-9)
    assert value(turned, "change") == pytest.approx(-4e-4, rel=1e-6)


def test_a_delay_adds_to_times_and_not_to_the_rise():
    t, u, late = step_record()
    y = 1.0 - np.exp(-np.maximum(late - 1e-3, 0.0) / TAU)
    of, plain = step_figures(t, u, y), step_figures(*first_order())
    for name, delay in (("time_to_90_percent", 1e-3), ("settling_time", 1e-3), ("dead_time", 1e-3), ("rise_time", 0)):
        assert value(of, name) - value(plain, name) == pytest.approx(delay, abs=1e-6)


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
def test_second_order_step_overshoots_as_its_damping_says(damping):
    t, u, late = step_record(end=0.2)
    wn = 2 * np.pi * 150.0
    wd = wn * np.sqrt(1 - damping**2)
    y = 1 - np.exp(-damping * wn * late) * (np.cos(wd * late) + damping * wn / wd * np.sin(wd * late))
    of = step_figures(t, u, y)
    assert value(of, "overshoot") == pytest.approx(100 * np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), rel=1e-3)
    last_outside = late[np.abs(y - 1) > 0.05][-1]
    assert value(of, "settling_time") == pytest.approx(last_outside, abs=1.1e-5)  # one sample


def test_a_command_that_ramps_steps_at_its_half():
    t, _, late = step_record()
    u = np.clip(late / 4e-4, 0.0, 1.0)  # 0.4 ms from end to end
    y = np.where(late > 0, 1 - np.exp(-np.maximum(late - 2e-4, 0) / TAU), 0.0)
    assert value(step_figures(t, u, y), "time_to_90_percent") == pytest.approx(TAU * np.log(10), rel=1e-3)


def test_noise_leaves_the_times_and_takes_the_dead_time():
    t, u, y = first_order()
    of = step_figures(t, u, y + 1e-2 * rng().standard_normal(len(t)))
    assert value(of, "time_to_90_percent") == pytest.approx(TAU * np.log(10), rel=0.1)
    assert "noise" in reason(of, "dead_time")


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda t, u, y: (t, 0 * u, y), "no step in the command"),
        (lambda t, u, y: (t[998:], u[998:], y[998:]), "before the step"),
        (lambda t, u, y: (t, np.where(t > 0.03, 0.0, u) + np.where(t > 0.04, u, 0.0), y), "does not hold"),
        (lambda t, u, y: (t[:1006], u[:1006], y[:1006]), "samples after the step"),
        (lambda t, u, y: (t[990:1003], u[990:1003], y[990:1003]), "only 13 samples"),
        (lambda t, u, y: (t, u, np.zeros_like(t)), "does not move"),
        (lambda t, u, y: (t, u, 1e-3 * rng().standard_normal(len(t))), "does not move|rest"),
        (lambda t, u, y: (t[:1300], u[:1300], y[:1300]), "come to rest"),
        (lambda t, u, y: (t, u, y + 0.2 * np.sin(5e3 * t) * u), "come to rest"),
        (lambda t, u, y: (t, u, np.minimum(y + 1e-3 * rng().standard_normal(len(t)), 0.7)), "clipped"),
    ],
)
def test_a_record_that_gives_no_figure_says_why(change, message):
    of = step_figures(*change(*first_order()))
    assert len(of) == 7
    for figure in of:
        assert isinstance(figure, Absent)
        assert any(part in figure.reason for part in message.split("|"))


def test_an_output_that_stays_below_its_known_end_never_reaches_90_percent():
    t, u, y = first_order()
    of = step_figures(t, u, 0.8 * y, steady=1.0)
    assert "never reaches 90 %" in reason(of, "time_to_90_percent")
    assert "outside 5 %" in reason(of, "settling_time")
    assert value(of, "dead_time") == pytest.approx(-TAU * np.log(1 - 0.02 / 0.8), rel=1e-3)


def test_slow_sampling_takes_the_rise_and_leaves_the_overshoot():
    of = step_figures(*first_order(rate=1e3))
    assert value(of, "overshoot") == pytest.approx(0.0, abs=1e-5)
    of = step_figures(*first_order(rate=500.0))
    assert "samples between the step and 90 %" in reason(of, "time_to_90_percent")


def test_a_clipped_peak_has_no_overshoot():
    t, u, late = step_record(end=0.2)
    y = 1 - np.exp(-200 * late) * np.cos(1500 * late)
    of = step_figures(t, u, np.minimum(y, 1.3))
    assert "clipped" in reason(of, "overshoot")
    assert value(of, "time_to_90_percent") == value(step_figures(t, u, y), "time_to_90_percent")


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda t, u, y: (t[:-1], u, y), "one length"),
        (lambda t, u, y: (t[:2], u[:2], y[:2]), "2 samples are too few"),
        (lambda t, u, y: (t, u, np.where(t == t[7], np.nan, y)), "gap in the output: sample 8"),
        (lambda t, u, y: (np.where(t == t[7], t[5], t), u, y), "sample 8 .* does not follow"),
        (lambda t, u, y: (np.delete(t, 50), np.delete(u, 50), np.delete(y, 50)), "gap of 2e-05 s after 0.00049 s"),
    ],
)
def test_a_broken_record_is_refused(change, message):
    t, u, y = first_order()
    for function in (step_figures, sine_point, spectral_response):
        with pytest.raises(InputError, match=message):
            function(*change(t, u, y))


# ---------------------------------------------------------------- steady sines


def sine_record(frequency=40.0, cycles=5.3, per_cycle=50, harmonics=(1.0,), lag=0.6, gain=0.25):
    t = 3.0 + np.arange(int(cycles * per_cycle)) / (per_cycle * frequency)
    angle = 2 * np.pi * frequency * t
    y = 0.7 + gain * sum(h * np.sin(k * (angle - lag)) for k, h in enumerate(harmonics, start=1))
    return t, 2.0 + 0.01 * np.sin(angle), y


@pytest.mark.parametrize("per_cycle", [6, 7.3, 50, 1000])
@pytest.mark.parametrize("frequency", [None, 40.0])
def test_a_sine_gives_its_gain_and_lag(frequency, per_cycle):
    point = sine_point(*sine_record(per_cycle=per_cycle), frequency=frequency)
    assert point.frequency == pytest.approx(40.0, rel=1e-5)
    assert abs(point.gain) == pytest.approx(25.0, rel=1e-4)
    assert np.angle(point.gain) == pytest.approx(-0.6, abs=1e-3)
    assert point.input_amplitude == pytest.approx(0.01, rel=1e-4)
    assert point.output_amplitude == pytest.approx(0.25, rel=1e-4)


def test_a_sine_need_not_be_sampled_evenly():
    t, u, y = sine_record()
    keep = np.sort(rng().choice(len(t) - 2, len(t) // 40, replace=False)) + 1
    move = np.zeros(len(t))
    move[keep] = 0.3 * (t[1] - t[0])
    t2 = t + move
    angle = 2 * np.pi * 40.0 * t2
    point = sine_point(t2, np.sin(angle), np.sin(angle - 1.0), frequency=40.0)
    assert point.gain == pytest.approx(np.exp(-1j), rel=1e-9)


def test_known_harmonics_give_the_known_distortion():
    point = sine_point(*sine_record(harmonics=(1.0, 0.0, 0.03, 0.0, 0.04)), frequency=40.0)
    assert point.distortion == pytest.approx(0.05, rel=1e-9)
    assert point.residual == pytest.approx(0.0, abs=1e-9)
    beyond = sine_point(
        *sine_record(harmonics=(1.0, 0, 0, 0, 0, 0.02)), frequency=40.0
    )  # the sixth is no harmonic here
    assert beyond.distortion == pytest.approx(0.0, abs=1e-9)
    assert beyond.residual == pytest.approx(0.02, rel=1e-3)


def test_a_clipped_sine_has_the_distortion_of_its_series():
    t, u, y = sine_record(cycles=5, per_cycle=2000, lag=0.0, gain=1.0)
    clipped = np.clip(y - 0.7, -0.8, 0.8)
    # Fourier sine series of a sine clipped at 0.8, by quadrature over one cycle
    angle = np.linspace(0, 2 * np.pi, 200_001)
    wave = np.clip(np.sin(angle), -0.8, 0.8)
    b = [np.trapezoid(wave * np.sin(k * angle), angle) / np.pi for k in range(1, 6)]
    point = sine_point(t, u, clipped, frequency=40.0, allow_flat=True)
    assert point.distortion == pytest.approx(np.hypot(b[2], b[4]) / b[0], rel=1e-4)


def test_few_samples_a_cycle_give_no_distortion():
    assert np.isnan(sine_point(*sine_record(per_cycle=9), frequency=40.0).distortion)
    points = [sine_point(*sine_record(frequency=f, per_cycle=9), frequency=f) for f in (10.0, 20.0)]
    assert "10 samples a cycle" in reason(join_points(points).figures, "largest_distortion")


@pytest.mark.parametrize(
    "record, frequency, message",
    [
        (sine_record(cycles=0.7), 40.0, "no complete cycle"),
        (sine_record(per_cycle=4), 40.0, "4 samples a cycle"),
        (sine_record(), -1.0, "outside"),
        (sine_record(), 31.0, "no steady sine|no sine"),
        ((sine_record()[0], 0.01 * np.ones(265), sine_record()[2]), None, "does not move"),
        ((sine_record()[0], 0.01 * np.ones(265), sine_record()[2]), 40.0, "no sine"),
        ((sine_record()[0], np.sign(sine_record()[1] - 2.0), sine_record()[2]), 40.0, "no sine"),
        ((*sine_record()[:2], np.minimum(sine_record()[2], 0.8)), 40.0, "rests at its extreme"),
        ((*sine_record()[:2], 0.0 * sine_record()[2]), 40.0, "rests at its extreme"),
    ],
)
def test_a_record_that_is_no_steady_sine_is_refused(record, frequency, message):
    with pytest.raises(InputError, match=message):
        sine_point(*record, frequency=frequency)


@pytest.mark.parametrize("levels", [64, 4096])
def test_coarse_quantisation_is_not_taken_for_clipping(levels):
    t, u, y = sine_record(per_cycle=400)
    point = sine_point(t, u, np.round(y * levels / 0.5) * 0.5 / levels, frequency=40.0)
    assert abs(point.gain) == pytest.approx(25.0, rel=0.01)


# ---------------------------------------------------------------- figures of a frequency response


def points_of(system, frequencies):
    h = [complex(system(2j * np.pi * f)) for f in frequencies]
    return [SinePoint(frequency=f, gain=g, distortion=0.01, residual=0.0, input_amplitude=1.0, output_amplitude=abs(g))
            for f, g in zip(frequencies, h, strict=True)]  # fmt: skip


def second_order(natural=120.0, damping=0.4, gain=0.04):
    w = 2 * np.pi * natural
    return lambda s: gain * w**2 / (s**2 + 2 * damping * w * s + w**2)


SIXTHS = np.geomspace(1.0, 512.0, 55)  # six to the octave


def test_first_order_falls_by_3_db_at_its_corner():
    of = join_points(points_of(lambda s: 1 / (1 + s / (2 * np.pi * 77.0)), SIXTHS)).figures
    # -3 dB, not -3.0103 dB: 77 sqrt(10^0.3 - 1), and the reference at 1 Hz is 7e-4 dB down
    assert value(of, "frequency_minus_3_db") == pytest.approx(77.0 * np.sqrt(10**0.3 - 1), rel=5e-4)
    assert "not reached up to 512 Hz (there 81.4 of 90 degrees)" in reason(of, "frequency_minus_90_deg")
    assert value(of, "resonant_peak") == 0.0


def test_a_lowest_frequency_near_the_corner_gives_no_corner():
    of = join_points(points_of(lambda s: 1 / (1 + s / (2 * np.pi * 100.0)), np.geomspace(40.0, 400.0, 21))).figures
    assert "the lowest frequency of 40 Hz, to which it refers, is too near" in reason(of, "frequency_minus_3_db")


def test_second_order_lags_90_degrees_at_its_natural_frequency():
    response = join_points(points_of(second_order(), SIXTHS)[::-1])  # in any order
    assert value(response.figures, "frequency_minus_90_deg") == pytest.approx(120.0, rel=5e-4)
    peak = -20 * np.log10(2 * 0.4 * np.sqrt(1 - 0.4**2))
    assert value(response.figures, "resonant_peak") == pytest.approx(peak, abs=0.02)
    assert value(response.figures, "largest_distortion") == pytest.approx(1.0)
    assert response.amplitude_ratio[0] == 0.0
    assert response.phase_lag[-1] == pytest.approx(180.0, abs=15.0)


def test_the_phase_is_unwrapped_beyond_half_a_turn():
    delayed = join_points(points_of(lambda s: second_order()(s) * np.exp(-s * 2e-3), SIXTHS))
    assert delayed.phase_lag[-1] - join_points(points_of(second_order(), SIXTHS)).phase_lag[-1] == pytest.approx(
        360.0 * 512.0 * 2e-3, rel=1e-6
    )


def test_an_output_of_the_wrong_sign_has_no_90_degree_frequency():
    of = join_points(points_of(lambda s: -second_order()(s), SIXTHS)).figures
    assert "sign of the input" in reason(of, "frequency_minus_90_deg")


def test_points_of_low_coherence_serve_no_figure():
    response = join_points(points_of(second_order(), SIXTHS))
    hidden = dataclasses.replace(response, coherence=np.where(abs(SIXTHS - 120) < 50, 0.5, 1.0))
    assert "coherence is below" in reason(hidden.figures, "frequency_minus_90_deg")
    easy = dataclasses.replace(hidden, options=ResponseOptions(least_coherence=0.4))
    assert value(easy.figures, "frequency_minus_90_deg") == value(response.figures, "frequency_minus_90_deg")
    one = dataclasses.replace(response, coherence=np.where(np.arange(55) == 3, 0.5, 1.0))
    assert value(one.figures, "frequency_minus_90_deg") == value(response.figures, "frequency_minus_90_deg")
    none = dataclasses.replace(response, coherence=np.zeros(55))
    for name in ("frequency_minus_3_db", "frequency_minus_90_deg", "resonant_peak"):
        assert "at every frequency" in reason(none.figures, name)


def test_one_point_or_two_of_one_frequency_are_refused():
    point = points_of(second_order(), [10.0])
    for points in (point, point * 2):
        with pytest.raises(InputError, match="two or more"):
            join_points(points)


# ---------------------------------------------------------------- chirp records


RATE = 5000.0


def chirp_record(noise=0.0, end=20.0, corner=80.0):
    """A chirp through a Butterworth filter of known corner, noise on its output."""
    t = np.arange(int((end + 2) * RATE)) / RATE
    swept = signal.chirp(np.clip(t - 1, 0, end), 1.0, end, 400.0, phi=-90)
    u = 0.01 * np.where((t > 1) & (t < 1 + end), swept, 0.0)
    b, a = signal.butter(2, corner, fs=RATE)
    return t, u, 1.0 + 3.0 * signal.lfilter(b, a, u) + noise * rng().standard_normal(len(t)), (b, a)


def test_a_chirp_gives_the_gain_the_corner_and_the_lag_of_a_known_filter():
    t, u, y, (b, a) = chirp_record()
    response = spectral_response(t, u, y, low=4.0, high=350.0)
    _, h = signal.freqz(b, a, worN=response.frequency, fs=RATE)
    assert np.max(np.abs(20 * np.log10(np.abs(response.gain / (3.0 * h))))) < 0.05
    assert np.max(np.abs(np.angle(response.gain / h, deg=True))) < 0.5
    assert value(response.figures, "frequency_minus_3_db") == pytest.approx(80.0, rel=0.005)
    assert value(response.figures, "frequency_minus_90_deg") == pytest.approx(80.0, rel=0.005)
    assert response.coherence.min() > 0.99
    assert response.amplitude == pytest.approx(0.01, rel=1e-3)
    assert "steady sines" in reason(response.figures, "largest_distortion")


def test_noise_lowers_the_coherence_where_the_output_is_small():
    t, u, y, _ = chirp_record(noise=5e-3)
    response = spectral_response(t, u, y, low=4.0, high=350.0)
    assert np.median(response.coherence[response.frequency < 60]) > 0.95
    assert np.median(response.coherence[response.frequency > 300]) < 0.8
    assert value(response.figures, "frequency_minus_3_db") == pytest.approx(80.0, rel=0.05)


@pytest.mark.parametrize(
    "change, options, message",
    [
        (lambda t, u, y: (t, 0 * u, y), {}, "does not move"),
        (lambda t, u, y: (t, u, np.clip(y, 0.99, 1.01)), {}, "rests at its extreme"),
        (lambda t, u, y: (t, u, y), {"high": 900.0}, "5.56 samples a cycle"),
        (lambda t, u, y: (t, u, y), {"low": -1.0}, "low = -1 Hz"),
        (lambda t, u, y: (t, u, y), {"low": 500.0, "high": 600.0}, "fewer than three points"),
        (lambda t, u, y: (t, u, y), {"resolution": 0.05}, "windows"),
        (lambda t, u, y: (t, u, y), {"resolution": 1e3}, "windows"),
    ],
)
def test_a_chirp_record_that_gives_nothing_is_refused(change, options, message):
    with pytest.raises(InputError, match=message):
        spectral_response(*change(*chirp_record()[:3]), **options)


# ---------------------------------------------------------------- the valve


def linearised(temperature, bias=0.0, drive=NOMINAL.drive):
    """f -> spool position per unit of command of the valve linearised at rest, by its exact Jacobians."""
    c = valve.at(vs.PartTemperatures.uniform(temperature))
    rest = vs.static_solution(valve, current=bias, temperature=temperature)
    model = vs.Model(drive)
    names = [channel.name for channel in model.state_channels]
    still = [getattr(rest, name, 0.0) for name in names]
    u = Inputs(bias, 0.0, valve.supply_pressure, valve.return_pressure, valve.load_pressure)
    A, B, _ = (np.array(m) for m in vs.derivatives(model)(np.array(still, float), np.array(u), np.array(c)))
    k, eye = names.index("spool_position"), np.eye(len(names))
    return lambda f: np.array([np.linalg.solve(2j * np.pi * each * eye - A, B[:, 0])[k] for each in f])


@pytest.mark.parametrize("temperature, bias", [(20.0, 0.0), (270.0, 0.0), (20.0, 5e-3)])
def test_small_sines_follow_the_linearised_valve(temperature, bias):
    f = np.geomspace(5.0, 300.0, 12)
    taken = frequency_response(valve, amplitude=1e-4, frequencies=f, oil_temperature=temperature, bias=bias)
    exact = linearised(temperature, bias)(f)
    # asked for: 0.5 dB and 3 degrees; measured: 1e-4 dB and 1e-4 degrees
    assert np.max(np.abs(20 * np.log10(np.abs(taken.gain / exact)))) < 0.005
    assert np.max(np.abs(np.angle(taken.gain / exact, deg=True))) < 0.02
    assert np.max(taken.distortion) < 2e-3


@pytest.fixture(scope="module")
def quarter():
    return frequency_response(valve, amplitude=2.5e-3)


@pytest.fixture(scope="module")
def full():
    return frequency_response(valve, amplitude=10e-3)


@pytest.mark.parametrize("amplitude, sines", [(2.5e-3, "quarter"), (10e-3, "full")])
def test_a_chirp_agrees_with_stepped_sines(amplitude, sines, request):
    stepped = request.getfixturevalue(sines)
    chirped = chirp_response(valve, amplitude=amplitude)
    inside = (stepped.frequency > chirped.frequency[0]) & (stepped.frequency < 400.0)
    f = stepped.frequency[inside]
    gain = np.interp(f, chirped.frequency, np.abs(chirped.gain))
    lag = np.interp(f, chirped.frequency, chirped.phase_lag)
    assert np.max(np.abs(20 * np.log10(gain / np.abs(stepped.gain[inside])))) < 0.05
    assert np.max(np.abs(lag - stepped.phase_lag[inside])) < 0.5
    for name in ("frequency_minus_3_db", "frequency_minus_90_deg"):
        assert value(chirped.figures, name) == pytest.approx(value(stepped.figures, name), rel=0.005)


def test_figures_hardly_depend_on_the_grid_of_frequencies(quarter):
    fine = frequency_response(valve, amplitude=2.5e-3, frequencies=[5.0, *np.linspace(160.0, 290.0, 40)])
    for name in ("frequency_minus_3_db", "frequency_minus_90_deg"):
        assert value(quarter.figures, name) == pytest.approx(value(fine.figures, name), rel=1e-3)


def test_the_flapper_limits_the_full_stroke(quarter, full):
    for name in ("frequency_minus_3_db", "frequency_minus_90_deg"):
        assert value(full.figures, name) < 0.9 * value(quarter.figures, name)
    assert value(quarter.figures, "largest_distortion") < 0.1 < 5.0 < value(full.figures, "largest_distortion")
    low = full.frequency < 60.0  # below it the flapper has room at full stroke as well
    assert np.max(np.abs(full.amplitude_ratio - quarter.amplitude_ratio)[low]) < 0.1
    limit = value(lumped_figures(valve), "speed_limit")
    small, large = (step_response(valve, amplitude=a).figures for a in (0.5e-3, 10e-3))
    assert value(large, "mean_rate") < limit
    assert value(large, "mean_rate") < 0.95 * 20 * value(small, "mean_rate")


def test_the_reference_valve_stands_among_its_class(quarter):
    published = {figure.name: figure for figure in class_figures()}
    own = figures(lumped_figures(valve))
    # the reference valve is made of the lumps of NASA TN D-5388 at other pressures and with other arms
    for name, share in (("armature_frequency", 0.02), ("loop_gain", 0.03), ("speed_limit", 0.15)):
        assert own[name].value == pytest.approx(published[name].low, rel=share)
    of = {**figures(quarter.figures), **figures(step_response(valve, amplitude=10e-3).figures)}
    for name in ("frequency_minus_3_db", "time_to_90_percent", "overshoot"):
        assert published[name].low <= of[name].value <= published[name].high
    assert of["frequency_minus_90_deg"].value < 1.1 * published["frequency_minus_90_deg"].high
    one = ResponseSet(oil_temperature=20.0, steps=(), sweeps=(quarter,), chirps=())
    pairs = beside_class(valve, one)
    assert [theirs.name for theirs, _ in pairs] == [ours.name for _, ours in pairs] == list(published)
    assert [ours.name for _, ours in pairs if isinstance(ours, Absent)] == ["time_to_90_percent", "overshoot"]


def test_a_step_of_the_valve_ends_at_the_static_solution():
    for amplitude in (-5e-3, 2.5e-3):
        step = step_response(valve, amplitude=amplitude, oil_temperature=100.0)
        rest = vs.static_solution(valve, current=amplitude, temperature=100.0)
        assert value(step.figures, "change") == pytest.approx(float(rest.spool_position), rel=1e-4)
        assert step.share == pytest.approx(amplitude / 10e-3)
        assert step.oil_temperature == 100.0


def test_threads_do_not_change_a_response():
    f = [10.0, 50.0, 200.0]
    one, two = (frequency_response(valve, amplitude=5e-3, frequencies=f, workers=n).gain for n in (1, 2))
    assert np.array_equal(one, two)


def test_progress_rises_to_one():
    told = []
    frequency_response(valve, amplitude=1e-3, frequencies=[10.0, 20.0, 30.0], progress=told.append)
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    told.clear()
    measure_responses(
        valve, steps=(0.1,), sweeps=(0.1, 0.2), frequencies=[20.0, 100.0], chirp=False, progress=told.append
    )
    assert told == sorted(told) and told[-1] == 1.0


@pytest.mark.filterwarnings("always")
def test_a_command_beyond_rated_is_allowed_with_a_warning():
    with pytest.warns(ValidityWarning, match="beyond the rated current"):
        of = frequency_response(valve, amplitude=15e-3, frequencies=[10.0, 20.0])
    assert of.share == pytest.approx(1.5)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"amplitude": 0.0}, "amplitude = 0"),
        ({"amplitude": np.nan}, "amplitude = nan"),
        ({"frequencies": [10.0, -5.0]}, "-5 Hz is outside"),
        ({"frequencies": [10.0, 0.0]}, "0 Hz is outside"),
        ({"frequencies": [10.0, np.nan]}, "nan Hz is outside"),
        ({"frequencies": [[10.0, 20.0]]}, "a row of numbers"),
        ({"frequencies": []}, "a row of numbers"),
        ({"frequencies": [10.0]}, "two or more"),
        ({"frequencies": [10.0, 10.0]}, "a frequency of its own"),
        ({"output": "spool_positon"}, "did you mean 'spool_position'"),
        ({"cycles": 0}, "cycles = 0"),
        ({"workers": 0}, "workers = 0"),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused(options, message):
    given = {"amplitude": 1e-3, "frequencies": [10.0, 20.0], **options}
    with pytest.raises(InputError, match=message):
        frequency_response(valve, **given)


def test_a_step_or_chirp_that_makes_no_sense_is_refused():
    with pytest.raises(InputError, match="amplitude = 0"):
        step_response(valve, amplitude=0.0)
    with pytest.raises(InputError, match="did you mean"):
        step_response(valve, amplitude=1e-3, output="spool")
    with pytest.raises(InputError, match="must be below"):
        chirp_response(valve, amplitude=1e-3, low=100.0, high=50.0)
    with pytest.raises(InputError, match="batch"):
        held(vs.Valve(spool_mass=np.array([1e-3, 2e-3])))


# ---------------------------------------------------------------- what is held


def test_a_scenario_is_held_as_it_is_at_its_start():
    scenario = vs.Scenario(
        valve=valve,
        thermal=vs.Thermal(initial_temperature=20.0),
        oil_temperature=vs.Ramp(start_value=150.0, end_value=270.0, rate=3.0),
        supply_pressure=vs.Step(before=20e6, after=15e6, time=0.1),
        effects=(vs.effect("spool_coulomb_friction")(friction_force=1.0),),
    )
    base = held(scenario)
    still = dataclasses.replace(base, command=vs.Constant(), effects=(), duration=30.0, output_rate=1.0)
    result = vs.simulate(still)
    for name, expected in (("oil", 150.0), ("pilot_metal", 20.0), ("torque_motor", 20.0)):
        assert result.values[f"{name}_temperature"] == pytest.approx(expected)
    assert result.values["supply_pressure"] == pytest.approx(20e6)
    assert base.effects == scenario.effects
    assert held(base) == base


def test_cold_parts_and_warm_parts_respond_unlike():
    f = [5.0, *np.linspace(150.0, 300.0, 7)]
    one, other = (
        frequency_response(valve, amplitude=1e-3, frequencies=f, oil_temperature=270.0, part_temperature=part)
        for part in (20.0, 270.0)
    )
    same = frequency_response(valve, amplitude=1e-3, frequencies=f, oil_temperature=270.0)
    assert np.allclose(other.gain, same.gain, rtol=1e-9)
    assert abs(value(one.figures, "frequency_minus_3_db") / value(other.figures, "frequency_minus_3_db") - 1) > 0.05


def test_a_drive_by_voltage_is_told_per_volt():
    scenario = vs.Scenario(valve=valve, drive=vs.VoltageDrive(), thermal=vs.Thermal(network=None))
    assert rated_command(held(scenario)) == pytest.approx(6.0)  # 10 mA on 600 ohm
    f = np.geomspace(5.0, 300.0, 6)
    taken = frequency_response(scenario, amplitude=0.06, frequencies=f)
    assert taken.share == pytest.approx(0.01)
    exact = linearised(20.0, drive=vs.VoltageDrive())(f)
    assert np.max(np.abs(20 * np.log10(np.abs(taken.gain / exact)))) < 0.005
    assert np.max(np.abs(np.angle(taken.gain / exact, deg=True))) < 0.02


def test_other_outputs_have_their_units():
    step = step_response(valve, amplitude=5e-3, output="load_flow")
    assert step.unit == "m^3/s" and figures(step.figures)["change"].unit == "m^3/s"
    rest = step_response(valve, amplitude=5e-3)
    ratio = value(step.figures, "time_to_90_percent") / value(rest.figures, "time_to_90_percent")
    assert ratio == pytest.approx(1.0, abs=0.05)


# ---------------------------------------------------------------- the report


def test_a_report_gives_figures_and_pictures(tmp_path):
    f = np.geomspace(10.0, 400.0, 6)
    sets = measure_responses(valve, oil_temperatures=(20.0, 100.0), sweeps=(0.25, 1.0), frequencies=f, chirp=False)
    paths = response_report(sets, tmp_path / "r", valve="valve 17 <b>", date=DAY)
    names = ["bode.png", "distortion.png", "step.png", "bandwidth.png", "response.html"]
    assert [path.name for path in paths] == names
    page = paths[-1].read_text(encoding="utf-8")
    assert "valve 17 &lt;b&gt; · valvesim" in page and "2026-01-02" in page and page.count("data:image/png") == 4
    for figure in draw_responses(sets).values():
        check_texts(figure)
    assert all(path.stat().st_size > 10_000 for path in paths)
    assert [one.oil_temperature for one in sets] == [20.0, 100.0]
    assert [sweep.share for sweep in sets[0].sweeps] == [0.25, 1.0]
    assert all(isinstance(sweep, FrequencyResponse) for one in sets for sweep in one.sweeps)


def test_a_report_draws_what_it_has(tmp_path):
    # two frequencies far below the bandwidth: no figure to mark, no step at all
    sets = measure_responses(valve, steps=(), sweeps=(0.25,), frequencies=[10.0, 20.0], chirp=False)
    drawn = draw_responses(sets)
    assert list(drawn) == ["bode", "distortion"]
    for figure in drawn.values():
        check_texts(figure)
    assert "not reached" in reason(sets[0].sweeps[0].figures, "frequency_minus_3_db")


def test_a_folder_that_cannot_be_made_is_refused_first(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        response_report((), tmp_path / "file", valve="", date=DAY)


def test_a_response_is_that_of_parts_at_their_own_temperatures():
    """At a launch the oil is hot while the body is not: the scenario's state at time zero is tested."""

    def stiffness(**thermal):
        scenario = vs.Scenario(oil_temperature=vs.Constant(value=120.0), thermal=vs.Thermal(**thermal))
        figures = {figure.name: figure.value for figure in lumped_figures(scenario)}
        return figures["armature_frequency"], figures["loop_gain"]

    cold = stiffness(initial_temperature=20.0)
    assert stiffness(initial_temperature=dict.fromkeys(THERMAL_NODES, 20.0)) == cold
    hot_tube = stiffness(initial_temperature=dict.fromkeys(THERMAL_NODES, 20.0) | {"spring_tube": 120.0})
    assert hot_tube[0] != pytest.approx(cold[0], rel=1e-4)
    assert stiffness(initial_temperature={"pilot_metal": 120.0}) == stiffness()  # left out: with the oil
