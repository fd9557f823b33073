"""The valve's quantities, and its coefficients over temperature against model.md, the oracle and the paper's tables."""

import dataclasses

import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import InputError, ValidityWarning
from valvesim.units import POSITIVE, convert, quantities, tolerance_text
from valvesim.valve.coefficients import PART_NAMES, ROUTES, Coefficients, PartTemperatures, check_routes
from valvesim.valve.fluid import MIL_PRF_5606, YH12_PAPER, Oil
from valvesim.valve.parameters import Valve, flow_coefficients_yan_2019, reference_valve

valve = reference_valve()

# paper Table 3: flow coefficients from CFD at °C: (nozzle, fixed orifice)
TABLE_3 = {
    -40: (0.1716, 0.2758), -30: (0.5501, 0.4185), -20: (0.6371, 0.5186), 0: (0.6617, 0.6372), 20: (0.6629, 0.6960),
    50: (0.6722, 0.7348), 100: (0.6635, 0.7467), 120: (0.6585, 0.7509), 150: (0.6581, 0.7517),
}  # fmt: skip

# model.md sections 2 and 3: which coefficients each route moves
GAPS = {"upper_air_gap_1", "upper_air_gap_2", "lower_air_gap_1", "lower_air_gap_2"}
ORIFICES = {
    "null_gap_1", "null_gap_2", "nozzle_diameter_1", "nozzle_diameter_2", "fixed_orifice_diameter_1",
    "fixed_orifice_diameter_2",
}  # fmt: skip
ROUTE_MOVES = {
    "flow": {"nozzle_flow_coefficient", "orifice_flow_coefficient"},
    "orifice": ORIFICES,
    "mmf": {"polarization_mmf"},
    "gap": GAPS | {"air_gap_area"},
    "reluctance": {"magnet_reluctance"},
    "arm": {"armature_arm"},
    "tube": {"spring_tube_stiffness"},
    "rod": {"feedback_rod_stiffness"},
}
PART_MOVES = {
    "oil": {
        "nozzle_flow_coefficient", "orifice_flow_coefficient", "density", "dynamic_viscosity", "bulk_modulus_at_zero",
    },
    "pilot_metal": ORIFICES,
    "spool": {"radial_clearance"},
    "sleeve": {"radial_clearance"},
    "body": set(),
    "torque_motor": GAPS
    | {"air_gap_area", "armature_arm", "polarization_mmf", "magnet_reluctance", "coil_resistance"},
    "spring_tube": GAPS | {"spring_tube_stiffness"},
    "feedback_rod": {"feedback_rod_stiffness"},
}  # fmt: skip


def parts(base=20.0, **others):
    return PartTemperatures(**{**dict.fromkeys(PART_NAMES, base), **others})


def moved(a, b):
    return {name for name in Coefficients._fields if np.any(np.asarray(getattr(a, name)) != getattr(b, name))}


# ---------------------------------------------------------------- declarations


@pytest.mark.parametrize("declared", [valve, MIL_PRF_5606], ids=["valve", "oil"])
def test_every_quantity_declares_unit_doc_bounds_and_source(declared):
    for name, field in quantities(declared).items():
        data = field.metadata
        low, high = data["bounds"]
        assert low <= field.default <= high, name
        assert low < high, name
        assert data["doc"].strip() and data["source"].strip(), name
        convert(1.0, data["unit"], data["unit"])  # pint knows the unit


def test_every_figure_of_a_valve_is_a_declared_quantity():
    assert {f.name for f in dataclasses.fields(Valve)} - set(quantities(Valve)) == {"flow_coefficients", "name"}
    assert {f.name for f in dataclasses.fields(Oil)} - set(quantities(Oil)) == {
        "name", "viscosity_law", "density_law", "bulk_modulus_law", "title", "scatter", "sources",
    }  # fmt: skip


ENDS = [(name, end) for name in quantities(Valve) for end in (0, 1)]


@pytest.mark.parametrize("name, end", ENDS)
def test_value_outside_its_bounds_is_refused_with_name_value_and_range(name, end):
    low, high = quantities(Valve)[name].metadata["bounds"]
    value = (0.0 if low == POSITIVE else low - 1.0) if end == 0 else high * 1.5
    shown = "(0" if low == POSITIVE else f"[{low:.6g}"
    with pytest.raises(InputError) as error:
        Valve(**{name: value})
    for text in (f"valve.{name} = {value:.6g}", shown, f"{high:.6g}]"):
        assert text in str(error.value)


