"""Oils by name at their published points (oils.md section 1), and a user's own oil from a table."""

import csv
import io
import json
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valvesim.errors import InputError, ValidityWarning
from valvesim.simulation.scenario_toml import load_scenario
from valvesim.units import quantities
from valvesim.valve.fluid import MIL_PRF_5606, YH12_PAPER, LogLinear, Oil, WaltherViscosity
from valvesim.valve.oils import JET_A, MIL_PRF_23699, OILS, RP_1, own_columns, property_table, read_oil

# oils.md 1.1: °C -> mm^2/s as published
POINTS = {
    "mil_prf_5606": {-54: 2450, -40: 495, 40: 13.5, 100: 5.1},
    "mil_prf_83282": {-53.1: 9886, -34.7: 1017, -6.8: 112.6, 22.3: 26.3, 205.1: 1.145},
    "mil_prf_87257": {
        -62.7: 10280, -40.4: 488, -5.7: 36.2, 30.9: 8.30, 79.0: 2.76, 122.2: 1.50, 169.2: 0.946, 204.7: 0.713
    },
    "skydrol_500b4": {-54: 2678, 38: 11.67, 99: 3.84},
    "skydrol_ld4": {-54: 1164, 38: 11.10, 99: 3.91},
    "skydrol_pe5": {-54: 1068, 38: 9.75, 99: 3.38},
    "mil_prf_23699": {-38.2: 9731, -17.3: 873, 8.4: 124.6, 38: 28.5, 71.9: 9.63, 145.8: 2.52, 190.5: 1.549},
    "rp_1": {-29.85: 7.667, 60: 1.126},
    "jet_a": {-53.3: 22.25, -35.9: 9.17, -14: 4.29, 9.8: 2.379, 37.3: 1.452, 70: 0.943, 115.5: 0.601},
}  # fmt: skip
# oils.md 1.2: read off one line (or the segments) at 40 / 100 / 150 °C
LINES = {
    "mil_prf_83282": (14.0, 3.60, 1.86), "mil_prf_87257": (6.40, 1.99, 1.12), "mil_prf_23699": (26.3, 5.15, 2.39),
    "skydrol_500b4": (11.1, 3.78, None), "skydrol_ld4": (10.6, 3.85, None), "skydrol_pe5": (9.27, 3.33, None),
    "rp_1": (1.47, 0.74, None), "jet_a": (1.39, 0.68, None), "iso_vg_46": (41.3, None, None),
}  # fmt: skip
# oils.md 1.3: linear fits a + b t of the density in °C and their range
DENSITIES = {
    "mil_prf_83282": (859.7, -0.6965, -62, 139), "skydrol_500b4": (1071.4, -0.7837, -62, 160),
    "skydrol_ld4": (1024.4, -0.8551, -62, 160), "mil_prf_23699": (1007.21, -0.7540, 5, 70),
    "jet_a": (822.9, -0.6225, -54, 155),
}  # fmt: skip


@pytest.mark.parametrize("name", POINTS)
def test_viscosity_passes_every_published_point(name):
    for temperature, viscosity in POINTS[name].items():
        assert OILS[name].viscosity(temperature) == pytest.approx(viscosity * 1e-6, rel=1e-9)


@pytest.mark.parametrize("name", LINES)
def test_viscosity_between_points_is_that_of_the_published_line(name):
    for temperature, viscosity in zip((40.0, 100.0, 150.0), LINES[name], strict=True):
        if viscosity is not None:
            assert OILS[name].viscosity(temperature) == pytest.approx(viscosity * 1e-6, rel=0.025)


def test_viscosity_of_rp_1_is_the_natural_logarithm_of_its_law():
    # NISTIR6646 Table 11, 1.1 %; two users read it as 10^(...)
    for temperature in (-20.0, 10.0, 30.0, 50.0):
        T = temperature + 273.15
        law = np.exp(-7.812 + 5530 / T - 1.503e6 / T**2 + 1.801e8 / T**3) * 1e-6
        assert RP_1.viscosity(temperature) == pytest.approx(law, rel=0.011)


def test_viscosity_of_the_polyol_ester_is_near_what_nist_measured():
    # oils.md 1.1: mu in mPa s, with the density of the same report
    for temperature, mu in ((16.89, 71.13), (46.94, 19.48), (76.84, 7.893), (106.91, 3.856), (126.85, 2.709)):
        assert MIL_PRF_23699.viscosity(temperature) * MIL_PRF_23699.density(temperature) == pytest.approx(
            mu * 1e-3, rel=0.12
        )


