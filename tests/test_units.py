"""Text with units in, numbers out; declared quantities, their bounds and their messages."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvesim import units
from valvesim.errors import InputError
from valvesim.unit_factors import FACTORS
from valvesim.units import (
    DISPLAY,
    POSITIVE,
    change,
    check_bounds,
    convert,
    parse,
    parse_list,
    quantities,
    quantity,
    range_text,
    symbol,
)
from valvesim.valve import fluid, parameters


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pump:
    pressure: float = quantity(2e7, "Pa", "delivery pressure", (0.0, 3.5e7), "data sheet", tolerance=0.05)
    clearance: float = quantity(3e-6, "m", "gap of the piston", (POSITIVE, 1e-3), "")
    temperature: float = quantity(20.0, "degC", "oil", (-54.0, np.inf), "")
    leakage: float = quantity(0.5, "1", "share", (-np.inf, np.inf), "")
    life: float = quantity(np.inf, "s", "service life", (POSITIVE, np.inf), "")
    maker: str = "nobody"

    def __post_init__(self):
        check_bounds(self)


def refusal(function, *arguments, **options):
    """The message of the InputError, of exactly that type, that a call ends in."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **options)
    assert type(caught.value) is InputError
    return str(caught.value)


# ---------------------------------------------------------------- text in

READ = [
    ("210 bar", "Pa", 210e5),
    ("3000 psi", "Pa", 3000 * 6894.757293168),
    ("0.03 mm", "m", 30e-6),
    ("5 µm", "m", 5e-6),  # micro sign
    ("5 μm", "m", 5e-6),  # Greek mu
    ("9.5 L/min", "m^3/s", 9.5e-3 / 60),
    ("13.5 cSt", "m^2/s", 13.5e-6),
    ("4 mm²", "m^2", 4e-6),
    ("4 mm**2", "m^2", 4e-6),
    ("2 %", "1", 0.02),
    ("2%", "1", 0.02),
    ("7", "1", 7.0),
    (7, "1", 7.0),
    (0.25, "1", 0.25),
    (np.float64(0.25), "1", 0.25),
    ("-40 degF", "degC", -40.0),
    ("212 degF", "degC", 100.0),
    ("293.15 K", "degC", 20.0),
    ("20 °C", "degC", 20.0),
    ("3 degC/s", "degC/s", 3.0),
    ("3 K/s", "degC/s", 3.0),
    ("9 degF/s", "delta_degC/s", 5.0),
    ("4 K", "delta_degC", 4.0),
    ("11e-6 1/degC", "1/K", 11e-6),
    ("2.82 N*m/A", "N*m/A", 2.82),
    ("2 kJ/(kg*K)", "J/kg/K", 2000.0),
    ("2 bar^(1/2)", "Pa**0.5", 2 * math.sqrt(1e5)),
    ("30 deg", "rad", math.pi / 6),
    ("+1.5e1mA", "A", 0.015),
    (" .5  s\n", "s", 0.5),
    ("5. s", "s", 5.0),
]


@pytest.mark.parametrize("text, unit, value", READ)
def test_text_with_a_unit_becomes_a_number(text, unit, value):
    number = parse(text, unit)
    assert type(number) is float
    assert number == pytest.approx(value, rel=1e-12, abs=1e-12 if unit == "degC" else 0.0)


