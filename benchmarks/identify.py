"""How well a valve is identified from its acceptance figures: hidden valves of six sizes, and the pages of catalogues.

    python benchmarks/identify.py --cases 60 -o results/identify.jsonl             # an hour of one core
    python benchmarks/identify.py --cases 60 --records -o results/records.jsonl
    python benchmarks/identify.py --model-error --cases 24                         # two minutes
    python benchmarks/identify.py --pages -o docs/catalogue_pages.md               # half a minute

A hidden valve is drawn from what similarity allows at its size (normal, cut at 2.5 deviations) and tested by the plant
of the tests (`tests/hidden_plant.py`: classical Runge-Kutta, an amplifier, a supply line and a second mode of the
armature of its own). Its figures are told with the noise of instruments (ISO 10770-1); with `--records` its flow
curve, blocked ports, chirp and step are written as files and reduced as measured ones instead. The answer's intervals
are held against the truth, and its Bode at 25 % of rated current, which nobody had told, against the plant's.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import hidden_plant as plant  # noqa: E402

import valvesim as vs  # noqa: E402
from valvesim.characterisation.judgement_table import (  # noqa: E402
    asked_text,
    condition_text,
    interval_text,
    value_cells,
)
from valvesim.characterisation.measured_valve import load_measured_valve  # noqa: E402
from valvesim.characterisation.specification import (  # noqa: E402
    COMMON,
    FIGURES,
    Limit,
    Specification,
    load_specification,
)
from valvesim.identification.from_figures.dynamic_figures import Bench, Sines  # noqa: E402
from valvesim.identification.from_figures.identify import Identification, identify  # noqa: E402
from valvesim.identification.from_figures.prediction import FigurePredictor, asked_of  # noqa: E402
from valvesim.identification.from_figures.similarity import UNKNOWNS, similar_valves  # noqa: E402
from valvesim.identification.from_figures.static_figures import static_figures  # noqa: E402
from valvesim.units import quantities  # noqa: E402
from valvesim.valve.coefficients import PartTemperatures  # noqa: E402

SIZES = ((4.0, 40e-3), (10.0, 10e-3), (19.0, 40e-3), (38.0, 40e-3), (75.0, 30e-3), (150.0, 15e-3))  # L/min, A
CONDITIONS = {"supply_pressure": 21e6, "return_pressure": 0.5e6, "oil_temperature": 40.0}
OIL = vs.MIL_PRF_5606
NOISE = {
    "coil_resistance": 0.01, "coil_inductance": 0.025, "rated_flow": 0.0125, "flow_gain": 0.0125, "pressure_gain": 0.03,
    "null_leakage": 0.0125, "tare_leakage": 0.0125, "frequency_minus_3_db": 0.02, "frequency_minus_90_deg": 0.02,
    "time_to_90_percent": 0.02,
}  # fmt: skip
"""One standard deviation of each figure as a share."""
TOLD, HIDDEN = (0.4, 1.0), 0.25  # amplitudes, shares of rated current
DRAWS = 40  # valves from an answer, of which the interval of a Bode is told


@dataclass(frozen=True)
class HiddenValve:
    """A valve under test by the plant; `step` s of its Runge-Kutta, `cycle` s of a slow cycle of its current."""

    valve: vs.Valve
    step: float
    line: float
    cycle: float = 0.6

    def run(self, command: np.ndarray, rate: float, load: float = 0.0) -> dict[str, np.ndarray]:
        """`time`, `current` in the coils, `spool_position`, `load_flow`, `internal_leakage` under a command (n,), A,
        after it has settled. The current lags the command by the plant's amplifier.
        """
        c = self.valve.at(PartTemperatures.uniform(CONDITIONS["oil_temperature"]), oil=OIL)._asdict()
        c["pinch_force"] = 0.0
        table = np.array([[float(c[name]) for name in plant.FIGURES]])
        now, knobs = (np.zeros(1, dtype=[(n, float) for n in names]) for names in (plant.FIGURES, plant.KNOBS))
        for name in plant.KNOBS:
            knobs[name] = {**plant.OFF, "line_resistance": self.line}[name]
        each = max(int(np.ceil(1.0 / rate / self.step)), 1)
        y = np.zeros(plant.STATES)
        y[2] = y[3] = CONDITIONS["supply_pressure"] / 2.0
        settled = np.concatenate([np.full(int(0.05 * rate) + 2, command[0]), command, command[-1:]])
        out = np.empty((len(settled) - 1, len(plant.RECORDED)))
        plant._integrate(
            y, settled, rate, CONDITIONS["supply_pressure"], (0.0, 0.0, 0.0), CONDITIONS["return_pressure"], load,
            table, now, now.view(float), knobs, each, each, out,
        )  # fmt: skip
        out = out[len(settled) - len(command) - 1 :][: len(command)]
        named = dict(zip(plant.RECORDED, out.T, strict=True))
        return {"time": np.arange(len(command)) / rate} | {
            name: named[name] for name in ("current", "spool_position", "load_flow", "internal_leakage")
        }

    def gain(self, amplitude: float, frequency: float) -> complex:
        """Complex gain, spool over the current in the coils, as ISO 10770-1 measures it."""
        rate, top = 64.0 * frequency, amplitude * self.valve.rated_current
        t = np.arange(int(np.ceil(0.05 * frequency) + 3) * 64) / rate
        run = self.run(top * np.sin(2 * np.pi * frequency * t), rate)
        angle = 2.0 * np.pi * frequency * t[-64:]
        basis = np.column_stack([np.cos(angle), -np.sin(angle), np.ones(64), t[-64:]])  # a slow valve still drifts
        both = np.column_stack([run["spool_position"][-64:], run["current"][-64:]])
        x, current = np.linalg.lstsq(basis, both, rcond=None)[0][:2].T @ (1.0, 1j)
        return complex(x / current)


def hide(flow: float, current: float, dice: np.random.Generator) -> HiddenValve:
    """A valve of a size."""
    similar = similar_valves(
        rated_flow=flow / 6e4, pressure_drop=7e6, rated_current=current, conditions=CONDITIONS, oil=OIL
    )
    points = dice.normal(size=(1500, len(UNKNOWNS)))
    points = points[np.abs(points).max(axis=1) < 2.8]
    drawn = similar.valves(points)
    rated = static_figures(drawn, {"rated_flow"}, {**CONDITIONS, "pressure_drop": 7e6}, OIL)["rated_flow"]
    of_size = np.abs(np.log(rated / (flow / 6e4))) < 0.05  # as its maker would name it
    believable = dice.uniform(size=len(points)) < np.exp(-0.5 * similar.ampere_turns(drawn) ** 2)  # the prior's own
    first = int(np.argmax(of_size & believable))
    batch = similar.valves(points[first : first + 1])
    valve = replace(similar.base, **{n: float(np.ravel(getattr(batch, n))[0]) for n in quantities(batch)})
    c = valve.at(PartTemperatures.uniform(40.0), oil=OIL)
    fastest = np.sqrt(2.0 * c.spool_area**2 * c.bulk_modulus_at_zero * 1.2 / (c.chamber_volume * c.spool_mass))
    stops = np.sqrt(valve.flapper_stop_stiffness * valve.nozzle_arm**2 / valve.armature_inertia)
    return HiddenValve(valve, min(2e-5, 1.0 / fastest, 1.0 / stops), 1.5e7 * 15.0 / flow)


# --------------------------------------------------------------------------- its acceptance figures


RATE = 4e3  # Hz, of slow cycles
HIGHEST = 4e3  # Hz, of sines


def slow(hidden: HiddenValve) -> np.ndarray:
    """A slow full cycle of the current, slowest about null."""
    top = hidden.valve.rated_current
    t = np.arange(int(hidden.cycle * RATE)) / RATE / hidden.cycle
    s = np.interp(t, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])
    return top * s * np.abs(s)


def branches(run: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Samples of both branches of a cycle, each with its current rising."""
    up = np.diff(run["current"], prepend=run["current"][0]) >= 0.0
    each = (np.flatnonzero(up), np.flatnonzero(~up))
    return [k[np.argsort(run["current"][k], kind="stable")] for k in each]


