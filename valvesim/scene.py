"""What a fit leaves, from all sides at once: candidates, free terms at every port, each part of each record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .evidence import Gram, Projected, alarm_level, block_statistic, project
from .hypotheses import Candidate, View
from .sensitivity import relax
from .study import BaseFit, Fit, Study, gram_of, own_columns, see_from, shown
from .terms import LAG, PATH, Family, families, hats, term_effect

KNOTS = 6  # of each family's function while it is looked for
REACH = 10.0  # a candidate must show at this multiple of its typical amplitude, or the session is blind to it
TWIN = 0.9  # of what a figure shows an effect must show to be counted in its place
NOISE_ERROR = 0.06  # relative error of a noise's variance that a pair of short repeats may make
DIRECT = ("load_flow", "internal_leakage")


@dataclass(frozen=True, eq=False)
class Scene:
    """A fit's residual against everything: `projected` candidates then families, off the base and the fit's extras.

    `sizes` (q,) are the excesses at which the candidates' columns stand; `blocks` the columns of each family;
    `own` the columns of the fit's extras: excess and shapes, freed.
    """

    study: Study
    fit: Fit
    views: tuple[View, ...]
    gram: Gram
    candidates: tuple[Candidate, ...]
    sizes: np.ndarray
    families: tuple[Family, ...]
    blocks: tuple[tuple[int, ...], ...]
    own: tuple[int, ...]
    projected: Projected

    @property
    def dispersion(self) -> float:
        """By how much the noise may be larger than its repeats have said: what the fit leaves, within reason."""
        return float(np.clip(self.fit.deviance / self.fit.rows, 1.0, 1.0 + NOISE_ERROR))

    def visible(self) -> np.ndarray:
        """(q,) True for candidates that the session would show if they were there."""
        reach = np.array([min(REACH * c.typical, max(map(abs, c.limits))) for c in self.candidates])
        return self.projected.distance[: len(self.candidates)] * reach / self.sizes > 4.0

    def z(self) -> np.ndarray:
        """(q,) of the candidates: below zero, or of the wrong sign, means no evidence; zero where blind.

        What goes by two names, an effect's and that of the figure which it changes, counts as the effect, where that
        shows as much.
        """
        q = len(self.candidates)
        z = self.projected.z[:q] / np.sqrt(self.dispersion)
        one_sided = np.array([c.one_sided for c in self.candidates])
        z = np.where(self.visible(), np.where(one_sided, np.maximum(z, 0.0), np.abs(z)), 0.0)
        effects = [(c, size) for c, size in zip(self.candidates, z, strict=True) if c.effect is not None]
        twice = [
            c.parameter is not None and any(c.is_same_as(e) and z_e > TWIN * own for e, z_e in effects)
            for c, own in zip(self.candidates, z, strict=True)
        ]
        return np.where(twice, 0.0, z)

    def level(self, probability: float) -> float:
        """The z that none of the candidates passes but with that probability, where nothing is hidden."""
        q = np.flatnonzero(self.visible())
        some = Projected(self.projected.score[q], self.projected.overlap[np.ix_(q, q)], 0.0)
        one_sided = np.array([self.candidates[k].one_sided for k in q], dtype=bool)
        return alarm_level(some, one_sided, probability, self.study.session.seed)

    def family_tests(self) -> list[tuple[float, int]]:
        """(chi-square, degrees of freedom) of each family."""
        projected = self.projected
        tests = [block_statistic(projected, block) for block in self.blocks]
        return [(value / self.dispersion, freedom) for value, freedom in tests]

    def constancy(self) -> tuple[float, int]:
        """(chi-square, degrees of freedom) of the first extra's amplitude being the same in every part."""
        if not self.own:
            return 0.0, 0
        G, k = self.gram, 1 + self.gram.parameters + self.own[0]
        at = [0, *range(1, 1 + G.parameters), *(1 + G.parameters + j for j in self.own)]
        m, total = len(G.products), G.total
        size = len(at)
        big = np.zeros((size + m, size + m))
        big[:size, :size] = total[np.ix_(at, at)]
        for j in range(m):
            big[:size, size + j] = big[size + j, :size] = G.products[j][at, k]
            big[size + j, size + j] = G.products[j][k, k]
        parts = Gram(big[None], G.prior_now, ())
        own = len(self.own)
        split = project(parts, 0, own + m).without(range(own))
        return block_statistic(split, range(own, own + m))


