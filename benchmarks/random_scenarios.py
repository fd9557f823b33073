"""Random scenarios from one seed: every shape of input, oil, drive, effect, pressure and temperature that may be asked.

`scenarios(seed, count)` yields what a scenario may say, not what a test finds convenient: quiet valves, stops that are
struck, cold oil, jumps in everything. Draws that the program refuses (a clearance that closes, say) are drawn again.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np

import valvesim as vs
from valvesim.errors import InputError
from valvesim.simulation.result import check_channels
from valvesim.valve.effect import ActiveEffect, Effect

SHAPES = ("constant", "step", "ramp", "sine", "chirp", "pulse", "staircase", "table", "sum")
RATED = 10e-3  # A
SAMPLES = 1500


def shape(rng: np.random.Generator, low: float, high: float, duration: float, *, kind: str = "") -> vs.Command:
    """A command of a random kind with values in [low, high]."""
    kind = kind or str(rng.choice(SHAPES))
    one, other = rng.uniform(low, high, 2)
    middle, swing = (one + other) / 2.0, abs(other - one) / 2.0
    at = float(rng.uniform(0.0, 0.95 * duration)) if rng.random() < 0.8 else 0.0
    frequency = float(np.exp(rng.uniform(np.log(0.5 / duration), np.log(200.0))))
    if kind == "constant":
        return vs.Constant(value=one)
    if kind == "step":
        return vs.Step(before=one, after=other, time=at)
    if kind == "ramp":
        rate = abs(other - one) / (duration * np.exp(rng.uniform(np.log(1e-3), np.log(2.0)))) + 1e-300
        return vs.Ramp(start_value=one, end_value=other, rate=rate, time=at)
    if kind == "sine":
        return vs.Sine(amplitude=swing, offset=middle, frequency=frequency, time=at, phase=rng.uniform(0.0, 6.0))
    if kind == "chirp":
        first, last = np.exp(rng.uniform(np.log(1.0 / duration), np.log(300.0), 2))
        length = float(rng.uniform(0.2, 1.0)) * duration
        return vs.Chirp(
            amplitude=swing, offset=middle, start_frequency=first, end_frequency=last, duration=length, time=at,
            logarithmic=bool(rng.random() < 0.5),
        )  # fmt: skip
    if kind == "pulse":
        width = float(np.exp(rng.uniform(np.log(1e-4 * duration), np.log(0.4 * duration))))
        period = np.inf if rng.random() < 0.6 else max(width * rng.uniform(1.2, 5.0), duration / 40.0)
        return vs.Pulse(base=one, height=other - one, width=width, time=at, period=float(period))
    if kind == "staircase":
        steps = int(rng.integers(1, 20))
        return vs.Staircase(start_value=one, end_value=other, steps=steps, hold=duration / (steps + 1.0))
    if kind == "table":
        times = np.unique(np.sort(rng.uniform(0.0, duration, int(rng.integers(2, 25)))))
        return vs.Table(times=tuple(times), values=tuple(rng.uniform(low, high, len(times))))
    third = (high - low) / 3.0
    terms = [shape(rng, -third / 2.0, third / 2.0, duration, kind=str(rng.choice(SHAPES[1:8]))) for _ in range(2)]
    return vs.Sum((vs.Constant(value=(low + high) / 2.0), *terms))


def effect_of(rng: np.random.Generator, entry: Effect) -> ActiveEffect:
    """An effect at a share of what is seen in service, or beyond it."""
    if entry.reading is not None:
        entry = entry.on(str(rng.choice(("spool_position", "load_flow", "nozzle_pressure_1"))))
    amplitude = entry.amplitude
    typical = amplitude.typical if amplitude.typical is not None else amplitude.default
    neutral = amplitude.neutral or 0.0
    value = neutral + (typical - neutral) * rng.uniform(0.2, 2.0)
    return entry(**{amplitude.name: float(np.clip(value, *amplitude.bounds))})


def draw(rng: np.random.Generator) -> vs.Scenario:
    """One scenario; InputError where what was drawn cannot be."""
    duration = float(np.exp(rng.uniform(np.log(0.05), np.log(4.0))))
    voltage = rng.random() < 0.2
    reach = RATED * (0.3 if rng.random() < 0.3 else 1.0 if rng.random() < 0.8 else 2.5)
    supply = float(np.exp(rng.uniform(np.log(10e5), np.log(350e5))))
    oil = vs.OILS[str(rng.choice(sorted(vs.OILS)))]
    cold, hot = np.sort(rng.uniform(-54.0, 270.0, 2))
    valve = vs.reference_valve()
    unit = valve.coil_resistance if voltage else 1.0
    quiet = rng.random() < 0.35  # a held command is what hid the worst errors
    command = shape(rng, -reach * unit, reach * unit, duration, kind="constant" if quiet else "")
    steady = rng.random() < 0.6
    held = "constant" if steady else ""
    effects: tuple[ActiveEffect, ...] = ()
    if rng.random() < 0.5:
        effects = (effect_of(rng, vs.CATALOGUE[str(rng.choice(sorted(vs.CATALOGUE)))]),)
    isothermal = rng.random() < 0.5
    return vs.Scenario(
        title="random",
        duration=duration,
        oil=oil,
        thermal=vs.Thermal(
            network=None if isothermal else vs.ThermalNetwork(),
            throttling_heat=bool(rng.random() < 0.3),
            initial_temperature=None if isothermal or rng.random() < 0.5 else float(rng.uniform(cold, hot)),
        ),
        oil_temperature=shape(rng, float(cold), float(hot), duration),
        drive=vs.VoltageDrive() if voltage else vs.CurrentDrive(),
        command=command,
        supply_pressure=shape(rng, (1.0 if steady else 0.7) * supply, supply, duration, kind=held),
        return_pressure=shape(rng, 0.0, 0.1 * supply, duration, kind="constant" if rng.random() < 0.8 else ""),
        load_pressure=shape(rng, -0.6 * supply, 0.6 * supply, duration, kind="constant" if rng.random() < 0.6 else ""),
        effects=effects,
        output_rate=SAMPLES / duration * float(rng.uniform(0.7, 1.3)),
    )  # fmt: skip


def scenarios(seed: int, count: int) -> Iterator[vs.Scenario]:
    """`count` scenarios that the program accepts."""
    rng, made = np.random.default_rng(seed), 0
    while made < count:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                scenario = draw(rng)
                scenario.valve.at(scenario.temperatures(spacing=scenario.duration / 50.0).parts, oil=scenario.oil)
                check_channels(scenario)
            except InputError:
                continue
        made += 1
        yield scenario