@pytest.mark.parametrize("value", [np.nan, np.inf, np.array([4e-3, np.nan])])
def test_value_that_is_not_finite_is_refused(value):
    with pytest.raises(InputError, match=r"valve\.spool_mass = (nan|inf)"):
        Valve(spool_mass=value)


@pytest.mark.parametrize(
    "values, text",
    [
        ({"length_2": 7.0e-3}, "length_2 must be larger than valve.length_1"),
        ({"length_3": 7.29e-3}, "length_3 must be larger than valve.length_2"),
        ({"length_4": np.array([8.85e-3, 8.0e-3])}, "length_4 must be larger than valve.length_3"),
        ({"null_gap_difference": 0.07e-3}, "null_gap_difference must be smaller than twice null_gap"),
        ({"nozzle_diameter": 0.1e-3, "nozzle_diameter_difference": -0.2e-3}, "nozzle_diameter_difference"),
        ({"fixed_orifice_difference": 0.4e-3}, "fixed_orifice_difference"),
        ({"length_4": 8.7e-3, "air_gap_difference": 0.17e-3}, "air_gap_difference must be smaller than twice length_4"),
        ({"length_2": 7.1e-3, "air_gap_difference": 0.11e-3}, "air_gap_difference must be smaller than twice length_2"),
        ({"return_pressure": 21e6}, "return_pressure must be below"),
        ({"load_pressure": -22e6}, "load_pressure must be within the supply pressure"),
    ],
)
def test_figures_that_make_no_valve_together_are_refused(values, text):
    with pytest.raises(InputError, match=text):
        Valve(**values)


# ---------------------------------------------------------------- coefficients at 20 °C and over temperature


def test_coefficients_at_20_degrees_are_the_drawing_dimensions():
    c = valve.at(parts(20.0))
    for name in ("spring_tube_stiffness", "feedback_rod_stiffness", "armature_arm", "polarization_mmf", "air_gap_area"):
        assert getattr(c, name) == getattr(valve, name)
    assert c.nozzle_diameter_1 == c.nozzle_diameter_2 == valve.nozzle_diameter
    assert c.null_gap_1 == c.null_gap_2 == valve.null_gap
    assert c.upper_air_gap_1 == c.upper_air_gap_2 == pytest.approx(0.23e-3, rel=1e-12)  # L4 - L3, paper Table 2
    assert c.lower_air_gap_1 == c.lower_air_gap_2 == pytest.approx(0.24e-3, rel=1e-12)  # L2 - L1


temperature = st.floats(-40.0, 270.0)


@given(temperature, temperature, temperature, temperature, temperature)
def test_coefficients_match_the_oracle_at_any_part_temperatures(T_m, T_s, T_f, T_n, T_o):
    mine = valve.at(parts(torque_motor=T_m, spring_tube=T_s, feedback_rod=T_f, pilot_metal=T_n, oil=T_o))
    theirs = oracle.coefficients(T_m, T_s, T_f, T_n, T_o)
    pairs = {
        "upper_air_gap_1": "l_g1", "lower_air_gap_2": "l_g2", "air_gap_area": "A_g", "armature_arm": "a",
        "polarization_mmf": "M_0", "magnet_reluctance": "R_0", "nozzle_diameter_1": "d_n", "null_gap_2": "x_f0",
        "fixed_orifice_diameter_1": "d_0", "nozzle_flow_coefficient": "C_df", "orifice_flow_coefficient": "C_d0",
        "spring_tube_stiffness": "K_s", "feedback_rod_stiffness": "K_f", "flux_share": "gamma", "coil_turns": "N_c",
        "armature_inertia": "J", "armature_damping": "B_a", "nozzle_arm": "r", "feedback_arm": "b", "spool_mass": "m",
        "chamber_volume": "V_1", "spool_area": "A_v", "spool_damping": "B_v", "spool_stroke": "stroke",
        "port_width": "w",
    }  # fmt: skip
    for name, symbol in pairs.items():
        assert getattr(mine, name) == pytest.approx(theirs[symbol], rel=1e-11), name


