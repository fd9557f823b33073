"""The paper's figures and tables recomputed, and the valve of its lost Table 4 identified. No pictures here.

Symbols (model.md sections 2 to 4)
    theta armature angle, drift theta(T)/theta(20 °C) - 1, M0 polarization magnetomotive force, a armature arm
    A1 A2 A3 factors of the balances, K_k coefficients of the TAD polynomial
Signs
    As derived: theta = A1 T_d + A2 p_L + A3 (Eqs. 33, 34). As the appendix prints it: theta = -A1 T_d - A2 p_L - A3, so
    that the magnetic spring stiffens the armature and the hydraulic feedback softens it. That variant lives here alone.
    A drift counts as positive where the angle grows. The paper tells which routes go together, not which way they go: a
    valve is compared in both senses, and "turned" so that the published flow coefficients count as negative.

Source: Yan, Liu, Ma, IEEE Access 2019, sections II to V; model.md section 6 for its misprints.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.errors import InputError
from valvesim.valve.equations import FLOW_FORCE_FACTOR
from valvesim.valve.equilibrium import static_solution, tad_polynomial
from valvesim.valve.flow_coefficients import (
    NOZZLE_HYDRAULIC_DIAMETER,
    TABLE_3,
    fit_orifice_law,
    flow_coefficients_reynolds,
    left_one_out,
    reynolds_number,
    table_3_reynolds,
)
from valvesim.valve.fluid import MIL_PRF_5606, YH12_PAPER, viscosity_yan_2019
from valvesim.valve.laws import MU_0
from valvesim.valve.parameters import (
    ROUTES,
    Coefficients,
    PartTemperatures,
    Valve,
    flow_coefficients_yan_2019,
    reference_valve,
)

Progress = Callable[[str, float], None]

OIL = replace(YH12_PAPER, rated_high=270.0)  # the paper uses its oil up to 270 °C; no warning for repeating it
RANGE = np.linspace(20.0, 270.0, 51)  # °C, of Figs. 3 and 14 to 18
EXPERIMENT_RANGE = np.linspace(20.0, 95.0, 31)  # °C, of section V
CURRENTS = (1e-3, 2e-3, 5e-3, 10e-3)  # A; the paper's "different currents" are not told
TOLERANCE = 0.05  # a published figure counts as reached within 5 % of itself


# ---------------------------------------------------------------- what the paper states


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure that section IV states: size in percent, direction (0: not told) and where it stands."""

    key: str
    title: str
    size: float
    direction: int
    source: str

    @property
    def target(self) -> float:
        """Signed where the direction is told."""
        return self.size * (self.direction or 1)


_SECTION_4 = "section IV, Figs. 15-16"
FIGURES = (
    Figure(key="flow", title="flow coefficients", size=16.01, direction=-1, source=_SECTION_4),
    Figure(key="orifice", title="orifice size", size=2.88, direction=+1, source=_SECTION_4),
    Figure(key="mmf", title="magnetomotive force", size=3.168, direction=+1, source=_SECTION_4),
    Figure(key="gap", title="air gaps", size=0.9648, direction=0, source=_SECTION_4),
    Figure(key="reluctance", title="magnet reluctance", size=0.163, direction=-1, source=_SECTION_4),
    Figure(key="arm", title="armature arm", size=0.163, direction=-1, source=_SECTION_4),
    Figure(key="tube", title="spring tube", size=0.700, direction=+1, source=_SECTION_4),
    Figure(key="rod", title="feedback rod", size=0.065, direction=+1, source=_SECTION_4),
    Figure(key="total", title="all routes, largest", size=15.6, direction=-1, source="section IV, Fig. 17"),
    Figure(key="knee", title="all routes, at 40 °C", size=15.6, direction=-1, source="section IV, Fig. 17"),
    Figure(key="total_5mA", title="all routes, largest at 5 mA", size=15.6, direction=-1, source="section IV, Fig. 18"),
)
"""What the identification aims at, in the order of its residuals."""

PUBLISHED_GAP_DRIFT = 6.0  # %, "the thickness of each gap drifts by 6%", opposite ways, Fig. 3
PUBLISHED_FIT_ERRORS = (1.3, 0.27)  # %, largest errors of C_df and C_d0, below Eq. 19
PUBLISHED_TRAVEL = 2.5  # %, "below 2.5% for a current of 1mA", of the nozzle gap, below Eq. 19
PUBLISHED_MMF_LOSS = 5.0  # %, "will drop by about 5%", below Eq. 5


