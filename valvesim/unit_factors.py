"""Factors between the units in daily use, so that reading them needs no registry of units, which takes 0.1 s to load.

Each is pint's own to the last bit, its rounding too, so that an answer is the same whichever converts; the tests hold
them against pint.
"""

_OWN = (
    "1/K", "A", "A/K", "A/Wb", "H", "Hz", "N", "N*m*s/rad", "N*m/rad", "N*s/m", "N/m", "Pa", "Pa/(m^3/s)", "V", "degC",
    "delta_degC", "delta_degC/s", "kg", "kg*m^2", "kg/m^3", "m", "m/K", "m/s", "m^2", "m^2/s", "m^3", "m^3/s", "ohm",
    "s", "s/m",
)  # fmt: skip
"""Units in which quantities are declared."""

FACTORS: dict[tuple[str, str], float] = {(unit, unit): 1.0 for unit in _OWN} | {
    ("mA", "A"): 1e-3, ("mH", "H"): 1e-3, ("kHz", "Hz"): 1e3, ("kPa", "Pa"): 1e3, ("MPa", "Pa"): 1e6,
    ("bar", "Pa"): 1e5, ("psi", "Pa"): 6894.7572931683635, ("°C", "degC"): 1.0, ("K", "delta_degC"): 1.0,
    ("K/s", "delta_degC/s"): 1.0, ("mm", "m"): 1e-3, ("um", "m"): 1e-6, ("mm/s", "m/s"): 1e-3, ("mm^2", "m^2"): 1e-6,
    ("cm^3", "m^3"): 1.0000000000000002e-06, ("L/min", "m^3/s"): 1.666666666666667e-05, ("mm^2/s", "m^2/s"): 1e-6,
    ("cSt", "m^2/s"): 1.0000000000000002e-06, ("ms", "s"): 1e-3, ("us", "s"): 1e-6, ("min", "s"): 60.0,
}  # fmt: skip
"""(unit, unit that it is converted to) -> the factor."""
