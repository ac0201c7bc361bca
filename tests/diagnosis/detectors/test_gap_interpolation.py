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
