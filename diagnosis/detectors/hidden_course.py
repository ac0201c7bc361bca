"""What a dead zone hides of a rate that goes into it and comes out again.

The readings say where the rate went in and came out, ±s for a half width s, and how fast it was on its way there. Inside it
settles towards a level L, that at which the body rests, and leaves it again. Between two edges a time T apart, a rate that
forgets them with the time constant τ (an Ornstein–Uhlenbeck process, tied to both) is on average

    r(t) = L + (p s − L) A(t) + (q s − L) B(t),    A = sinh((T − t)/τ)/sinh(T/τ),   B = sinh(t/τ)/sinh(T/τ)

for signs p and q of the edges. Where the way is short it is the straight line from one edge to the other; where it is long, two
passages between which the body rests. At the begin or the end of an interval there is one edge, and A = e^{−t/τ} or
B = e^{−(T−t)/τ}.

A rate that needs the time T₁ from twice the half width to the edge, or back, turns by the angle s τ between the edge and its
rest: τ = T₁/2 if it goes there at a steady pace, 0.8 T₁ if the pace falls to zero steadily, as at the end of a smooth slew, and
T₁/ln 2 if it dies away. The middle one is taken, and how r changes with log τ is told beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.gap_interpolation import runs

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTH = 0.8  # T₁ in τ, of a rate whose pace falls to zero steadily
FARTHER = 2.0  # half widths, up to which the time of the way to the edge is taken
SHARE = 0.1  # of τ, by which the change with it is found
AT_ONCE = 0.5  # windows that a way takes whose end is in the next one


@dataclass(frozen=True)
class Course:
    """Samples in a zone and the rate to expect there; (n,) each, zero outside.

    Attributes
    ----------
    dead : samples in it
    expected : rate without that of a rest, rad/s
    resting : share that the rest's rate has in it
    slower : change of `expected` with log τ, rad/s
    """

    dead: Mask
    expected: Array
    resting: Array
    slower: Array


def course(x: Array, parts: Sequence[slice], size: float, count: int, inside: float) -> Course:
    """What a zone of some half width hides of the readings.

    Parameters
    ----------
    x : (n,) raw rates, rad/s
    parts : samples of each interval
    size : half width, rad/s
    count : samples of a window
    inside : half widths below which the mean of a window is in the zone
    """
    found = Course(np.zeros(x.size, dtype=bool), *(np.zeros(x.size) for _ in range(3)))
    windows = [x[part][: (part.stop - part.start) // count * count].reshape(-1, count).mean(axis=1) / size for part in parts]
    passages = [runs(np.abs(u) < inside) for u in windows]
    ways = [_ways(u, one) for u, one in zip(windows, passages, strict=True)]
    known = [way for one in ways for both in one for way in both if np.isfinite(way)]
    usual = float(np.median(known)) if known else np.inf
    for part, u, own, own_ways in zip(parts, windows, passages, ways, strict=True):
        for (a, b), both in zip(own, own_ways, strict=True):
            low, high = part.start + a * count, part.start + b * count if b < u.size else part.stop
            edges = float(np.sign(u[a - 1])) if a else 0.0, float(np.sign(u[b])) if b < u.size else 0.0
            tau = SMOOTH * count * np.where(np.isfinite(both), both, usual)
            here = slice(low, high)
            found.dead[here] = True
            found.expected[here], found.resting[here] = _between(high - low, edges, tau)
            longer, shorter = (_between(high - low, edges, tau * (1 + way * SHARE))[0] for way in (1, -1))
            found.slower[here] = (longer - shorter) / (2 * SHARE)
    return Course(found.dead, size * found.expected, found.resting, size * found.slower)


def _ways(u: Array, passages: Sequence[tuple[int, int]]) -> list[tuple[float, float]]:
    """Windows that the rate is on its way before and after each passage, see `_way`."""
    begins, ends = [a for a, _ in passages], [b for _, b in passages]
    before = [_way(u[low:high][::-1]) for low, high in zip([0, *ends], begins, strict=False)]
    after = [_way(u[low:high]) for low, high in zip(ends, [*begins[1:], u.size], strict=False)]
    return list(zip(before, after, strict=True))


def _way(outside: Array) -> float:
    """Windows between an edge and twice as far, of those up to the next passage; NaN where the rate is not seen to go there."""
    if not outside.size:
        return float("nan")
    beyond = np.sign(outside[0]) * outside
    far, back = np.argmax(beyond > FARTHER), np.argmax(beyond < 0)
    if beyond[far] <= FARTHER or (beyond[back] < 0 and back < far):
        return float("nan")
    return max(float(far), AT_ONCE)


def _between(n: int, edges: tuple[float, float], tau: Array) -> tuple[Array, Array]:
    """Expected rate of n samples in half widths without that of a rest, and the share of the rest."""
    t = np.arange(n) + 0.5
    forgotten = [_share(t, n, float(tau[0]), edges[1] != 0), _share(n - t, n, float(tau[1]), edges[0] != 0)]
    A, B = (share if edge else np.zeros(n) for share, edge in zip(forgotten, edges, strict=True))
    return edges[0] * A + edges[1] * B, 1 - A - B


def _share(t: NDArray[np.floating[Any]], n: int, tau: float, tied: bool) -> Array:
    """A after t samples of n, with or without another edge at the end."""
    if not np.isfinite(tau):
        return 1 - t / n if tied else np.ones_like(t)
    decay = np.exp(-t / tau)
    return decay * np.expm1(-2 * (n - t) / tau) / np.expm1(-2 * n / tau) if tied else decay
