"""Sessions in which the oil warms up: parts that follow otherwise than assumed are no fault of the valve."""

import dataclasses

import numpy as np
import pytest
from thermal_plant import OTHERWISE, draw_thermal, thermal_records, write_thermal_session

import valvesim as vs
from valvesim.diagnosis.advice import _of_candidate
from valvesim.identification.candidates import Candidate
from valvesim.identification.options import DEFAULT_IDENTIFICATION
from valvesim.identification.prior import NETWORK, _network_parameters
from valvesim.identification.session import PART_TEMPERATURES
from valvesim.units import quantities
from valvesim.valve.thermal_network import THERMAL_NODES, ThermalNetwork, heat_words


def short(case, seconds=0.2):
    """The case with its first and its last run cut short."""
    n = int(seconds * case.runs[0].rate) + 1
    runs = [dataclasses.replace(run, command=run.command[:n], oil=run.oil[:n]) for run in (case.runs[0], case.runs[-1])]
    return dataclasses.replace(case, runs=tuple(runs))


def test_the_plants_of_another_structure_have_rod_and_tube_elsewhere():
    case = short(draw_thermal(3, network="structure", duration=2.0), 2.0)
    case = dataclasses.replace(case, runs=case.runs[:1])
    (record,) = thermal_records(
        case, [dict.fromkeys(case.channels, np.zeros(401)) | {"time": case.runs[0].time}], THERMAL_NODES
    )
    rod, tube, motor = (record[f"{name}_temperature"] for name in ("feedback_rod", "spring_tube", "torque_motor"))
    assert set(OTHERWISE) == {"feedback_rod", "spring_tube"}
    assert rod == pytest.approx(case.runs[0].oil, abs=0.6)  # a thermometer's noise
    assert tube == pytest.approx((case.runs[0].oil + motor) / 2.0, abs=0.8)


@pytest.mark.parametrize("name", quantities(ThermalNetwork))
def test_each_figure_of_the_network_is_told_in_words_of_heat_with_what_to_do(name):
    (parameter,) = (p for p in _network_parameters(ThermalNetwork(), options=DEFAULT_IDENTIFICATION)
                    if p.name == NETWORK + name)  # fmt: skip
    candidate = Candidate(f"parameter:{parameter.name}", parameter=parameter)
    advice = _of_candidate(candidate)
    assert heat_words(name).startswith(("heat transfer from ", "heat capacity of the "))
    assert heat_words(name) in advice.part and f"thermal.{name}" in advice.remedy
    assert any(column in advice.confirm for column in PART_TEMPERATURES)  # one that a session may have


def test_heat_transfer_is_known_less_well_than_heat_capacities():
    figures = _network_parameters(ThermalNetwork(), options=DEFAULT_IDENTIFICATION)
    known = {p.name.removeprefix(NETWORK): p for p in figures}
    assert np.exp(2.0 * known["spool_capacity"].deviation) == pytest.approx(1.5)  # its declared tolerance
    assert np.exp(2.0 * known["oil_to_spool"].deviation) == pytest.approx(DEFAULT_IDENTIFICATION.prior.heat_transfer)
    halfway = np.log(known["oil_to_spring_tube"].nominal / known["spring_tube_to_torque_motor"].nominal)
    apart = known["oil_to_spring_tube"].deviation + known["spring_tube_to_torque_motor"].deviation
    assert halfway < 2.0 * apart  # a tube halfway between oil and torque motor is within the tolerances


@pytest.mark.slow
def test_a_healthy_valve_with_other_heat_paths_raises_no_alarm_in_a_warm_up(tmp_path):
    write_thermal_session(draw_thermal(710020, network="structure", rate=50.0, duration=10.0), tmp_path)
    assert vs.diagnose(tmp_path).verdict == "no_discrepancy"


@pytest.mark.slow
def test_nor_does_one_whose_heat_paths_had_been_named(tmp_path):
    write_thermal_session(draw_thermal(810000, network="structure", rate=100.0, duration=20.0), tmp_path)
    assert vs.diagnose(tmp_path).verdict == "no_discrepancy"