def test_air_gaps_drift_apart_by_the_corrected_eq_10():
    hot, cold = valve.at(parts(270.0)), valve.at(parts(20.0))
    # model.md 6.1: -4.4 % and +6.6 % at 270 °C
    assert hot.upper_air_gap_1 / cold.upper_air_gap_1 - 1 == pytest.approx(-0.044, abs=0.0005)
    assert hot.lower_air_gap_1 / cold.lower_air_gap_1 - 1 == pytest.approx(0.066, abs=0.0005)


def test_flow_coefficients_meet_the_cfd_table_within_the_stated_errors():
    t = np.array(list(TABLE_3), dtype=float)
    error = np.abs(np.array(flow_coefficients_yan_2019(t)).T / np.array(list(TABLE_3.values())) - 1).max(axis=0)
    assert error == pytest.approx([0.0137, 0.0027], abs=0.0001)  # model.md 6.3: 1.37 % and 0.27 %


def test_flow_coefficients_are_flat_far_beyond_150_degrees():
    assert flow_coefficients_yan_2019(np.array([400.0])) == (pytest.approx([0.663]), pytest.approx([0.752]))  # Eq. 19


def test_flow_coefficients_are_held_below_minus_40_degrees_with_one_warning():
    with pytest.warns(ValidityWarning, match=r"flow coefficients \(Eq\. 19\): -50 °C") as given_warnings:
        held = flow_coefficients_yan_2019(np.array([-50.0, -40.0]))
        flow_coefficients_yan_2019(-50.0)
    assert len(given_warnings) == 1
    assert held[0][0] == held[0][1] > 0.0 and held[1][0] == held[1][1] > 0.0


def test_valve_takes_its_own_flow_coefficient_law():
    own = Valve(flow_coefficients=lambda t: (0.6 + 0.0 * t, 0.7 + 0.0 * t))
    c = own.at(parts(90.0))
    assert (c.nozzle_flow_coefficient, c.orifice_flow_coefficient) == (0.6, 0.7)


# ---------------------------------------------------------------- routes and parts


@pytest.mark.parametrize("route", ROUTES)
def test_route_moves_only_its_own_coefficients(route):
    hot = parts(150.0)
    assert moved(valve.at(hot, routes=(route,)), valve.at(hot, routes=())) == ROUTE_MOVES[route]


@pytest.mark.parametrize("route", ROUTES)
def test_route_alone_moves_its_coefficients_as_all_routes_together(route):
    alone, together = valve.at(parts(150.0), routes=route), valve.at(parts(150.0))
    for name in ROUTE_MOVES[route]:
        assert getattr(alone, name) == getattr(together, name)


def test_no_route_leaves_every_route_coefficient_at_20_degrees():
    free = {"density", "dynamic_viscosity", "bulk_modulus_at_zero", "coil_resistance"}  # oil and copper always follow
    assert moved(valve.at(parts(270.0), routes=()), valve.at(parts(20.0))) == free


@pytest.mark.parametrize("part", PART_NAMES)
def test_part_temperature_moves_only_the_coefficients_of_that_part(part):
    assert moved(valve.at(parts(**{part: 60.0})), valve.at(parts())) == PART_MOVES[part]


def test_unknown_route_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="unknown temperature route 'rods'; did you mean 'rod'"):
        valve.at(parts(), routes=("flow", "rods"))


def test_one_route_may_be_named_without_a_tuple():
    assert check_routes("rod") == check_routes(["rod"]) == {"rod"}


def test_coil_resistance_rises_as_copper():
    # field.md 5: +98 % at +250 K
    assert valve.at(parts(270.0)).coil_resistance / valve.coil_resistance == pytest.approx(1.98, abs=0.005)


def test_spool_clearance_shrinks_while_the_spool_leads_the_sleeve():
    lead, even = valve.at(parts(spool=45.0)), valve.at(parts(45.0))
    # field.md 5: -0.7 um radial for a 25 K lead of a 4.6 mm spool
    assert lead.radial_clearance - 3e-6 == pytest.approx(-0.7e-6, abs=0.02e-6)
    assert even.radial_clearance == pytest.approx(3e-6, rel=1e-12)


def test_spool_has_the_circumference_of_its_end_area():
    assert valve.at(parts()).spool_circumference ** 2 == pytest.approx(4 * np.pi * 16.8e-6, rel=1e-12)