# ---------------------------------------------------------------- what is unknown, and its physical bounds


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A parameter of the lost Table 4: bounds in SI, and why a valve of this class lies inside."""

    name: str
    low: float
    high: float
    why: str


UNKNOWNS = (
    Unknown(name="air_gap_area", low=4e-6, high=30e-6, why="a pole face of 2 x 2 mm to 5 x 6 mm"),
    Unknown(
        name="magnet_reluctance", low=3.9e7, high=4.7e8,
        why=f"Eq. 1 gives l_m/mu = {2980.0 / 1.27:.0f} A/T; a magnet of 5 to 60 mm² section",
    ),
    Unknown(name="coil_turns", low=500.0, high=10000.0, why="coils of 10 to 100 mA down to a few mA"),
    Unknown(name="armature_arm", low=8e-3, high=25e-3, why="14.5 mm in the textbook motor, halved to enlarged"),
    Unknown(name="nozzle_arm", low=4e-3, high=15e-3, why="8.9 mm in the textbook motor, halved to enlarged"),
    Unknown(name="feedback_arm", low=6e-3, high=25e-3, why="13.3 mm in the textbook motor, halved to doubled"),
    Unknown(name="spring_tube_stiffness", low=1.0, high=40.0, why="3.7 to 10.2 N·m/rad in three published sets, x 4"),
    Unknown(name="feedback_rod_stiffness", low=300.0, high=8000.0, why="2.7 to 3.3 kN/m in three published sets"),
    Unknown(name="nozzle_diameter", low=0.15e-3, high=0.8e-3, why="0.3 to 0.6 mm usual; below 0.15 mm it clogs"),
    Unknown(name="fixed_orifice_diameter", low=0.10e-3, high=0.5e-3, why="0.2 mm usual; below 0.1 mm it clogs"),
    Unknown(name="null_gap", low=15e-6, high=150e-6, why="30 to 40 um usual; at 15 um it closes on dirt"),
    Unknown(name="nozzle_length", low=0.05e-3, high=5e-3, why="wall that narrows the bore, up to a whole insert"),
    Unknown(name="fixed_orifice_length", low=0.05e-3, high=5e-3, why="same"),
    Unknown(name="flapper_length", low=0.1e-3, high=5e-3, why="half a flapper and the free end of a nozzle (Eq. 15)"),
    Unknown(name="spool_area", low=8e-6, high=120e-6, why="spool of 3.2 to 12.4 mm diameter"),
    Unknown(name="port_width", low=1e-3, high=40e-3, why="a slot of 1 mm to the whole circumference of 12.4 mm"),
    Unknown(name="supply_pressure", low=7e6, high=28e6, why="aerospace supplies; the paper's CFD has 15 MPa"),
    Unknown(name="return_pressure", low=0.1e6, high=3e6, why="open return to the 3 MPa of the paper's CFD"),
)  # fmt: skip
"""All else is in the paper (Tables 1, 2, gamma, M0). The pilot metal's expansion is held at 11e-6 1/K: it only ever
appears as a product with one of the three lengths."""

_LOW, _HIGH = (np.log([getattr(u, side) for u in UNKNOWNS]) for side in ("low", "high"))


def valves(shares: np.ndarray, *, flow_coefficients: Callable = flow_coefficients_yan_2019) -> Valve:
    """A batch of valves from shares (k, 18) of the logarithmic ranges of `UNKNOWNS`; fields are (k, 1)."""
    values = np.exp(_LOW + (_HIGH - _LOW) * np.clip(shares, 0.0, 1.0))
    # at the ends the logarithm must not carry a figure past its bound
    values = np.clip(values, [u.low for u in UNKNOWNS], [u.high for u in UNKNOWNS])
    fields: dict[str, Any] = {u.name: values[:, k : k + 1] for k, u in enumerate(UNKNOWNS)}
    return replace(reference_valve(), flow_coefficients=flow_coefficients, **fields)


# ---------------------------------------------------------------- drift by route, as derived and as printed


def flow_coefficients_as_printed(oil_temperature):
    """Eq. 19 as it is printed, in dT = T - 20 °C. Only for the question whether the paper's curves came from it."""
    return flow_coefficients_yan_2019(np.asarray(oil_temperature, dtype=float) - 20.0)


def printed_polynomial(c: Coefficients, current, *, supply_pressure, return_pressure):
    """K_0..K_9 with the appendix's signs (model.md 6.5). Not the model: for this reproduction alone.

    The polynomial is affine in A1, A2, A3; a rigid spring tube makes all three vanish, so the one with their signs
    turned is twice the rigid one less the derived one.
    """
    pressures = {"supply_pressure": supply_pressure, "return_pressure": return_pressure}
    rigid = tad_polynomial(c._replace(spring_tube_stiffness=1e40), current, **pressures)
    return 2.0 * rigid - tad_polynomial(c, current, **pressures)


@dataclass(frozen=True, kw_only=True)
class Drifts:
    """Drift of the angle in percent. k valves, n temperatures, m currents."""

    by_route: np.ndarray  # (8, k, n), at the first current
    total: np.ndarray  # (m, k, n)
    angle: np.ndarray  # (m, k, n), rad
    stiffness: np.ndarray  # (k,), least net stiffness over that without magnet and oil; at or below 0: no stable rest
    mechanical: np.ndarray  # (k,), least stiffness of springs and jets over springs alone
    travel: np.ndarray  # (m, k), greatest flapper travel over null gap


