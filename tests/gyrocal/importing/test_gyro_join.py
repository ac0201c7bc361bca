"""Several gyros joined to three rates: their noise, their parity, and what they refuse."""

import numpy as np
import pytest

from gyrocal.importing import join_gyros
from gyrocal.importing.column_mapping import TETRAHEDRON

GOLDEN = (1 + np.sqrt(5)) / 2
SIX = np.array([[1, GOLDEN, 0], [-1, GOLDEN, 0], [0, 1, GOLDEN], [0, -1, GOLDEN], [GOLDEN, 0, 1], [GOLDEN, 0, -1]])
AXES = {4: np.array(TETRAHEDRON), 6: SIX / np.sqrt(1 + GOLDEN**2)}
NOISE = 1e-5


def draw(axes, noise=NOISE, rows=4000, seed=1):
    """Rates of a body, and the readings of gyros."""
    rng = np.random.default_rng(seed)
    rates = 1e-2 * rng.standard_normal((rows, 3))
    return rates, rates @ axes.T + noise * rng.standard_normal((rows, len(axes)))


@pytest.mark.parametrize("count", [4, 6])
def test_joined_rates_are_true_within_the_stated_noise(count):
    rates, raw = draw(AXES[count])
    joined = join_gyros(raw, AXES[count])
    assert joined.gain == pytest.approx(np.sqrt(3 / count))
    assert (joined.rates - rates).std() == pytest.approx(NOISE * joined.gain, rel=0.03)
    np.testing.assert_allclose(joined.residuals.std(axis=0), NOISE * joined.spread, rtol=0.05)
    assert joined.find_disagreement(NOISE) == ""


def test_noisier_gyros_weigh_less():
    noise = NOISE * np.array([1, 1, 1, 5, 1, 20])
    rates, raw = draw(AXES[6], noise)
    joined = join_gyros(raw, AXES[6], noise=noise)
    assert (joined.rates - rates).std() == pytest.approx(joined.gain, rel=0.03)


def test_parity_finds_the_gyro_that_is_biased_where_it_can():
    _, raw = draw(AXES[6])
    joined = join_gyros(raw + 10 * NOISE * np.eye(6)[4], AXES[6], names="abcdef")
    assert joined.residuals[:, 4].mean() == pytest.approx(10 * NOISE, rel=0.05)
    assert "gyro e does not agree with the others" in joined.find_disagreement(NOISE)
    assert joined.find_disagreement(NOISE).endswith("--gyros a,b,c,d,f")
    _, raw = draw(AXES[4])
    raw[:, 2] = 1.001 * raw[:, 2] + 10 * NOISE  # which a calibration finds, of joined rates as well
    assert join_gyros(raw, AXES[4]).find_disagreement(NOISE) == ""


def test_a_row_without_a_gyro_uses_the_others():
    rates, raw = draw(AXES[4])
    raw[10:20, 0] = np.nan
    raw[30, :2] = np.nan
    joined = join_gyros(raw, AXES[4])
    assert np.flatnonzero(~np.isfinite(joined.rates).all(axis=1)).tolist() == [30]
    assert np.nanmax(np.abs(joined.rates - rates)) < 8 * NOISE
    assert np.isnan(joined.residuals[10:20]).all()