REFUSED = [
    (True, "Pa", "expected a quantity such as '1 Pa', got True"),
    (False, "1", "expected a quantity such as '0.5', got False"),
    (None, "Pa", "expected a quantity such as '1 Pa', got None"),
    ([210, "bar"], "Pa", "expected a quantity such as '1 Pa', got [210, 'bar']"),
    ("", "Pa", "cannot read '' as a number with a unit, such as '1 Pa'"),
    ("  ", "1", "cannot read '  ' as a number with a unit, such as '0.5'"),
    ("bar", "Pa", "cannot read 'bar' as a number with a unit, such as '1 Pa'"),
    ("--1 bar", "Pa", "cannot read '--1 bar' as a number with a unit, such as '1 Pa'"),
    ("1 b\nar", "Pa", "cannot read '1 b\\nar' as a number with a unit, such as '1 Pa'"),
    ("nan bar", "Pa", "'nan bar' is not a finite number"),
    ("-inf bar", "Pa", "'-inf bar' is not a finite number"),
    ("1e999 bar", "Pa", "'1e999 bar' is not a finite number"),
    (math.nan, "1", "nan is not a finite number"),
    (-math.inf, "1", "-inf is not a finite number"),
    (10**400, "1", "a whole number of 1329 bits is not a finite number"),
    pytest.param(10**5000, "1", "a whole number of 16610 bits is not a finite number", id="5000 digits"),
    (210, "Pa", "210 has no unit; write it as text, such as '210 Pa'"),
    ("210", "Pa", "'210' has no unit; write it as text, such as '210 Pa'"),
    ("5", "rad", "'5' has no unit; write it as text, such as '5 rad'"),
    ("210 bra", "Pa", "unknown unit 'bra'; expected one that converts to 'Pa'"),
    ("210 Bar", "Pa", "unknown unit 'Bar'; expected one that converts to 'Pa'; did you mean 'bar'?"),
    ("1,5 bar", "Pa", "'1,5 bar' has a decimal comma; write a point, such as '1.5 bar'"),
    ("0,03 mm", "m", "'0,03 mm' has a decimal comma; write a point, such as '0.03 mm'"),
    ("20 C", "degC", "'C' has the wrong dimension; expected a unit that converts to 'degC'; did you mean 'degC'?"),
    ("68 F", "degC", "'F' has the wrong dimension; expected a unit that converts to 'degC'; did you mean 'degF'?"),
    ("20 C", "Pa", "'C' has the wrong dimension; expected a unit that converts to 'Pa'"),
    ("2 mil", "m", "'mil' has the wrong dimension; expected a unit that converts to 'm'; did you mean 'thou'?"),
    ("1 lpm", "m^3/s", "unknown unit 'lpm'; expected one that converts to 'm^3/s'; did you mean 'L/min'?"),
    ("3000 psia", "Pa", "unknown unit 'psia'; expected one that converts to 'Pa'; did you mean 'psi'?"),
    (
        "3000 psig",
        "Pa",
        "unknown unit 'psig'; expected one that converts to 'Pa'; 'psig' is above the air's pressure, "
        "but pressures are absolute: add 14.696 psi",
    ),
    (
        "200 bar(g)",
        "Pa",
        "'bar(g)' has the wrong dimension; expected a unit that converts to 'Pa'; 'bar(g)' is above "
        "the air's pressure, but pressures are absolute: add 1.01325 bar",
    ),
    ("1 2 bar", "Pa", "unknown unit '2 bar'; expected one that converts to 'Pa'"),
    ("1 bar/0", "Pa", "unknown unit 'bar/0'; expected one that converts to 'Pa'"),
    ("1 (bar", "Pa", "unknown unit '(bar'; expected one that converts to 'Pa'"),
    ("1 'bar", "Pa", "unknown unit \"'bar\"; expected one that converts to 'Pa'"),
    ("1 bar#", "Pa", "unknown unit 'bar#'; expected one that converts to 'Pa'"),
    ("1 __import__('os')", "Pa", "unknown unit \"__import__('os')\"; expected one that converts to 'Pa'"),
    ("3 mm", "Pa", "'mm' has the wrong dimension; expected a unit that converts to 'Pa'"),
    ("3 bar", "1", "'bar' has the wrong dimension; expected a unit that converts to '1'"),
    ("20 degC", "Pa", "'degC' has the wrong dimension; expected a unit that converts to 'Pa'"),
    ("1 dB²", "Pa", "'dB²' has the wrong dimension; expected a unit that converts to 'Pa'"),
    ("-1e305 bar", "Pa", "-1e+305 bar is too large a number in 'Pa'"),
    ("1e5 Np", "1", "100000 Np is too large a number in '1'"),
]


@pytest.mark.parametrize("text, unit, message", REFUSED)
def test_a_text_that_is_no_quantity_is_refused(text, unit, message):
    assert refusal(parse, text, unit) == message


@pytest.mark.parametrize("text, unit, message", REFUSED)
def test_a_refusal_names_where_the_text_stands(text, unit, message):
    assert refusal(parse, text, unit, "valve.null_gap") == f"valve.null_gap: {message}"


@pytest.mark.parametrize("text", ["m**9**9**9", "m*(9**9**9)", "m" * 100_000, "(" * 3000])
def test_a_unit_that_would_take_ages_never_reaches_pint(text, monkeypatch):
    asked, ask = [], units._unit
    monkeypatch.setattr(units, "_unit", lambda unit: asked.append(unit) or ask(unit))
    assert "unknown unit" in refusal(parse, f"1 {text}", "m")
    assert text not in asked
    assert parse("1 nm", "m") == 1e-9 and "nm" in asked  # the same way for what is a unit


pieces = st.sampled_from(
    ["bar", "m", "**", "^", "2", "9", "(", ")", "-", "1", "/", "*", " ", "²", "degC", "%", "°", "dB"]
)


@given(
    st.one_of(st.text(), st.text("0123456789.eE+-*/^()²%°'#_abr "), st.lists(pieces, max_size=12).map("".join)),
    st.sampled_from(["Pa", "1", "degC"]),
)
def test_any_text_is_either_a_finite_number_or_an_input_error(text, unit):
    for whole in (text, f"3e300 {text}"):
        try:
            assert math.isfinite(parse(whole, unit))
        except InputError as error:
            assert str(error)


