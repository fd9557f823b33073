"""Units at the edges: text with a unit in, SI out; and each quantity declared once, with unit, bounds and source.

Inside the package every number is SI, and temperatures are in °C by name. Files, command line and plots carry units as
words, read by `pint` where they are not in daily use; a wrong dimension is an `InputError`.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import re
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.unit_factors import FACTORS

P = ParamSpec("P")
F = TypeVar("F")

_NUMBER = re.compile(r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)")
# What a unit may look like. Nothing else reaches pint, which would work out a text such as 9**9**9 for days.
_UNIT = re.compile(
    r"(?:[A-Za-z_°Δ\u00b5\u03bcΩ%‰\s/·.()]|\*(?!\*)|(?<=[A-Za-z])\d(?!\d)|(?<![\w.])1(?![\w.])"
    r"|(?<=[A-Za-z°Ω%)])\s*(?:(?:\^|\*\*)\s*(?:-?\d(?:\.\d)?|\(-?\d/\d\))(?![\d.])|⁻?[¹²³])){1,60}"
)
_SYMBOLS = {"delta_degC": "K", "1": "-", "degC": "°C"}

# Unit of a quantity -> the units in which people rather read it, with the factor from SI.
DISPLAY = {
    "m": ("mm", 1e3), "Pa": ("bar", 1e-5), "A": ("mA", 1e3), "rad": ("mrad", 1e3), "m^3/s": ("L/min", 6e4),
    "m^2": ("mm^2", 1e6), "m^3": ("cm^3", 1e6), "m/s": ("mm/s", 1e3), "degC": ("degC", 1.0),
}  # fmt: skip

_WRITTEN = DISPLAY | {"delta_degC": ("K", 1.0), "delta_degC/s": ("K/s", 1.0)}


@functools.cache
def _registry() -> Any:
    import pint

    try:
        return pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=":auto:")
    except OSError:  # no writable cache: the definitions are read anew, 0.3 s
        return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@functools.cache
def _unit(text: str) -> Any:
    return _registry().parse_units(text)


_MEANT = {
    "C": "degC", "c": "degC", "F": "degF", "mpa": "MPa", "Mpa": "MPa", "kpa": "kPa", "Kpa": "kPa", "KPa": "kPa",
    "pa": "Pa", "Bar": "bar", "BAR": "bar", "PSI": "psi", "Psi": "psi", "ma": "mA", "MA": "mA", "hz": "Hz",
    "HZ": "Hz", "khz": "kHz", "lpm": "L/min", "LPM": "L/min", "l/m": "L/min",
    "gpm": "gal/min", "GPM": "gal/min", "cis": "in^3/s", "CIS": "in^3/s", "cst": "cSt", "S": "s", "sec.": "s",
    "Sec": "s", "v": "V", "Ohm": "ohm", "MM": "mm", "Mm": "mm",
    "mil": "thou", "mils": "thou", "mn": "mN", "nm": "N*m", "n": "N",
}  # fmt: skip
_ABSOLUTE = {"psia": "psi", "bara": "bar", "bar(a)": "bar", "bar_a": "bar"}
_GAUGE = {"psig": "psi", "barg": "bar", "bar(g)": "bar", "bar_g": "bar", "kPag": "kPa", "kPa(g)": "kPa"}
_ATMOSPHERE = {"psi": "14.696 psi", "bar": "1.01325 bar", "kPa": "101.325 kPa"}


def _advice(unit: str, to: str) -> str:
    """What was probably meant by a unit that does not convert; empty where nothing comes to mind."""
    if unit in _GAUGE:
        absolute = _GAUGE[unit]
        return f"; {unit!r} is above the air's pressure, but pressures are absolute: add {_ATMOSPHERE[absolute]}"
    meant = _ABSOLUTE.get(unit) or _MEANT.get(unit)
    if meant is None or _UNIT.fullmatch(meant) is None:
        return ""
    wanted = _registry().get_dimensionality(_unit(to))
    return f"; did you mean {meant!r}?" if _registry().get_dimensionality(_unit(meant)) == wanted else ""


def convert(value: Any, unit: str, to: str, where: str = "") -> Any:
    """Convert numbers from one unit to another ("bar" to "Pa").

    Raises InputError for a wrong dimension, an unknown unit, and where a number leaves the range of a float.
    """
    factor = FACTORS.get((unit, to))
    with np.errstate(all="ignore"):
        converted = _convert_by_pint(value, unit, to, where) if factor is None else value * factor
    lost = np.isfinite(value) & ~np.isfinite(converted)
    if lost.any():
        raise InputError(f"{np.asarray(value)[lost].flat[0]:.6g} {unit} is too large a number in {to!r}", key=where)
    return converted


def _convert_by_pint(value: Any, unit: str, to: str, where: str) -> Any:
    """`convert` of units of any kind."""
    import pint

    try:
        if _UNIT.fullmatch(unit) is None:
            raise ValueError(unit)
        source = _unit(unit)
    except Exception as error:  # pint raises errors of many kinds on nonsense
        told = f"unknown unit {_shown(unit)}; expected one that converts to {to!r}{_advice(unit, to)}"
        raise InputError(told, key=where) from error
    try:
        return _registry().Quantity(value, source).to(_unit(to)).magnitude
    except (pint.errors.PintError, AssertionError, ArithmeticError) as error:
        raise InputError(
            f"{_shown(unit)} has the wrong dimension; expected a unit that converts to {to!r}{_advice(unit, to)}",
            key=where,
        ) from error


def parse(text: Any, unit: str, where: str = "") -> float:
    """Read `"210 bar"` as a float in `unit`. A bare number is refused unless the quantity has no dimension.

    Raises InputError (no number, unit missing, wrong dimension, not finite), naming `where`.
    """
    example = "0.5" if unit == "1" else f"1 {unit}"
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise InputError(f"expected a quantity such as '{example}', got {_shown(text)}", key=where)
    if isinstance(text, int) and abs(text) >= 2**63:
        raise InputError(f"a whole number of {text.bit_length()} bits is not a finite number", key=where)
    split = _split(str(text))
    if split is None:
        raise InputError(f"cannot read {_shown(text)} as a number with a unit, such as '{example}'", key=where)
    number, source = float(split[0]), split[1]
    if not np.isfinite(number):
        raise InputError(f"{_shown(text)} is not a finite number", key=where)
    if not source:
        if unit != "1":
            raise InputError(f"{_shown(text)} has no unit; write it as text, such as '{text} {unit}'", key=where)
        return number
    if re.match(r",\d", source):
        meant = str(text).strip().replace(",", ".", 1)
        raise InputError(f"{_shown(text)} has a decimal comma; write a point, such as {_shown(meant)}", key=where)
    return float(convert(number, _difference(source) if unit.startswith("delta_") else source, unit, where))


def in_si(value: Any, unit: str, where: str = "", *, several: bool = False) -> Any:
    """A number or array as it is; text with a unit and a pint quantity as a number (or array) in `unit`.

    With `several` a text may be a list, "20, 100 degC". Raises InputError for a wrong dimension, an unknown unit, and
    text without one.
    """
    if isinstance(value, str):
        numbers = parse_list(value, unit, where) if several else np.array([parse(value, unit, where)])
        return float(numbers[0]) if len(numbers) == 1 else numbers
    if isinstance(value, (list, tuple)) and any(has_unit(each) for each in value):
        return np.array([in_si(each, unit, where) for each in value], dtype=float)
    if not has_unit(value):
        return value
    source = f"{value.units}"
    source = _difference_of_pint(source) if unit.startswith("delta_") else source
    magnitude = np.asarray(value.magnitude, dtype=float)
    if source in ("", "dimensionless"):
        source = "1"
    converted = convert(magnitude, source, unit, where)
    return float(converted) if np.ndim(converted) == 0 else np.asarray(converted, dtype=float)


_NUMBERS = {float, int, np.float64, np.int64}  # of a long table of these none is looked at


def has_unit(value: Any) -> bool:
    """True of what `in_si` converts: text, a quantity of pint, and a list of such."""
    if isinstance(value, (list, tuple)):
        return not set(map(type, value)) <= _NUMBERS and any(map(has_unit, value))
    return isinstance(value, str) or (hasattr(value, "magnitude") and hasattr(value, "units"))


def reads_units(**units: str) -> Callable[[Callable[P, F]], Callable[P, F]]:
    """A function whose named arguments are numbers in these units, or text with a unit, or pint quantities.

    `@reads_units(current="A", temperature="degC")`: what comes as text or as a quantity reaches the function in SI.
    """

    def decorate(function: Callable[P, F]) -> Callable[P, F]:
        names = list(inspect.signature(function).parameters)

        plain: Callable[..., F] = function

        @functools.wraps(function)
        def reading(*args: P.args, **kwargs: P.kwargs) -> F:
            given = dict(zip(names, args, strict=False)) | kwargs
            if any(has_unit(given.get(name)) for name in units):
                read: Any = {n: in_si(v, units[n], n, several=True) if n in units else v for n, v in given.items()}
                return plain(**read)
            return function(*args, **kwargs)

        return reading

    return decorate


def exact_text(value: float, unit: str) -> str:
    """A number with its unit that `parse` reads back exactly: in the unit that people use where that does."""
    value = float(value)
    if unit == "1":
        return repr(value)
    shown, factor = _WRITTEN.get(unit, (unit, 1.0))
    text = f"{value * factor:.12g} {shown}"
    return text if np.isfinite(value * factor) and parse(text, unit) == value else f"{value!r} {unit}"


def _difference_of_pint(source: str) -> str:
    """The unit of a quantity as one of a difference: 5 kelvin and 5 degree_Celsius both are 5 K more."""
    return source.replace("degree_Celsius", "delta_degC").replace("delta_delta_degC", "delta_degC")


def _split(text: str) -> tuple[str, str] | None:
    """(number, unit) of a text, or None where it does not begin with a number; in time proportional to its length."""
    text = text.strip()
    match = _NUMBER.match(text)
    if match is None or "\n" in text:
        return None
    return match[0], text[match.end() :].strip()


def _shown(value: Any) -> str:
    """A value as it was given, for a message; the middle of a long one is left out."""
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:60]} ... {text[-30:]}"


_DIFFERENCES = {
    "degC": "delta_degC", "°C": "delta_degC", "celsius": "delta_degC", "degF": "delta_degF", "°F": "delta_degF",
}  # fmt: skip


def _difference(source: str) -> str:
    """The unit of a difference of temperatures, alone or per something: everybody writes 5 °C for 5 K."""
    first, slash, rest = source.partition("/")
    return _DIFFERENCES.get(first.strip(), first) + slash + rest


def parse_list(text: str, unit: str, where: str = "") -> np.ndarray:
    """Read `"20, 100, 270 degC"` (or one unit each, `"1 mA, 0.002 A"`) as an array in `unit`."""
    words = [word.strip() for word in str(text).split(",")]
    if any(re.match(r"0\d", word) for word in words[1:]):
        meant = str(text).replace(",", ".", 1)
        raise InputError(f"{_shown(text)} has a decimal comma; write a point, such as {_shown(meant)}", key=where)
    last = _split(words[-1])
    shared = last[1] if last else ""
    if shared and all(_is_number(word) for word in words[:-1]) and len(words) > 1:  # the usual list, in one go
        numbers = np.array([float(word) for word in words[:-1]])
        if np.isfinite(numbers).all():
            parse(f"1 {shared}", unit, where)  # for the messages of a wrong unit
            source = _difference(shared) if unit.startswith("delta_") else shared
            converted = np.asarray(convert(numbers, source, unit, where), dtype=float)
            return np.append(converted, parse(words[-1], unit, where))
    return np.array([parse(f"{w} {shared}".strip() if _is_number(w) else w, unit, where) for w in words])


def _is_number(word: str) -> bool:
    match = _NUMBER.fullmatch(word)
    return match is not None and word[-1] not in "nf"  # nan, inf


def quantity(
    default: Any,
    unit: str,
    doc: str,
    bounds: tuple[float, float],
    source: str,
    *,
    tolerance: float = 0.0,
    of_material: bool = False,
    time_scale: float = float("inf"),
) -> Any:
    """A dataclass field that declares a quantity once: default, unit, doc, bounds, source and tolerance.

    `tolerance` is how far a unit in service may be from the default (unit-to-unit spread, or the doubt in an estimate):
    relative to the default, or in `unit` where the default is 0. Zero: known, or not a matter of spread.
    `time_scale` (s) tells of what acts in the dynamics alone how soon it has done so.
    `of_material` is true of what the material has, however the part was made: seldom off in one unit alone.
    A lower bound of 0 includes zero; use `POSITIVE` for strictly positive quantities.
    Loader, parameter table, documentation and fits all read this declaration.
    """
    metadata = {"unit": unit, "doc": doc, "bounds": bounds, "source": source, "tolerance": tolerance,
                "of_material": of_material, "time_scale": time_scale}  # fmt: skip
    return dataclasses.field(default=default, metadata=metadata)


POSITIVE = float(np.nextafter(0, 1))  # the smallest positive number: an open lower bound at zero


def quantities(cls: Any) -> dict[str, dataclasses.Field]:
    """The declared quantities of a dataclass (or its instance), by name."""
    return {f.name: f for f in dataclasses.fields(cls) if "unit" in f.metadata}


def range_text(field: dataclasses.Field) -> str:
    """The allowed range of a declared quantity in words, such as `(0, 0.001]`."""
    low, high = field.metadata["bounds"]
    left = "(0" if low == POSITIVE else ("(-inf" if low == -np.inf else f"[{low:.6g}")
    return f"{left}, {'inf)' if high == np.inf else f'{high:.6g}]'}"


def tolerance_text(field: dataclasses.Field) -> str:
    """The tolerance of a declared quantity in words, such as `±2 %` or `±1e-06 m`; empty where there is none."""
    tolerance = field.metadata["tolerance"]
    if not tolerance:
        return ""
    return f"±{100 * tolerance:g} %" if field.default else f"±{tolerance:g} {symbol(field.metadata['unit'])}"


def check_bounds(instance: Any) -> None:
    """Raise InputError for the first declared quantity of a dataclass instance that leaves its bounds or is not finite.

    Infinity is allowed only as a default. A quantity may be an array of any shape (a batch of valves); then each of its
    values must be inside. In an instance that is being made, text with a unit and pint quantities become numbers first.
    """
    for name, field in quantities(instance).items():
        given, (low, high) = getattr(instance, name), field.metadata["bounds"]
        if isinstance(given, float) and low <= given <= high and math.isfinite(given):
            continue  # nearly all are plain numbers in their range, and numpy takes a dozen times as long
        if has_unit(given):
            given = in_si(given, field.metadata["unit"], f"{type(instance).__name__.lower()}.{name}")
            object.__setattr__(instance, name, given)
        value = np.asarray(given, dtype=float)
        outside = ~((value >= low) & (value <= high)) | (np.isinf(value) & (value != field.default))  # NaN is outside
        if outside.any():
            worst = value[outside].flat[0]
            raise out_of_range(worst, field, key=f"{type(instance).__name__.lower()}.{name}")


def out_of_range(value: float, field: dataclasses.Field, *, key: str, unit: str = "") -> InputError:
    """The error for a value outside the bounds of a declared quantity, in its own unit or in `unit`."""
    told = symbol(unit or field.metadata["unit"])
    problem = f"{value:.6g} {told} is outside {range_text(field)} {told} ({field.metadata['doc']})"
    return InputError(problem, key=key, joint=" = ")


def change(instance: Any, values: dict[str, Any], where: str = "") -> Any:
    """A copy of a dataclass of quantities with some of them read from text with units; unknown names are refused."""
    declared = quantities(instance)
    new = {}
    for name, text in values.items():
        here = f"{where}.{name}" if where else name
        if name not in declared:
            raise unknown_name(f"parameter of {type(instance).__name__}", name, declared, where)
        new[name] = parse(text, declared[name].metadata["unit"], here)
    try:
        return dataclasses.replace(instance, **new)
    except InputError as error:
        raise error.moved(type(instance).__name__.lower(), where) from None


def fmi_base_unit(unit: str) -> dict[str, float]:
    """A unit as FMI has it: exponents of kg, m, s, A, K and rad, with `factor` and `offset` to that base."""
    kelvin = {"degC": "kelvin", "delta_degC": "kelvin"}.get(unit, unit)
    quantity = _registry().Quantity(1.0, _unit(kelvin)).to_base_units()
    names = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K"}
    base = {names[name]: power for name, power in quantity.unit_items() if name in names}
    above, _, below = unit.partition("/")
    turns = above.split("*").count("rad") - below.split("*").count("rad")
    base |= {"rad": turns} if turns else {}
    base |= {"factor": float(quantity.magnitude)} if quantity.magnitude != 1.0 else {}
    return base | ({"offset": 273.15} if unit == "degC" else {})


def symbol(unit: str) -> str:
    """A unit as a person writes it on an axis."""
    return _SYMBOLS.get(unit, unit).replace("^2", "²").replace("^3", "³").replace("*", "·")
