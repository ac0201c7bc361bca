"""Four reaction wheels in a pyramid, and their unloading by three magnetic torquers.

Wheels
    The spin axes a_i lie at the azimuths 45°, 135°, 225°, 315° about body z and rise from the XY plane by the pyramid's
    elevation ε: W = (a_1 … a_4), (3, 4). A torque T on the body takes the wheel torques −W⁺ T, of all that do it the ones of
    least square sum; W⁺ = Wᵀ (W Wᵀ)⁻¹. At sin ε = 1/√3 W Wᵀ = (4/3) I and every direction is alike. Too large a torque is
    shortened and keeps its direction; a wheel at its largest momentum takes no more, and then the direction is lost.
Unloading
    The cross-product law: with the measured field B and the wheels' momentum h, the torquers' moment

        m = (k/|B|²) h × B,    of which the torque is m × B = −k (h − B (B·h)/|B|²)

    takes momentum out across the field; what lies along it waits until orbit and Earth have turned the field. Too large a
    moment is shortened and keeps its direction.
"""

import math

import numpy as np

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached

WHEELS = 4
EQUAL_ELEVATION = math.asin(1 / math.sqrt(3))  # rad; the pyramid alike in all directions


def build_wheel_pyramid(elevation: float = EQUAL_ELEVATION) -> Array:
    """Build spin axes W, (3, 4) unit columns, of a pyramid about body z; elevation above the XY plane in rad."""
    azimuth = np.deg2rad([45.0, 135.0, 225.0, 315.0])
    flat = math.cos(elevation) * np.stack([np.cos(azimuth), np.sin(azimuth)])
    return np.concatenate([flat, np.full((1, WHEELS), math.sin(elevation))])


@compile_cached
def distribute_torque(
    torque: Array, distribution: Array, momentum: Array, torque_limit: float, momentum_limit: float, dt: float, out: Array
) -> None:
    """Distribute a torque on the body to the wheels.

    Parameters
    ----------
    torque : (3,) wanted on the body, N m
    distribution : (4, 3) W⁺
    momentum : (4,) of the wheels, N m s
    torque_limit : of one wheel, N m
    momentum_limit : of one wheel, N m s
    dt : s that the torques will act
    out : (4,) torques that speed the wheels up, N m; written
    """
    largest = torque_limit
    for i in range(WHEELS):
        out[i] = -(distribution[i, 0] * torque[0] + distribution[i, 1] * torque[1] + distribution[i, 2] * torque[2])
        largest = max(largest, abs(out[i]))
    scale = torque_limit / largest
    for i in range(WHEELS):
        after = min(max(momentum[i] + scale * out[i] * dt, -momentum_limit), momentum_limit)
        out[i] = (after - momentum[i]) / dt


@compile_cached
def compute_unloading_moment(
    h_x: float, h_y: float, h_z: float, b_x: float, b_y: float, b_z: float, gain: float, limit: float
) -> tuple[float, float, float]:
    """Compute the moment m of the torquers by the cross-product law.

    Parameters
    ----------
    h_x, h_y, h_z : wheels' momentum in body axes, N m s
    b_x, b_y, b_z : measured field in body axes, T
    gain : k, 1/s
    limit : largest moment of one torquer, A m²

    Returns
    -------
    A m², body axes
    """
    scale = gain / (b_x * b_x + b_y * b_y + b_z * b_z)
    m_x, m_y, m_z = scale * (h_y * b_z - h_z * b_y), scale * (h_z * b_x - h_x * b_z), scale * (h_x * b_y - h_y * b_x)
    shorten = limit / max(limit, abs(m_x), abs(m_y), abs(m_z))
    return shorten * m_x, shorten * m_y, shorten * m_z