def drifts(
    valve: Valve, *, printed_signs: bool = False, temperatures=RANGE, currents=CURRENTS[:1], steps: int = 1
) -> Drifts:
    """Drift by route and of all together, isothermal, of a batch of valves (fields (k, 1), or floats for one).

    `steps` of the current follow the root that is connected to zero angle at zero current, from the linear one on.
    """
    t = np.asarray(temperatures, dtype=float)
    c = _by_route(valve, t, len(currents))
    i = np.array([currents[0]] * len(ROUTES) + list(currents))[:, None, None]
    pressures = {"supply_pressure": valve.supply_pressure, "return_pressure": valve.return_pressure}
    polynomial = printed_polynomial if printed_signs else tad_polynomial
    gap = np.asarray(c.null_gap_1 / c.nozzle_arm)
    z: Any = 0.0
    for step in range(1, steps + 1):
        K = polynomial(c, i * step / steps, **pressures)
        k = K * np.broadcast_to(gap[..., None], (*K.shape[:-1], 1)) ** np.arange(10)
        with np.errstate(all="ignore"):  # unstable valves may run off; their stiffness tells
            z, slope, settled = _newton(k, -k[..., 0] / k[..., 1] if step == 1 else z)
    springs = tad_polynomial(c._replace(spring_tube_stiffness=1e40), i, **pressures)[..., 1] * gap
    with np.errstate(all="ignore"):
        share = np.where(settled, np.minimum(k[..., 1], slope) / springs, -np.inf)
    stiffness = np.min(share, axis=(0, 2))
    angle, m = z * gap, len(ROUTES)
    with np.errstate(all="ignore"):
        percent = 100.0 * (angle / _at_20(valve, angle, t) - 1.0)
    return Drifts(
        by_route=percent[:m],
        total=percent[m:],
        angle=angle[m:],
        stiffness=stiffness,
        mechanical=_mechanical_share(valve, t, z.shape[1]),
        travel=np.max(np.abs(z[m:]), axis=2),
    )


def _at_20(valve: Valve, angle: np.ndarray, t: np.ndarray) -> np.ndarray:
    if t[0] != 20.0:
        raise InputError(f"drifts: the temperatures must start at 20 °C, where drift is zero; got {t[0]:.4g} °C")
    return angle[..., :1]