def test_oil_coefficients_are_those_of_the_oil_at_mean_pressure():
    c = valve.at(parts(80.0), oil=YH12_PAPER)
    assert c.density == YH12_PAPER.density(80.0, 10.75e6)  # (p_s + p_0)/2, model.md section 5
    assert c.dynamic_viscosity == pytest.approx(c.density * YH12_PAPER.viscosity(80.0), rel=1e-14)
    assert c.bulk_modulus_at_zero + c.bulk_modulus_slope * 1e6 == pytest.approx(YH12_PAPER.bulk_modulus(80.0, 1e6))


def test_oil_beyond_its_rating_is_warned_of_by_name():
    with pytest.warns(ValidityWarning, match="mil_prf_5606.*270 °C"):
        valve.at(parts(270.0))


@pytest.mark.parametrize("part", sorted(set(PART_NAMES) - {"oil"}))
def test_part_temperature_that_is_not_a_number_is_refused(part):
    with pytest.raises(InputError, match="nan"):
        valve.at(parts(**{part: np.nan}))


# ---------------------------------------------------------------- clearances that close


@pytest.mark.parametrize(
    "figures, hot, words, closes",
    [
        # each closes where its size at 20 °C is used up: model.md section 3
        ({"flapper_length": 0.03}, {"pilot_metal": 200.0}, "null gap 1.*pilot metal", 20 + 0.035e-3 / (11e-6 * 0.03)),
        ({"nozzle_length": 0.05}, {"pilot_metal": 400.0}, "nozzle diameter 1.*pilot metal", 20 + 0.3e-3 / 1.1e-6),
        (
            {"fixed_orifice_length": 0.05}, {"pilot_metal": 300.0}, "fixed orifice diameter 1.*pilot metal",
            20 + 0.2e-3 / 1.1e-6,
        ),
        ({}, {"spool": 150.0}, "radial clearance.*spool", 20 + 3e-6 / (12e-6 * np.sqrt(16.8e-6 / np.pi))),
        (
            {"null_gap_difference": -10e-6, "flapper_length": 0.03}, {"pilot_metal": 200.0}, "null gap 1.*pilot metal",
            20 + 0.030e-3 / (11e-6 * 0.03),
        ),
        (
            {"spring_tube_expansion": 1e-4}, {"torque_motor": 450.0, "spring_tube": 450.0},
            "upper air gap 1.*torque motor",
            # Eq. 10: the gap shrinks by L2 a_s - (L5 - L7) a_c - L6 a_m + (L3 - L2) a_x per kelvin
            20 + 0.23e-3 / (7.29e-7 + 1.39e-3 * 9.2e-6 - 10.24e-3 * 11e-6 + 1.33e-3 * 9.2e-6),
        ),
    ],
    ids=["null gap", "nozzle", "orifice", "spool", "narrower side", "air gap"],
)  # fmt: skip
def test_closed_clearance_names_part_and_temperature(figures, hot, words, closes):
    with pytest.raises(InputError, match=words) as error:
        Valve(**figures).at(parts(**hot))
    assert f"reaches {closes:.4g} °C" in str(error.value)
    assert f"asked for {max(hot.values()):.4g} °C" in str(error.value)


def test_closed_clearance_in_a_batch_is_reported_where_it_is_worst():
    batch = Valve(flapper_length=np.array([0.6e-3, 0.05]))
    with pytest.raises(InputError, match=r"null gap 1 closes .* reaches 83\.64 °C \(asked for 200 °C"):  # 20 + 35/0.55
        batch.at(parts(pilot_metal=np.array([[100.0], [200.0]])))


def test_air_gap_closed_by_the_spring_tube_is_reported_with_its_temperature():
    with pytest.raises(InputError, match="spring tube reaches 335"):  # 20 + 0.23 mm/(7.29 mm 1e-4)
        Valve(spring_tube_expansion=1e-4).at(parts(spring_tube=450.0))


def test_clearance_closed_by_a_cold_sleeve_is_reported_with_its_temperature():
    with pytest.raises(InputError, match=r"sleeve reaches -88\.1"):  # 20 - 3e-6/(12e-6 2.3125e-3)
        valve.at(parts(sleeve=-120.0))


# ---------------------------------------------------------------- batches and sides