@pytest.mark.parametrize("name", DENSITIES)
def test_density_is_near_its_published_line_over_its_range(name):
    a, b, low, high = DENSITIES[name]
    t = np.linspace(low, high, 9)
    assert OILS[name].density(20.0) == pytest.approx(a + 20 * b, rel=1e-3)
    assert OILS[name].density(t) == pytest.approx(a + b * t, rel=9e-3)


def test_density_of_rp_1_is_as_measured():
    for temperature, density in ((2.9, 813.2), (23.3, 799.0), (43.1, 785.0)):  # NISTIR6646, ±0.1 %
        assert RP_1.density(temperature, 83e3) == pytest.approx(density, rel=1e-3)


@given(st.floats(-54.0, 269.0), st.floats(0.05, 30.0), st.sampled_from(sorted(OILS)))
def test_properties_of_every_oil_are_positive_and_run_one_way(temperature, rise, name):
    oil, warmer = OILS[name], min(temperature + rise, 270.0)
    for law in (oil.viscosity, oil.density, oil.bulk_modulus_at_zero):
        assert law(temperature) > law(warmer) > 0.0
    assert 0.0 < oil.vapour_pressure(temperature) < oil.vapour_pressure(warmer)
    assert 0.0 < oil.specific_heat(temperature) < oil.specific_heat(warmer)


@given(st.floats(-54.0, 270.0), st.sampled_from(sorted(OILS)))
def test_viscosity_rises_with_pressure_and_is_the_table_at_none(temperature, name):
    oil = OILS[name]
    assert oil.viscosity(temperature) == oil.viscosity_law(temperature)
    rise = oil.viscosity(temperature, 21e6) / oil.viscosity(temperature)
    assert rise == 1.0 if oil is YH12_PAPER else 1.0 < rise < 2.1
    assert oil.viscosity(temperature, 10e6) ** 2 == pytest.approx(
        oil.viscosity(temperature) * oil.viscosity(temperature, 20e6), rel=1e-12
    )


def test_mineral_oil_rises_by_the_published_share_at_21_megapascal():
    for temperature in (30.0, 60.0, 100.0):  # oils.md 1.1: 32 to 52 % between 100 and 30 °C
        rise = float(MIL_PRF_5606.viscosity(temperature, 21e6) / MIL_PRF_5606.viscosity(temperature)) - 1.0
        assert 0.25 < rise < 0.52


def test_thin_and_plain_form_agree_above_eight_and_part_below_two():
    rows = ((-20.0, 400.0), (40.0, 12.0))
    thick = [WaltherViscosity(rows, full=full) for full in (False, True)]
    assert thick[0](20.0) == pytest.approx(thick[1](20.0), rel=1e-9)
    thin = [WaltherViscosity(((0.0, 3.3), (100.0, 0.7)), full=full)(50.0) for full in (False, True)]
    assert abs(thin[0] / thin[1] - 1.0) > 0.01


def test_one_straight_line_misses_a_real_oil_where_segments_do_not():
    # oils.md 1.2: the line through the ends of the 5606J sheet is far off at its middle
    line = WaltherViscosity(((-54.0, 2450.0), (100.0, 5.1)))
    assert abs(line(-40.0) / 495e-6 - 1.0) > 0.1


@pytest.mark.parametrize("name", [n for n in OILS if n not in ("mil_prf_5606", "yh12_paper")])
def test_every_oil_warns_once_beyond_its_range_and_names_a_source_for_every_figure(name):
    oil = OILS[name]
    with pytest.warns(ValidityWarning, match=rf"oil {name}: up to 300 °C .* rated {oil.rated_high:g} °C") as caught:
        oil.check_rated(300.0)
        oil.check_rated(310.0)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        oil.check_rated(np.array([oil.rated_low, oil.rated_high]))
    assert all(oil.source(figure) for figure in ("viscosity_law", *quantities(oil)))
    assert oil.title and oil.scatter and set(dict(oil.sources)) <= {"viscosity_law", *quantities(oil)}


def test_the_table_of_an_oil_says_what_is_rated():
    table = property_table(JET_A)
    assert {len(column) for column in table.values()} == {12}
    rated = (table["temperature_degC"] >= -40.0) & (table["temperature_degC"] <= 150.0)
    assert np.array_equal(table["rated"] > 0.0, rated)


# ---------------------------------------------------------------- an oil of one's own

OWN = {"name": "mine", "temperature": "-40, 40, 100 degC", "viscosity": "400, 12.5, 4.75 cSt"}


