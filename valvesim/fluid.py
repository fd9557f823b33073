"""Hydraulic oil: density, viscosity, bulk modulus and vapour pressure of (temperature, pressure).

Symbols
    T temperature °C, p absolute pressure Pa, nu kinematic viscosity m^2/s, rho density kg/m^3
    K isothermal bulk modulus Pa, K0 at p = 0, K1 = dK/dp; alpha share of entrained air at 1 atm

The laws are plain functions kept in a field of `Oil`, so a user's own oil is an `Oil` with other functions or figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .errors import InputError, warn_once
from .units import check_bounds, quantity

ATMOSPHERE = 101325.0
KELVIN = 273.15
COMPUTED_RANGE = (-100.0, 400.0)  # °C: beyond it the oil is solid or gone, and the laws mean nothing


@dataclass(frozen=True)
class WaltherViscosity:
    """Walther law (ASTM D341) through a table of (°C, mm^2/s): log10 log10(nu + 0.7) straight in log10 of kelvin.

    A straight line between neighbours and on beyond the ends: oils with viscosity-index improver need more than one.
    Called with °C it returns m^2/s. Raises InputError for a table of one row or out of order.
    """

    table: tuple[tuple[float, float], ...]

    def __post_init__(self):
        rows = self.table
        if len(rows) < 2 or any(b[0] <= a[0] or b[1] >= a[1] for a, b in zip(rows[:-1], rows[1:], strict=True)):
            raise InputError(f"viscosity table {rows}: needs rows of rising temperature and falling viscosity")

    def __call__(self, temperature):
        log_kelvin = np.log10(np.array([t for t, _ in self.table]) + KELVIN)
        log_log = np.log10(np.log10(np.array([nu for _, nu in self.table]) + 0.7))
        slopes = np.diff(log_log) / np.diff(log_kelvin)
        x = np.log10(np.asarray(temperature, dtype=float) + KELVIN)
        segment = np.clip(np.searchsorted(log_kelvin, x) - 1, 0, len(slopes) - 1)
        y = log_log[segment] + slopes[segment] * (x - log_kelvin[segment])
        return (10.0**10.0**y - 0.7) * 1e-6


def viscosity_yan_2019(temperature):
    """The paper's Eq. 18 read in °C (model.md 6.3): 48.46 exp(-0.03 T) mm^2/s, in m^2/s. Unphysical above 150 °C."""
    return 48.46e-6 * np.exp(-0.03 * np.asarray(temperature, dtype=float))


