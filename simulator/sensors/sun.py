"""The truth of a digital sun sensor: from an attitude to the counts of its two heads.

A sensor has two heads, each of which sees the Sun's angle in one plane. In the frame of the α head, which is taken as that
of the sensor, a Sun direction s has tan α = s_x / s_z and tan β = s_y / s_z, the inverse of R (4). The β head is turned
against it by a 2-3-1 Euler sequence: e₁ about y, then e₂ about the new z, then e₃ about the new x. In components,

    s' = X(e₃) Z(e₂) Y(e₁) s

    Y s = (x, y, z₁),  x₁ = c₁ x − s₁ z,  z₁ = s₁ x + c₁ z
    Z   :              y₂ = c₂ y − s₂ x₁
    X   :              y₃ = c₃ y₂ + s₃ z₁,  z₃ = c₃ z₁ − s₃ y₂

and it sees tan β' = y₃ / z₃. Divided by s_z, with a = tan α and b = tan β, and p = c₂ b − s₂ (c₁ a − s₁), q = s₁ a + c₁,

    tan β' = (c₃ p + s₃ q) / (c₃ q − s₃ p) = (b − e₂ a + e₃) / (1 + e₁ a − e₃ b) to first order.

e₃ alone adds to β exactly. e₁ scales tan β in proportion to tan α and e₂ shifts it in proportion to tan α: neither acts
where the Sun crosses the plane α = 0, except in second order.

A head's counts N follow from R (5) solved for N,

    a₁ + a₂ N + a₃ sin(a₄ N + a₅) + a₆ sin(a₇ N + a₈) = tan(α − a₉)

by Newton's method from the straight line; the sines' slopes are small against a₂, so that the left side rises everywhere.
R publishes the form only. The coefficients here are made up: 14-bit counts with the boresight at their middle, tan ±1.19 over
them all (0.0083° a count at the boresight), and sines of 0.02° and 0.01°.
"""

from dataclasses import dataclass
from math import cos, sin, tan

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array, Mask
from gyrocal.jit_cache import compile_cached

Counts = NDArray[np.int64]

SIMULATED_ALPHA_COEFFICIENTS = np.array([-1.1918, 1.4549e-4, 3.5e-4, 1.5340e-3, 0.40, 1.7e-4, 6.1359e-3, 1.10, 2.6e-4])
SIMULATED_BETA_COEFFICIENTS = np.array([-1.1925, 1.4556e-4, 3.1e-4, 1.5340e-3, 2.30, 2.0e-4, 6.1359e-3, 0.20, -1.9e-4])
SIMULATED_HALF_FOV = np.deg2rad(48.0)  # R: 96° about a head's boresight
SIMULATED_BORESIGHT_TILT = np.deg2rad(20.0)  # of the boresights from ±X toward −Y, not published
SUN_ANGLE_NOISE = np.deg2rad(0.005)  # 1-sigma of an angle before it is quantised, not published

# R: the β heads' 2-3-1 Euler angles against the α heads, from alignment records.
HEAD_DSS1 = np.deg2rad([0.044, -0.008, 0.067])
HEAD_DSS2 = np.deg2rad([0.206, 0.061, 0.182])

NEWTON_STEPS = 8  # two or three suffice; the bound only stops a loop that rounding keeps alive


@dataclass(frozen=True)
class TrueSunSensor:
    """A sun sensor as it really is."""

    name: str  # of the sensor
    alignment: Array  # (3, 3) true sensor to body, N M of R (1)
    coefficients_alpha: Array  # (9,) of R (5), rad where an angle
    coefficients_beta: Array
    head: Array  # (3,) 2-3-1 Euler angles (e₁, e₂, e₃) of the β head, rad
    half_fov: float = SIMULATED_HALF_FOV  # of each head, rad
    noise: float = SUN_ANGLE_NOISE  # 1-sigma of each angle before it is quantised, rad


def build_trmm_alignments(tilt: float = SIMULATED_BORESIGHT_TILT, elevation: float = 0.0) -> tuple[Array, Array]:
    """Build the nominal sensor-to-body matrices of DSS-1 and DSS-2, (3, 3) each.

    The boresights z lie in the body's XY plane, `tilt` rad from +X (DSS-1) and −X (DSS-2) toward −Y, where the Sun is kept. y
    of each sensor lies in that plane, toward −Y, and x along +Z (DSS-1) and −Z (DSS-2): α vanishes when the Sun crosses the
    XY plane. An elevation then lifts the boresight out of the plane toward +Z about y, and the Sun crosses at
    tan α = ∓tan(elevation). DSS-2 is DSS-1 with the boresight's x reversed.
    """
    (c, s), (ce, se) = (cos(tilt), sin(tilt)), (cos(elevation), sin(elevation))
    first = np.array([[-se * c, -s, ce * c], [se * s, -c, -ce * s], [ce, 0.0, se]])
    second = np.array([[-se * c, s, -ce * c], [-se * s, -c, -ce * s], [-ce, 0.0, se]])
    return first, second


def build_trmm_sensors(
    tilt: float = SIMULATED_BORESIGHT_TILT,
    misalignments: tuple[Array, Array] | None = None,
    heads: tuple[Array, Array] = (HEAD_DSS1, HEAD_DSS2),
    elevation: float = 0.0,
) -> tuple[TrueSunSensor, TrueSunSensor]:
    """Build TRMM's two sensors, DSS-1 toward +X and DSS-2 toward −X.

    Parameters
    ----------
    tilt, elevation : see `build_trmm_alignments`
    misalignments : M of R (1) of each, (3, 3), true to nominal sensor frame; none by default
    heads : (3,) Euler angles of each β head, rad; the flight's by default, zeros for heads at right angles
    """
    turns = misalignments or (np.eye(3), np.eye(3))
    first, second = (
        TrueSunSensor(f"DSS-{k + 1}", N @ turns[k], SIMULATED_ALPHA_COEFFICIENTS, SIMULATED_BETA_COEFFICIENTS, heads[k])
        for k, N in enumerate(build_trmm_alignments(tilt, elevation))
    )
    return first, second