def test_own_oil_passes_its_table_and_takes_the_rest_from_another():
    oil = read_oil(OWN | {"density": "905, 850, 810 kg/m^3", "bulk_modulus": "2, 1.5, 1.1 GPa", "like": "skydrol_ld4"})
    assert oil.viscosity(np.array([-40.0, 40.0, 100.0])) == pytest.approx([400e-6, 12.5e-6, 4.75e-6], rel=1e-9)
    assert oil.density(np.array([-40.0, 40.0, 100.0]), 0.0) == pytest.approx([905.0, 850.0, 810.0], rel=1e-12)
    assert oil.bulk_modulus_at_zero(np.array([-40.0, 100.0])) == pytest.approx([2e9, 1.1e9], rel=1e-12)
    assert (oil.rated_low, oil.rated_high) == (-40.0, 100.0)
    assert oil.specific_heat_at_60 == OILS["skydrol_ld4"].specific_heat_at_60
    assert oil.source("viscosity_law") == "its table" and "skydrol_ld4" in oil.source("specific_heat_at_60")


def test_figures_beside_the_table_take_its_place():
    oil = read_oil(OWN | {"rated_high": "150 degC", "density_at_20": "800 kg/m^3"})
    assert oil.rated_high == 150.0 and oil.density(20.0, 0.0) == 800.0


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.floats(1.0, 40.0), st.floats(0.5, 6.0)), min_size=2, max_size=8), st.floats(-99.0, 20.0),
    st.floats(0.6, 50.0),
)  # fmt: skip
def test_any_falling_table_is_an_oil_that_falls_and_comes_back_from_its_text(steps, first, last):
    t = first + np.cumsum([step for step, _ in steps])
    falls = np.diff(np.log10(t + 273.15)) * [slope for _, slope in steps[1:]]  # on the axes of ASTM D341
    up = np.append(np.cumsum(falls[::-1])[::-1], 0.0)
    nu = 10.0**10.0 ** (np.log10(np.log10(last + 0.7)) + up) - 0.7
    rows = {"temperature": ", ".join(map(repr, t.tolist())), "viscosity": ", ".join(map(repr, nu.tolist()))}
    rows = {"temperature": rows["temperature"] + " degC", "viscosity": rows["viscosity"] + " cSt"}
    oil = read_oil({"name": "any", **rows})
    at = np.linspace(-54.0, 270.0, 40)
    values = oil.viscosity(at)
    assert np.all(np.diff(values) < 0.0) and np.all(values > 0.0)
    assert oil.viscosity(t) == pytest.approx(nu * 1e-6, rel=1e-8)
    assert read_oil({"name": "any", **dict(own_columns(oil))}).viscosity_law == oil.viscosity_law


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"viscosity": "400, 12.5 cSt"}, r"oil\.viscosity: 2 values for 3 temperatures; each needs one"),
        ({"viscosity": "400, 12.5, 13 cSt"}, r"oil\.viscosity: must fall"),
        ({"temperature": "38, 40, 99 degC", "viscosity": "4000, 12.5, 4.7 cSt"}, r"oil\.viscosity: falls too steeply"),
        ({"viscosity": "4, 1, 0.1 cSt"}, r"oil\.viscosity: .* above 0\.2"),
        ({"viscosity": "400, 12.5, 4.75 bar"}, r"oil\.viscosity: 'bar' has the wrong dimension"),
        ({"viscosity": "400, 12.5, 4.75"}, r"oil\.viscosity: '400' has no unit"),
        ({"viscosity": [400, 12]}, r"oil\.viscosity: expected a list as text"),
        ({"temperature": "-40, 100, 40 degC"}, r"oil\.temperature: .* each above"),
        ({"temperature": "-140, 40, 100 degC"}, r"oil\.temperature: -140 to 100 °C is not within -100 to 400"),
        ({"temperature": None}, r"oil\.temperature is missing"),
        ({"viscosity": None}, r"oil\.viscosity is missing"),
        ({"name": None}, r"oil\.name is missing"),
        ({"name": "jet_a"}, r"oil\.name: 'jet_a' is an oil of this package"),
        ({"name": ["x"]}, r"oil\.name: expected a name as text, got \['x'\]"),
        ({"like": "jet_b"}, r"oil\.like: unknown oil 'jet_b'; did you mean 'jet_a'"),
        ({"density": "900, -1, 800 kg/m^3"}, r"oil\.density: every value must be positive"),
        ({"density": "90, 80, 70 kg/m^3"}, r"oil\.density_at_20 = .* outside \[500, 2000\]"),
        ({"viscosty": "1"}, r"unknown parameter of Oil 'viscosty'; did you mean 'viscosity'"),
        ({"rated_high": "9 bar"}, r"oil\.rated_high: 'bar' has the wrong dimension"),
    ],
)
def test_own_oil_that_makes_no_sense_is_refused_by_key(changed, message):
    table = {key: value for key, value in (OWN | changed).items() if value is not None}
    with pytest.raises(InputError, match=message):
        read_oil(table)


