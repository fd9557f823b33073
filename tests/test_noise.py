"""The noise of a sensor: its colour from long series, its deviation in closed form, whitening that leaves no colour."""

import numpy as np
import pytest
from scipy.signal import lfilter

from valvesim.identification.noise_model import NoiseModel, fit_autoregression
from valvesim.identification.options import DEFAULT_IDENTIFICATION as OPTIONS

AR2 = (1.2, -0.5)


def coloured(lags, innovation=1.0, count=20_000, seed=0):
    """Stationary noise of these lags: the first 2000 samples, which still know the start, are left out."""
    white = np.random.default_rng(seed).normal(0.0, innovation, count + 2000)
    return lfilter([1.0], [1.0, *(-a for a in lags)], white)[2000:]


def found(*series, floor=0.0):
    return fit_autoregression(series, verified=True, source="a test", floor=floor, options=OPTIONS)


def correlations(white, most=6):
    white = white - white.mean()
    return np.array([np.mean(white[k:] * white[: len(white) - k]) for k in range(1, most + 1)]) / np.mean(white**2)


# ---------------------------------------------------------------- the fit


@pytest.mark.parametrize("lags", [(0.9,), (-0.6,), AR2, (0.5, 0.0, 0.3)])
def test_lags_and_innovation_of_a_long_series_are_recovered(lags):
    noise = found(3.0 + coloured(lags, innovation=2e-6, seed=3))
    assert len(noise.lags) == len(lags)
    assert noise.lags == pytest.approx(lags, abs=0.03)  # about four standard deviations of an estimate
    assert noise.innovation == pytest.approx(2e-6, rel=0.02)
    assert (noise.verified, noise.source) == (True, "a test")


def test_several_series_of_one_noise_are_fitted_together_each_about_its_own_mean():
    series = [offset + coloured((0.8,), count=1500, seed=k) for k, offset in enumerate((-50.0, 0.0, 1000.0))]
    noise = found(*series)
    assert noise.lags == pytest.approx((0.8,), abs=0.04)
    assert noise.innovation == pytest.approx(1.0, rel=0.05)


def test_white_noise_is_seldom_taken_for_coloured():
    orders = [len(found(np.random.default_rng(seed).normal(size=500)).lags) for seed in range(200)]
    assert np.mean(np.array(orders) == 0) >= 0.93  # BIC errs in about 2 of 100
    assert max(orders) <= 2


def test_a_short_series_is_not_given_more_lags_than_it_can_tell():
    short = coloured((0.0,) * 7 + (0.95,), count=5 * OPTIONS.noise.samples_per_lag - 1, seed=2)
    assert len(found(short).lags) <= 4
    assert len(found(coloured((0.0,) * 7 + (0.95,), count=4000, seed=2)).lags) == OPTIONS.noise.most_lags == 8
    assert found(np.array([1.0, 3.0])).lags == ()


def test_samples_that_a_sensor_lost_tell_nothing_of_its_noise():
    whole = coloured(AR2, count=30_000)
    lost = np.arange(len(whole)) % 100 < 40
    gaps, zeros = found(np.where(lost, np.nan, whole)), found(np.where(lost, 0.0, whole))
    assert gaps.deviation == pytest.approx(found(whole).deviation, rel=0.03)
    assert gaps.lags[:2] == pytest.approx(AR2, abs=0.03)
    assert zeros.deviation < 0.85 * gaps.deviation  # what is clipped is quiet, but is no reading


def test_gaps_that_leave_few_whole_stretches_cost_lags():
    scattered = np.where(np.arange(400) % 4 == 0, np.nan, coloured((0.5,), count=400))
    assert len(found(scattered).lags) < 4 and found(scattered).deviation == pytest.approx(1.15, rel=0.15)


def test_lags_that_would_grow_are_pulled_in():
    time = np.arange(2000)
    growing = 1.004**time + 1e-3 * np.random.default_rng(0).normal(size=time.size)
    for series in (growing, np.sin(0.1 * time) + 1e-4 * np.random.default_rng(1).normal(size=time.size)):
        noise = found(series)
        roots = np.abs(np.roots([1.0, *(-a for a in noise.lags)]))
        assert len(roots) and roots.max() <= 0.995 + 1e-6
        assert np.isfinite(noise.deviation)
    assert np.abs(np.roots([1.0, *(-a for a in found(growing).lags)])).max() == pytest.approx(0.995, abs=1e-6)


def test_lags_that_decay_are_left_as_they_are():
    assert found(coloured((0.98,), seed=5)).lags[0] == pytest.approx(0.98, abs=0.01)


# ---------------------------------------------------------------- the floor


def test_the_floor_raises_the_deviation_and_keeps_the_colour():
    series = coloured((0.8,), innovation=1e-3)
    free, raised = found(series), found(series, floor=1.0)
    assert raised.deviation == pytest.approx(1.0, rel=1e-9)
    assert raised.lags == free.lags
    assert found(series, floor=0.5 * free.deviation) == free


def test_a_series_without_any_noise_has_the_floor_alone():
    assert found(np.full(500, 2.0), floor=1e-6) == NoiseModel(1e-6, (), True, "a test")


# ---------------------------------------------------------------- deviation and whitening


def test_the_stationary_deviation_is_the_closed_form():
    assert NoiseModel(0.3, (), True, "").deviation == 0.3
    for a in (0.5, -0.9, 0.99):
        assert NoiseModel(0.3, (a,), True, "").deviation == pytest.approx(0.3 / np.sqrt(1.0 - a * a), rel=1e-9)
    a, b = AR2
    variance = (1.0 - b) / ((1.0 + b) * ((1.0 - b) ** 2 - a * a))
    assert NoiseModel(2.0, AR2, True, "").deviation == pytest.approx(2.0 * np.sqrt(variance), rel=1e-9)


