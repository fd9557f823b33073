"""White noise and rounding of the instrument upon a measured input: found, told and taken away; what moves stays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvesim.identification.input_noise import input_noise, rounding_error, without_noise, without_rounding
from valvesim.identification.options import DEFAULT_IDENTIFICATION

TIME = np.arange(1001) / 1e3
DICE = np.random.default_rng(3)
STEP = np.where(TIME < 0.1, 0.0, 4.0)
PRBS = 3.0 * np.sign(np.repeat(DICE.normal(size=101), 10)[:1001])
COMMANDS = {
    "triangle": np.interp(TIME, [0.0, 0.25, 0.75, 1.0], [0.0, 8.0, -8.0, 0.0]),
    "sine": 4.0 * np.sin(2.0 * np.pi * 5.0 * TIME),
    "chirp": np.sin(2.0 * np.pi * (2.0 * TIME + 100.0 * TIME**2)),
    "step": STEP,
    "filtered step": STEP * (1.0 - np.exp(-np.clip(TIME - 0.1, 0.0, None) / 2e-3)),
    "binary": PRBS,
    "dither": STEP + 0.5 * np.sin(2.0 * np.pi * 400.0 * TIME),
}
OPTIONS = DEFAULT_IDENTIFICATION.input_noise


@pytest.mark.parametrize("name", COMMANDS)
def test_a_clean_command_has_no_noise(name):
    assert input_noise(COMMANDS[name], options=OPTIONS) < 1e-3


@pytest.mark.parametrize("name", COMMANDS)
def test_the_noise_of_an_instrument_is_found_whatever_the_command_does(name):
    read = COMMANDS[name] + np.random.default_rng(11).normal(0.0, 0.02, 1001)  # whichever tests have drawn before
    assert input_noise(read, options=OPTIONS) == pytest.approx(0.02, rel=0.25)


@pytest.mark.parametrize("name", COMMANDS)
def test_what_moves_stays_to_some_deviations_of_the_noise(name):
    read = COMMANDS[name] + np.random.default_rng(12).normal(0.0, 0.02, 1001)
    left = without_noise(read, 0.02, options=OPTIONS) - COMMANDS[name]
    assert np.max(np.abs(left)) < 4.0 * 0.02


@pytest.mark.parametrize("name", ["triangle", "sine", "step", "filtered step"])
def test_most_of_the_noise_of_a_slow_command_goes(name):
    read = COMMANDS[name] + np.random.default_rng(12).normal(0.0, 0.02, 1001)
    left = without_noise(read, 0.02, options=OPTIONS) - COMMANDS[name]
    assert np.sqrt(np.mean(left**2)) < 0.5 * 0.02


def test_the_shortest_record_is_cleaned_too():
    read = np.linspace(0.0, 1.0, 50) + np.random.default_rng(13).normal(0.0, 0.02, 50)
    assert np.std(without_noise(read, 0.02, options=OPTIONS) - np.linspace(0.0, 1.0, 50)) < 0.02


def rounded(values, step):
    return np.round(values / step) * step


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("step", [0.005, 0.01, 0.04])
def test_what_rounding_may_have_done_is_as_much_as_it_has_done(name, step):
    read, dice = rounded(COMMANDS[name] + step / 3.0, step), np.random.default_rng(1)
    cleaned = without_rounding(read, step)
    off = np.sqrt(np.mean((cleaned - COMMANDS[name] - step / 3.0) ** 2))
    thought = np.sqrt(np.mean([rounding_error(cleaned, step, dice) ** 2 for _ in range(50)]))
    assert thought <= step / np.sqrt(12.0) * 1.1
    assert off < 2.5 * thought  # half a step throughout is 2.1 deviations of what was interpolated


@pytest.mark.parametrize("name", ["triangle", "sine"])
def test_the_rounding_of_a_slow_command_goes(name):
    left = without_rounding(rounded(COMMANDS[name] / 50.0, 0.01), 0.01) - COMMANDS[name] / 50.0
    assert np.sqrt(np.mean(left**2)) < 0.5 * 0.01 / np.sqrt(12.0)


@given(
    values=st.lists(st.integers(-300, 300), min_size=2, max_size=60),
    offset=st.floats(-1.0, 1.0),
    step=st.floats(1e-6, 1e3),
)
@settings(max_examples=200, deadline=None)
def test_what_was_read_on_a_grid_stays_within_half_a_step_of_it(values, offset, step):
    read = (np.array(values) + offset) * step
    cleaned = without_rounding(read, step)
    assert np.max(np.abs(cleaned - read)) <= 0.5 * step * (1.0 + 1e-6)
    np.testing.assert_allclose(without_rounding(-read, step), -cleaned, atol=1e-9 * step)
    np.testing.assert_allclose(without_rounding(read[::-1], step), cleaned[::-1], atol=1e-6 * step)


def test_an_input_that_stands_still_stays_as_it_is():
    assert np.array_equal(without_rounding(np.full(50, 3.7), 0.1), np.full(50, 3.7))
