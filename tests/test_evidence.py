"""What the data say of a candidate, against least squares written out with the prior as rows of its own."""

import numpy as np
import pytest
from scipy import stats

from valvesim.identification.projection import (
    GramMatrix,
    ProjectedScores,
    alarm_level,
    block_statistic,
    inverse_of,
    largest_by_chance,
    project,
)

N, P, Q = 120, 4, 5
T_NOW = np.array([0.5, -1.0, 0.0, 2.0])

DRAWS = 20_000


def columns(seed=0, draws=DRAWS):
    """Residual (N,), answers to base parameters (N, P) of very different strength, to candidates (N, Q), all alike."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(N, P)) * np.array([30.0, 3.0, 0.3, 0.03])
    S = rng.normal(size=(N, Q)) + 0.1 * J @ rng.normal(size=(P, Q))
    return rng.normal(size=N), J, S


def gram_matrix(r, J, S, prior=T_NOW, parts=3):
    """The products over `parts` segments of the rows."""
    rows = np.array_split(np.column_stack([r, J, S]), parts)
    products = np.stack([one.T @ one for one in rows])
    return GramMatrix(products, prior, tuple(map(len, rows)))


def with_prior(r, J, S, prior=T_NOW):
    """The same least squares with a row for each parameter's prior: minimises |r - J dt - S a|^2 + |t + dt|^2."""
    p, q = J.shape[1], S.shape[1]
    return np.concatenate([r, -prior]), np.vstack([J, np.eye(p)]), np.vstack([S, np.zeros((p, q))])


def off(J, columns):
    """Columns less what J explains of them."""
    return columns - J @ np.linalg.lstsq(J, columns, rcond=None)[0]


# ---------------------------------------------------------------- algebra


@pytest.mark.parametrize("which", [[], [1], [3, 0], [0, 1, 2, 3]])
def test_parameters_at_zero_are_those_of_a_model_without_them(which):
    r, J, S = columns(7)
    kept = [k for k in range(P) if k not in which]
    reduced = gram_matrix(r + J[:, which] @ T_NOW[which], J[:, kept], S, T_NOW[kept])
    gram = gram_matrix(r, J, S).without(which)
    assert gram.products == pytest.approx(reduced.products, rel=1e-9, abs=1e-9)
    assert gram.prior_now == pytest.approx(reduced.prior_now) and gram.rows == reduced.rows
    assert gram.chi_square == pytest.approx(reduced.chi_square)


def test_a_gram_is_the_sum_of_its_segments():
    r, J, S = columns()
    whole, split = gram_matrix(r, J, S, parts=1), gram_matrix(r, J, S, parts=5)
    assert split.total == pytest.approx(whole.total)
    assert split.parameters == P
    assert split.chi_square == pytest.approx(r @ r + T_NOW @ T_NOW)


def test_projecting_is_least_squares_with_rows_for_the_prior():
    r, J, S = columns(2)
    r_, J_, S_ = with_prior(r, J, S)
    r_off, S_off = off(J_, r_), off(J_, S_)
    projected = project(gram_matrix(r, J, S), 0, Q)
    assert projected.score == pytest.approx(S_off.T @ r_off)
    assert projected.overlap == pytest.approx(S_off.T @ S_off)
    assert projected.chi_square == pytest.approx(r_off @ r_off)
    assert projected.distance == pytest.approx(np.linalg.norm(S_off, axis=0))
    assert projected.z == pytest.approx(S_off.T @ r_off / np.linalg.norm(S_off, axis=0))
    unit = S_off / np.linalg.norm(S_off, axis=0)
    assert projected.correlation() == pytest.approx(unit.T @ unit)


def test_a_range_of_columns_is_projected_as_among_all():
    gram = gram_matrix(*columns(3))
    everything, some = project(gram, 0, Q), project(gram, 1, 3)
    assert some.score == pytest.approx(everything.score[1:3])
    assert some.overlap == pytest.approx(everything.overlap[1:3, 1:3])


def test_the_fall_of_the_deviance_is_z_squared():
    r, J, S = columns(4)
    r_, J_, S_ = with_prior(r, J, S)
    projected = project(gram_matrix(r, J, S), 0, Q)
    for k in range(Q):
        left = off(np.column_stack([J_, S_[:, k]]), r_)
        assert projected.chi_square - left @ left == pytest.approx(projected.z[k] ** 2)


@pytest.mark.parametrize("taken", [(2,), (0, 3), (4, 1, 0)])
def test_without_is_projecting_the_taken_jointly_and_free(taken):
    r, J, S = columns(5)
    r_, J_, S_ = with_prior(r, J, S)
    wider = np.column_stack([J_, S_[:, taken]])  # no prior on those taken
    r_off, S_off = off(wider, r_), off(wider, S_)
    rest = [k for k in range(Q) if k not in taken]
    left = project(gram_matrix(r, J, S), 0, Q).without(taken)
    assert left.score[rest] == pytest.approx((S_off.T @ r_off)[rest])
    assert left.overlap[np.ix_(rest, rest)] == pytest.approx((S_off.T @ S_off)[np.ix_(rest, rest)])
    assert left.chi_square == pytest.approx(r_off @ r_off)
    assert left.distance[list(taken)] == pytest.approx(0.0) and left.z[list(taken)] == pytest.approx(0.0)


def test_without_nothing_is_the_same_and_one_by_one_is_together():
    projected = project(gram_matrix(*columns(6)), 0, Q)
    assert projected.without(()) is projected
    step_by_step, together = projected.without([1]).without([3]), projected.without([1, 3])
    assert step_by_step.score[[0, 2, 4]] == pytest.approx(together.score[[0, 2, 4]])
    assert step_by_step.chi_square == pytest.approx(together.chi_square)


