"""valvesim: a two-stage electro-hydraulic servo valve over temperature and time.

import valvesim as vs

valve = vs.reference_valve()
vs.static_solution(valve, current=1e-3, temperature=20.0).spool_position     # m
result = vs.simulate(vs.load_scenario("scenarios/launch_shock.toml"))
result["spool_position"]                                                     # over time, with its unit
vs.diagnose("my_session").summary                                            # what measured records show of its errors
"""

from valvesim.errors import InputError, SolveError, ValidityWarning, ValvesimError
from valvesim.inputs import Chirp, Constant, Pulse, Ramp, Sine, Staircase, Step, Sum, Table
from valvesim.simulation.batch import simulate_batch
from valvesim.simulation.result import Result
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.simulation.scenario_toml import load_scenario, scenario_to_toml
from valvesim.solver.codegen import compile_model, derivatives
from valvesim.valve.catalogue import CATALOGUE, effect
from valvesim.valve.coefficients import ROUTES, Coefficients, PartTemperatures
from valvesim.valve.effect import ActiveEffect, Effect, Parameter, Ports
from valvesim.valve.equations import CurrentDrive, Model, VoltageDrive
from valvesim.valve.equilibrium import StaticSolution, static_solution, tad_polynomial
from valvesim.valve.fluid import MIL_PRF_5606, YH12_PAPER, Oil
from valvesim.valve.oils import OILS
from valvesim.valve.parameters import Valve, reference_valve
from valvesim.valve.thermal_network import ThermalNetwork, temperature_path

_DIAGNOSIS = ("Diagnosis", "diagnose", "load_session")


def __getattr__(name: str):
    """What a diagnosis needs is loaded when it is asked for: a simulation starts without it."""
    if name not in _DIAGNOSIS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from valvesim.diagnosis import diagnose, result
    from valvesim.identification import session_toml

    return getattr({"Diagnosis": result, "diagnose": diagnose, "load_session": session_toml}[name], name)


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
    "scenario_to_toml",
    "simulate",
    "simulate_batch",
    "static_solution",
    "tad_polynomial",
    "temperature_path",
]