@pytest.mark.parametrize("lags", [(), (0.9,), AR2])
def test_whitening_leaves_white_noise_of_unit_size(lags):
    series = coloured(lags, innovation=5e-6, seed=7)
    white = NoiseModel(5e-6, lags, True, "").whiten(series[:, None], np.ones(len(series), dtype=bool))
    assert white.shape == (len(series) - len(lags), 1)
    assert np.std(white) == pytest.approx(1.0, abs=0.02)
    assert np.abs(correlations(white[:, 0])).max() < 4.0 / np.sqrt(len(white))
    if lags:
        assert np.abs(correlations(series)).max() > 0.5


def test_whitening_is_the_filter_of_the_lags():
    columns, noise = np.random.default_rng(1).normal(size=(200, 3)), NoiseModel(0.3, AR2, True, "a test")
    filtered = lfilter([1.0, *(-a for a in AR2)], [1.0], columns, axis=0) / 0.3
    assert noise.whiten(columns, np.ones(200, dtype=bool)) == pytest.approx(filtered[2:], abs=1e-12)
    assert np.ptp(columns) > 1.0  # they are left as they were


def test_rows_that_touch_an_unusable_sample_are_dropped_and_no_others():
    series = np.column_stack([coloured(AR2, count=60), coloured(AR2, count=60, seed=1)])
    noise, usable = NoiseModel(1.0, AR2, True, ""), np.ones(60, dtype=bool)
    clean = noise.whiten(series, usable)
    assert clean == pytest.approx(series[2:] - 1.2 * series[1:-1] + 0.5 * series[:-2])
    spoiled, gone = series.copy(), [20, 40, 41, 59]
    usable[gone], spoiled[gone] = False, 1e9
    touched = {k + j for k in gone for j in range(3)}
    keep = [k for k in range(2, 60) if k not in touched]
    assert noise.whiten(spoiled, usable) == pytest.approx(clean[np.array(keep) - 2])


def test_whitening_is_linear_so_that_answers_and_residual_stay_together():
    rng, noise, usable = np.random.default_rng(0), NoiseModel(0.1, AR2, True, ""), np.ones(200, dtype=bool)
    r, s = rng.normal(size=(2, 200, 1))
    together = noise.whiten(r - 3.0 * s, usable)
    assert together == pytest.approx(noise.whiten(r, usable) - 3.0 * noise.whiten(s, usable))


# ---------------------------------------------------------------- resolution


def rounded(values, step):
    """What a white noise as large as rounding by a step makes of the variance of a coarse channel."""
    return NoiseModel(step / np.sqrt(12.0), (), True, "test", rounding_step=step).rounding_variance(values, 0, 16)


def test_rounding_of_what_moves_by_many_steps_in_a_sample_is_white():
    fast = np.random.default_rng(1).normal(0.0, 1e-3, 4000)
    assert rounded(np.round(fast / 1e-5) * 1e-5, 1e-5) == pytest.approx(1.0, abs=0.5)


def test_a_reading_that_stays_at_a_level_may_be_off_by_as_much_all_the_while():
    """In a quarter of the record at most: longer ones are not told from a bias."""
    still = rounded(np.full(4000, 3.0), 1.0)
    assert still == pytest.approx(1000.0, rel=0.8) and rounded(np.full(4000, 3.0), 1.0) == still
    assert 5.0 < rounded(np.round(np.linspace(0.0, 400.0, 4000)), 1.0) < still  # a sawtooth, alike from tooth to tooth


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_the_mean_of_a_rounded_channel_is_off_by_no_more_than_its_noise_says(share):
    """Segments of readings of a grid, against the variance that is said to bound what any combination of them has."""
    t, step, bound, apart = np.linspace(0.0, 1.0, 2000), 1.0, [], []
    for seed in range(12):
        dice = np.random.default_rng(seed)
        true = dice.uniform(-3.0, 3.0) * np.sin(2.0 * np.pi * (dice.uniform(0.2, 1.0) * t + dice.uniform()))
        read = np.round(true + dice.normal(0.0, share * step, len(t)))
        bound.append(step**2 / 12.0 * rounded(read, step))
        apart.append([np.mean((read - true)[k : k + 250]) for k in range(0, 2000, 250)])
    variance = np.mean(np.square(apart)) * 250.0
    assert variance < np.mean(bound)



def test_rows_of_a_coarse_channel_count_as_much_as_noise_leaves_of_them(biased_fit):
    """And what noise and rounding leave of the records is what is expected of them."""
    study = biased_fit.study
    (name, pace), *_ = study.noise
    before, step = study.expected_rows, 4.0 * study.noise[name, pace].deviation
    coarse = NoiseModel(step / np.sqrt(12.0), (), True, "test", rounding_step=step)
    other = study.with_noise(study.noise | {(name, pace): coarse})
    own = [(one.record, other.expected_squares(one.record, name)) for one in other.predictors]
    assert before == study.expected_rows and all(np.all(squares <= 1.0) for _, squares in own)
    for predictor, (record, squares) in zip(other.predictors, own, strict=True):
        one = {each: np.zeros((len(record.time), 1)) for each in record.outputs} | {
            name: np.full((len(record.time), 1), coarse.deviation)
        }
        white = other.whiten(predictor, one)[list(record.outputs).index(name)][:, 0]
        assert white == pytest.approx(np.sqrt(squares))
    rows = [study.expected_squares(one.record, name) for one in study.predictors]
    assert other.expected_rows <= before + sum(len(new) - len(old) for (_, new), old in zip(own, rows, strict=True))
