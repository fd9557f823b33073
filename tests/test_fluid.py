"""The oils against the figures of field.md section 3 (marked [V], [D] or [M] there) and their own definitions."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim.errors import InputError, ValidityWarning, forget_warnings
from valvesim.valve.fluid import (
    ATMOSPHERE,
    MIL_PRF_5606,
    YH12_PAPER,
    Oil,
    WaltherViscosity,
    aerated_bulk_modulus,
)
from valvesim.valve.oils import OILS

oil = MIL_PRF_5606


@pytest.mark.parametrize("temperature, viscosity", [(-54, 2450e-6), (-40, 495e-6), (40, 13.5e-6), (100, 5.1e-6)])
def test_viscosity_of_5606_passes_its_published_points(temperature, viscosity):
    assert oil.viscosity(temperature) == pytest.approx(viscosity, rel=1e-9)  # field.md 3 [V]


@pytest.mark.parametrize("temperature, viscosity", [(150, 3.0e-6), (200, 2.0e-6), (270, 1.37e-6)])
def test_viscosity_of_5606_goes_on_along_the_walther_line_of_40_and_100(temperature, viscosity):
    assert oil.viscosity(temperature) == pytest.approx(viscosity, rel=0.02)  # field.md 3 [D]


def test_walther_line_through_two_points_has_the_published_coefficients():
    # field.md 3 [D]: through 40/100 °C A 5.92281, B 2.34849, so 21.5 mm^2/s at 20 °C
    law = WaltherViscosity(((40.0, 13.5), (100.0, 5.1)))
    A, B = 5.92281, 2.34849
    for t in (20.0, 60.0, 270.0):
        assert law(t) == pytest.approx((10**10 ** (A - B * np.log10(t + 273.15)) - 0.7) * 1e-6, rel=1e-4)
    assert law(20.0) == pytest.approx(21.5e-6, rel=0.005)


@given(st.floats(-60.0, 300.0), st.floats(1.0, 50.0))
def test_viscosity_of_every_oil_falls_with_temperature(temperature, rise):
    for each in OILS.values():
        assert each.viscosity(temperature) > each.viscosity(temperature + rise) > 0.0


@pytest.mark.parametrize("temperature", [-54.0, -40.0, 40.0, 100.0])
def test_viscosity_is_continuous_where_two_walther_lines_meet(temperature):
    assert oil.viscosity(temperature - 1e-6) == pytest.approx(oil.viscosity(temperature + 1e-6), rel=1e-6)


def test_viscosity_of_the_paper_is_its_eq_18_in_celsius():
    assert YH12_PAPER.viscosity(20.0) == pytest.approx(26.6e-6, rel=1e-3)  # model.md 6.3
    assert YH12_PAPER.viscosity(0.0) == pytest.approx(48.46e-6, rel=1e-12)  # Eq. 18
    assert YH12_PAPER.viscosity(100.0) == pytest.approx(48.46e-6 * np.exp(-3.0), rel=1e-12)


@pytest.mark.parametrize(
    "temperature, low, high", [(20, 1.54, 1.76), (100, 0.97, 1.19), (200, 0.54, 0.77), (270, 0.36, 0.58)]
)
def test_bulk_modulus_at_low_and_supply_pressure_is_the_published_tait_law(temperature, low, high):
    # field.md 3 [D], at 0.1 and 21 MPa; printed to 0.01 GPa (0.58 stands there for 0.589)
    assert oil.bulk_modulus(temperature, 0.1e6) == pytest.approx(low * 1e9, abs=0.01e9)
    assert oil.bulk_modulus(temperature, 21e6) == pytest.approx(high * 1e9, abs=0.01e9)


def test_density_is_that_of_the_specific_gravity_at_60_fahrenheit():
    assert oil.density(15.556) == pytest.approx(0.871 * 999.0, rel=1.5e-3)  # field.md 3 [V]; water 999.0 there


def test_figures_at_20_degrees_are_the_declared_ones():
    assert oil.density(20.0, 0.0) == oil.density_at_20 == 866.0
    assert oil.bulk_modulus(20.0, 0.0) == oil.bulk_modulus_at_20 == 1.534e9
    assert oil.vapour_pressure(100.0) == oil.vapour_pressure_at_100 == 1.9e3


@given(st.floats(-54.0, 270.0))
def test_density_falls_by_the_volume_expansion(temperature):
    ratio = oil.density(temperature + 0.5, 0.0) / oil.density(temperature - 0.5, 0.0)
    assert -np.log(ratio) == pytest.approx(8.3e-4, rel=1e-6)  # field.md 3 [M]


@pytest.mark.parametrize("slope", [0.0, 10.9])
@given(temperature=st.floats(-54.0, 270.0), pressure=st.floats(0.0, 40e6))
def test_bulk_modulus_is_density_times_pressure_per_density(slope, temperature, pressure):
    some = Oil(name="some", viscosity_law=oil.viscosity_law, bulk_modulus_slope=slope)
    step = 1e4
    drho = some.density(temperature, pressure + step) - some.density(temperature, pressure - step)
    modulus = some.density(temperature, pressure) * 2 * step / drho
    assert some.bulk_modulus(temperature, pressure) == pytest.approx(modulus, rel=1e-6)


@pytest.mark.parametrize("temperature, pressure", [(66, 0.4e3), (100, 2e3), (200, 50e3)])
def test_vapour_pressure_of_5606_is_near_its_published_figures(temperature, pressure):
    assert oil.vapour_pressure(temperature) == pytest.approx(pressure, rel=0.1)  # field.md 3 [M], "about"


def test_specific_heat_is_published_at_60_degrees_and_rises():
    assert oil.specific_heat(60.0) == pytest.approx(2010.0, rel=1e-12)  # field.md 3 [V]
    assert oil.specific_heat(70.0) - oil.specific_heat(60.0) == pytest.approx(37.0, rel=0.08)  # +3.5..4 per K [M]


def test_throttling_from_supply_heats_the_oil_by_the_published_rise():
    assert oil.throttling_rise(20.0, 21e6) == pytest.approx(9.5, rel=0.05)  # field.md 2 [D]


def test_throttling_rise_scales_with_the_pressure_drop_and_loses_to_expansion():
    assert oil.throttling_rise(20.0, 42e6) == pytest.approx(2 * oil.throttling_rise(20.0, 21e6), rel=1e-12)
    still = Oil(name="still", viscosity_law=oil.viscosity_law, thermal_expansion=0.0)
    # without expansion all the work heats: dp/(rho cp)
    expected = 21e6 / (still.density(20.0) * still.specific_heat(20.0))
    assert still.throttling_rise(20.0, 21e6) == pytest.approx(expected, rel=1e-12)
    assert expected == pytest.approx(12.5, rel=0.05)  # field.md 2 [D]


# ---------------------------------------------------------------- entrained air

clean = st.floats(0.3e9, 3e9)
pressures = st.floats(1e4, 2.1e7)


@given(clean, pressures, st.floats(1.0, 1.67))
def test_modulus_without_air_is_that_of_the_oil(modulus, pressure, exponent):
    assert aerated_bulk_modulus(modulus, pressure, 0.0, exponent) == modulus


@given(clean, pressures, st.floats(1e-4, 0.1), st.floats(1.01, 2.0))
def test_modulus_falls_with_more_air_and_with_less_pressure(modulus, pressure, air, factor):
    here = aerated_bulk_modulus(modulus, pressure, air, 1.4)
    assert aerated_bulk_modulus(modulus, pressure, air * factor, 1.4) < here < modulus
    assert aerated_bulk_modulus(modulus, pressure / factor, air, 1.4) < here


def test_modulus_tends_to_the_oil_at_high_and_to_the_gas_at_low_pressure():
    assert aerated_bulk_modulus(1.5e9, 4e8, 1e-4, 1.4) == pytest.approx(1.5e9, rel=1e-5)
    # bubbles carry it alone: n p per share of bubbles in the volume, here a half
    assert aerated_bulk_modulus(1e15, ATMOSPHERE, 1.0, 1.4) == pytest.approx(2 * 1.4 * ATMOSPHERE, rel=1e-6)


@given(clean, pressures, st.floats(1e-4, 0.1), st.floats(1.0, 1.67))
def test_volumes_of_oil_and_bubbles_add_to_the_aerated_compliance(modulus, pressure, air, exponent):
    bubbles = air * (ATMOSPHERE / pressure) ** (1 / exponent)  # polytropic, per volume of oil
    compliance = (1 / modulus + bubbles / (exponent * pressure)) / (1 + bubbles)
    assert aerated_bulk_modulus(modulus, pressure, air, exponent) == pytest.approx(1 / compliance, rel=1e-9)


def test_aerated_modulus_is_held_below_one_kilopascal():
    low = aerated_bulk_modulus(1.5e9, 1e3, 0.01, 1.4)
    assert aerated_bulk_modulus(1.5e9, 0.0, 0.01, 1.4) == aerated_bulk_modulus(1.5e9, -1e6, 0.01, 1.4) == low > 0.0


def test_oil_lowers_its_modulus_by_entrained_air():
    aerated = oil.bulk_modulus(20.0, 1e6, air_fraction=0.02, air_exponent=1.2)
    assert aerated == aerated_bulk_modulus(oil.bulk_modulus(20.0, 1e6), 1e6, 0.02, 1.2)


# ---------------------------------------------------------------- range, bounds, shapes


@pytest.mark.parametrize("name, temperature, side", [("mil_prf_5606", 270.0, "135"), ("yh12_paper", -54.0, "-40")])
def test_oil_warns_by_name_once_outside_its_rated_range(name, temperature, side):
    with pytest.warns(ValidityWarning, match=rf"{name}.*{temperature:g} °C.*{side} °C") as given_warnings:
        OILS[name].check_rated(np.array([20.0, temperature]))
        OILS[name].check_rated(temperature)
    assert len(given_warnings) == 1
    forget_warnings()
    with pytest.warns(ValidityWarning, match=name):
        OILS[name].check_rated(temperature)


def test_oil_warns_once_while_the_temperature_goes_on_rising():
    with pytest.warns(ValidityWarning, match="mil_prf_5606") as given_warnings:
        for temperature in (140.0, 150.0, 160.0):
            oil.check_rated(temperature)
    assert len(given_warnings) == 1


@pytest.mark.parametrize(
    "temperature, shown",
    [(-101.0, "-101"), (401.0, "401"), (np.nan, "nan"), (np.inf, "inf"), (np.array([20.0, np.nan]), "nan")],
)
def test_temperature_at_which_there_is_no_oil_is_refused(temperature, shown):
    with pytest.raises(InputError, match=f"oil mil_prf_5606: {shown} °C is outside -100 to 400 °C"):
        oil.check_rated(temperature)


def test_oil_is_computed_up_to_the_ends_of_its_range():
    with pytest.warns(ValidityWarning, match="-100 °C.*-54 °C"):
        oil.check_rated(-100.0)
    with pytest.warns(ValidityWarning, match="400 °C.*135 °C"):
        oil.check_rated(400.0)


def test_oil_is_silent_inside_its_rated_range():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        oil.check_rated(np.array([-54.0, 20.0, 135.0]))


@pytest.mark.parametrize("name, value", [("density_at_20", 100.0), ("bulk_modulus_at_20", np.nan), ("rated_low", 30.0)])
def test_oil_outside_its_bounds_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=rf"oil\.{name} = {value:g} .*outside \["):
        Oil(name="x", viscosity_law=oil.viscosity_law, **{name: value})


def test_oil_laws_broadcast_temperature_over_pressure():
    temperature, pressure = np.array([[20.0], [100.0], [270.0]]), np.array([1e5, 21e6])
    for law in (oil.density, oil.bulk_modulus):
        values = law(temperature, pressure)
        assert values.shape == (3, 2)
        assert values[2, 1] == pytest.approx(law(270.0, 21e6), rel=1e-14)
    assert oil.viscosity(temperature).shape == oil.vapour_pressure(temperature).shape == (3, 1)