def test_a_twin_of_one_taken_is_seen_no_more():
    r, J, S = columns(7)
    S[:, 1] = -2.0 * S[:, 0]
    left = project(gram_matrix(r, J, S), 0, Q).without([0])
    assert left.distance[1] == 0.0 and left.z[1] == 0.0
    assert left.distance[2] > 1.0


def test_columns_that_show_nothing_give_zero():
    r, J, S = columns(8)
    S[:, 0] = 0.0
    S[:, 1] = 1e6 * J[:, 0]
    J[:, 0] *= 1e8  # known so badly that the data alone fix it: what it can imitate is no evidence
    projected = project(gram_matrix(r, J, S), 0, Q)
    assert projected.score[:2] == pytest.approx(0.0, abs=0.0) and projected.z[:2] == pytest.approx(0.0, abs=0.0)
    assert not projected.overlap[:2].any() and not projected.overlap[:, :2].any()
    assert np.abs(projected.z[2:]).min() > 0.0


# ---------------------------------------------------------------- what chance does


def null_draws(count, S, J):
    """Projections of `count` residuals that hold noise and base parameters as likely as their prior, nothing else."""
    rng = np.random.default_rng(11)
    for _ in range(count):
        truth = rng.normal(size=J.shape[1])
        r = rng.normal(size=len(J)) + J @ (truth - T_NOW)
        yield project(gram_matrix(r, J, S, parts=1), 0, S.shape[1])


def test_z_is_standard_normal_where_nothing_is_hidden():
    _, J, S = columns(9)
    z = np.array([projected.z for projected in null_draws(2000, S, J)])
    for k in range(Q):
        assert stats.kstest(z[:, k], "norm").pvalue > 0.01


def test_the_statistic_of_a_block_is_chi_square():
    _, J, S = columns(10)
    S = np.column_stack([S, S[:, 0] - S[:, 1], np.zeros(N)])  # one says nothing new, one nothing at all
    members = (0, 1, 2, Q, Q + 1)
    found = [block_statistic(projected, members) for projected in null_draws(2000, S, J)]
    assert {degrees for _, degrees in found} == {3}
    assert stats.kstest([chi for chi, _ in found], "chi2", args=(3,)).pvalue > 0.01


def test_the_statistic_of_a_block_is_the_fall_of_the_deviance():
    projected = project(gram_matrix(*columns(12)), 0, Q)
    chi, degrees = block_statistic(projected, (0, 2, 3))
    assert degrees == 3
    assert chi == pytest.approx(projected.chi_square - projected.without((0, 2, 3)).chi_square)
    assert block_statistic(projected, (4,)) == (pytest.approx(projected.z[4] ** 2), 1)


def test_a_block_that_shows_nothing_has_no_degree_of_freedom():
    assert block_statistic(ProjectedScores(np.zeros(3), np.zeros((3, 3)), 1.0), (0, 2)) == (0.0, 0)


def alike(correlation, count=12):
    """Candidates of very different strength whose z have this correlation."""
    d = np.geomspace(1e-3, 1e3, count)
    C = np.full((count, count), correlation) + (1.0 - correlation) * np.eye(count)
    return ProjectedScores(np.zeros(count), C * np.outer(d, d), 0.0)


@pytest.mark.parametrize("probability", [0.05, 0.01])
@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("correlation, trials", [(0.0, 12), (1.0, 1)])
def test_the_alarm_has_its_rate(correlation, trials, one_sided, probability):
    """Independent candidates are as many trials; those that show the same are one."""
    level = alarm_level(largest_by_chance(alike(correlation), np.full(12, one_sided), 3, DRAWS), probability)
    one = stats.norm.cdf(level) - (0.0 if one_sided else stats.norm.cdf(-level))
    assert 1.0 - one**trials == pytest.approx(probability, abs=4.0 * np.sqrt(probability / DRAWS))


def test_the_alarm_leaves_out_what_the_data_do_not_see():
    some = alike(0.0)
    overlap = some.overlap.copy()
    overlap[1:], overlap[:, 1:] = 0.0, 0.0
    two_sided = np.zeros(12, dtype=bool)
    alone = largest_by_chance(ProjectedScores(some.score, overlap, 0.0), two_sided, 0, DRAWS)
    assert alarm_level(alone, 0.05) == pytest.approx(1.96, abs=0.05)
    blind = ProjectedScores(np.zeros(2), np.zeros((2, 2)), 0.0)
    assert alarm_level(largest_by_chance(blind, two_sided[:2], 0, DRAWS), 0.05) == np.inf


def test_the_alarm_is_the_same_for_a_seed():
    two_sided = np.zeros(12, dtype=bool)
    assert np.array_equal(*(largest_by_chance(alike(0.3), two_sided, 1, DRAWS) for _ in range(2)))


def test_the_inverse_minds_neither_sizes_nor_what_nothing_is_known_of():
    sizes = np.array([1e-9, 1.0, 1e12])
    root = np.random.default_rng(3).normal(size=(3, 3))
    plain, scale = root @ root.T + np.eye(3), np.outer(sizes, sizes)
    H = scale * plain
    assert inverse_of(H) * scale == pytest.approx(np.linalg.inv(plain), rel=1e-9)
    blind = np.zeros((4, 4))
    blind[:3, :3] = H
    assert inverse_of(blind)[:3, :3] == pytest.approx(inverse_of(H), rel=1e-9)
    assert not inverse_of(blind)[3].any()
