"""Hydraulic oil: density, viscosity, bulk modulus and vapour pressure of (temperature, pressure).

Symbols
    T temperature °C, p absolute pressure Pa, nu kinematic viscosity m^2/s, rho density kg/m^3
    Z of ASTM D341, a function of nu in mm^2/s; alpha_p pressure-viscosity coefficient 1/Pa, nu ~ exp(alpha_p p)
    K isothermal tangent bulk modulus Pa, K0 at p = 0, K1 = dK/dp; alpha share of entrained air at 1 atm

The laws are plain functions kept in fields of `Oil`, so a user's own oil is an `Oil` with other functions or figures;
`valvesim.valve.oils` holds the oils by name and reads a user's own.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from valvesim.errors import InputError, warn_once
from valvesim.units import check_bounds, quantity
from valvesim.valve.laws import is_number, straight_segments

ATMOSPHERE = 101325.0
KELVIN = 273.15
COMPUTED_RANGE = (-100.0, 400.0)  # °C: beyond it the oil is solid or gone, and the laws mean nothing


@dataclass(frozen=True)
class WaltherViscosity:
    """Walther law (ASTM D341) through a table of (°C, mm^2/s): log10 log10 Z straight in log10 of kelvin.

    A straight line between neighbours and on beyond the ends: oils with viscosity-index improver need more than one.
    Z is nu + 0.7, or with `full` the standard's form for thin liquids (below 2 mm^2/s, where nu + 0.7 misses by 10 %).
    Called with °C it returns m^2/s. Raises InputError for a table of one row, out of order or not positive.
    """

    table: tuple[tuple[float, float], ...]
    full: bool = False

    def __post_init__(self):
        rows = self.table
        if len(rows) < 2 or any(b[0] <= a[0] or b[1] >= a[1] for a, b in zip(rows[:-1], rows[1:], strict=True)):
            raise InputError(f"viscosity table {rows}: needs rows of rising temperature and falling viscosity")
        least = 0.2 if self.full else 0.0
        if not rows[-1][1] > least or not np.all(np.isfinite(rows)) or not rows[0][0] > -KELVIN:
            raise InputError(
                f"viscosity table {rows}: needs viscosities above {least:g} mm^2/s and temperatures above absolute zero"
            )

    @property
    def steepest(self) -> float:
        """The largest slope B of log10 log10 Z = A - B log10 T between two neighbours; real oils have 2 to 5."""
        log_kelvin, log_log = _d341_axes(self.table, self.full)
        return float(np.max(-np.diff(log_log) / np.diff(log_kelvin)))

    def __call__(self, temperature):
        y = straight_segments(np.log10(np.asarray(temperature) + KELVIN), *_d341_axes(self.table, self.full))
        plain = 10.0**10.0**y - 0.7
        return (plain - _thin(plain) if self.full else plain) * 1e-6


def _thin(plain):
    """What ASTM D341 takes off Z - 0.7 to give the viscosity of a thin liquid, mm^2/s; nothing above 8 mm^2/s."""
    z = np.minimum(plain, 20.0)
    return np.exp(-0.7487 - 3.295 * z + 0.6119 * z * z - 0.3193 * z * z * z)


@functools.lru_cache(maxsize=64)
def _d341_axes(table: tuple[tuple[float, float], ...], full: bool) -> tuple[np.ndarray, np.ndarray]:
    """(log10 of kelvin, log10 log10 Z) of a table: for the full form Z by iteration, which contracts."""
    nu = np.array([nu for _, nu in table])
    plain = nu + 0.0
    for _ in range(200 if full else 0):
        plain = nu + _thin(plain)
    return np.log10(np.array([t for t, _ in table]) + KELVIN), np.log10(np.log10(plain + 0.7))


@dataclass(frozen=True)
class LogLinear:
    """A positive property through a table of (°C, value): its logarithm straight between rows and beyond the ends."""

    table: tuple[tuple[float, float], ...]

    def __post_init__(self):
        rows = self.table
        if len(rows) < 2 or any(b[0] <= a[0] for a, b in zip(rows[:-1], rows[1:], strict=True)):
            raise InputError(f"table {rows}: needs two rows or more of rising temperature")
        if not all(np.isfinite(t) and 0.0 < value < np.inf for t, value in rows):
            raise InputError(f"table {rows}: needs finite positive values")

    def __call__(self, temperature):
        at, logs = np.array([t for t, _ in self.table]), np.log([value for _, value in self.table])
        return np.exp(straight_segments(np.asarray(temperature), at, logs))


def viscosity_yan_2019(temperature):
    """The paper's Eq. 18 read in °C: 48.46 exp(-0.03 T) mm^2/s, in m^2/s. Unphysical above 150 °C."""
    return 48.46e-6 * np.exp(-0.03 * np.asarray(temperature))


