"""valvesim: a two-stage electro-hydraulic servo valve over temperature and time.

import valvesim as vs

valve = vs.reference_valve()
vs.static_solution(valve, current=1e-3, temperature=20.0).spool_position     # m
result = vs.simulate(vs.load_scenario("scenarios/launch_shock.toml"))
result["spool_position"]                                                     # over time, with its unit
vs.diagnose("my_session").summary                                            # what measured records show of its errors
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "characterisation.specification": "Limit Specification Verdict judge load_specification",
    "diagnosis.diagnose": "diagnose",
    "diagnosis.result": "Diagnosis",
    "errors": "InputError SolveError ValidityWarning ValvesimError",
    "identification.session_toml": "load_session",
    "inputs": "Chirp Constant Pulse Ramp Sine Staircase Step Sum Table",
    "simulation.batch": "simulate_batch",
    "simulation.result": "Result",
    "simulation.run": "simulate",
    "simulation.scenario": "Scenario Thermal",
    "simulation.scenario_toml": "load_scenario scenario_to_toml",
    "solver.codegen": "compile_model derivatives",
    "valve.catalogue": "CATALOGUE effect",
    "valve.coefficients": "ROUTES Coefficients PartTemperatures",
    "valve.effect": "ActiveEffect Effect Parameter Ports",
    "valve.equations": "CurrentDrive Model VoltageDrive",
    "valve.equilibrium": "StaticSolution static_solution tad_polynomial",
    "valve.fluid": "MIL_PRF_5606 YH12_PAPER Oil",
    "valve.oils": "OILS",
    "valve.parameters": "Valve reference_valve",
    "valve.valve_file": "ValveFile load_valve save_valve valve_to_toml",
    "valve.thermal_network": "ThermalNetwork temperature_path",
}
"""Modules with the names that this package gives; each is loaded when one of its names is asked for."""
_HOME = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value  # found at once from now on
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
