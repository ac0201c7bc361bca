"""The body axis that flies forward, from the body's rate.

With z to nadir the body turns once an orbit about the orbit normal N, ω = n N, and N lies in its xy-plane. The velocity is
along ẑ × N, so that a rate of −n about y means +x forward, +n about y −x, −n about x −y and +n about x +y (conventions in
`gyrocal`). A yaw turn adds a rate about z and leaves that about the other axes at n; while it lasts, a reference belongs to
the direction flown before or after it, whichever is nearer. Where the rate across z is not n the body does not point to
nadir, as in an inertial hold, and no axis flies forward.

The rate at a reference is the median of the a-priori adjusted gyro samples around it, over long enough that their noise does
not matter. An interval whose `forward` is given is taken at its word; what its `activity` says is for people.
"""

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Mask
from gyrocal.recording import GyroStream, Interval, Recording, find_reference_rows
from simulator.effects.base import Array

SHORTEST_S = 10.0  # to either side of a reference; half a transition to an inertial hold
LONGEST_S = 150.0
RATE_NOISE_LIMIT = 0.05  # of orbit rate: the rate must be known as well as that
NADIR_RATE_TOLERANCE = 0.25  # of orbit rate: how far the rate may be from that of pointing to nadir, and about z from no turn
FLIGHT_DIRECTIONS = np.array(["+x", "-x", "+y", "-y"])
HEADING_VECTORS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


def find_flight_directions(recording: Recording) -> tuple[NDArray[np.str_], Array]:
    """Find the forward axis and heading at each reference; "" and NaN without one.

    The body axis along the velocity, (m,), and the angle of the velocity in the body's xy-plane from +x to +y, (m,) rad.
    """
    t_s = recording.attitudes.t_s
    axes, headings = np.full(t_s.size, "", dtype="<U2"), np.full(t_s.size, np.nan)
    is_assigned = np.zeros(t_s.size, dtype=bool)
    gyro = recording.gyro
    for interval in recording.intervals:
        rows = find_reference_rows(t_s, interval)
        rows = rows[~is_assigned[rows]]
        is_assigned[rows] = True
        if not rows.size:
            continue
        if interval.forward is not None:
            if interval.forward != "none":
                axes[rows] = interval.forward
                headings[rows] = _compute_heading(HEADING_VECTORS[np.isin(FLIGHT_DIRECTIONS, interval.forward)])
        elif recording.orbit is not None:
            rate = 2 * np.pi / recording.orbit.period_s
            rates = _estimate_rates(gyro, interval, t_s[rows], RATE_NOISE_LIMIT * rate) / rate
            axes[rows] = _find_forward_axes(rates)
            headings[rows] = np.where(_is_nadir_pointing(rates), _compute_heading(_compute_velocity(rates)), np.nan)
    return axes, headings


def _estimate_rates(gyro: GyroStream, interval: Interval, t_s: Array, accuracy: float) -> Array:
    """Estimate body rates at some times of an interval, (m, 3) rad/s; NaN where the samples are too noisy."""
    half = max(SHORTEST_S, 0.5 * (gyro.arw / accuracy) ** 2)
    out = np.full((t_s.size, 3), np.nan)
    if half > LONGEST_S:
        return out
    tags = gyro.t_s + 0.5 * gyro.sample_s
    low = np.searchsorted(tags, np.maximum(t_s - half, interval.start_s))
    high = np.searchsorted(tags, np.minimum(t_s + half, interval.stop_s))
    for k, (first, last) in enumerate(zip(low, high, strict=True)):
        if last > first:
            out[k] = np.median(gyro.rates[first:last], axis=0)
    return out @ gyro.apriori_G.T + gyro.apriori_bias


def _find_forward_axes(rates: Array) -> NDArray[np.str_]:
    """Find the forward axes of the references of an interval, from rates (m, 3) in orbit rates."""
    out = np.full(len(rates), "", dtype="<U2")
    velocity = _compute_velocity(rates)
    similarity = velocity @ HEADING_VECTORS.T
    pointing = _is_nadir_pointing(rates)
    steady = pointing & (np.abs(rates[:, 2]) < NADIR_RATE_TOLERANCE)
    out[steady] = FLIGHT_DIRECTIONS[similarity[steady].argmax(axis=1)]
    for row in np.flatnonzero(pointing & ~steady):
        steady_rows = np.flatnonzero(steady)
        neighbours = {*steady_rows[steady_rows < row][-1:], *steady_rows[steady_rows > row][:1]}
        choices = (
            np.isin(FLIGHT_DIRECTIONS, out[list(neighbours)]) if neighbours else np.ones(FLIGHT_DIRECTIONS.size, dtype=bool)
        )
        out[row] = FLIGHT_DIRECTIONS[np.where(choices, similarity[row], -np.inf).argmax()]
    return out


def _compute_velocity(rates: Array) -> Array:
    """Compute ẑ × ω in the xy-plane, (m, 2): the direction of the velocity where the body points to nadir."""
    return np.column_stack([-rates[:, 1], rates[:, 0]])


def _is_nadir_pointing(rates: Array) -> Mask:
    """Mark samples whose rate across z is that of the orbit."""
    return np.abs(np.linalg.norm(_compute_velocity(rates), axis=1) - 1) < NADIR_RATE_TOLERANCE


def _compute_heading(velocity: Array) -> Array:
    """Compute the heading from +x to +y, rad."""
    return np.arctan2(velocity[:, 1], velocity[:, 0])