@dataclass(frozen=True, kw_only=True)
class Oil:
    """An oil: figures at the reference temperature of 20 °C and laws over temperature and pressure.

    Arrays broadcast. Values outside the rated temperature range are computed, with one `ValidityWarning` by name.
    `density_law` and `bulk_modulus_law` (°C -> any unit) give the run over temperature where a table is known; the
    figures at 20 °C give the size. `sources` says where this oil's figures come from where that is not the field's own;
    words (title, scatter, sources) make no other oil.
    """

    name: str
    viscosity_law: Callable
    density_law: Callable | None = None
    bulk_modulus_law: Callable | None = None
    title: str = field(default="", compare=False)
    scatter: str = field(default="", compare=False)
    sources: tuple[tuple[str, str], ...] = field(default=(), compare=False)
    rated_low: float = quantity(-54.0, "degC", "lowest rated temperature", (-100.0, 20.0), "specification")
    rated_high: float = quantity(135.0, "degC", "highest rated temperature", (20.0, 400.0), "specification")
    density_at_20: float = quantity(
        866.0, "kg/m^3", "density at 20 °C, 1 atm", (500.0, 2000.0), "Phillips 5606J sheet: SG 0.871"
    )
    thermal_expansion: float = quantity(8.3e-4, "1/K", "volume expansion at 20 °C", (0.0, 3e-3), "estimate")
    pressure_viscosity_at_40: float = quantity(
        17e-9, "1/Pa", "alpha_p at 40 °C, viscosity ~ exp(alpha_p p)", (0.0, 5e-8),
        "estimate: mineral oils 13-20e-9 at 100..30 °C, Stachowiak Table 2.3 (docs/oils.md)",
    )  # fmt: skip
    pressure_viscosity_decay: float = quantity(
        6.5e-3, "1/K", "alpha_p falls as exp(-decay (T - 40))", (0.0, 0.02), "same table: 6 to 8e-3 at 30 to 100 °C"
    )  # fmt: skip
    bulk_modulus_at_20: float = quantity(
        1.534e9, "Pa", "isothermal tangent bulk modulus at 20 °C, p = 0", (1e8, 1e10), "OpenHydraulics, Tait"
    )
    bulk_modulus_decay: float = quantity(5.8e-3, "1/K", "K0 falls as exp(-decay dT)", (0.0, 0.02), "same")
    bulk_modulus_slope: float = quantity(10.9, "1", "dK/dp", (0.0, 30.0), "same")
    vapour_pressure_at_100: float = quantity(1.9e3, "Pa", "vapour pressure at 100 °C", (0.0, 1e6), "estimate")
    vapour_temperature: float = quantity(
        5782.0, "K", "d ln(vapour pressure)/d(-1/T)", (0.0, 2e4), "fit to 0.4 kPa at 66 °C, 50 kPa at 200 °C"
    )
    specific_heat_at_60: float = quantity(
        2010.0, "J/(kg*K)", "specific heat at 60 °C", (500.0, 5000.0), "MSL MineralOil"
    )
    specific_heat_slope: float = quantity(3.7, "J/(kg*K^2)", "its rise per kelvin", (0.0, 20.0), "estimate")

    def __post_init__(self):
        check_bounds(self)

    def check_rated(self, temperature) -> None:
        """Warn once, by the oil's name, outside the rated range; InputError for NaN or where no law can hold."""
        low, high = float(np.min(temperature)), float(np.max(temperature))
        if not (low >= COMPUTED_RANGE[0] and high <= COMPUTED_RANGE[1]):  # NaN is outside
            wrong = high if high > COMPUTED_RANGE[1] else low
            raise InputError(
                f"oil {self.name}: {wrong:.4g} °C is outside {COMPUTED_RANGE[0]:g} to {COMPUTED_RANGE[1]:g} °C, "
                "beyond which no law of the oil is computed"
            )
        if high > self.rated_high:
            message = f"oil {self.name}: up to {high:.4g} °C is above its rated {self.rated_high:g} °C; extrapolated"
            warn_once(message, about=f"oil {self.name}, hot")
        if low < self.rated_low:
            message = f"oil {self.name}: down to {low:.4g} °C is below its rated {self.rated_low:g} °C; extrapolated"
            warn_once(message, about=f"oil {self.name}, cold")

    def source(self, name: str) -> str:
        """Where a figure of this oil comes from."""
        own = dict(self.sources)
        return own.get(name, type(self).__dataclass_fields__[name].metadata.get("source", ""))

    def viscosity(self, temperature, pressure=0.0):
        """Kinematic viscosity m^2/s, by Barus' law over pressure: nu(T) exp(alpha_p(T) p), to about 50 MPa.

        The coefficient is one of dynamic viscosity; the oil's compression (1 % at 21 MPa) is far within its doubt.
        """
        fall = -self.pressure_viscosity_decay * (np.asarray(temperature) - 40.0)
        rise = np.exp(self.pressure_viscosity_at_40 * np.exp(fall) * pressure)
        return self.viscosity_law(temperature) * rise

    def bulk_modulus_at_zero(self, temperature):
        """Isothermal tangent bulk modulus K0 of the air-free oil at p = 0, Pa."""
        if self.bulk_modulus_law is not None:
            return self.bulk_modulus_at_20 * (self.bulk_modulus_law(temperature) / self.bulk_modulus_law(20.0))
        return self.bulk_modulus_at_20 * np.exp(-self.bulk_modulus_decay * (np.asarray(temperature) - 20.0))

    def density(self, temperature, pressure=ATMOSPHERE):
        """kg/m^3. Compression belongs to K = K0 + K1 p: rho = rho0 (1 + K1 p/K0)^(1/K1)."""
        if self.density_law is not None:
            at_zero = self.density_at_20 * (self.density_law(temperature) / self.density_law(20.0))
        else:
            at_zero = self.density_at_20 * np.exp(-self.thermal_expansion * (np.asarray(temperature) - 20.0))
        if is_number(self.bulk_modulus_slope) and self.bulk_modulus_slope == 0.0:
            return at_zero * np.exp(pressure / self.bulk_modulus_at_zero(temperature))
        ratio = 1.0 + self.bulk_modulus_slope * pressure / self.bulk_modulus_at_zero(temperature)
        return at_zero * ratio ** (1.0 / self.bulk_modulus_slope)

    def bulk_modulus(self, temperature, pressure=ATMOSPHERE, *, air_fraction=0.0, air_exponent=1.4):
        """Isothermal bulk modulus, Pa: K0(T) + K1 p, lowered by entrained air (`aerated_bulk_modulus`)."""
        clean = self.bulk_modulus_at_zero(temperature) + self.bulk_modulus_slope * pressure
        return aerated_bulk_modulus(clean, pressure, air_fraction, air_exponent)

    def vapour_pressure(self, temperature):
        """Pa, absolute: Clausius-Clapeyron through two figures."""
        kelvin = np.asarray(temperature) + KELVIN
        return self.vapour_pressure_at_100 * np.exp(self.vapour_temperature * (1.0 / (100.0 + KELVIN) - 1.0 / kelvin))

    def specific_heat(self, temperature):
        """J/(kg K)."""
        return self.specific_heat_at_60 + self.specific_heat_slope * (np.asarray(temperature) - 60.0)

    def throttling_rise(self, temperature, pressure_drop):
        """Temperature rise of the oil over a throttle, K: dp (1 - alpha T)/(rho cp), T in kelvin."""
        kelvin = np.asarray(temperature) + KELVIN
        capacity = self.density(temperature) * self.specific_heat(temperature)
        return pressure_drop * (1.0 - self.thermal_expansion * kelvin) / capacity