def look(base: BaseFit, fit: Fit, *, searched: Sequence[Family] = families(), knots: int = KNOTS) -> Scene:
    """Look at what a fit leaves, from where it is; the functions of the families searched have so many knots."""
    study = base.study
    variant = fit.variant(study.base)
    views, J = (base.views, base.columns) if fit is base.fit else see_from(study, fit)
    taken = [extra.candidate for extra in fit.extras]
    families_taken = {candidate.family for candidate in taken}
    candidates = tuple(
        c for c in study.candidates if c.family not in families_taken and not any(map(c.excludes, taken))
    )
    sizes = np.array([_size(c) for c in candidates])
    changed = [c.add_to(variant, size) for c, size in zip(candidates, sizes, strict=True)]
    S = shown(study, views, J, candidates, changed)
    spans = _spans(views, searched)
    T = study.each(lambda seen: family_columns(seen, searched, spans, knots), views)
    own = own_columns(study, fit, views, J)
    gram = gram_of(study, views, [list(four) for four in zip(J, S, T, own, strict=True)], fit.point)
    q, f = len(candidates), len(searched) * knots
    count = len(fit.kinds)
    blocks = tuple(tuple(range(q + k * knots, q + (k + 1) * knots)) for k in range(len(searched)))
    freed = tuple(range(q + f, q + f + count))
    projected = project(gram, 0, q + f + count).without(freed)
    return Scene(study, fit, tuple(views), gram, candidates, sizes, tuple(searched), blocks, freed, projected)


def _size(candidate: Candidate) -> float:
    """The excess at which a candidate is looked for: small, so that the answer is linear, and inside its limits."""
    low, high = candidate.limits
    size = 0.2 * candidate.typical
    return size if size <= high else max(0.5 * low, -size)


def family_columns(
    seen: View, searched: Sequence[Family], spans: Sequence[tuple[float, float]], knots: int
) -> dict[str, np.ndarray]:
    """Answers (n_samples, families * knots) to each hat of each family, whose knots go over its span."""
    record = seen.bench.record
    out = {name: np.zeros((len(record.time), len(searched) * knots)) for name in record.outputs}
    for port in {family.port.name: family.port for family in searched}.values():
        if port.name in DIRECT and port.name not in record.outputs:
            continue
        own = [k for k, family in enumerate(searched) if family.port == port]
        unit = term_effect(port.name, "current", (0.0, 1.0), (1.0, 1.0), name="unit_term")
        g, direct = seen.forcing(seen.variant.with_effect(unit(share=1.0)))
        basis = np.column_stack([family_basis(seen, searched[k], spans[k], knots) for k in own])
        columns = [k * knots + j for k in own for j in range(knots)]
        if port.name in DIRECT:
            out[port.name][:, columns] = (np.asarray(direct[port.name])[:, None] * basis)[:: seen.bench.refinement]
            continue
        parts = {name: d[:, None] * basis for name, d in direct.items()}
        for name, moved in seen.by_forcing(g[:, :, None] * basis[:, None, :], parts).items():
            out[name][:, columns] = moved
    return out


def family_basis(seen: View, family: Family, over: tuple[float, float], count: int) -> np.ndarray:
    """(n, count) hats of a family's variable along a view's course, times its direction where it has one."""
    u = argument(seen, family)
    basis = hats(u, np.linspace(*over, count))
    if family.memory != PATH:
        return basis
    step = np.diff(u, prepend=u[0]) / family.width  # Dahl's memory of a path of straight steps
    z = relax(np.sign(step) * np.abs(step), np.abs(step), 1.0)
    return basis * z[:, None]


def argument(seen: View, family: Family) -> np.ndarray:
    """A family's variable (n,) along a view's course, lagged where it is."""
    states = [seen.course.states[:, k] for k in seen.linear.active]
    u = seen.argument(family.variable, tuple(states))
    if family.memory != LAG:
        return u
    b = np.full(len(u), 1.0 / family.time_constant)
    middle = np.concatenate([u[:1], (u[1:] + u[:-1]) / 2.0])
    return relax(middle / family.time_constant, b, float(seen.bench.times[1] - seen.bench.times[0]))


def _spans(views: Sequence[View], searched: Sequence[Family]) -> list[tuple[float, float]]:
    """The range of each family's variable that the records visit, but for its extreme hundredths."""
    found: dict[str, tuple[float, float]] = {}
    for family in searched:
        name = family.variable.name
        if name not in found:
            values = np.concatenate([argument(seen, Family(family.port, family.variable)) for seen in views])
            low, high = (float(v) for v in np.quantile(values, [0.005, 0.995]))
            found[name] = (low, high) if high > low else (low - 1e-9, low + 1e-9)
    return [found[family.variable.name] for family in searched]