def test_valves_and_temperatures_broadcast():
    diameters, T = np.array([0.28e-3, 0.30e-3, 0.32e-3]), np.array([[20.0], [100.0]])
    batch = Valve(nozzle_diameter=diameters, spring_tube_stiffness=np.array([10.0, 10.2, 10.4]))
    c = batch.at(PartTemperatures.uniform(T))
    assert c.nozzle_diameter_1.shape == c.spring_tube_stiffness.shape == (2, 3)
    one = Valve(nozzle_diameter=0.32e-3, spring_tube_stiffness=10.4).at(parts(100.0))
    for name in Coefficients._fields:
        value = np.broadcast_to(getattr(c, name), (2, 3))[1, 2]
        assert value == pytest.approx(getattr(one, name), rel=1e-14), name


def test_one_value_outside_in_a_batch_is_refused():
    with pytest.raises(InputError, match=r"valve\.nozzle_diameter = 0\.006 m"):
        Valve(nozzle_diameter=np.array([0.3e-3, 6e-3]))


def test_reference_valve_is_symmetric():
    assert valve.is_symmetric


@pytest.mark.parametrize(
    "difference, first, second",
    [
        ("null_gap_difference", "null_gap_1", "null_gap_2"),
        ("nozzle_diameter_difference", "nozzle_diameter_1", "nozzle_diameter_2"),
        ("fixed_orifice_difference", "fixed_orifice_diameter_1", "fixed_orifice_diameter_2"),
        ("air_gap_difference", "upper_air_gap_1", "upper_air_gap_2"),
        ("air_gap_difference", "lower_air_gap_1", "lower_air_gap_2"),
    ],
)
def test_difference_is_side_1_minus_side_2_with_the_mean_kept(difference, first, second):
    uneven = Valve(**{difference: np.array([0.0, 4e-6])})
    c, even = uneven.at(parts(90.0)), valve.at(parts(90.0))
    one, two = (np.broadcast_to(getattr(c, name), 2) for name in (first, second))
    assert not uneven.is_symmetric
    assert one - two == pytest.approx([0.0, 4e-6], abs=1e-15)
    assert (one + two) / 2 == pytest.approx(getattr(even, first), rel=1e-12)


# ---------------------------------------------------------------- lands and tolerances


def test_every_land_has_the_overlap_of_the_valve_at_every_temperature():
    for overlap in (-5e-6, 0.0, 8e-6):
        c = Valve(land_overlap=overlap).at(PartTemperatures.uniform(np.array([20.0, 100.0])))
        assert c.land_overlap == overlap
    assert valve.land_overlap == 0.0 and Valve(land_overlap=1e-6).is_symmetric


# what a unit's spread leaves uncertain: figures that hold no place in `Valve.at` or are measured have none
CERTAIN = {
    *(f"length_{k}" for k in range(1, 7)), "copper_resistance_slope", "rated_current", "transition_pressure",
    "flapper_stop_stiffness", "spool_stroke", "spool_stop_stiffness", "stop_damping", "supply_pressure",
    "return_pressure", "load_pressure",
}  # fmt: skip


def test_every_figure_of_the_valve_has_a_tolerance_or_is_certain():
    fields = quantities(Valve)
    assert {name for name, field in fields.items() if field.metadata["tolerance"] == 0.0} == CERTAIN
    assert all(field.metadata["tolerance"] >= 0.0 for field in fields.values())


@pytest.mark.parametrize("name", sorted(set(quantities(Valve)) - CERTAIN))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_valve_at_its_tolerance_is_a_valve(name, sign):
    field = quantities(Valve)[name]
    off = sign * field.metadata["tolerance"] * (field.default or 1.0)
    c = Valve(**{name: field.default + off}).at(PartTemperatures.uniform(60.0))
    assert c != valve.at(PartTemperatures.uniform(60.0))


@pytest.mark.parametrize(
    "name, text",
    [
        ("nozzle_diameter", "±2 %"), ("polarization_mmf", "±2 %"), ("spool_damping", "±30 %"),
        ("null_gap_difference", "±3e-07 m"), ("land_overlap", "±1e-06 m"), ("length_1", ""), ("load_pressure", ""),
    ],
)  # fmt: skip
def test_a_tolerance_is_told_in_percent_or_in_the_unit_of_what_is_zero(name, text):
    assert tolerance_text(quantities(Valve)[name]) == text
