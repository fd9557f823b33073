"""White noise of the instrument upon a measured input: found, told and taken away; what moves stays."""

import numpy as np
import pytest

from valvesim.identification.input_noise import input_noise, without_noise
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
    assert input_noise(COMMANDS[name] + DICE.normal(0.0, 0.02, 1001), options=OPTIONS) == pytest.approx(0.02, rel=0.25)


@pytest.mark.parametrize("name", COMMANDS)
def test_what_moves_stays_to_some_deviations_of_the_noise(name):
    read = COMMANDS[name] + DICE.normal(0.0, 0.02, 1001)
    left = without_noise(read, 0.02, options=OPTIONS) - COMMANDS[name]
    assert np.max(np.abs(left)) < 4.0 * 0.02


@pytest.mark.parametrize("name", ["triangle", "sine", "step", "filtered step"])
def test_most_of_the_noise_of_a_slow_command_goes(name):
    read = COMMANDS[name] + DICE.normal(0.0, 0.02, 1001)
    left = without_noise(read, 0.02, options=OPTIONS) - COMMANDS[name]
    assert np.sqrt(np.mean(left**2)) < 0.5 * 0.02


def test_the_shortest_record_is_cleaned_too():
    read = np.linspace(0.0, 1.0, 50) + DICE.normal(0.0, 0.02, 50)
    assert np.std(without_noise(read, 0.02, options=OPTIONS) - np.linspace(0.0, 1.0, 50)) < 0.02
