"""Structural isolability of the valve's equations: ours against faultdiagnosistoolbox (Frisk, Krysander, Jung 2017).

The same structural model is given to both: equations with their unknown variables, faults with an equation each.

    python benchmarks/structural_isolability.py
"""

from __future__ import annotations

import contextlib
import io
import itertools

import numpy as np

from valvesim.planning.structure import StructuralModel, isolability, structural_model
from valvesim.valve.catalogue import CATALOGUE
from valvesim.valve.parameters import Valve

CHANNELS = (
    "spool_position", "load_flow", "nozzle_pressure_1", "nozzle_pressure_2", "internal_leakage", "armature_angle",
)  # fmt: skip


def by_toolbox(model: StructuralModel) -> np.ndarray:
    """(k, k) True where the toolbox calls the row's fault isolable from the column's; the diagonal is detectability."""
    import faultdiagnosistoolbox as fdt

    unknowns = sorted(frozenset().union(*model.equations.values()))
    faults = list(model.faults)
    safe = {name: f"x{k}" for k, name in enumerate(unknowns)} | {name: f"f{k}" for k, name in enumerate(faults)}
    fault_of = {equation: fault for fault, equation in model.faults.items()}
    relations = [
        [*(safe[variable] for variable in sorted(variables)), *([safe[fault_of[name]]] if name in fault_of else [])]
        for name, variables in model.equations.items()
    ]
    with contextlib.redirect_stdout(io.StringIO()):
        own = fdt.DiagnosisModel(
            {"type": "VarStruc", "x": [safe[name] for name in unknowns], "f": [safe[name] for name in faults], "z": [],
             "rels": relations}, name="valve",
        )  # fmt: skip
        matrix = own.IsolabilityAnalysis()
        detectable, _ = own.DetectabilityAnalysis()
    isolable = np.asarray(matrix) == 0
    np.fill_diagonal(isolable, [safe[name] in detectable for name in faults])
    undetectable = ~np.diag(isolable)
    isolable[undetectable] = False
    return isolable


def main() -> None:
    effects = {name: effect for name, effect in CATALOGUE.items() if effect.reading is None}
    sensor_faults = {f"sensor_bias@{name}": CATALOGUE["sensor_bias"].on(name) for name in CHANNELS}
    compared = agree = sets = 0
    for count in range(1, len(CHANNELS) + 1):
        for channels in itertools.combinations(CHANNELS, count):
            faults = effects | {k: e for k, e in sensor_faults.items() if e.channel in channels}
            model = structural_model(Valve(), channels, faults)
            names, ours = isolability(model)
            theirs = by_toolbox(model)
            sets, compared = sets + 1, compared + ours.size
            agree += int(np.count_nonzero(ours == theirs))
            for k, j in np.argwhere(ours != theirs)[:3]:
                print(f"{channels}: {names[k]} from {names[j]}: ours {ours[k, j]}, theirs {theirs[k, j]}")
    print(f"{sets} sets of sensors, {compared} pairs of faults: {agree} agree")


if __name__ == "__main__":
    main()