def aerated_bulk_modulus(clean, pressure, air_fraction, exponent):
    """Bulk modulus of oil with entrained air, Pa: E = El (1 + a r)/(1 + a r El/(n p)), r = (p_atm/p)^(1/n).

    Equals El without air. `pressure` is absolute and bounded below by 1 kPa. Source: Simscape, isothermal liquid.
    """
    p = np.maximum(pressure, 1e3)
    share = air_fraction * np.exp(np.log(ATMOSPHERE / p) / exponent)
    return clean * (1.0 + share) / (1.0 + share * clean / (exponent * p))


MIL_PRF_5606 = Oil(
    name="mil_prf_5606",
    title="MIL-PRF-5606, mineral aircraft oil with viscosity-index improver",
    viscosity_law=WaltherViscosity(((-54.0, 2450.0), (-40.0, 495.0), (40.0, 13.5), (100.0, 5.1))),
    scatter="viscosity ±15 % warm, times or by 2.5 at -54 °C; density ±2.5 % between products (docs/oils.md)",
    sources=(
        ("viscosity_law", "Phillips X/C 5606J data sheet"),
        ("rated_low", "5606 class, GJB 1177-91"),
        ("rated_high", "5606 class, GJB 1177-91"),
        ("bulk_modulus_at_20", "OpenHydraulics Tait law of a general oil; Lee: 1.79 GPa, kind not stated"),
        ("specific_heat_at_60", "MSL (Modelica), MineralOil; Lee: 1968 J/(kg K) at 38 °C, 2 % more than this"),
    ),
)
YH12_PAPER = Oil(
    name="yh12_paper", title="YH-12 as the TAD paper computes it (Eq. 18)", viscosity_law=viscosity_yan_2019,
    rated_low=-40.0, rated_high=150.0, pressure_viscosity_at_40=0.0,
    scatter="a law of print: unphysical above 150 °C; no table of YH-12 was found",
    sources=(
        ("viscosity_law", "paper, Eq. 18 read in °C"), ("pressure_viscosity_at_40", "the paper knows none"),
        ("rated_low", "range of the paper's figures"), ("rated_high", "range of the paper's figures"),
    ),
)  # fmt: skip
