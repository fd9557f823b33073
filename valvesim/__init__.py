"""valvesim: a two-stage electro-hydraulic servo valve over temperature and time.

import valvesim as vs

valve = vs.reference_valve()
vs.static_solution(valve, current=1e-3, temperature=20.0).spool_position     # m
result = vs.simulate(vs.load_scenario("scenarios/launch_shock.toml"))
result["spool_position"]                                                     # over time, with its unit
vs.diagnose("my_session").summary                                            # what measured records show of its errors
"""

from .catalogue import CATALOGUE, effect
from .commands import Chirp, Constant, Pulse, Ramp, Sine, Staircase, Step, Sum, Table
from .compiled import compile_model, derivatives
from .effects import ActiveEffect, Effect, Parameter, Ports
from .errors import InputError, SolveError, ValidityWarning, ValvesimError
from .fluid import MIL_PRF_5606, OILS, YH12_PAPER, Oil
from .model import CurrentDrive, Model, VoltageDrive
from .parameters import ROUTES, Coefficients, PartTemperatures, Valve, reference_valve
from .scenario import Scenario, Thermal, load_scenario
from .simulate import Result, simulate, simulate_batch
from .static import StaticSolution, static_solution, tad_polynomial
from .thermal import ThermalNetwork, temperature_path

_DIAGNOSIS = ("Diagnosis", "diagnose", "load_session")


def __getattr__(name: str):
    """What a diagnosis needs is loaded when it is asked for: a simulation starts without it."""
    if name not in _DIAGNOSIS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import answer, diagnosis, session

    return getattr({"Diagnosis": answer, "diagnose": diagnosis, "load_session": session}[name], name)


__all__ = [
    "ActiveEffect",
    "CATALOGUE",
    "Chirp",
    "Coefficients",
    "Constant",
    "CurrentDrive",
    "Diagnosis",
    "Effect",
    "InputError",
    "MIL_PRF_5606",
    "Model",
    "OILS",
    "Oil",
    "Parameter",
    "PartTemperatures",
    "Ports",
    "Pulse",
    "ROUTES",
    "Ramp",
    "Result",
    "Scenario",
    "Sine",
    "SolveError",
    "Staircase",
    "StaticSolution",
    "Step",
    "Sum",
    "Table",
    "Thermal",
    "ThermalNetwork",
    "ValidityWarning",
    "Valve",
    "ValvesimError",
    "VoltageDrive",
    "YH12_PAPER",
    "compile_model",
    "derivatives",
    "diagnose",
    "effect",
    "load_scenario",
    "load_session",
    "reference_valve",
    "simulate",
    "simulate_batch",
    "static_solution",
    "tad_polynomial",
    "temperature_path",
]