def test_like_without_a_table_is_refused():
    with pytest.raises(InputError, match=r"oil\.like: goes with an oil of one's own"):
        read_oil({"name": "jet_a", "like": "rp_1"})


def test_tables_out_of_order_are_refused():
    for rows in (((20.0, 1.0),), ((20.0, 1.0), (20.0, 2.0)), ((20.0, 1.0), (30.0, -1.0))):
        with pytest.raises(InputError, match="table"):
            LogLinear(rows)
    with pytest.raises(InputError, match="above absolute zero"):
        WaltherViscosity(((-300.0, 10.0), (20.0, 5.0)))


def test_an_oil_without_a_table_cannot_be_written():
    with pytest.raises(InputError, match=r"oil\.name: 'x' is an oil of its own"):
        own_columns(Oil(name="x", viscosity_law=lambda t: 1e-5))
    laws = {"density_law": LogLinear(((0.0, 900.0), (50.0, 850.0)))}
    with pytest.raises(InputError, match="laws that no table holds"):
        own_columns(Oil(name="x", viscosity_law=WaltherViscosity(((0.0, 40.0), (60.0, 9.0))), **laws))


# ---------------------------------------------------------------- in files and on the command line

BASE = 'duration = "20 ms"\n[command.current]\nconstant = "1 mA"\n[oil]\n'
FILE = 'name = "mine"\ntemperature = "-40, 40, 100 degC"\nviscosity = "400, 12.5, 4.75 mm^2/s"\n'


@pytest.mark.parametrize("head", ["", "[oil]\n"])
def test_an_oil_stands_in_a_file_of_its_own_beside_the_scenario(tmp_path, head):
    (tmp_path / "my_oil.toml").write_text(head + FILE)
    (tmp_path / "case.toml").write_text(BASE + 'file = "my_oil.toml"\nrated_high = "120 degC"\n')
    oil = load_scenario(tmp_path / "case.toml").oil
    assert oil.name == "mine" and oil.rated_high == 120.0 and oil.viscosity(40.0) == pytest.approx(12.5e-6)


def test_an_oil_stands_in_the_scenario_itself(tmp_path):
    (tmp_path / "case.toml").write_text(BASE + FILE)
    assert load_scenario(tmp_path / "case.toml").oil.viscosity(100.0) == pytest.approx(4.75e-6)


def test_what_is_wrong_in_the_file_of_an_oil_is_found_by_its_line(tmp_path):
    (tmp_path / "my_oil.toml").write_text(FILE.replace("4.75", "475"))
    (tmp_path / "case.toml").write_text(BASE + 'file = "my_oil.toml"\n')
    with pytest.raises(InputError, match=r"my_oil\.toml, line 3: viscosity: must fall"):
        load_scenario(tmp_path / "case.toml")
    (tmp_path / "case.toml").write_text(BASE + 'file = "no_oil.toml"\n')
    with pytest.raises(InputError, match=r"no_oil\.toml: no such file"):
        load_scenario(tmp_path / "case.toml")
    (tmp_path / "case.toml").write_text(BASE + "file = 3\n")
    with pytest.raises(InputError, match=r"oil\.file: expected the name of a TOML file"):
        load_scenario(tmp_path / "case.toml")


def test_the_command_lists_and_shows_oils_in_every_format(call, tmp_path):
    code, out, _ = call("oils")
    assert code == 0 and all(name in out for name in OILS)
    code, out, _ = call("oils", "skydrol_ld4")
    assert code == 0 and "EASAF7870" in out and "135 *" in out and "doubt" in out
    code, out, _ = call("oils", "jet_a", "--format", "json")
    rows = json.loads(out)
    assert code == 0 and rows[4]["viscosity_m2_s"] == pytest.approx(float(JET_A.viscosity(20.0)))
    code, out, _ = call("oils", "--format", "csv")
    assert code == 0 and len(list(csv.DictReader(io.StringIO(out)))) == 3 * len(OILS)
    (tmp_path / "own.toml").write_text(FILE)
    code, out, _ = call("oils", "--file", tmp_path / "own.toml")
    assert code == 0 and "its table" in out


def test_the_command_refuses_an_oil_that_it_does_not_know(call, tmp_path):
    code, _, err = call("oils", "skydrol_ld5")
    assert code == 2 and "oils.name: unknown oil 'skydrol_ld5'; did you mean 'skydrol_ld4'?" in err
    code, _, err = call("oils", "jet_a", "--file", tmp_path / "x.toml")
    assert code == 2 and "not both" in err