@dataclass(frozen=True, kw_only=True)
class Oil:
    """An oil: figures at the reference temperature of 20 °C and laws over temperature and pressure.

    Arrays broadcast. Values outside the rated temperature range are computed, with one `ValidityWarning` by name.
    """

    name: str
    viscosity_law: Callable
    rated_low: float = quantity(-54.0, "degC", "lowest rated temperature", (-100.0, 20.0), "specification")
    rated_high: float = quantity(135.0, "degC", "highest rated temperature", (20.0, 400.0), "specification")
    density_at_20: float = quantity(866.0, "kg/m^3", "density at 20 °C, 1 atm", (500.0, 2000.0), "field.md 3: SG 0.871")
    thermal_expansion: float = quantity(8.3e-4, "1/K", "volume expansion at 20 °C", (0.0, 3e-3), "field.md 3")
    bulk_modulus_at_20: float = quantity(
        1.534e9, "Pa", "isothermal bulk modulus at 20 °C, p = 0", (1e8, 1e10), "field.md 3: OpenHydraulics Tait"
    )
    bulk_modulus_decay: float = quantity(5.8e-3, "1/K", "K0 falls as exp(-decay dT)", (0.0, 0.02), "same")
    bulk_modulus_slope: float = quantity(10.9, "1", "dK/dp", (0.0, 30.0), "same")
    vapour_pressure_at_100: float = quantity(1.9e3, "Pa", "vapour pressure at 100 °C", (0.0, 1e6), "field.md 3, memory")
    vapour_temperature: float = quantity(
        5782.0, "K", "d ln(vapour pressure)/d(-1/T)", (0.0, 2e4), "fit to 0.4 kPa at 66 °C, 50 kPa at 200 °C"
    )
    specific_heat_at_60: float = quantity(2010.0, "J/(kg*K)", "specific heat at 60 °C", (500.0, 5000.0), "field.md 3")
    specific_heat_slope: float = quantity(3.7, "J/(kg*K^2)", "its rise per kelvin", (0.0, 20.0), "field.md 3, memory")

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

    def viscosity(self, temperature):
        """Kinematic viscosity m^2/s."""
        return self.viscosity_law(temperature)

    def bulk_modulus_at_zero(self, temperature):
        """Bulk modulus K0 of the air-free oil at p = 0, Pa."""
        return self.bulk_modulus_at_20 * np.exp(-self.bulk_modulus_decay * (np.asarray(temperature) - 20.0))

    def density(self, temperature, pressure=ATMOSPHERE):
        """kg/m^3. Compression belongs to K = K0 + K1 p: rho = rho0 (1 + K1 p/K0)^(1/K1)."""
        at_zero = self.density_at_20 * np.exp(-self.thermal_expansion * (np.asarray(temperature) - 20.0))
        if self.bulk_modulus_slope == 0.0:
            return at_zero * np.exp(pressure / self.bulk_modulus_at_zero(temperature))
        ratio = 1.0 + self.bulk_modulus_slope * pressure / self.bulk_modulus_at_zero(temperature)
        return at_zero * ratio ** (1.0 / self.bulk_modulus_slope)

    def bulk_modulus(self, temperature, pressure=ATMOSPHERE, *, air_fraction=0.0, air_exponent=1.4):
        """Isothermal bulk modulus, Pa: K0(T) + K1 p, lowered by entrained air (`aerated_bulk_modulus`)."""
        clean = self.bulk_modulus_at_zero(temperature) + self.bulk_modulus_slope * pressure
        return aerated_bulk_modulus(clean, pressure, air_fraction, air_exponent)

    def vapour_pressure(self, temperature):
        """Pa, absolute: Clausius-Clapeyron through two figures."""
        kelvin = np.asarray(temperature, dtype=float) + KELVIN
        return self.vapour_pressure_at_100 * np.exp(self.vapour_temperature * (1.0 / (100.0 + KELVIN) - 1.0 / kelvin))

    def specific_heat(self, temperature):
        """J/(kg K)."""
        return self.specific_heat_at_60 + self.specific_heat_slope * (np.asarray(temperature) - 60.0)

    def throttling_rise(self, temperature, pressure_drop):
        """Temperature rise of the oil over a throttle, K: dp (1 - alpha T)/(rho cp), T in kelvin. field.md 2."""
        kelvin = np.asarray(temperature, dtype=float) + KELVIN
        capacity = self.density(temperature) * self.specific_heat(temperature)
        return pressure_drop * (1.0 - self.thermal_expansion * kelvin) / capacity


def aerated_bulk_modulus(clean, pressure, air_fraction, exponent):
    """Bulk modulus of oil with entrained air, Pa: E = El (1 + a r)/(1 + a r El/(n p)), r = (p_atm/p)^(1/n).

    Equals El without air. `pressure` is absolute and bounded below by 1 kPa. Source: Simscape form, field.md 3.
    """
    p = np.maximum(pressure, 1e3)
    share = air_fraction * np.exp(np.log(ATMOSPHERE / p) / exponent)
    return clean * (1.0 + share) / (1.0 + share * clean / (exponent * p))


MIL_PRF_5606 = Oil(
    name="mil_prf_5606",
    viscosity_law=WaltherViscosity(((-54.0, 2450.0), (-40.0, 495.0), (40.0, 13.5), (100.0, 5.1))),
)
YH12_PAPER = Oil(
    name="yh12_paper", viscosity_law=viscosity_yan_2019, rated_low=-40.0, rated_high=150.0
)  # fmt: skip

OILS = {oil.name: oil for oil in (MIL_PRF_5606, YH12_PAPER)}