def middle(run: dict[str, np.ndarray], name: str, at: np.ndarray) -> np.ndarray:
    """The mean of both branches at currents: what the valve trails by goes."""
    return np.mean([np.interp(at, run["current"][k], run[name][k]) for k in branches(run)], axis=0)


def at_no_flow(hidden: HiddenValve, load: float, near: float) -> tuple[float, float]:
    """(current, leakage) at rest at which no load flow passes at a load pressure; `near` is a current near it."""
    from scipy.optimize import brentq

    rated = hidden.valve.rated_current

    def rest(current: float) -> tuple[float, float]:
        run = hidden.run(np.full(int(0.08 * hidden.cycle * RATE) + 2, current), RATE, load)
        return float(run["load_flow"][-1]), float(run["internal_leakage"][-1])

    width = 2e-3 * rated
    while rest(near - width)[0] > 0.0 or rest(near + width)[0] < 0.0:
        width *= 2.0
    current = brentq(lambda i: rest(i)[0], near - width, near + width, xtol=1e-7 * rated)
    return current, rest(current)[1]


def blocked(hidden: HiddenValve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(current, load pressure, leakage) at blocked ports at rest."""
    from scipy.interpolate import PchipInterpolator

    supply, top = CONDITIONS["supply_pressure"], hidden.valve.rated_current
    loads = supply * np.concatenate([[-0.995], np.linspace(-0.96, 0.96, 17), [0.995]])
    found, near = [], 0.0
    for load in loads:
        found.append(at_no_flow(hidden, float(load), near))
        near = found[-1][0]
    current, leakage = np.array(found).T
    ends = [hidden.run(slow(hidden), RATE, float(load)) for load in loads[[0, -1]]]
    fine = supply * np.linspace(-0.995, 0.995, 399)
    i, leak = PchipInterpolator(loads, current)(fine), PchipInterpolator(loads, leakage)(fine)
    outer = top * np.linspace(0.02, 0.999, 60)
    left, right = -outer[::-1][-outer[::-1] < i[0]], outer[outer > i[-1]]
    return (
        np.concatenate([left, i, right]),
        np.concatenate([np.full(len(left), fine[0]), fine, np.full(len(right), fine[-1])]),
        np.concatenate([middle(ends[0], "internal_leakage", left), leak,
                        middle(ends[1], "internal_leakage", right)]),
    )  # fmt: skip


def true_figures(hidden: HiddenValve) -> dict[tuple[str, float], float]:
    """Figures (name, amplitude or 0) of a hidden valve, as the plant has them."""
    from valvesim.characterisation.acceptance.metrics import weighted_line

    valve, supply = hidden.valve, CONDITIONS["supply_pressure"]
    rated = valve.rated_current
    found: dict[tuple[str, float], float] = {
        ("coil_resistance", 0.0): valve.coil_resistance, ("coil_inductance", 0.0): valve.coil_inductance
    }  # fmt: skip
    low, f = hidden.gain(TOLD[0], 2.0), 2.0
    while (reached := hidden.gain(TOLD[0], f) / low).real > 0.0 and abs(reached) > 0.7:
        f *= 1.5
    corner, hidden = f, replace(hidden, cycle=max(0.6, 40.0 / f))
    held = np.full(int(max(0.05, 10.0 / corner) * RATE), rated)
    ends = [hidden.run(s * held, RATE, s * (supply - 7e6))["load_flow"][-1] for s in (-1.0, 1.0)]
    found["rated_flow", 0.0] = (ends[1] - ends[0]) / 2.0
    cycle = hidden.run(slow(hidden), RATE)
    i = np.linspace(0.05, 0.8, 40) * rated
    gains = [weighted_line(s * i, middle(cycle, "load_flow", s * i))[0] for s in (-1.0, 1.0)]
    found["flow_gain", 0.0] = float(np.mean(gains))
    at, pressure, leak = blocked(hidden)
    y = np.linspace(-0.4, 0.4, 41) * supply
    found["pressure_gain", 0.0] = weighted_line(np.interp(y, pressure, at), y)[0]
    found["null_leakage", 0.0] = float(leak.max())
    found["tare_leakage", 0.0] = float(np.interp([-0.975 * rated, 0.975 * rated], at, leak).mean())
    for amplitude in (*TOLD, HIDDEN):
        found |= {(name, amplitude): f for name, f in crossings(hidden, amplitude, corner).items()}
    expected = 0.35 / found["frequency_minus_3_db", 1.0]
    rate = 400.0 / expected
    command = np.where(np.arange(int(10 * expected * rate)) / rate < 0.5 * expected, 0.0, rated)
    step = hidden.run(command, rate)
    x = step["spool_position"] / step["spool_position"][-50:].mean()
    k = int(np.argmax(x >= 0.9))
    start = float(step["time"][np.argmax(step["current"] > 0.5 * rated)])
    found["time_to_90_percent", 1.0] = float(
        step["time"][k - 1] + (0.9 - x[k - 1]) / (x[k] - x[k - 1]) / rate - start
    )  # fmt: skip
    return found


def crossings(hidden: HiddenValve, amplitude: float, corner: float) -> dict[str, float]:
    """Where the response to sines passes -3 dB and -90 degrees (Hz), as far as it does below `HIGHEST`."""
    from scipy.optimize import brentq

    low, f, found = hidden.gain(amplitude, corner / 20.0), corner / 4.0, {}
    falls = {
        "frequency_minus_3_db": lambda gain: -3.0 - 20.0 * np.log10(abs(gain / low)),
        "frequency_minus_90_deg": lambda gain: -np.rad2deg(np.angle(gain * 1j)),
    }
    while len(found) < 2 and f < HIGHEST:
        gain, further = hidden.gain(amplitude, f), hidden.gain(amplitude, 1.1 * f)
        for name, fall in falls.items():
            if name not in found and fall(gain) < 0.0 <= fall(further):
                found[name] = brentq(lambda f, fall=fall: fall(hidden.gain(amplitude, f)), f, 1.1 * f, xtol=1e-3 * f)
        f *= 1.1
    return found


def specification(hidden: HiddenValve, figures: dict[tuple[str, float], float], dice) -> Specification:
    """What is told of a hidden valve: its figures with noise, and the spread of that noise as tolerance."""
    limits = [Limit(figure="rated_current", value=hidden.valve.rated_current)]
    for (name, amplitude), value in figures.items():
        if amplitude == HIDDEN:
            continue
        told = value * (1.0 + NOISE[name] * (0.0 if dice is None else dice.normal()))
        width = 2.0 * NOISE[name] * abs(told)
        at = {**{k: v for k, v in FIGURES[name].conditions.items() if v > 0.0}, **CONDITIONS}
        at |= {"amplitude": amplitude} if amplitude else {}
        limits.append(Limit(figure=name, value=told, low=told - width, high=told + width, conditions=at))
    return Specification(title="hidden", limits=tuple(limits), conditions=CONDITIONS, oil=OIL)


# --------------------------------------------------------------------------- its records

READING = 0.002  # share of a channel's greatest: one standard deviation of a reading


def write_records(hidden: HiddenValve, figures: dict[tuple[str, float], float], folder: Path, dice) -> None:
    """A folder with acceptance.toml: flow curve, blocked ports, chirp at 40 % and step at 100 % of rated current."""
    valve, rated = hidden.valve, hidden.valve.rated_current
    supply, slowest = CONDITIONS["supply_pressure"], figures["frequency_minus_3_db", TOLD[0]]
    hidden = replace(hidden, cycle=max(0.6, 40.0 / slowest))
    cycle = hidden.run(slow(hidden), RATE)
    at, pressure, leak = blocked(hidden)
    both = np.concatenate([at[::-1], at])  # of a slow cycle
    steady = {"time": np.linspace(0.0, 400.0, len(both)), "current": both,
              "load_pressure": np.concatenate([pressure[::-1], pressure]),
              "internal_leakage": np.concatenate([leak[::-1], leak])}  # fmt: skip
    top = 2.5 * figures["frequency_minus_90_deg", TOLD[0]]
    low, duration = slowest / 20.0, min(max(400.0 / slowest, 2.0), 15.0)
    t = np.arange(int(duration * 20.0 * top)) / (20.0 * top)
    phase = 2.0 * np.pi * (low * t + (top - low) * t**2 / (2.0 * duration))
    rest = np.zeros(int(len(t) / 12))
    chirp = hidden.run(np.concatenate([rest, TOLD[0] * rated * np.sin(phase), rest]), 20.0 * top)
    late = figures["time_to_90_percent", 1.0]
    rate = 200.0 / late
    step = hidden.run(np.where(np.arange(int(10 * late * rate)) / rate < 0.5 * late, 0.0, rated), rate)
    current = rated * np.sin(2.0 * np.pi * 5.0 * (when := np.linspace(0.0, 1.0, 2001)))
    voltage = valve.coil_resistance * current + valve.coil_inductance * np.gradient(current, when)
    for name, run, columns in (
        ("flow", cycle, ("load_flow",)), ("blocked", steady, ("load_pressure", "internal_leakage")),
        ("chirp", chirp, ("spool_position",)), ("step", step, ("spool_position",)),
        ("coil", {"time": when, "current": current, "voltage": voltage}, ("voltage",)),
    ):  # fmt: skip
        table = [run["time"], run["current"]]
        for column in columns:
            noise = READING * np.abs(run[column]).max() * (0.1 if name == "blocked" else 1.0)
            table.append(run[column] + noise * dice.normal(size=len(run["time"])))
        units = {"load_flow": "m^3/s", "load_pressure": "Pa", "internal_leakage": "m^3/s", "spool_position": "m",
                 "voltage": "V"}  # fmt: skip
        header = ",".join(["time [s]", "current [A]", *(f"{column} [{units[column]}]" for column in columns)])
        path = folder / f"{name}.csv"
        np.savetxt(path, np.column_stack(table), delimiter=",", header=header, comments="", fmt="%.9g")
    tests = (("flow", "flow", ""), ("blocked", "pressure-gain", ""), ("blocked", "leakage", 'lag = "0 s"'),
             ("chirp", "chirp", ""), ("step", "step", ""), ("coil", "coil", 'oil_temperature = "20 degC"'))  # fmt: skip
    listed = "\n".join(f'[[records]]\nfile = "{file}.csv"\ntest = "{test}"\n{more}\n' for file, test, more in tests)
    (folder / "acceptance.toml").write_text(
        f'title = "hidden"\nrated_current = "{rated!r} A"\n[conditions]\nsupply_pressure = "{supply!r} Pa"\n'
        f'oil_temperature = "40 degC"\n[instruments]\nflow = "1 %"\ncurrent = "0.5 %"\n{listed}', encoding="utf-8",
    )  # fmt: skip


# --------------------------------------------------------------------------- cases


def bode(valves: vs.Valve, frequencies: np.ndarray) -> np.ndarray:
    """Complex gains (m, k) at the amplitude that was not told."""
    sines = Sines(Bench(valves, CONDITIONS, OIL))
    return np.array([np.ravel(sines.gain(HIDDEN, float(f))) for f in frequencies])


def beside(own: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """dB (from the first frequency) and degrees by which gains (m, k) are off the true ones (m, 1)."""
    ratio = 20 * np.log10(np.abs(own / own[:1]) / np.abs(true / true[:1]))
    return ratio, np.rad2deg(np.angle(own / true))


def bode_found(hidden: HiddenValve, answer: Identification, top: float) -> dict[str, float]:
    """Greatest difference of the Bode at the amplitude that was not told, to its -90 degrees, and the share of its
    points that lie inside 95 % of valves drawn from the answer.
    """
    f = np.geomspace(max(top / 20.0, 2.0), top, 7)
    true = np.array([[hidden.gain(HIDDEN, one)] for one in f])
    decibel, degrees = beside(bode(answer.valve.valve, f), true)
    posterior, dice = answer.posterior, np.random.default_rng(1)
    points = dice.multivariate_normal(posterior.point, posterior.covariance, size=DRAWS)
    drawn = beside(bode(posterior.similar.valves(points), f), true)
    ends = [np.percentile(np.nan_to_num(off[1:]), (2.5, 97.5), axis=1) for off in drawn]
    inside = [(low <= 0.0) & (high >= 0.0) for low, high in ends]
    return {
        "bode_dB": float(np.abs(decibel).max()), "bode_degrees": float(np.abs(degrees).max()),
        "bode_dB_inside": float(np.mean(inside[0])), "bode_degrees_inside": float(np.mean(inside[1])),
    }  # fmt: skip


def run_case(number: int, *, records: bool = False) -> dict:
    """One hidden valve: what of the truth is inside the intervals, and how far its Bode is off."""
    dice = np.random.default_rng([27, number])
    flow, current = SIZES[number % len(SIZES)]
    hidden = hide(flow, current, dice)
    figures = true_figures(hidden)
    told_by, measured = specification(hidden, figures, dice), None
    if records:
        with tempfile.TemporaryDirectory() as folder:
            write_records(hidden, figures, Path(folder), dice)
            measured = load_measured_valve(folder)
        rated = [one for one in told_by.limits if one.figure in ("rated_current", "rated_flow")]
        told_by = replace(told_by, limits=tuple(rated))
    begin, used = time.perf_counter(), time.process_time()
    answer = identify(told_by, measured=measured, seed=number)
    seconds, processor = time.perf_counter() - begin, time.process_time() - used
    parameters = {
        p.name: (getattr(hidden.valve, p.name), p.value, p.low, p.high, p.identified) for p in answer.parameters
    }
    told = {}
    for f in answer.figures:
        key = (f.asked.limit.figure, round(f.asked.limit.conditions.get("amplitude", 0.0), 2))
        if key in figures:  # of records also what nobody has worked out of the plant
            told[f"{key[0]}@{key[1]:g}"] = (figures[key], f.value, f.deviation)
    inside = [low <= true <= high for true, _, low, high, _ in parameters.values()]
    figures_inside = [abs(value - true) <= 1.96 * sd for true, value, sd in told.values()]
    top = figures["frequency_minus_90_deg", HIDDEN]
    foreseen = {
        f"{one.limit.figure}@{HIDDEN:g}": (figures[one.limit.figure, HIDDEN], one.expected, one.deviation)
        for one in answer.next_figures if one.limit.conditions.get("amplitude") == HIDDEN
        and (one.limit.figure, HIDDEN) in figures
    }  # fmt: skip
    return {
        "case": number, "flow": flow, "seconds": seconds, "processor": processor, "parameters": parameters,
        "figures": told, "inside": float(np.mean(inside)), "figures_inside": float(np.mean(figures_inside)),
        "foreseen": foreseen, **bode_found(hidden, answer, top),
        "conflicts": [c.figure.limit.figure for c in answer.conflicts],
    }  # fmt: skip


def summary(cases: list[dict]) -> str:
    """The cases in words."""
    parameters = [(t, lo, hi, told) for c in cases for t, _, lo, hi, told in c["parameters"].values()]
    inside = np.array([lo <= t <= hi for t, lo, hi, _ in parameters])
    told = np.array([told for *_, told in parameters])
    figures = np.array([abs(v - t) <= 1.96 * s for c in cases for t, v, s in c["figures"].values()])
    dB, deg = (np.array([c[k] for c in cases]) for k in ("bode_dB", "bode_degrees"))
    foreseen = [abs(np.log(t / v)) <= 1.96 * s / v for c in cases for t, v, s in c["foreseen"].values()]
    points = [np.mean([c[f"bode_{k}_inside"] for c in cases]) for k in ("dB", "degrees")]
    ratios = [v / t for c in cases for n, (t, v, *_) in c["parameters"].items() if t > 0 and "difference" not in n]
    return (
        f"{len(cases)} cases: parameters inside their 95 % intervals {100 * inside.mean():.1f} % of {len(inside)} "
        f"(identified ones {100 * inside[told].mean():.1f} % of {told.sum()}), figures {100 * figures.mean():.1f} % of "
        f"{len(figures)}; Bode at 25 % within 1 dB in {100 * np.mean(dB <= 1.0):.0f} %, within 10 degrees in "
        f"{100 * np.mean(deg <= 10.0):.0f} % of cases (worst {dB.max():.2f} dB, {deg.max():.1f} degrees); -3 dB and "
        f"-90 degrees at 25 % inside the intervals told {100 * np.mean(foreseen):.1f} % of {len(foreseen)}, points of "
        f"that Bode inside 95 % of valves drawn {100 * points[0]:.0f} % (dB), {100 * points[1]:.0f} % (phase); "
        "parameters within a factor of two of the truth "
        f"{100 * np.mean(np.abs(np.log(np.abs(ratios))) < np.log(2)):.1f} %; "
        f"{np.median([c['processor'] for c in cases]):.1f} s of processor (most "
        f"{max(c['processor'] for c in cases):.1f})"
    )


def model_error(numbers: Sequence[int]) -> None:
    """How far the fit's own figures of the true valves are off the plant's: what `MODEL_ERROR` has to allow for."""
    found: dict[str, list[float]] = {}
    for number in numbers:
        dice = np.random.default_rng([27, number])
        hidden = hide(*SIZES[number % len(SIZES)], dice)
        limits = specification(hidden, true_figures(hidden), None).limits
        asked = tuple(asked_of(limit) for limit in limits if limit.figure in NOISE)
        told = FigurePredictor(asked, CONDITIONS, OIL).predict(hidden.valve, 1)[0]
        for one, value in zip(asked, told, strict=True):
            name = f"{one.limit.figure}@{one.limit.conditions.get('amplitude', 0.0):g}"
            found.setdefault(name, []).append(float(value / one.limit.value - 1.0))
    for name, errors in found.items():
        rms, worst = np.sqrt(np.mean(np.square(errors))), max(map(abs, errors))
        print(f"{name}: rms {100 * rms:.2f} %, worst {100 * worst:.2f} %")


PAGES = """\
# Catalogue pages

Written by `python benchmarks/identify.py --pages -o docs/catalogue_pages.md` from the files of
`examples/specifications`, each a page of a catalogue as far as it was read. Of each: what is asked beside what the
identified valve has (± one standard deviation by what the page says), the parameter farthest from what similarity
gives, the parameters that the page narrows (*identified*; all others are assumed), and what to measure next. A limit
alone (*at most*, *at least*) is kept, not aimed at: where similarity keeps it, the figure stays similarity's. Times
are seconds of processor. Hysteresis and threshold are those of effects, not of the fit; a coil resistance that is
told is taken for similarity's.

{pages} pages, {reached} of {figures} figures reached, {conflicts} conflicts. {near} of {parameters} parameters are
within a factor of two of similarity's{beyond}.

| page | reached | farthest from similarity | conflicts | s |
|---|---|---|---|---|
"""


def pages(folder: Path) -> str:
    """Every catalogue page: asked and reached, as a document."""
    overview, details, ratios = [], [], {}
    found = {path: timed_identification(path) for path in sorted(folder.glob("*.toml"))}
    for path, (answer, seconds) in found.items():
        title, figures = answer.specification.title, answer.figures
        own = {p.name: p.value / p.similar for p in answer.parameters if p.similar}
        far = max(own, key=lambda name: abs(np.log(own[name])))
        ratios |= {(title, name): ratio for name, ratio in own.items()}
        apart = "; ".join(
            f"{c.figure.limit.figure} against {', '.join(a.limit.figure for a in c.against) or 'similarity'}"
            for c in answer.conflicts
        )
        overview.append(
            f"| {title} | {sum(f.reached for f in figures)} of {len(figures)} | {in_words(far)} x {own[far]:.2f} | "
            f"{in_words(apart) or 'none'} | {seconds:.1f} |"
        )
        source = path.read_text(encoding="utf-8").partition("\n\n")[0].partition("\ntitle")[0]
        details.append(page_details(answer, f"`{path.name}`: {' '.join(source.replace('#', ' ').split())}"))
    answers = [answer for answer, _ in found.values()]
    reached = [f.reached for answer in answers for f in answer.figures]
    beyond = {where: ratio for where, ratio in ratios.items() if abs(np.log(ratio)) >= np.log(2.0)}
    told = "; ".join(f"{in_words(name)} of {title} ({ratio:.2f})" for (title, name), ratio in beyond.items())
    head = PAGES.format(
        pages=len(found), reached=sum(reached), figures=len(reached), conflicts=sum(len(a.conflicts) for a in answers),
        near=len(ratios) - len(beyond), parameters=len(ratios), beyond=f", all but {told}" if told else "",
    )  # fmt: skip
    return head + "\n".join([*overview, "", *details])


def timed_identification(path: Path) -> tuple[Identification, float]:
    """An answer, and the seconds of processor that it took."""
    used = time.process_time()
    answer = identify(load_specification(path))
    return answer, time.process_time() - used


def page_details(answer: Identification, source: str) -> str:
    """A page's figures, asked and reached, what they identify and what to measure next."""
    common = answer.specification.conditions
    rows = [f"## {answer.specification.title}", "", source, "", "| figure | condition | asked | reached | within |",
            "|---|---|---|---|---|"]  # fmt: skip
    for f in answer.figures:
        limit = f.asked.limit
        value, error, unit = value_cells(f.value, limit.unit, f.deviation)
        at = condition_text(dict(limit.conditions.items() - common.items()))
        rows.append(
            f"| {in_words(limit.figure)} | {at} | {asked_text(limit)} | {value} ± {error} {unit} | "
            f"{'yes' if f.reached else 'NO'} |"
        )
    narrowed = [f"{in_words(p.name)} ({p.value / p.similar:.2f})" if p.similar else in_words(p.name)
                for p in answer.parameters if p.identified]  # fmt: skip
    following = answer.next_figures[0]
    value, interval, unit = interval_text(following.expected, *following.interval, following.limit.unit)
    at = condition_text(following.limit.conditions, COMMON)
    return "\n".join([
        *rows, "", f"Identified (of similarity's): {', '.join(narrowed) or 'none'}.", "",
        f"Measure next: {in_words(following.limit.figure)}{f' ({at})' if at else ''}, now {value} {unit} ({interval}).",
        "", *(f"Conflict: {in_words(c.figure.limit.figure)}: {c.reason}.\n" for c in answer.conflicts),
    ])  # fmt: skip


def in_words(name: str) -> str:
    return name.replace("_", " ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--pages", action="store_true")
    parser.add_argument("--model-error", action="store_true")
    parser.add_argument("--records", action="store_true")
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("results/identify.jsonl"),
        help="a case a line, those that it holds are not run again; of --pages the document",
    )  # fmt: skip
    options = parser.parse_args()
    if options.pages:
        options.output.write_text(pages(ROOT / "examples" / "specifications"), encoding="utf-8")
        return
    if options.model_error:
        model_error(range(options.first, options.first + options.cases))
        return
    options.output.parent.mkdir(parents=True, exist_ok=True)
    lines = options.output.read_text(encoding="utf-8").splitlines() if options.output.is_file() else []
    cases = {case["case"]: case for case in map(json.loads, lines)}
    wanted = range(options.first, options.first + options.cases)
    for number in (number for number in wanted if number not in cases):
        one = cases[number] = run_case(number, records=options.records)
        print(
            f"case {number}: {one['flow']:g} L/min, inside {one['inside']:.2f}, figures {one['figures_inside']:.2f}, "
            f"Bode {one['bode_dB']:.2f} dB {one['bode_degrees']:.1f} degrees, {one['processor']:.1f} s, "
            f"{one['conflicts']}",
            flush=True,
        )
        with options.output.open("a", encoding="utf-8") as file:
            file.write(json.dumps(one) + "\n")
    print(summary([cases[number] for number in wanted]))


if __name__ == "__main__":
    main()
