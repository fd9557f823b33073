"""The nominal valve in C by hand (hand_written.c), compiled here and run as the comparator of benchmarks/solvers.py."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from valvesim.channels import STATE_CHANNELS
from valvesim.inputs import Chirp, Command, Sine, Step
from valvesim.simulation.driver import ABSOLUTE_SHARE
from valvesim.simulation.run import Problem

COMPILER = ("gcc", "-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")
SCALE = np.array([channel.scale for channel in STATE_CHANNELS])


class _Command(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("offset", "amplitude", "frequency", "sweep", "time")]


@cache
def _library() -> ctypes.CDLL:
    """The compiled file. Raises FileNotFoundError without gcc."""
    folder = Path(tempfile.mkdtemp())
    subprocess.run([*COMPILER, "-o", folder / "hand_written.so", Path(__file__).with_suffix(".c"), "-lm"], check=True)
    library = ctypes.CDLL(str(folder / "hand_written.so"))
    library.hand_written.restype = ctypes.c_long
    return library


def _command(command: Command) -> tuple[float, _Command]:
    """(when it begins to act, the command from then on)."""
    if isinstance(command, Step):
        return command.time, _Command(command.after, 0.0, 0.0, 0.0, 0.0)
    if isinstance(command, Sine):
        return 0.0, _Command(command.offset, command.amplitude, command.frequency, 0.0, command.time)
    if isinstance(command, Chirp) and not command.logarithmic:
        sweep = (command.end_frequency - command.start_frequency) / command.duration
        return 0.0, _Command(command.offset, command.amplitude, command.start_frequency, sweep, command.time)
    raise TypeError(f"{command} is not in hand_written.c")


def hand_written(problem: Problem, member: int, rtol: float) -> Callable[[], tuple[np.ndarray, int]]:
    """A run of a member: () -> (states (n_t, 6) in SI, steps tried)."""
    library, scenario = _library(), problem.scenario
    begin, command = _command(scenario.command)
    rest = problem.initial[member] * SCALE
    pressures = problem.rows[0, 1:, 1].copy()
    times, knot_times, knots = (
        np.ascontiguousarray(x) for x in (problem.times, problem.path.times, problem.knots[member])
    )
    out = np.empty((len(times), len(rest)))

    def array(values: np.ndarray) -> ctypes.c_void_p:
        return values.ctypes.data_as(ctypes.c_void_p)

    def run() -> tuple[np.ndarray, int]:
        y = rest.copy()
        tried = library.hand_written(
            ctypes.c_double(begin), ctypes.c_double(scenario.duration), array(y), array(rest), array(SCALE),
            array(pressures), ctypes.byref(command), ctypes.c_long(len(knot_times)), array(knot_times), array(knots),
            ctypes.c_double(rtol), ctypes.c_double(ABSOLUTE_SHARE), ctypes.c_long(len(times)), array(times), array(out),
        )  # fmt: skip
        if tried < 0:
            raise RuntimeError(f"hand-written C fails at rtol {rtol:g}")
        return out, tried

    return run
