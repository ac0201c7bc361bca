"""What stands in for samples that show nothing of the motion, and how uncertain it is.

Straight lines through m readings on either side of a run of n bad samples give its edges p₀, p₁ and slopes s₀, s₁; between
them goes the cubic with these (Hermite's). Over the run's length L = (n + 1)Δt it turns the body by nearly
nΔt (p₀ + p₁)/2 + L² (s₀ − s₁)/12. The readings are integrated themselves as well, so that their white noise σ gives the angle
over all n + 2m samples the variance

    2σ²Δt² [m (1 + n/2m)² + c²/S],    c = n(m − 1)/4 + (n + 1)²/12,    S = m(m² − 1)/12

of which m a side is their own. If the rate has a corner in the middle of the run, as where a slew starts, the cubic is off by
(s₀ − s₁) L²/24; that is taken for a sigma as well. Both are spread over the run as a noise density.

Runs of one or two are short beside any corner: there the line between the neighbours does. Its angle and that of the neighbours
have the variance (n + 2)²σ²Δt²/2 over the n + 2 samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SIDE = 8  # readings on either side
SHORT = 2  # samples of a run, up to which a line does
FEWEST = 3  # readings of a side, for a slope


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Unbroken runs as slices."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def filled(t_s: Array, rates: Array, bad: Mask, sample_s: float) -> tuple[Array, Array, Array]:
    """Rates with the bad samples bridged.

    Parameters
    ----------
    t_s : (n,) sample starts
    rates : (n, 3) rad/s
    bad : (n,) samples to bridge
    sample_s : their spacing where none is missing, s

    Returns
    -------
    rates : (n, 3)
    factor : (n,) by which the noise density of a sample grows; runs and their neighbours
    density : (n, 3) what a corner of the motion inside a long run adds to it, rad²/s
    """
    out = rates.copy()
    factor, density = np.ones(len(rates)), np.zeros(rates.shape)
    good = np.flatnonzero(~bad)
    for axis in range(3):
        out[bad, axis] = np.interp(t_s[bad], t_s[good], rates[good, axis])
    for low, high in runs(bad):
        n = high - low
        factor[max(low - 1, 0) : high + 1] = 1 + n / 2
        if n <= SHORT:
            continue
        before = _side(t_s, bad, range(low - 1, max(low - 1 - SIDE, -1), -1), sample_s)
        after = _side(t_s, bad, range(high, min(high + SIDE, len(rates))), sample_s)
        if min(before.size, after.size) < FEWEST:
            continue
        m = min(before.size, after.size)
        span = float(t_s[high] - t_s[low - 1])
        u = (t_s[low:high, None] - t_s[low - 1]) / span
        (p0, s0), (p1, s1) = _line(t_s, rates, before, t_s[low - 1]), _line(t_s, rates, after, t_s[high])
        out[low:high] = (
            (1 + 2 * u) * (1 - u) ** 2 * p0
            + u * (1 - u) ** 2 * span * s0
            + u**2 * (3 - 2 * u) * p1
            + u**2 * (u - 1) * span * s1
        )
        factor[max(low - 1, 0) : high + 1] = _factor(n, m)
        density[low:high] = ((s0 - s1) * span**2 / 24) ** 2 / span
    return out, factor, density


def _side(t_s: Array, bad: Mask, places: range, sample_s: float) -> NDArray[np.intp]:
    """Readings of a side, from the run outward until one is missing or bad."""
    kept: list[int] = []
    for place in places:
        if bad[place] or (kept and abs(t_s[place] - t_s[kept[-1]]) > 1.5 * sample_s):
            break
        kept.append(place)
    return np.array(kept, dtype=np.intp)


def _factor(n: int, m: int) -> float:
    """Noise density of a run of n and its two neighbours, as the module's text has it, relative to that of good samples."""
    c = n * (m - 1) / 4 + (n + 1) ** 2 / 12
    whole = 2 * (m * (1 + n / (2 * m)) ** 2 + 12 * c**2 / (m * (m**2 - 1)))
    return (whole - 2 * (m - 1)) / (n + 2)


def _line(t_s: Array, rates: Array, places: NDArray[np.intp], at_s: float) -> tuple[Array, Array]:
    """Value (3,) at a time and slope (3,) of the straight line through some readings."""
    t = t_s[places] - t_s[places].mean()
    slope = t @ rates[places] / (t @ t)
    return rates[places].mean(axis=0) + slope * (at_s - t_s[places].mean()), slope
