"""How an effect of the catalogue declares its parameters."""

from __future__ import annotations

from valvesim.valve.coefficients import Coefficients
from valvesim.valve.effect import Parameter


def amplitude_parameter(
    name: str,
    unit: str,
    doc: str,
    bounds: tuple[float, float],
    typical: float,
    neutral: float = 0.0,
    ordinary: float = 0.0,
) -> Parameter:
    """What switches an effect: its default is the neutral value."""
    return Parameter(
        name=name, unit=unit, doc=doc, default=neutral, bounds=bounds, neutral=neutral, typical=typical,
        ordinary=ordinary,
    )  # fmt: skip


def shape_parameter(
    name: str,
    unit: str,
    doc: str,
    default: float,
    bounds: tuple[float, float],
    sought: tuple[float, ...] = (),
    *,
    discrete: bool = False,
) -> Parameter:
    """What an effect looks like once it is there."""
    return Parameter(name=name, unit=unit, doc=doc, default=default, bounds=bounds, sought=sought, discrete=discrete)


def scaled(c: Coefficients, **factors) -> Coefficients:
    """The coefficients with some of them multiplied."""
    return c._replace(**{name: getattr(c, name) * factor for name, factor in factors.items()})
