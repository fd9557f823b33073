"""Oils by name, with the source of each figure, and a user's own oil from a table over temperature.

Viscosity stands as the points that are published, joined on the axes of ASTM D341 (`WaltherViscosity`); density is the
value at 20 °C with its expansion (within 0.9 % of the published lines over their ranges), bulk modulus the isothermal
tangent one at 20 °C and p = 0. What no readable source gives is an estimate and says so. Source: oils.md section 1,
whose short names are kept: Lee-v and Lee-sg (The Lee Company's charts), Lee-B, Lee-cp, EASAF7870 (Eastman's Skydrol
brochure), IR8263 (NIST), NISTIR6646 (Magee et al. 2007).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from valvesim.errors import InputError, unknown_name
from valvesim.units import change, parse_list, quantities
from valvesim.valve.fluid import COMPUTED_RANGE, MIL_PRF_5606, YH12_PAPER, LogLinear, Oil, WaltherViscosity

_NONE = "estimate: no readable source gives it; "
_CHART = "typical of the class, Lee-v chart (a few %)"
_ADIABATIC = "read as adiabatic tangent (Lee states no kind), over the ratio 1.21 of n-dodecane"
_VAPOUR = (("vapour_pressure_at_100", _NONE + "5606's"), ("vapour_temperature", _NONE + "5606's"))
_ALPHA = "estimate: "

MIL_PRF_83282 = Oil(
    name="mil_prf_83282",
    title="MIL-PRF-83282, synthetic hydrocarbon, fire resistant",
    viscosity_law=WaltherViscosity(((-53.1, 9886.0), (-34.7, 1017.0), (-6.8, 112.6), (22.3, 26.3), (205.1, 1.145))),
    rated_low=-40.0,
    rated_high=205.0,
    density_at_20=845.8,
    thermal_expansion=8.23e-4,
    pressure_viscosity_at_40=13e-9,
    bulk_modulus_at_20=1.71e9,
    specific_heat_at_60=2174.0,
    scatter="Lee prints one curve for 7808 and 83282; fit of its chart 1.2 % rms; no product sheet was readable",
    sources=(
        ("viscosity_law", _CHART), ("rated_low", "aircraftsystemstech.com"), ("rated_high", "estimate"),
        ("density_at_20", "Lee-sg, one curve with 5606"), ("thermal_expansion", "Lee-sg"),
        ("pressure_viscosity_at_40", _ALPHA + "synthetic hydrocarbon, below mineral oil"),
        ("bulk_modulus_at_20", "Lee-B 2.07 GPa, " + _ADIABATIC), ("bulk_modulus_decay", _NONE + "the Tait law's"),
        ("bulk_modulus_slope", _NONE + "the Tait law's"), ("specific_heat_at_60", "Lee-cp 2093 at 38 °C, 3.7 per K"),
        ("specific_heat_slope", _NONE + "5606's"), *_VAPOUR,
    ),
)  # fmt: skip

MIL_PRF_87257 = replace(
    MIL_PRF_83282,
    name="mil_prf_87257",
    title="MIL-PRF-87257, synthetic hydrocarbon for the cold",
    viscosity_law=WaltherViscosity(
        ((-62.7, 10280.0), (-40.4, 488.0), (-5.7, 36.2), (30.9, 8.30), (79.0, 2.76), (122.2, 1.50), (169.2, 0.946),
         (204.7, 0.713)), full=True,
    ),
    rated_low=-54.0,
    rated_high=200.0,
    scatter="fit of the Lee chart 1.7 % rms; no product sheet was readable",
    sources=(
        ("viscosity_law", _CHART), ("rated_low", "MIL-PRF-87257C par. 1.1"), ("rated_high", "MIL-PRF-87257C par. 1.1"),
        *((name, _NONE + "83282's") for name in (
            "density_at_20", "thermal_expansion", "pressure_viscosity_at_40", "bulk_modulus_at_20",
            "bulk_modulus_decay", "bulk_modulus_slope", "specific_heat_at_60", "specific_heat_slope",
            "vapour_pressure_at_100", "vapour_temperature",
        )),
    ),
)  # fmt: skip


def _skydrol(name: str, title: str, viscosity: tuple, scatter: str, sources: dict[str, str], **figures: Any) -> Oil:
    """A phosphate ester: what all of them share in range, source and doubt."""
    shared = {
        "viscosity_law": "typical, D445, EASAF7870", "rated_low": "EASAF7870, coldest point",
        "rated_high": "estimate: 225 °F of aircraft systems",
        "pressure_viscosity_at_40": _NONE + "between mineral oil and synthetic hydrocarbon",
        "bulk_modulus_at_20": "EASAF7870, BMS 3-11; its state is not given, read as isothermal at 20 °C",
        "bulk_modulus_decay": _NONE + "the Tait law's", "bulk_modulus_slope": _NONE + "the Tait law's",
        "specific_heat_at_60": "EASAF7870, D2766", "specific_heat_slope": "EASAF7870, D2766", **dict(_VAPOUR),
    }  # fmt: skip
    return Oil(
        name=name, title=title, viscosity_law=WaltherViscosity(viscosity), rated_low=-54.0, rated_high=107.0,
        pressure_viscosity_at_40=15e-9, scatter=scatter, sources=tuple((shared | sources).items()), **figures,
    )  # fmt: skip


SKYDROL_500B4 = _skydrol(
    "skydrol_500b4", "Skydrol 500B-4, phosphate ester", ((-54.0, 2678.0), (38.0, 11.67), (99.0, 3.84)),
    "limit at -54 °C is 2900 mm²/s; bulk modulus: Lee 2.34 GPa (adiabatic, say) against 1.67, 40 % apart",
    {"density_at_20": "Lee-sg; EASAF7870 1053.2 at 25 °C", "thermal_expansion": "Lee-sg"},
    density_at_20=1055.7, thermal_expansion=7.42e-4, bulk_modulus_at_20=1.67e9, specific_heat_at_60=1807.0,
    specific_heat_slope=2.6,
)  # fmt: skip
SKYDROL_LD4 = _skydrol(
    "skydrol_ld4", "Skydrol LD-4, phosphate ester of low density", ((-54.0, 1164.0), (38.0, 11.10), (99.0, 3.91)),
    "the Lee chart is within 1 to 13 % of these points",
    {"density_at_20": "Lee-sg; EASAF7870 1008.0 at 25 °C", "thermal_expansion": "Lee-sg"},
    density_at_20=1007.3, thermal_expansion=8.49e-4, bulk_modulus_at_20=1.59e9, specific_heat_at_60=1887.0,
    specific_heat_slope=2.6,
)  # fmt: skip
SKYDROL_PE5 = _skydrol(
    "skydrol_pe5", "Skydrol PE-5, phosphate ester", ((-54.0, 1068.0), (38.0, 9.75), (99.0, 3.38)),
    "one brochure; no second source",
    {"density_at_20": "EASAF7870 992.7 at 25 °C with LD-4's slope", "thermal_expansion": _NONE + "LD-4's"},
    density_at_20=997.0, thermal_expansion=8.49e-4, bulk_modulus_at_20=1.62e9, specific_heat_at_60=1904.0,
    specific_heat_slope=0.415,
)  # fmt: skip

MIL_PRF_23699 = Oil(
    name="mil_prf_23699",
    title="MIL-PRF-23699, polyol ester 5 mm²/s (turbine oil)",
    viscosity_law=WaltherViscosity(
        ((-38.2, 9731.0), (-17.3, 873.0), (8.4, 124.6), (38.0, 28.5), (71.9, 9.63), (145.8, 2.52), (190.5, 1.549))
    ),
    rated_low=-40.0,
    rated_high=204.0,
    density_at_20=992.1,
    thermal_expansion=7.6e-4,
    pressure_viscosity_at_40=11e-9,
    bulk_modulus_at_20=1.6e9,
    specific_heat_at_60=1896.0,
    specific_heat_slope=2.8,
    scatter="measured viscosities (IR8263) lie within 12 % of the Lee chart from 17 to 127 °C",
    sources=(
        ("viscosity_law", _CHART), ("rated_low", "estimate: the chart's coldest point is -38 °C"),
        ("rated_high", "estimate: 400 °F"), ("density_at_20", "IR8263, measured 5..70 °C"),
        ("thermal_expansion", "IR8263"), ("pressure_viscosity_at_40", _ALPHA + "polyol esters lie lowest"),
        ("bulk_modulus_at_20", _NONE + "near the Tait law's mineral oil"),
        ("bulk_modulus_decay", _NONE + "the Tait law's"), ("bulk_modulus_slope", _NONE + "the Tait law's"),
        ("specific_heat_at_60", "IR8263, measured, ±3 %"), ("specific_heat_slope", "IR8263"), *_VAPOUR,
    ),
)  # fmt: skip


def _walther_points(a: float, b: float, temperatures: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
    """Points of one Walther line, log10 log10 (nu + 0.7) = a - b log10(T/K)."""
    return tuple((t, float(10.0**10.0 ** (a - b * np.log10(t + 273.15)) - 0.7)) for t in temperatures)


ISO_VG_46 = Oil(
    name="iso_vg_46",
    title="ISO VG 46, industrial mineral oil",
    viscosity_law=WaltherViscosity(_walther_points(9.32, 3.65, (0.0, 40.0, 100.0))),
    rated_low=-20.0,
    rated_high=100.0,
    density_at_20=856.7,
    thermal_expansion=7.7e-4,
    scatter="41.3 mm²/s at 40 °C, within the grade's 41.4 to 50.6 but for 0.2 %; no data sheet was readable",
    sources=(
        ("viscosity_law", "OpenHydraulics GenericOil, Walther A 9.32, B 3.65, 'approximately ISO VG 46'"),
        ("rated_low", "estimate: pumps start below 1500 mm²/s or so"), ("rated_high", "estimate: life of the oil"),
        ("density_at_20", "OpenHydraulics GenericOil, 870 at 0 °C"), ("thermal_expansion", "OpenHydraulics GenericOil"),
        ("bulk_modulus_at_20", "OpenHydraulics GenericOil, Tait law"),
    ),
)  # fmt: skip


def _rp1_viscosity(temperature: float) -> float:
    """NISTIR6646 Table 11, mm^2/s: ln nu = -7.812 + 5530/T - 1.503e6/T^2 + 1.801e8/T^3 in kelvin, -30..60 °C."""
    T = temperature + 273.15
    return float(np.exp(-7.812 + 5530.0 / T - 1.503e6 / T**2 + 1.801e8 / T**3))


_FUEL = (
    ("bulk_modulus_at_20", "Lee-B JP-4 1.38 GPa, " + _ADIABATIC),
    ("bulk_modulus_decay", "run of n-dodecane, 20..200 °C"),
    ("pressure_viscosity_at_40", _ALPHA + "light hydrocarbons, below mineral oil"),
    ("bulk_modulus_slope", "n-dodecane: about 11"),
)  # fmt: skip
RP_1 = Oil(
    name="rp_1",
    title="RP-1, rocket kerosene",
    viscosity_law=WaltherViscosity(
        ((-29.85, 7.667), *((t, _rp1_viscosity(t)) for t in (-10.0, 0.0, 20.0, 40.0)), (60.0, 1.126)), full=True
    ),
    rated_low=-30.0,
    rated_high=270.0,
    density_at_20=801.3,
    thermal_expansion=8.8e-4,
    pressure_viscosity_at_40=10e-9,
    bulk_modulus_at_20=1.14e9,
    bulk_modulus_decay=7.8e-3,
    vapour_pressure_at_100=2.05e3,
    vapour_temperature=6130.0,
    specific_heat_at_60=2148.0,
    specific_heat_slope=4.0,
    scatter="other lots 7 to 10 % more viscous; density ±0.1 %, low-sulphur lot +0.28 %",
    sources=(
        ("viscosity_law", "NISTIR6646 Table 11, -30..60 °C, fits to 1.1 %; beyond on the D341 axes"),
        ("rated_low", "NISTIR6646, measured from"), ("rated_high", "decomposes above 375 °C (NISTIR6646 Table 7)"),
        ("density_at_20", "NISTIR6646"), ("thermal_expansion", "NISTIR6646"), *_FUEL,
        ("specific_heat_at_60", "library value (RocketProps)"), ("specific_heat_slope", "library value (RocketProps)"),
        ("vapour_pressure_at_100", "library value (RocketProps)"),
        ("vapour_temperature", "library value (RocketProps)"),
    ),
)  # fmt: skip
JET_A = Oil(
    name="jet_a",
    title="Jet A, aviation kerosene",
    viscosity_law=WaltherViscosity(
        ((-53.3, 22.25), (-35.9, 9.17), (-14.0, 4.29), (9.8, 2.379), (37.3, 1.452), (70.0, 0.943), (115.5, 0.601)),
        full=True,
    ),
    rated_low=-40.0,
    rated_high=150.0,
    density_at_20=810.5,
    thermal_expansion=7.68e-4,
    pressure_viscosity_at_40=10e-9,
    bulk_modulus_at_20=1.14e9,
    bulk_modulus_decay=7.8e-3,
    vapour_pressure_at_100=2.05e3,
    vapour_temperature=6130.0,
    specific_heat_at_60=2180.0,
    specific_heat_slope=4.0,
    scatter="fit of the Lee chart 0.4 % rms; batches differ far more",
    sources=(
        ("viscosity_law", _CHART), ("rated_low", "freezing point of Jet A, ASTM D1655"),
        ("rated_high", "estimate: deposits form above"), ("density_at_20", "Lee-sg"), ("thermal_expansion", "Lee-sg"),
        *_FUEL, ("specific_heat_at_60", "Lee-cp JP-4 2093 at 38 °C"), ("specific_heat_slope", _NONE + "RP-1's"),
        ("vapour_pressure_at_100", _NONE + "RP-1's"), ("vapour_temperature", _NONE + "RP-1's"),
    ),
)  # fmt: skip

OILS = {
    oil.name: oil
    for oil in (
        MIL_PRF_5606, YH12_PAPER, MIL_PRF_83282, MIL_PRF_87257, SKYDROL_500B4, SKYDROL_LD4, SKYDROL_PE5, MIL_PRF_23699,
        ISO_VG_46, RP_1, JET_A,
    )
}  # fmt: skip
"""The oils by name."""

OIL_TABLE_UNITS = {"temperature": "degC", "viscosity": "mm^2/s", "density": "kg/m^3", "bulk_modulus": "Pa"}
"""The columns of a user's own oil with their units in the package's tables."""


STEEPEST = 8.0  # slope B of log10 log10 Z over log10 T up to which a table is believed: it is drawn on beyond its ends


def read_oil(table: dict[str, Any], where: str = "oil") -> Oil:
    """An oil from text with units: one by `name` with figures changed, or one's own from columns over temperature.

    One's own has `name`, `temperature = "-40, 40, 100 degC"` and `viscosity = "495, 13.5, 5.1 mm^2/s"`, and may have
    `density` and `bulk_modulus` (isothermal tangent, p = 0) at the same temperatures; what else it is silent about it
    takes from the oil that `like` names [mil_prf_5606]. It is rated over the table's range unless it says otherwise.
    Raises InputError for unknown names, columns of unequal length, temperatures that do not rise, viscosity that does
    not fall, and figures out of bounds.
    """
    figures = dict(table)
    dot = f"{where}." if where else ""
    own = "temperature" in figures or "viscosity" in figures
    columns = {name: figures.pop(name) for name in OIL_TABLE_UNITS if own and name in figures}
    name, like = figures.pop("name", None), figures.pop("like", None)
    for key, given in (("name", name), ("like", like)):
        if columns and given is not None and (not isinstance(given, str) or not given.strip()):
            raise InputError(f"expected a name as text, got {given!r}", key=f"{dot}{key}")
    known = {*quantities(Oil), *(OIL_TABLE_UNITS if own else ()), "name", "like", "file"}
    for key in figures:
        if key not in quantities(Oil):
            raise unknown_name("parameter of Oil", key, known, where)
    if not columns:
        if like is not None:
            raise InputError(
                "goes with an oil of one's own (temperature and viscosity); give name alone", key=f"{dot}like"
            )
        chosen = MIL_PRF_5606.name if name is None else name
        if not isinstance(chosen, str) or chosen not in OILS:
            raise unknown_name("oil", str(chosen), OILS, f"{dot}name")
        return change(OILS[chosen], figures, where)
    base = MIL_PRF_5606.name if like is None else like
    if base not in OILS:
        raise unknown_name("oil", base, OILS, f"{dot}like")
    if name is None:
        raise InputError("is missing: an oil of one's own needs a name", key=f"{dot}name", joint=" ")
    if name in OILS:
        raise InputError(f"{name!r} is an oil of this package; give one's own another name", key=f"{dot}name")
    return change(_own_oil(name, OILS[base], columns, dot), figures, where)


def _own_oil(name: str, base: Oil, columns: dict[str, Any], dot: str) -> Oil:
    """The oil of a table, with the rest of `base`."""
    for needed in ("temperature", "viscosity"):
        if needed not in columns:
            problem = "is missing: an oil of one's own has temperature and viscosity, as lists"
            raise InputError(problem, key=f"{dot}{needed}", joint=" ")
    rows: dict[str, np.ndarray] = {}
    for key, given in columns.items():
        if not isinstance(given, str):
            raise InputError(
                f"expected a list as text, such as '-40, 40, 100 {OIL_TABLE_UNITS[key]}', got {given!r}",
                key=f"{dot}{key}",
            )
        rows[key] = parse_list(given, OIL_TABLE_UNITS[key], f"{dot}{key}")
        if len(rows[key]) != len(rows["temperature"]):
            raise InputError(
                f"{len(rows[key])} values for {len(rows['temperature'])} temperatures; each needs one",
                key=f"{dot}{key}",
            )
    t = rows["temperature"]
    if len(t) < 2 or np.any(np.diff(t) <= 0.0):
        raise InputError("two or more temperatures are needed, each above the one before", key=f"{dot}temperature")
    if t[0] < COMPUTED_RANGE[0] or t[-1] > COMPUTED_RANGE[1]:
        low, high = COMPUTED_RANGE
        raise InputError(f"{t[0]:g} to {t[-1]:g} °C is not within {low:g} to {high:g} °C", key=f"{dot}temperature")
    nu = rows["viscosity"]
    if np.any(nu <= 0.2) or np.any(np.diff(nu) >= 0.0):
        raise InputError("must fall from row to row, and stay above 0.2 mm²/s", key=f"{dot}viscosity")
    steepest = WaltherViscosity(tuple(zip(t.tolist(), nu.tolist(), strict=True)), full=bool(nu[-1] < 2.0)).steepest
    if steepest > STEEPEST:
        raise InputError(
            f"falls too steeply, with a slope of {steepest:.3g} on the axes of ASTM D341, where oils "
            f"have 2 to 5 (at most {STEEPEST:g} is taken); are the rows in the right units?",
            key=f"{dot}viscosity",
        )
    for key in ("density", "bulk_modulus"):
        if key in rows and np.any(rows[key] <= 0.0):
            raise InputError("every value must be positive", key=f"{dot}{key}")

    def table(key: str) -> tuple[tuple[float, float], ...]:
        return tuple((float(a), float(b)) for a, b in zip(t, rows[key], strict=True))

    own: dict[str, Any] = {"rated_low": min(float(t[0]), 20.0), "rated_high": max(float(t[-1]), 20.0)}
    if "density" in rows:
        law = LogLinear(table("density"))
        around = float(law(19.5)), float(law(20.5))
        own |= {"density_law": law, "density_at_20": float(law(20.0))}
        own["thermal_expansion"] = max(float(np.log(around[0] / around[1])), 0.0)
    if "bulk_modulus" in rows:
        law = LogLinear(table("bulk_modulus"))
        own |= {"bulk_modulus_law": law, "bulk_modulus_at_20": float(law(20.0))}
    said = {"viscosity_law", *own}
    silent = [n for n in quantities(Oil) if n not in said]
    try:
        return replace(
            base, name=name, title=f"{name}, an oil of one's own", scatter="",
            viscosity_law=WaltherViscosity(table("viscosity"), full=bool(nu[-1] < 2.0)),
            sources=tuple((n, "its table") for n in sorted(said))
            + tuple((n, f"not given: that of {base.name}") for n in silent),
            **own,
        )  # fmt: skip
    except InputError as error:
        raise error.moved("oil", dot.rstrip(".")) from None


def own_columns(oil: Oil) -> list[tuple[str, str]]:
    """(key, text) of the table of an oil that came from one: `read_oil` reads it back. InputError for other laws."""
    law = oil.viscosity_law
    others = [(name, getattr(oil, f"{name}_law")) for name in ("density", "bulk_modulus")]
    others = [(name, given) for name, given in others if given is not None]
    if oil.name in OILS or not isinstance(law, WaltherViscosity):
        raise InputError(f"{oil.name!r} is an oil of its own; a scenario knows {', '.join(OILS)}", key="oil.name")
    at = [t for t, _ in law.table]
    if not all(isinstance(given, LogLinear) and [t for t, _ in given.table] == at for _, given in others):
        raise InputError(
            f"{oil.name!r} has laws that no table holds; a scenario knows {', '.join(OILS)}", key="oil.name"
        )
    columns = [("temperature", at), ("viscosity", [nu for _, nu in law.table])]
    columns += [(name, [value for _, value in given.table]) for name, given in others]
    return [(key, f"{', '.join(map(repr, values))} {OIL_TABLE_UNITS[key]}") for key, values in columns]


TABLE_TEMPERATURES = (-54.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0, 100.0, 135.0, 150.0, 200.0, 270.0)  # °C
TABLE_PRESSURE = 21e6  # Pa, beside 1 atm


def property_table(oil: Oil, temperatures: Any = TABLE_TEMPERATURES) -> dict[str, np.ndarray]:
    """Columns (n,) of an oil over temperature in SI, viscosity in m^2/s, at 1 atm and at 21 MPa; `rated` is 1 or 0."""
    t = np.asarray(temperatures, dtype=float)
    return {
        "temperature_degC": t,
        "rated": ((t >= oil.rated_low) & (t <= oil.rated_high)).astype(float),
        "viscosity_m2_s": oil.viscosity(t),
        "viscosity_at_21_MPa_m2_s": oil.viscosity(t, TABLE_PRESSURE),
        "density_kg_m3": oil.density(t),
        "density_at_21_MPa_kg_m3": oil.density(t, TABLE_PRESSURE),
        "bulk_modulus_Pa": oil.bulk_modulus(t),
        "bulk_modulus_at_21_MPa_Pa": oil.bulk_modulus(t, TABLE_PRESSURE),
        "specific_heat_J_kgK": oil.specific_heat(t),
        "vapour_pressure_Pa": oil.vapour_pressure(t),
    }