@given(st.floats(-1e200, 1e200))
def test_any_number_survives_its_text(number):
    assert parse(f"{number!r} bar", "Pa") == pytest.approx(number * 1e5, rel=1e-12)
    assert parse(number, "1") == number


@pytest.mark.parametrize("kind", [parameters.Valve, fluid.Oil])
def test_every_declared_unit_can_be_written_in_a_file(kind):
    for field in quantities(kind).values():
        assert parse(f"2 {field.metadata['unit']}", field.metadata["unit"]) == pytest.approx(2.0, rel=1e-12)


# ---------------------------------------------------------------- lists and arrays


@pytest.mark.parametrize(
    "text, unit, values",
    [
        ("20, 100, 270 degC", "degC", [20, 100, 270]),
        ("-40 degF, 100 degC", "degC", [-40, 100]),
        ("1 mA, 0.002 A", "A", [0.001, 0.002]),
        ("1, 2 A, 3 mA", "A", [0.001, 2, 0.003]),  # a bare number has the last one's unit
        ("5 bar", "Pa", [5e5]),
        ("0.1,0.2", "1", [0.1, 0.2]),
        ("1,2 %", "1", [0.01, 0.02]),
    ],
)
def test_a_list_of_numbers_may_share_its_unit(text, unit, values):
    assert parse_list(text, unit) == pytest.approx(np.array(values), rel=1e-12)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "at: cannot read '' as a number with a unit, such as '1 Pa'"),
        ("1 bar,", "at: cannot read '' as a number with a unit, such as '1 Pa'"),
        ("1, 2", "at: '1' has no unit; write it as text, such as '1 Pa'"),
        ("1 bar, 2", "at: '2' has no unit; write it as text, such as '2 Pa'"),
        ("1, 2 mm", "at: 'mm' has the wrong dimension; expected a unit that converts to 'Pa'"),
        ("nan, 2 bar", "at: 'nan' is not a finite number"),
        ("1e999, 2 bar", "at: '1e999 bar' is not a finite number"),
        ("1 bar; 2 bar", "at: unknown unit 'bar; 2 bar'; expected one that converts to 'Pa'"),
    ],
)
def test_a_list_with_one_bad_entry_is_refused(text, message):
    assert refusal(parse_list, text, "Pa", "at") == message


def test_arrays_are_converted_entry_by_entry_with_gaps_kept():
    assert convert(np.array([[1.0, np.nan], [-2.0, 0.0]]), "bar", "Pa") == pytest.approx(
        np.array([[1e5, np.nan], [-2e5, 0.0]]), rel=1e-12, nan_ok=True
    )


def test_an_array_that_overflows_is_refused_with_its_entry():
    message = refusal(convert, np.array([1.0, 1e307, np.inf]), "bar", "Pa", "column 'p'")
    assert message == "column 'p': 1e+307 bar is too large a number in 'Pa'"


@pytest.mark.parametrize("unit", DISPLAY)
def test_what_is_displayed_agrees_with_the_conversion(unit):
    shown, factor = DISPLAY[unit]
    assert convert(3.0, unit, shown) == pytest.approx(3.0 * factor, rel=1e-12)


@pytest.mark.parametrize(
    "unit, written", [("m^3/s", "m³/s"), ("m^2", "m²"), ("N*m", "N·m"), ("1", "-"), ("degC", "°C"), ("delta_degC", "K")]
)
def test_a_unit_is_written_as_on_an_axis(unit, written):
    assert symbol(unit) == written


# ---------------------------------------------------------------- declared quantities


def test_a_declaration_is_kept_whole():
    field = quantities(Pump)["pressure"]
    assert field.default == 2e7
    assert dict(field.metadata) == {
        "unit": "Pa", "doc": "delivery pressure", "bounds": (0.0, 3.5e7), "source": "data sheet", "tolerance": 0.05,
        "of_material": False, "time_scale": np.inf,
    }  # fmt: skip


def test_only_declared_quantities_are_listed_in_order():
    assert list(quantities(Pump)) == ["pressure", "clearance", "temperature", "leakage", "life"]
    assert list(quantities(Pump())) == list(quantities(Pump))


@pytest.mark.parametrize(
    "name, text",
    [
        ("pressure", "[0, 3.5e+07]"),
        ("clearance", "(0, 0.001]"),
        ("temperature", "[-54, inf)"),
        ("leakage", "(-inf, inf)"),
        ("life", "(0, inf)"),
    ],
)
def test_a_range_is_written_with_its_open_and_closed_ends(name, text):
    assert range_text(quantities(Pump)[name]) == text


