"""Bridged samples: exact where the motion is simple, and as uncertain as stated where it is not."""

import numpy as np
import pytest

from diagnosis.detectors.gap_interpolation import SIDE, fill_gaps

DT = 0.5
T = DT * np.arange(81)


def bridged(rates, low, high, sigma=0.0, t_s=T):
    bad = np.zeros(len(t_s), dtype=bool)
    bad[low:high] = True
    spoiled = rates.copy()
    spoiled[bad] = spoiled[low - 1]
    return fill_gaps(t_s, spoiled, bad, DT, sigma)


def test_a_corner_inside_a_run_is_covered_by_its_density():
    """Slew start in the middle: the angle is off by Δs L²/24, a third of what a line makes of it."""
    n = 19
    low, high = 31, 50
    middle = 0.5 * (T[low - 1] + T[high])
    slope = 0.004
    rates = np.column_stack([slope * np.maximum(T - middle, 0)] * 3)
    out, _, density = bridged(rates, low, high)
    error = float((out - rates)[:, 0].sum() * DT)
    span = (n + 1) * DT
    assert error == pytest.approx(slope * span**2 / 24, rel=0.02)
    assert density[low:high, 0].sum() * DT == pytest.approx((slope * span**2 / 24) ** 2, rel=0.1)
    line = np.interp(T, T[[low - 1, high]], rates[[low - 1, high], 0])
    assert (line - rates[:, 0])[low:high].sum() * DT == pytest.approx(3 * error, rel=0.02)


@pytest.mark.parametrize("n", [1, 12])
def test_noise_of_a_bridge_is_as_stated(n):
    """Angle over run and neighbours against the density it is given; 3000 draws, which leaves 2.6 % of sampling error."""
    rng = np.random.default_rng(n)
    low = 35
    found, stated = [], 0.0
    for _ in range(1000):
        out, factor, _ = bridged(rng.standard_normal((T.size, 3)), low, low + n, 1.0)
        # All that a bridge is made of, so that what it shares with its neighbours is counted.
        found.append(out[low - SIDE : low + n + SIDE].sum(axis=0))
        stated = float(factor[low - SIDE : low + n + SIDE].sum())
    variance = float(np.var(found))
    assert 0.9 < variance / stated < 1.1


@pytest.mark.parametrize(("period", "n"), [(12.0, 3), (400.0, 5)])
def test_a_fast_swing_is_covered_by_what_the_bridge_misses_nearby(period, n):
    """Swings of a thousand sigmas, at 40 phases: the angle over run and sides is off by about what factor and density say."""
    rng, t_s, sigma, low = np.random.default_rng(n), DT * np.arange(401), 1e-3, 200
    z, line = [], []
    for phase in np.linspace(0, 2 * np.pi, 40, endpoint=False):
        true = np.sin(2 * np.pi * t_s[:, None] / (period * DT) + phase + np.arange(3))
        read = true + sigma * rng.standard_normal(true.shape)
        out, factor, density = bridged(read, low, low + n, sigma, t_s)
        own = slice(low - SIDE, low + n + SIDE)
        variance = np.sum(factor[own] * sigma**2 * DT**2) + np.sum(density[own], axis=0) * DT
        z.append((out - true)[own].sum(axis=0) * DT / np.sqrt(variance))
        straight = np.interp(t_s[low : low + n], t_s[[low - 1, low + n]], true[[low - 1, low + n], 0])
        line.append(float((straight - true[low : low + n, 0]).sum() * DT))
        assert abs((out - true)[low : low + n, 0].sum() * DT) < 10 * np.sqrt(variance[0])
    assert np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.abs(z).max() < 5
    if period < 100:
        assert np.sqrt(np.mean(np.square(line))) > 5 * sigma * DT
