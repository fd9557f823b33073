"""What the package gives, for type checkers: made of `_HOMES` of `__init__.py`, and held equal to it by a test."""

from valvesim.characterisation.specification import Limit as Limit
from valvesim.characterisation.specification import Specification as Specification
from valvesim.characterisation.specification import Verdict as Verdict
from valvesim.characterisation.specification import judge as judge
from valvesim.characterisation.specification import load_specification as load_specification
from valvesim.characterisation.acceptance.acceptance_tests import acceptance_tests as _acceptance_tests
from valvesim.characterisation.acceptance.acceptance_tests import measured_test as measured_test
from valvesim.characterisation.datasheet import measure as _measure
from valvesim.characterisation.frequency_response import frequency_response as frequency_response
from valvesim.characterisation.linearisation import linearise as linearise
from valvesim.characterisation.linearisation import modes as modes
from valvesim.characterisation.linearisation import operating_point as operating_point
from valvesim.characterisation.response_set import measure_responses as _measure_responses
from valvesim.characterisation.step_response import step_response as step_response
from valvesim.diagnosis.diagnose import diagnose as diagnose
from valvesim.diagnosis.result import Diagnosis as Diagnosis
from valvesim.errors import InputError as InputError
from valvesim.errors import SolveError as SolveError
from valvesim.errors import ValidityWarning as ValidityWarning
from valvesim.errors import ValvesimError as ValvesimError
from valvesim.identification.from_figures.identify import Identification as Identification
from valvesim.identification.from_figures.identify import identify as identify
from valvesim.identification.session_toml import load_session as load_session
from valvesim.inputs import Chirp as Chirp
from valvesim.inputs import Constant as Constant
from valvesim.inputs import Pulse as Pulse
from valvesim.inputs import Ramp as Ramp
from valvesim.inputs import Sine as Sine
from valvesim.inputs import Staircase as Staircase
from valvesim.inputs import Step as Step
from valvesim.inputs import Sum as Sum
from valvesim.inputs import Table as Table
from valvesim.simulation.batch import simulate_batch as simulate_batch
from valvesim.simulation.result import Result as Result
from valvesim.simulation.run import simulate as simulate
from valvesim.simulation.scenario import Scenario as Scenario
from valvesim.simulation.scenario import Thermal as Thermal
from valvesim.simulation.scenario_toml import load_scenario as load_scenario
from valvesim.simulation.scenario_toml import scenario_to_toml as scenario_to_toml
from valvesim.solver.codegen import compile_model as compile_model
from valvesim.solver.codegen import derivatives as derivatives
from valvesim.studies.parameter_study import ParameterStudy as ParameterStudy
from valvesim.studies.study import study as study
from valvesim.studies.study_toml import load_study as load_study
from valvesim.valve.catalogue import CATALOGUE as CATALOGUE
from valvesim.valve.catalogue import effect as effect
from valvesim.valve.coefficients import ROUTES as ROUTES
from valvesim.valve.coefficients import Coefficients as Coefficients
from valvesim.valve.coefficients import PartTemperatures as PartTemperatures
from valvesim.valve.effect import ActiveEffect as ActiveEffect
from valvesim.valve.effect import Effect as Effect
from valvesim.valve.effect import Parameter as Parameter
from valvesim.valve.effect import Ports as Ports
from valvesim.valve.equations import CurrentDrive as CurrentDrive
from valvesim.valve.equations import Model as Model
from valvesim.valve.equations import VoltageDrive as VoltageDrive
from valvesim.valve.equilibrium import StaticSolution as StaticSolution
from valvesim.valve.equilibrium import static_solution as static_solution
from valvesim.valve.equilibrium import tad_polynomial as tad_polynomial
from valvesim.valve.fluid import MIL_PRF_5606 as MIL_PRF_5606
from valvesim.valve.fluid import YH12_PAPER as YH12_PAPER
from valvesim.valve.fluid import Oil as Oil
from valvesim.valve.oils import OILS as OILS
from valvesim.valve.parameters import Valve as Valve
from valvesim.valve.parameters import reference_valve as reference_valve
from valvesim.valve.valve_file import ValveFile as ValveFile
from valvesim.valve.valve_file import load_valve as load_valve
from valvesim.valve.valve_file import save_valve as save_valve
from valvesim.valve.valve_file import valve_to_toml as valve_to_toml
from valvesim.valve.thermal_network import ThermalNetwork as ThermalNetwork
from valvesim.valve.thermal_network import temperature_path as temperature_path

__version__: str
bench = _acceptance_tests
datasheet = _measure
responses = _measure_responses
