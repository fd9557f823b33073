"""Sessions in which the oil warms up, on the plant of `hidden_plant`: parts that follow by another network.

    case = draw_thermal(7, profile="warm_up", network="structure", hidden="thermal_gradient_null_drift")
    write_thermal_session(case, folder, thermometers=("body",))

Profiles
    warm_up     the oil goes from 20 to 80 degC within 8 to 20 s, in one record down from 80
    launch      from 20 towards 270 degC at 3 to 5 K/s

Networks
    nominal     that of the model
    scattered   each figure off by a factor with a logarithm of 0.3 deviation, at most two
    structure   scattered, the rod at the oil's temperature at once, the tube halfway between oil and torque motor
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import hidden_plant
import numpy as np
from hidden_plant import Case, Run

from valvesim.errors import InputError
from valvesim.valve.coefficients import PartTemperatures
from valvesim.valve.parameters import Valve
from valvesim.valve.thermal_network import ThermalNetwork

PROFILES = ("warm_up", "launch")
NETWORKS = ("nominal", "scattered", "structure")
CAUSES = (
    "thermal_lag", "thermal_gradient_null_drift", "spool_thermal_pinch", "sensor_temperature_drift",
    "oil_viscosity_grade", "spring_tube_expansion", "polarization_mmf_slope", "spool_expansion",
    "feedback_rod_expansion", "null_gap_asymmetry", "spool_coulomb_friction", "magnet_demagnetization",
)  # fmt: skip
"""What is hidden in such sessions; the last three have nothing to do with heat."""
CHANNELS = (
    ("spool_position", "nozzle_pressure_1", "nozzle_pressure_2"), ("spool_position", "load_flow", "internal_leakage"),
    ("spool_position", "armature_angle", "internal_leakage"), ("spool_position", "nozzle_pressure_1", "load_flow"),
)  # fmt: skip
OTHERWISE = {"feedback_rod": {"oil": 1.0}, "spring_tube": {"oil": 0.5, "torque_motor": 0.5}}
THERMOMETER = 0.1  # K, deviation of a part's thermometer


def draw_thermal(
    seed: int,
    *,
    profile: str = "warm_up",
    network: str = "scattered",
    hidden: str | None = None,
    rate: float = 200.0,
    duration: float = 30.0,
) -> Case:
    """The case of a seed: two tests to learn from, the first of them twice, and one locked away."""
    if profile not in PROFILES or network not in NETWORKS:
        raise ValueError(f"{profile!r} is none of {PROFILES}, or {network!r} none of {NETWORKS}")
    dice = np.random.default_rng([seed, 28])
    channels = CHANNELS[int(dice.integers(len(CHANNELS)))]
    if hidden == "oil_viscosity_grade" and "internal_leakage" not in channels:
        channels = CHANNELS[1]
    names = () if hidden is None else (hidden,)
    first, second, locked = (_run(dice, k, profile, rate, duration) for k in range(3))
    case = Case(
        seed=seed,
        kind="effect" if hidden else "none",
        hidden=tuple((name, hidden_plant._figures(dice, name, channels)) for name in names),
        runs=(replace(first, repeats="a"), second, replace(first, name="record_4", repeats="a"), locked),
        meters=hidden_plant._meters(dice, channels, None),
        unit=hidden_plant._unit(dice),
        isothermal=False,
        network=ThermalNetwork() if network == "nominal" else scattered_network(dice, 0.3),
        between=OTHERWISE if network == "structure" else {},
    )
    while not all(map(_moves, (case, replace(case, hidden=()), _nominal(case)))):
        case = replace(case, runs=tuple(map(_slower, case.runs)))
    return case


def _nominal(case: Case) -> Case:
    """The case on the model's own valve and network."""
    return replace(case, hidden=(), unit={}, network=ThermalNetwork(), between={})