@pytest.mark.parametrize(
    "name, value, message",
    [
        ("pressure", -1.0, "pump.pressure = -1 Pa is outside [0, 3.5e+07] Pa (delivery pressure)"),
        ("pressure", 3.6e7, "pump.pressure = 3.6e+07 Pa is outside [0, 3.5e+07] Pa (delivery pressure)"),
        ("pressure", np.nan, "pump.pressure = nan Pa is outside [0, 3.5e+07] Pa (delivery pressure)"),
        ("pressure", np.array([[0.0, 1.0], [1e9, 2.0]]),
         "pump.pressure = 1e+09 Pa is outside [0, 3.5e+07] Pa (delivery pressure)"),
        ("clearance", 0.0, "pump.clearance = 0 m is outside (0, 0.001] m (gap of the piston)"),
        ("temperature", np.inf, "pump.temperature = inf °C is outside [-54, inf) °C (oil)"),
        ("leakage", -np.inf, "pump.leakage = -inf - is outside (-inf, inf) - (share)"),
        ("leakage", np.array([0.0, np.nan]), "pump.leakage = nan - is outside (-inf, inf) - (share)"),
        ("life", -np.inf, "pump.life = -inf s is outside (0, inf) s (service life)"),
    ],
)  # fmt: skip
def test_a_value_outside_its_bounds_is_refused(name, value, message):
    assert refusal(Pump, **{name: value}) == message


@pytest.mark.parametrize(
    "name, value",
    [
        ("pressure", 0.0),
        ("pressure", 3.5e7),
        ("clearance", POSITIVE),
        ("pressure", np.array([0.0, 3.5e7])),
        ("life", np.inf),
    ],
)
def test_a_bound_itself_and_an_infinite_default_are_allowed(name, value):
    assert getattr(Pump(**{name: value}), name) is value


@given(st.floats(allow_nan=True))
def test_bounds_split_the_numbers_in_two(value):
    if 0.0 <= value <= 3.5e7:
        assert Pump(pressure=value).pressure == value
    else:
        assert range_text(quantities(Pump)["pressure"]) in refusal(Pump, pressure=value)


def test_figures_are_changed_from_text_and_the_rest_is_kept():
    changed = change(Pump(maker="us"), {"pressure": "210 bar", "leakage": 0.25, "temperature": "-40 degF"})
    assert changed.pressure == pytest.approx(210e5, rel=1e-12)
    assert changed.temperature == pytest.approx(-40.0, abs=1e-9)
    assert (changed.leakage, changed.clearance, changed.maker) == (0.25, 3e-6, "us")


def test_no_changes_give_an_equal_copy():
    assert change(Pump(), {}) == Pump()


@pytest.mark.parametrize(
    "values, message",
    [
        ({"presure": "1 bar"}, "unknown parameter of Pump 'presure'; did you mean 'pressure'?"),
        ({"maker": "us"}, "unknown parameter of Pump 'maker'; did you mean 'leakage'?"),  # not a quantity
        ({"zz": 1}, "unknown parameter of Pump 'zz'; valid names: clearance, leakage, life, pressure, temperature"),
    ],
)
@pytest.mark.parametrize("where", ["", "pumps[1]"])
def test_a_change_that_makes_no_sense_is_refused(values, message, where):
    assert refusal(change, Pump(), values, where) == (f"{where}: {message}" if where else message)


@pytest.mark.parametrize("where, prefix", [("", ""), ("pumps.1", "pumps.1.")])
def test_a_change_beyond_the_bounds_is_named_by_the_key_it_stands_at(where, prefix):
    message = refusal(change, Pump(), {"pressure": "400 bar"}, where)
    assert message == f"{prefix}pressure = 4e+07 Pa is outside [0, 3.5e+07] Pa (delivery pressure)"


@pytest.mark.parametrize("where, prefix", [("", "clearance: "), ("pump", "pump.clearance: ")])
def test_a_change_names_the_figure_that_cannot_be_read(where, prefix):
    message = refusal(change, Pump(), {"pressure": "1 bar", "clearance": "3"}, where)
    assert message == prefix + "'3' has no unit; write it as text, such as '3 m'"


def test_a_temperature_difference_may_be_written_in_degrees_celsius():
    assert parse("5 degC", "delta_degC") == parse("5 K", "delta_degC") == pytest.approx(5.0)


def test_the_units_in_daily_use_convert_as_pint_converts_them():
    numbers = np.array([1.0, -3.7, 0.123456789, 21e6, 7.77e-12])
    for unit, to in FACTORS:
        by_pint = units._convert_by_pint(numbers, unit, to, "")
        assert convert(numbers, unit, to).tolist() == by_pint.tolist(), (unit, to)
        assert [convert(number, unit, to) for number in numbers.tolist()] == by_pint.tolist(), (unit, to)