def _newton(k: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(root, slope of the polynomial there, whether it has converged) by six steps from `z`."""
    slope = move = z
    for _ in range(6):
        value, slope = k[..., 9], np.zeros(k.shape[:-1])
        for power in range(8, -1, -1):
            slope = slope * z + value
            value = value * z + k[..., power]
        move = value / slope
        z = z - move
    return z, slope, np.abs(move) <= 1e-9 * np.abs(z)


def _by_route(valve: Valve, t: np.ndarray, totals: int) -> Coefficients:
    """Coefficients with a leading axis: each route alone, then all of them `totals` times."""
    hot = valve.at(PartTemperatures.uniform(t), oil=OIL)
    cold = valve.at(PartTemperatures.uniform(t), oil=OIL, routes=())
    fields = _route_fields()
    changed = {}
    for name in sorted({name for names in fields.values() for name in names}):
        on = np.array([name in fields[route] for route in ROUTES] + [True] * totals)[:, None, None]
        changed[name] = np.where(on, getattr(hot, name), getattr(cold, name))
    return cold._replace(**changed)


@functools.cache
def _route_fields() -> dict[str, frozenset[str]]:
    """Which coefficients each route changes, found on the reference valve."""
    valve, hot = reference_valve(), PartTemperatures.uniform(120.0)
    cold = valve.at(hot, oil=OIL, routes=())
    found = {}
    for route in ROUTES:
        warm = valve.at(hot, oil=OIL, routes=(route,))
        found[route] = frozenset(n for n in Coefficients._fields if np.any(getattr(warm, n) != getattr(cold, n)))
    return found


def _mechanical_share(valve: Valve, t: np.ndarray, k: int) -> np.ndarray:
    """D over its part from the springs: the springs must outweigh the jets without any magnet."""
    c = valve.at(PartTemperatures.uniform(t), oil=OIL)
    arm, K_f = c.nozzle_arm + c.feedback_arm, c.feedback_rod_stiffness
    K_flow = FLOW_FORCE_FACTOR * c.port_width * valve.supply_pressure
    jets = 8 * np.pi * c.nozzle_arm**2 * c.nozzle_flow_coefficient**2 * valve.supply_pressure * c.null_gap_1
    springs = c.spring_tube_stiffness + K_f * arm**2 - K_f**2 * arm**2 / (K_f + K_flow)
    return np.min(np.atleast_2d(1.0 - jets / springs), axis=1) * np.ones(k)


def largest(percent: np.ndarray) -> np.ndarray:
    """The value of largest size along the last axis, with its sign."""
    at = np.argmax(np.abs(percent), axis=-1)[..., None]
    return np.take_along_axis(percent, at, axis=-1)[..., 0]


FIT_TEMPERATURES = np.array([20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, 150.0, 200.0, 270.0])
FIT_CURRENTS = (1e-3, 5e-3)


def figure_values(d: Drifts, temperatures) -> np.ndarray:
    """The figures of `FIGURES` in percent, signed, (k, 11), from drifts at the currents of `FIT_CURRENTS`."""
    knee = int(np.flatnonzero(np.asarray(temperatures) == 40.0)[0])
    rows = [*largest(d.by_route), largest(d.total[0]), d.total[0][:, knee], largest(d.total[1])]
    return np.stack(rows, axis=-1)


# ---------------------------------------------------------------- identification of the lost Table 4


@dataclass(frozen=True, kw_only=True)
class Variant:
    """How the balances, Eq. 19 and the stated directions are taken."""

    key: str
    title: str
    printed_signs: bool
    directions: bool = True
    sense: int = 1
    """+1: the directions of `FIGURES` are those of the angle; -1: all of them the other way round."""
    flow_coefficients: Callable = flow_coefficients_yan_2019


VARIANTS = (
    Variant(key="derived", title="as derived", printed_signs=False),
    Variant(key="derived_sizes", title="as derived, sizes only", printed_signs=False, directions=False),
    Variant(key="printed", title="signs as printed", printed_signs=True),
    Variant(
        key="printed_rise", title="signs and Eq. 19 as printed", printed_signs=True,
        flow_coefficients=flow_coefficients_as_printed,
    ),
)  # fmt: skip


def residuals(shares: np.ndarray, variant: Variant) -> np.ndarray:
    """(k, 11 + 3): computed/published - 1 of each figure, then what keeps a valve stable and within its travel.

    Directions count where the variant says so and the paper tells them. The last three are zero for a valve that is
    stable with 2 % to spare, with and without magnet, and whose flapper travels less than 2.5 % of its gap at 1 mA.
    """
    valve = valves(shares, flow_coefficients=variant.flow_coefficients)
    d = drifts(valve, printed_signs=variant.printed_signs, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS)
    values = figure_values(d, FIT_TEMPERATURES)
    misses = []
    for value, figure in zip(values.T, FIGURES, strict=True):
        direction = variant.directions * variant.sense * figure.direction
        misses.append((value * direction if direction else np.abs(value)) / figure.size - 1.0)
    limits = (
        300.0 * np.maximum(0.0, 0.02 - d.stiffness),
        300.0 * np.maximum(0.0, 0.02 - d.mechanical),
        3.0 * np.maximum(0.0, d.travel[0] / (PUBLISHED_TRAVEL / 100.0) - 1.0),
    )
    return np.clip(np.nan_to_num(np.stack([*misses, *limits], axis=-1), nan=1e3), -1e3, 1e3)


def misfit(residual: np.ndarray) -> float:
    """Root mean square of the relative misses of the figures, in percent."""
    return 100.0 * float(np.sqrt(np.mean(residual[: len(FIGURES)] ** 2)))


def _least_squares(start: np.ndarray, variant: Variant, free: np.ndarray, rows: np.ndarray, evaluations: int) -> Any:
    """Bounded least squares over the free parameters; one batch of valves gives residual and Jacobian."""
    from scipy.optimize import least_squares

    width = 1e-6
    base = np.clip(start, 0.0, 1.0)

    def full(u: np.ndarray) -> np.ndarray:
        shares = np.tile(base, (len(u), 1))
        shares[:, free] = u
        return residuals(shares, variant)[:, rows]

    def jacobian(u: np.ndarray) -> np.ndarray:
        step = np.where(u + width > 1.0, -width, width)
        r = full(np.vstack([u, u + np.diag(step)]))
        return ((r[1:] - r[0]) / step[:, None]).T

    return least_squares(
        lambda u: full(u[None])[0], np.clip(base[free], 1e-5, 1.0 - 1e-5), jacobian, bounds=(0.0, 1.0),
        max_nfev=evaluations, xtol=1e-6, ftol=1e-7,
    )  # fmt: skip


ALL_ROWS = np.arange(len(FIGURES) + 3)
ALL_FREE = np.arange(len(UNKNOWNS))
STARTS = 24
SCREENED = 4000  # random valves, of which the best are refined


@dataclass(frozen=True, kw_only=True)
class Identification:
    """The valve that comes closest, under one variant."""

    variant: Variant  # with the sense that comes closer
    shares: np.ndarray  # (18,) of the logarithmic ranges
    values: np.ndarray  # (11,) %, turned
    misfit: float  # %
    misfits: np.ndarray  # (starts,) %, ascending
    within_1: np.ndarray  # (starts that come within one percentage point, 18)

    @property
    def valve(self) -> Valve:
        """The valve, every field a float."""
        batch = valves(self.shares[None], flow_coefficients=self.variant.flow_coefficients)
        values: dict[str, Any] = {u.name: float(getattr(batch, u.name)[0, 0]) for u in UNKNOWNS}
        return replace(batch, **values)

    @property
    def misses(self) -> np.ndarray:
        """Relative miss of each figure; its size alone where the direction is not told or not asked for."""
        return residuals(self.shares[None], self.variant)[0, : len(FIGURES)]

    @property
    def reached(self) -> np.ndarray:
        """Which figures are met within `TOLERANCE`."""
        return np.abs(self.misses) <= TOLERANCE


def identify(
    variant: Variant, *, seed: int = 0, starts: int = STARTS, progress: Progress | None = None
) -> Identification:
    """Screen random valves, refine the best `starts` of them by bounded least squares, keep the best.

    Half of the starts aim at the directions in either sense.
    The same seed and number of starts give the same answer. Raises InputError for starts < 1.
    """
    if starts < 1:
        raise InputError(f"identification: {starts} starts; at least 1 is needed")
    shares = np.random.default_rng(seed).random((SCREENED, len(UNKNOWNS)))
    senses = [replace(variant, sense=sense) for sense in ((1, -1) if variant.directions else (1,))]
    begin = []
    for each in senses:
        cost = np.concatenate([np.sum(residuals(s, each) ** 2, axis=1) for s in np.array_split(shares, 16)])
        begin += [(each, shares[k]) for k in np.argsort(cost, kind="stable")[: -(-starts // len(senses))]]
    found = []
    for number, (each, start) in enumerate(begin):
        found.append((_least_squares(start, each, ALL_FREE, ALL_ROWS, 120), each))
        if progress is not None:
            progress(f"identifying {variant.title}", (number + 1) / len(begin))
    found.sort(key=lambda pair: pair[0].cost)
    best, aim = found[0]
    closest = aim
    if not variant.directions:
        closest = replace(variant, sense=-1 if _turned_values(best.x, variant)[0] > 0.0 else 1)
    alike = [fit for fit, each in found if each == aim and misfit(fit.fun) <= misfit(best.fun) + 1.0]
    return Identification(
        variant=closest,
        shares=best.x,
        values=_turned_values(best.x, closest, steps=10),
        misfit=misfit(best.fun),
        misfits=np.array([misfit(fit.fun) for fit, _ in found]),
        within_1=np.array([fit.x for fit in alike]),
    )


def _turned_values(shares: np.ndarray, variant: Variant, *, steps: int = 1) -> np.ndarray:
    """(11,) figures of one valve, turned so that the published flow coefficients count as negative."""
    valve = valves(shares[None], flow_coefficients=variant.flow_coefficients)
    d = drifts(
        valve, printed_signs=variant.printed_signs, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS, steps=steps
    )  # fmt: skip
    return variant.sense * figure_values(d, FIT_TEMPERATURES)[0]


PROFILE_SHARES = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True, kw_only=True)
class Determination:
    """How well the eleven figures determine each of the parameters, at an identified valve."""

    singular_values: np.ndarray  # (11,) relative change of the figures per factor e of a combination
    remaining: np.ndarray  # (18,) share of the prior spread (uniform in the bounds) that the figures leave
    profile: np.ndarray  # (18, 9) misfit in % with the parameter held at PROFILE_SHARES and all others refitted

    @property
    def combinations(self) -> int:
        """Combinations of parameters that the figures, taken as good to 5 %, fix better than a factor e."""
        return int(np.sum(self.singular_values > TOLERANCE))


def determine(found: Identification, *, progress: Progress | None = None) -> Determination:
    """Singular values, spread left by a linear estimate, and the misfit along each parameter.

    The linear estimate takes the figures as good to `TOLERANCE` and the bounds as a prior of the same spread.
    """
    n, width = len(UNKNOWNS), 1e-5
    step = np.where(found.shares + width > 1.0, -width, width)
    r = residuals(np.vstack([found.shares, found.shares + np.diag(step)]), found.variant)[:, : len(FIGURES)]
    jacobian = ((r[1:] - r[0]) / (step * (_HIGH - _LOW))[:, None]).T
    prior = (_HIGH - _LOW) / np.sqrt(12.0)
    information = jacobian.T @ jacobian / TOLERANCE**2 + np.diag(1.0 / prior**2)
    profile = np.empty((n, len(PROFILE_SHARES)))
    for k in range(n):
        free = np.delete(ALL_FREE, k)
        below = [j for j in range(len(PROFILE_SHARES)) if PROFILE_SHARES[j] <= found.shares[k]]
        above = [j for j in range(len(PROFILE_SHARES)) if PROFILE_SHARES[j] > found.shares[k]]
        for places in (below[::-1], above):  # from the optimum outward, each from the one before: along the valley
            start = found.shares
            for j in places:
                fit = _held(start, found, k, free, PROFILE_SHARES[j])
                start = np.insert(fit.x, k, PROFILE_SHARES[j])
                profile[k, j] = max(100.0 * float(np.sqrt(2.0 * fit.cost / len(FIGURES))), found.misfit)
        if progress is not None:
            progress(f"how well the figures determine the valve, {found.variant.title}", (k + 1) / n)
    return Determination(
        singular_values=np.linalg.svd(jacobian, compute_uv=False),
        remaining=np.sqrt(np.diag(np.linalg.inv(information))) / prior,
        profile=profile,
    )


def _held(start: np.ndarray, found: Identification, k: int, free: np.ndarray, share: float) -> Any:
    """Refit with parameter k held at a share of its range: from `start`, else from the optimum, whichever is closer."""
    fits = []
    for base in (start, found.shares):
        held = base.copy()
        held[k] = share
        fits.append(_least_squares(held, found.variant, free, ALL_ROWS, 30))
        if fits[-1].cost < 1.1 * np.sum(found.misses**2) / 2.0:
            break
    return min(fits, key=lambda fit: fit.cost)


GROUPS: dict[str, tuple[str, ...]] = {figure.key: (figure.key,) for figure in FIGURES} | {
    "curve": ("total", "knee", "total_5mA"),
    "curve_and_flow": ("flow", "total", "knee", "total_5mA"),
    "mmf_and_arm": ("mmf", "arm"),
    "routes": ROUTES,
}
"""Figures aimed at alone or together, to see what no valve inside the bounds can do."""


@dataclass(frozen=True, kw_only=True)
class Reach:
    """The closest that any valve found comes to a group of figures, all others ignored, in either sense."""

    keys: tuple[str, ...]
    values: np.ndarray  # (n,) %, turned
    worst: float  # largest relative miss of the group

    @property
    def possible(self) -> bool:
        """Whether the group can be met within `TOLERANCE`."""
        return self.worst <= TOLERANCE


def reach(found: Identification, *, seed: int = 0, progress: Progress | None = None) -> dict[str, Reach]:
    """For each of `GROUPS`, least squares on that group alone, from the identified valve and from random ones."""
    order = [figure.key for figure in FIGURES]
    rng = np.random.default_rng(seed)
    pool = rng.random((SCREENED // 4, len(UNKNOWNS)))
    screened = residuals(pool, found.variant)
    result = {}
    for number, (name, keys) in enumerate(GROUPS.items()):
        rows = np.array([order.index(key) for key in keys])
        with_limits = np.append(rows, np.arange(len(FIGURES), len(FIGURES) + 3))
        starts = np.argsort(np.sum(screened[:, with_limits] ** 2, axis=1), kind="stable")[:3]
        best: Any = None
        for sense in (1, -1):
            aim = replace(found.variant, sense=sense, directions=True)
            for start in (found.shares, *pool[starts]):
                fit = _least_squares(start, aim, ALL_FREE, with_limits, 60)
                if best is None or fit.cost < best[0].cost:
                    best = fit, aim
                if best[0].cost < 1e-6:
                    break
        fit, aim = best
        worst = float(np.max(np.abs(residuals(fit.x[None], aim)[0, rows])))
        result[name] = Reach(keys=tuple(keys), values=_turned_values(fit.x, aim)[rows], worst=worst)
        if progress is not None:
            progress(f"what is out of reach, {found.variant.title}", (number + 1) / len(GROUPS))
    return result


# ---------------------------------------------------------------- what no valve can do


@dataclass(frozen=True, kw_only=True)
class MagnetCheck:
    """The inequality of model.md 6.6 over random valves, 20 to 270 °C at 1 mA, balances as derived."""

    drawn: int
    stable: int
    mmf_loss: float  # %, loss of M0 itself
    losses: np.ndarray  # (stable,) %, loss of angle by the magnetomotive force alone
    stiffness: np.ndarray  # (stable,) net stiffness over the springs' own

    @property
    def exceptions(self) -> int:
        """Stable valves that lose less of their angle than M0 loses of itself."""
        return int(np.sum(self.losses < self.mmf_loss))


DRAWN = 20000  # random valves for the inequality


def check_magnet(*, seed: int = 0, drawn: int | None = None) -> MagnetCheck:
    """theta ~ M0/(K - k M0^2): a stable valve loses at least the share of angle that M0 loses. Checked, not assumed.

    Random valves inside the bounds of `UNKNOWNS`; those that are unstable, or leave their null gap, are left out.
    """
    drawn = DRAWN if drawn is None else drawn
    shares = np.random.default_rng(seed).random((drawn, len(UNKNOWNS)))
    row = ROUTES.index("mmf")
    losses, stiffness = [], []
    for part in np.array_split(shares, max(1, drawn // 2000)):
        d = drifts(valves(part), temperatures=(20.0, 270.0), steps=10)
        keep = (d.stiffness > 0.0) & (d.mechanical > 0.0) & (d.travel[0] < 1.0)
        losses.append(-d.by_route[row, keep, -1])
        stiffness.append(d.stiffness[keep])
    valve = reference_valve()
    loss = -100.0 * valve.polarization_mmf_slope * 250.0 / valve.polarization_mmf
    lost = np.concatenate(losses)
    return MagnetCheck(
        drawn=drawn, stable=len(lost), mmf_loss=loss, losses=lost, stiffness=np.concatenate(stiffness)
    )  # fmt: skip


ARM_GROWTH = reference_valve().pole_expansion * 250.0
"""Relative growth of the armature's arm from 20 to 270 °C, of Table 1 alone."""


def mmf_drift_implied_by_arm(arm_drift: float) -> float:
    """The drift by magnetomotive force, %, that a published drift by the armature's arm implies (opposite in sign).

    At small angle torque and magnetic spring hold a and M0 only as the product a M0: theta ~ m/(1 + x (m^2 - 1)) with
    m the product over its value at 20 °C and 1 - 2 x = S its sensitivity there. The arm grows by a_c dT.
    """
    valve = reference_valve()
    sensitivity = arm_drift / 100.0 / ARM_GROWTH
    m = 1.0 + valve.polarization_mmf_slope * 250.0 / valve.polarization_mmf
    x = (1.0 - sensitivity) / 2.0
    return 100.0 * (m / (1.0 + x * (m * m - 1.0)) - 1.0)


# ---------------------------------------------------------------- torque motor: Figs. 3 and 7


@dataclass(frozen=True, kw_only=True)
class AirGaps:
    """Fig. 3: drift of the two air gaps in percent over temperature, corrected and by the printed Eqs. 9 and 10."""

    temperatures: np.ndarray
    upper: np.ndarray
    lower: np.ndarray
    upper_printed: np.ndarray
    lower_printed: np.ndarray


def air_gaps(temperatures=RANGE) -> AirGaps:
    """The gaps of Table 2 over temperature. Printed Eq. 10 has L5 + L7 for L5 - L7, and l_g2 a_s for L2 a_s."""
    valve, rise = reference_valve(), np.asarray(temperatures) - 20.0
    c = valve.at(PartTemperatures.uniform(temperatures), oil=OIL)
    L1, L2, L3, L4 = valve.length_1, valve.length_2, valve.length_3, valve.length_4
    L5, L6 = valve.length_5, valve.length_6
    L7, upper, lower = L5 + L6 - L4, L4 - L3, L2 - L1
    a_c, a_x, a_m, a_s = (
        valve.pole_expansion, valve.armature_expansion, valve.magnet_expansion, valve.spring_tube_expansion
    )  # fmt: skip
    printed_1 = ((L5 + L7) * a_c + (L2 - L3) * a_x + L6 * a_m - L2 * a_s) / upper
    printed_2 = (lower * a_s - L1 * a_c) / lower
    return AirGaps(
        temperatures=np.asarray(temperatures),
        upper=100.0 * (c.upper_air_gap_1 / upper - 1.0),
        lower=100.0 * (c.lower_air_gap_1 / lower - 1.0),
        upper_printed=100.0 * printed_1 * rise,
        lower_printed=100.0 * printed_2 * rise,
    )


@dataclass(frozen=True, kw_only=True)
class GapFlux:
    """Fig. 7: fluxes phi1..phi4 in Wb, (4, n), over current in A, at 20 °C and the armature held in the middle."""

    currents: np.ndarray
    fluxes: np.ndarray

    @property
    def nonlinearity(self) -> float:
        """Largest distance of a flux from its straight line, % of that flux's rise."""
        worst = 0.0
        for flux in self.fluxes:
            line = np.polyval(np.polyfit(self.currents, flux, 1), self.currents)
            worst = max(worst, float(np.max(np.abs(flux - line)) / np.ptp(flux)))
        return 100.0 * worst


def gap_flux(valve: Valve, currents) -> GapFlux:
    """The nine equations of the magnetic circuit (Eq. 11 restored, model.md 2), solved as they stand."""
    c = valve.at(PartTemperatures.uniform(20.0), oil=OIL)
    share, R0 = c.flux_share, c.magnet_reluctance
    R1 = R2 = c.upper_air_gap_1 / (MU_0 * c.air_gap_area)
    R3 = R4 = c.lower_air_gap_1 / (MU_0 * c.air_gap_area)
    # unknowns: phi1..phi8, phi_a
    rows = np.array(
        [
            [1, 0, 0, 0, 1, 0, -share, 0, 0],
            [0, 1, 0, 0, -1, 0, 0, -share, 0],
            [0, 0, 1, 0, 0, -1, 0, -share, 0],
            [1, 0, 0, -1, 0, 0, 0, 0, -1],
            [0, -1, 1, 0, 0, 0, 0, 0, -1],
            [R1, 0, 0, R4, 0, 0, R0, 0, 0],
            [0, R2, R3, 0, 0, 0, 0, R0, 0],
            [R1, -R2, 0, 0, 0, 0, 0, 0, 0],
            [0, 0, R3, -R4, 0, 0, 0, 0, 0],
        ],
        dtype=float,
    )
    i = np.asarray(currents, dtype=float)
    N, M0 = c.coil_turns * i, np.full(i.shape, float(c.polarization_mmf))
    right = np.stack([*np.zeros((5, len(i))), M0, M0, N, N])
    scale = np.array([1.0] * 5 + [1e-8] * 4)[:, None]
    return GapFlux(currents=i, fluxes=np.linalg.solve(rows * scale, right * scale)[:4])


# ---------------------------------------------------------------- oil: Figs. 11 and 13, Table 3


@dataclass(frozen=True, kw_only=True)
class FlowFit:
    """One law for one orifice of Table 3: relative errors in percent at the nine temperatures."""

    title: str
    orifice: str
    errors: np.ndarray
    left_out: np.ndarray | None
    """Error of each point by the law fitted to the other eight; None for a law that is taken as printed."""


@dataclass(frozen=True, kw_only=True)
class FlowFits:
    """Fig. 13 and Table 3, with what Eq. 19 misses."""

    printed: tuple[FlowFit, FlowFit]  # Eq. 19 read in °C
    as_rise: tuple[FlowFit, FlowFit]  # Eq. 19 as printed, in dT
    power: tuple[FlowFit, FlowFit]  # Eq. 19 refitted: a power of Re
    hump: tuple[FlowFit, FlowFit]  # power of Re with hump
    nozzle_rise: float  # %, Table 3, 20 to 50 °C
    nozzle_fall: float  # %, Table 3, 50 to 150 °C
    nozzle_rise_printed: float  # %, the same by Eq. 19
    nozzle_fall_printed: float
    cold_slope_yan: float  # d ln C_d0/d ln Re between -40 and -30 °C with Eq. 18; viscous flow allows 1 at most
    cold_slope_walther: float
    highest_reynolds: float  # of the nozzle in Table 3
    reynolds_at_270: float  # of the nozzle with the Walther law at 270 °C


def flow_fits() -> FlowFits:
    """Eq. 19 and the law over Reynolds number against Table 3, in the fit and left one out."""
    t = TABLE_3[:, 0]
    names = ("nozzle", "fixed orifice")

    def taken(title: str, law: Callable) -> tuple[FlowFit, FlowFit]:
        fits = [
            FlowFit(title=title, orifice=name, errors=100.0 * (c / table - 1.0), left_out=None)
            for name, c, table in zip(names, law(t), TABLE_3[:, 1:].T, strict=True)
        ]
        return fits[0], fits[1]

    def fitted(title: str, hump: bool) -> tuple[FlowFit, FlowFit]:
        fits = []
        for name, re, c in zip(names, table_3_reynolds(), TABLE_3[:, 1:].T, strict=True):
            errors = 100.0 * (fit_orifice_law(re, c, hump=hump)(re) / c - 1.0)
            out = 100.0 * left_one_out(re, c, hump=hump)
            fits.append(FlowFit(title=title, orifice=name, errors=errors, left_out=out))
        return fits[0], fits[1]

    def change(values: np.ndarray, low: float, high: float) -> float:
        return 100.0 * float(values[t == high][0] / values[t == low][0] - 1.0)

    def cold_slope(viscosity: Callable) -> float:
        return float(np.log(TABLE_3[1, 2] / TABLE_3[0, 2]) / np.log(viscosity(t[0]) / viscosity(t[1])))

    eq_19 = flow_coefficients_yan_2019(t)[0]
    return FlowFits(
        printed=taken("Eq. 19, in °C", flow_coefficients_yan_2019),
        as_rise=taken("Eq. 19 as printed, in temperature rise", _eq_19_in_rise),
        power=fitted("power of Re (Eq. 19 refitted)", False),
        hump=fitted("power of Re with hump", True),
        nozzle_rise=change(TABLE_3[:, 1], 20.0, 50.0),
        nozzle_fall=change(TABLE_3[:, 1], 50.0, 150.0),
        nozzle_rise_printed=change(eq_19, 20.0, 50.0),
        nozzle_fall_printed=change(eq_19, 50.0, 150.0),
        cold_slope_yan=cold_slope(viscosity_yan_2019),
        cold_slope_walther=cold_slope(MIL_PRF_5606.viscosity),
        highest_reynolds=float(reynolds_number(150.0, NOZZLE_HYDRAULIC_DIAMETER)),
        reynolds_at_270=float(
            reynolds_number(270.0, NOZZLE_HYDRAULIC_DIAMETER, viscosity=MIL_PRF_5606.viscosity)
        ),
    )  # fmt: skip


def _eq_19_in_rise(t):
    """Eq. 19 in dT without the hold below -40 °C: this is what shows that dT cannot be meant."""
    rise = np.asarray(t) - 20.0
    return 0.663 - 0.00136 * np.exp(-0.1473 * rise), 0.752 - 0.1143 * np.exp(-0.03569 * rise)


# ---------------------------------------------------------------- all together


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Everything on the page."""

    seed: int
    starts: int
    gaps: AirGaps
    flux: GapFlux
    fits: FlowFits
    magnet: MagnetCheck
    identified: dict[str, Identification]
    determined: dict[str, Determination]
    reached: dict[str, dict[str, Reach]]
    curves: dict[str, Drifts]  # of the reference valve ("reference") and of each identified one, over RANGE
    experiment: dict[str, Drifts]  # the same over EXPERIMENT_RANGE
    reference_values: np.ndarray  # (11,) %, the reference valve's figures, turned
    reference_sense: int
    reference_flow_drifts: tuple[float, float]  # %, its flow route at 270 °C: Eq. 19, Re law with the real oil
    polynomial_error: float  # largest relative difference from `static_solution` over RANGE

    def sense(self, key: str) -> int:
        """-1 where a valve's drifts must be turned for its flow coefficients to count as the published ones."""
        return self.identified[key].variant.sense if key in self.identified else self.reference_sense


def compute(*, seed: int = 0, starts: int = STARTS, progress: Progress | None = None) -> Reproduction:
    """Recompute all of the paper that its text lets one compute. `progress` gets (what, share from 0 to 1)."""
    tell = progress or (lambda text, share: None)
    tell("torque motor, oil and flow coefficients", 0.0)
    reference = reference_valve()
    gaps, flux, fits = air_gaps(), gap_flux(reference, np.linspace(1e-3, 10e-3, 10)), flow_fits()
    tell("the magnet's inequality over random valves", 0.05)
    magnet = check_magnet(seed=seed)

    def within(low: float, high: float) -> Progress:
        return lambda text, share: tell(text, low + (high - low) * share)

    identified = {
        variant.key: identify(variant, seed=seed, starts=starts, progress=within(0.1 + 0.14 * k, 0.24 + 0.14 * k))
        for k, variant in enumerate(VARIANTS)
    }
    determined, reached = {}, {}
    for k, key in enumerate(("derived", "printed")):
        determined[key] = determine(identified[key], progress=within(0.66 + 0.16 * k, 0.74 + 0.16 * k))
        reached[key] = reach(identified[key], seed=seed, progress=within(0.74 + 0.16 * k, 0.82 + 0.16 * k))
    cases = {"reference": (reference, False)} | {
        key: (found.valve, found.variant.printed_signs) for key, found in identified.items()
    }

    def curves(temperatures: np.ndarray) -> dict[str, Drifts]:
        return {
            key: drifts(valve, printed_signs=signs, temperatures=temperatures, currents=CURRENTS, steps=10)
            for key, (valve, signs) in cases.items()
        }

    whole = curves(RANGE)
    direct = static_solution(reference, current=CURRENTS[0], temperature=RANGE, oil=OIL).armature_angle
    at_fit = drifts(reference, temperatures=FIT_TEMPERATURES, currents=FIT_CURRENTS, steps=10)
    laws = (flow_coefficients_yan_2019, flow_coefficients_reynolds)
    row = ROUTES.index("flow")
    sense = -1 if figure_values(at_fit, FIT_TEMPERATURES)[0, row] > 0.0 else 1
    return Reproduction(
        seed=seed,
        starts=starts,
        gaps=gaps,
        flux=flux,
        fits=fits,
        magnet=magnet,
        identified=identified,
        determined=determined,
        reached=reached,
        curves=whole,
        experiment=curves(EXPERIMENT_RANGE),
        reference_values=sense * figure_values(at_fit, FIT_TEMPERATURES)[0],
        reference_sense=sense,
        reference_flow_drifts=tuple(  # type: ignore[arg-type]
            float(drifts(replace(reference, flow_coefficients=law)).by_route[row, 0, -1]) for law in laws
        ),
        polynomial_error=float(np.max(np.abs(whole["reference"].angle[0, 0] / direct - 1.0))),
    )  # fmt: skip