@compile_cached
def compute_head_tangents(s_x: float, s_y: float, s_z: float, head: Array) -> tuple[float, float]:
    """Compute (tan α, tan β') of a direction s in the α head's frame, s_z > 0; head: Euler angles (3,) of the β head, rad."""
    c1, s1 = cos(head[0]), sin(head[0])
    c2, s2 = cos(head[1]), sin(head[1])
    c3, s3 = cos(head[2]), sin(head[2])
    y2 = c2 * s_y - s2 * (c1 * s_x - s1 * s_z)
    z1 = s1 * s_x + c1 * s_z
    return s_x / s_z, (c3 * y2 + s3 * z1) / (c3 * z1 - s3 * y2)


@compile_cached
def _count(tangent: float, k: Array) -> float:
    """Compute the count N, unrounded, at which R (5) with coefficients k (9,) gives an angle of this tangent."""
    offset = tan(k[8])
    target = (tangent - offset) / (1.0 + tangent * offset)
    N = (target - k[0]) / k[1]
    for _ in range(NEWTON_STEPS):
        first, second = k[3] * N + k[4], k[6] * N + k[7]
        value = k[0] + k[1] * N + k[2] * sin(first) + k[5] * sin(second)
        slope = k[1] + k[2] * k[3] * cos(first) + k[5] * k[6] * cos(second)
        step = (target - value) / slope
        N += step
        if abs(step) < 1e-9:
            break
    return N


@compile_cached
def compute_counts(tan_alpha: float, tan_beta: float, a: Array, b: Array) -> tuple[float, float]:
    """Compute counts (N_α, N_β), unrounded, of two tangents; a, b (9,) coefficients of R (5)."""
    return _count(tan_alpha, a), _count(tan_beta, b)


@compile_cached
def compute_sensor_counts(
    A: Array,
    sun: Array,
    alignment: Array,
    head: Array,
    a: Array,
    b: Array,
    half_fov: float,
    noise_alpha: float,
    noise_beta: float,
) -> tuple[int, int, bool]:
    """Compute the counts of both heads at one moment, and whether the Sun is in view of both; zeros when not.

    Parameters
    ----------
    A : (3, 3) true attitude
    sun : (3,) unit vector, inertial
    alignment : (3, 3) true sensor to body
    head : (3,) Euler angles of the β head, rad
    a, b : (9,) coefficients of R (5)
    half_fov : of each head, rad
    noise_alpha, noise_beta : errors of the two angles, rad
    """
    body, s = np.empty(3), np.empty(3)
    for i in range(3):
        body[i] = A[i, 0] * sun[0] + A[i, 1] * sun[1] + A[i, 2] * sun[2]
    for i in range(3):
        s[i] = alignment[0, i] * body[0] + alignment[1, i] * body[1] + alignment[2, i] * body[2]
    if s[2] <= 0.0:
        return 0, 0, False
    tan_alpha, tan_beta = compute_head_tangents(s[0], s[1], s[2], head)
    edge = tan(half_fov)
    if abs(tan_alpha) > edge or abs(tan_beta) > edge:
        return 0, 0, False
    e_alpha, e_beta = tan(noise_alpha), tan(noise_beta)
    n_alpha, n_beta = compute_counts(
        (tan_alpha + e_alpha) / (1.0 - tan_alpha * e_alpha), (tan_beta + e_beta) / (1.0 - tan_beta * e_beta), a, b
    )
    return round(n_alpha), round(n_beta), True


def observe(rng: np.random.Generator | None, sensor: TrueSunSensor, A: Array, sun: Array) -> tuple[Counts, Mask]:
    """Simulate counts at a series of moments, without the Earth's shadow (see `simulator.truth.sun.is_eclipsed`).

    Parameters
    ----------
    rng : source of the noise; None for none, counts are whole numbers all the same
    A : (n, 3, 3) true attitudes
    sun : (n, 3) unit vectors, inertial

    Returns
    -------
    counts : (n, 2) N_α, N_β; zeros where the Sun is out of view
    visible : (n,) the Sun is in view of both heads
    """
    noise = np.zeros((len(A), 2)) if rng is None else sensor.noise * rng.standard_normal((len(A), 2))
    counts, visible = np.zeros((len(A), 2), dtype=np.int64), np.zeros(len(A), dtype=bool)
    _observe(
        np.ascontiguousarray(A),
        np.ascontiguousarray(sun),
        sensor.alignment,
        sensor.head,
        sensor.coefficients_alpha,
        sensor.coefficients_beta,
        sensor.half_fov,
        noise,
        counts,
        visible,
    )
    return counts, visible


@compile_cached
def _observe(
    A: Array,
    sun: Array,
    alignment: Array,
    head: Array,
    a: Array,
    b: Array,
    half_fov: float,
    noise: Array,
    counts: Counts,
    visible: Mask,
) -> None:
    for k in range(len(A)):
        counts[k, 0], counts[k, 1], visible[k] = compute_sensor_counts(
            A[k], sun[k], alignment, head, a, b, half_fov, noise[k, 0], noise[k, 1]
        )
