"""valvesim: a two-stage electro-hydraulic servo valve over temperature and time.

import valvesim as vs

valve = vs.reference_valve()                      # or vs.Valve(null_gap="0.03 mm"): text, pint or SI
vs.static_solution(valve, current="1 mA", temperature="20 degC").spool_position     # m
result = vs.simulate("launch.toml")               # or vs.simulate(vs.Scenario(command="5 mA", duration="60 ms"))
result["spool_position"]                          # over time, with its unit; result.plot(), .bode(), .to_pandas()
vs.bench(valve)                                   # static acceptance tests; vs.responses, vs.linearise, vs.datasheet
vs.diagnose("my_session").summary                 # what measured records show of the simulation's errors
"""

from importlib import import_module as _load
from typing import Any as _Any

_HOMES = {
    "characterisation.specification": "Limit Specification Verdict judge load_specification",
    "characterisation.acceptance.acceptance_tests": "bench:acceptance_tests measured_test",
    "characterisation.datasheet": "datasheet:measure",
    "characterisation.frequency_response": "frequency_response",
    "characterisation.linearisation": "linearise modes operating_point",
    "characterisation.response_set": "responses:measure_responses",
    "characterisation.step_response": "step_response",
    "diagnosis.diagnose": "diagnose",
    "diagnosis.result": "Diagnosis",
    "errors": "InputError SolveError ValidityWarning ValvesimError",
    "export.c_source": "export_c",
    "export.fmu": "export_fmu",
    "identification.from_figures.identify": "Identification identify",
    "identification.session_toml": "load_session",
    "inputs": "Chirp Constant Pulse Ramp Sine Staircase Step Sum Table",
    "simulation.batch": "simulate_batch",
    "simulation.fmu_valve": "FmuValve",
    "simulation.result": "Result",
    "simulation.run": "simulate",
    "simulation.scenario": "Scenario Thermal",
    "simulation.scenario_toml": "load_scenario scenario_to_toml",
    "solver.codegen": "compile_model derivatives",
    "studies.parameter_study": "ParameterStudy",
    "studies.study": "study",
    "studies.study_toml": "load_study",
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
"""Modules with the names that this package gives; each is loaded when one of its names is asked for.

`bench:acceptance_tests` is `acceptance_tests` of the module, given as `bench`.
"""
_HOME = {
    given: (module, own or given)
    for module, names in _HOMES.items()
    for given, _, own in (name.partition(":") for name in names.split())
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> _Any:
    if name == "__version__":
        from valvesim.version import package_version

        return package_version()
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, own = _HOME[name]
    value = getattr(_load(f"{__name__}.{module}"), own)
    globals()[name] = value  # found at once from now on
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