def _moves(case: Case) -> bool:
    """Whether the spool has room in its sleeve throughout: on the way up the sleeve stays behind."""
    hidden = dict(case.hidden)
    lag = hidden.get("thermal_lag", {}).get("time_constant", 0.0)
    grown = {name: getattr(case.valve, name) * (1.0 + p["offset"]) for name, p in hidden.items() if "offset" in p}
    try:
        for run in case.runs:
            Valve(**{**case.unit, **grown}).at(PartTemperatures(**hidden_plant._parts(case, run, lag)))
    except InputError:
        return False
    return True


def _slower(run: Run) -> Run:
    """The run with four fifths of the oil's change."""
    return replace(run, oil=hidden_plant._rounded(run.oil[0] + 0.8 * (run.oil - run.oil[0]), 0.01))


def scattered_network(dice: np.random.Generator, scatter: float) -> ThermalNetwork:
    """A network whose figures are those of the nominal one times what is drawn, within a factor of two."""
    nominal = ThermalNetwork()
    factor = {each.name: np.exp(np.clip(dice.normal(0.0, scatter), -0.7, 0.7)) for each in fields(nominal)}
    return ThermalNetwork(**{name: getattr(nominal, name) * by for name, by in factor.items()})


def _run(dice: np.random.Generator, k: int, profile: str, rate: float, duration: float) -> Run:
    """A record: slow sines, a staircase of levels or a triangle, while the oil goes up (in the second one down)."""
    t = np.arange(int(duration * rate) + 1) / rate
    shape = ("sine", "levels", "triangle")[int(dice.integers(3))]
    mean, size = dice.uniform(-1.5e-3, 1.5e-3), dice.uniform(1.5e-3, 4e-3)
    turns = dice.uniform(0.15, 0.6) * t
    if shape == "levels":
        edges = np.cumsum(dice.uniform(0.8, 2.5, int(duration) + 2))
        levels = dice.uniform(-1.0, 1.0, len(edges) + 1)[np.searchsorted(edges, t, side="right")]
        wave = hidden_plant._first_order(levels, 1.0 / rate, 0.05)
    else:
        wave = np.sin(2.0 * np.pi * turns)
        wave = 2.0 / np.pi * np.arcsin(wave) if shape == "triangle" else wave
    if profile == "launch":
        begin, end, slope = 20.0, 270.0, dice.uniform(3.0, 5.0)
    else:
        begin, end = (80.0, 20.0) if k == 1 else (20.0, 80.0)
        slope = (end - begin) / dice.uniform(8.0, 20.0)
    begin, start = begin + dice.uniform(-3.0, 3.0), dice.uniform(0.5, 3.0)
    share = np.clip((t - start) * slope / (end - begin), 0.0, 1.0)
    return Run(
        name=f"record_{k + 1}", shape=shape, rate=rate, command=hidden_plant._rounded(mean + size * wave, 1e-9),
        oil=hidden_plant._rounded(begin + (end - begin) * share, 0.01), supply=210e5, load=0.0,
        role="test" if k == 2 else "train",
    )  # fmt: skip


def thermal_records(
    case: Case,
    clean: list[dict[str, np.ndarray]] | None = None,
    thermometers: tuple[str, ...] = (),
    strength: float = 1.0,
) -> list[dict[str, np.ndarray]]:
    """Per record what the logger writes, SI; `thermometers` are parts whose temperature is measured too. The `clean`
    responses are worked out where they are not known.
    """
    dice = np.random.default_rng([case.seed, 29])
    records = hidden_plant.noisy(case, strength, clean)
    lag = dict(case.hidden).get("thermal_lag", {}).get("time_constant", 0.0) * strength
    for run, record in zip(case.runs, records, strict=True):
        parts = hidden_plant._parts(case, run, lag)
        for name in thermometers:
            read = parts[name] + dice.normal(0.0, THERMOMETER, len(run.oil))
            record[f"{name}_temperature"] = np.round(read, 2)
    return records


def write_thermal_session(
    case: Case,
    folder: str | Path,
    clean: list[dict[str, np.ndarray]] | None = None,
    thermometers: tuple[str, ...] = (),
    strength: float = 1.0,
) -> None:
    """Write session.toml and the records; nothing in them tells what is hidden, nor how the parts follow."""
    hidden_plant.write_files(case, thermal_records(case, clean, thermometers, strength), folder)
