"""A rigid body with wheels on a circular orbit: Euler's equations, stepped by the classical Runge–Kutta method.

With the inertia I (wheels locked), the wheels' momentum h relative to the body in body axes and the torque w that speeds the
wheels up, the body's rate ω against inertial space follows

    I ω' = T + T_g − w − ω × (I ω + h),    h' = w,    q' = ½ q ∘ (ω, 0)                                             (1)

Without outer torque Aᵀ(Iω + h) is constant, whatever w does; without wheels' torque so is ½ ω·Iω (with w = 0 the term
ω·(ω × h) vanishes). The gravity gradient on the unit vector z to the Earth's centre, in body axes, is

    T_g = 3 n² z × I z                                                                                              (2)

Wertz, Spacecraft Attitude Determination and Control, (17-33). T and w are held through a step; T_g follows the body and the
orbit, on which z turns to z cos nτ − x sin nτ with x along the velocity.

The integral of the rate over the step, what a gyro shows, has the weights of the method: (ω₁ + 2ω₂ + 2ω₃ + ω₄)/6.
"""

import math

from gyrocal.arrays import Array
from gyrocal.jit_cache import compile_cached

Triple = tuple[float, float, float]
Quad = tuple[float, float, float, float]


@compile_cached
def compute_attitude_matrix(q: Array, out: Array) -> None:
    """Compute A(q), inertial to body, of a quaternion (4,), scalar last, into out (3, 3)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)


@compile_cached(inline="always")
def multiply(M: Array, x: float, y: float, z: float) -> Triple:
    """Multiply a matrix (3, 3) and a vector."""
    return (
        M[0, 0] * x + M[0, 1] * y + M[0, 2] * z,
        M[1, 0] * x + M[1, 1] * y + M[1, 2] * z,
        M[2, 0] * x + M[2, 1] * y + M[2, 2] * z,
    )


@compile_cached(inline="always")
def _compute_acceleration(
    inertia: Array, inverse: Array, q: Quad, w: Triple, h: Triple, torque: Triple, z: Triple, gradient: float
) -> Triple:
    """Compute ω' of (1); torque is T − w, z inertial, gradient 3 n²."""
    a, b, c, d = q
    z_x = (1 - 2 * (b * b + c * c)) * z[0] + 2 * (a * b + c * d) * z[1] + 2 * (a * c - b * d) * z[2]
    z_y = 2 * (a * b - c * d) * z[0] + (1 - 2 * (a * a + c * c)) * z[1] + 2 * (b * c + a * d) * z[2]
    z_z = 2 * (a * c + b * d) * z[0] + 2 * (b * c - a * d) * z[1] + (1 - 2 * (a * a + b * b)) * z[2]
    i_x, i_y, i_z = multiply(inertia, z_x, z_y, z_z)
    l_x, l_y, l_z = multiply(inertia, w[0], w[1], w[2])
    l_x, l_y, l_z = l_x + h[0], l_y + h[1], l_z + h[2]
    return multiply(
        inverse,
        torque[0] + gradient * (z_y * i_z - z_z * i_y) - (w[1] * l_z - w[2] * l_y),
        torque[1] + gradient * (z_z * i_x - z_x * i_z) - (w[2] * l_x - w[0] * l_z),
        torque[2] + gradient * (z_x * i_y - z_y * i_x) - (w[0] * l_y - w[1] * l_x),
    )


@compile_cached(inline="always")
def _differentiate_quaternion(q: Quad, w: Triple) -> Quad:
    """Compute q' of (1)."""
    a, b, c, d = q
    x, y, z = 0.5 * w[0], 0.5 * w[1], 0.5 * w[2]
    return (d * x + b * z - c * y, d * y - a * z + c * x, d * z + a * y - b * x, -a * x - b * y - c * z)


@compile_cached
def step_rigid_body(
    q: Array,
    omega: Array,
    momentum: Array,
    inertia: Array,
    inverse: Array,
    torque: Array,
    wheel_torque: Array,
    nadir: Array,
    velocity: Array,
    mean_motion: float,
    gradient: float,
    dt: float,
    rotation: Array,
) -> None:
    """Step (1) once, in place.

    Parameters
    ----------
    q : (4,) inertial to body, scalar last; brought up to date
    omega : (3,) ω, rad/s; brought up to date
    momentum : (3,) h at the start, N m s, body axes; brought up to date
    inertia, inverse : (3, 3) I, kg m², and its inverse
    torque : (3,) T, N m, body axes
    wheel_torque : (3,) w, N m, body axes
    nadir, velocity : (3,) unit vectors z and x at the start, inertial
    mean_motion : n, rad/s
    gradient : 3 n² of (2), 1/s²; 0 without gravity gradient
    dt : s
    rotation : (3,) the integral of ω over the step is added, rad
    """
    half = 0.5 * dt
    c, s = math.cos(mean_motion * half), math.sin(mean_motion * half)
    c2, s2 = c * c - s * s, 2 * s * c
    z1 = (nadir[0], nadir[1], nadir[2])
    z2 = (c * nadir[0] - s * velocity[0], c * nadir[1] - s * velocity[1], c * nadir[2] - s * velocity[2])
    z4 = (c2 * nadir[0] - s2 * velocity[0], c2 * nadir[1] - s2 * velocity[1], c2 * nadir[2] - s2 * velocity[2])
    total = (torque[0] - wheel_torque[0], torque[1] - wheel_torque[1], torque[2] - wheel_torque[2])
    h1 = (momentum[0], momentum[1], momentum[2])
    h2 = (h1[0] + half * wheel_torque[0], h1[1] + half * wheel_torque[1], h1[2] + half * wheel_torque[2])
    h4 = (h1[0] + dt * wheel_torque[0], h1[1] + dt * wheel_torque[1], h1[2] + dt * wheel_torque[2])
    q1, w1 = (q[0], q[1], q[2], q[3]), (omega[0], omega[1], omega[2])
    a1, p1 = _compute_acceleration(inertia, inverse, q1, w1, h1, total, z1, gradient), _differentiate_quaternion(q1, w1)
    w2 = (w1[0] + half * a1[0], w1[1] + half * a1[1], w1[2] + half * a1[2])
    q2 = (q1[0] + half * p1[0], q1[1] + half * p1[1], q1[2] + half * p1[2], q1[3] + half * p1[3])
    a2, p2 = _compute_acceleration(inertia, inverse, q2, w2, h2, total, z2, gradient), _differentiate_quaternion(q2, w2)
    w3 = (w1[0] + half * a2[0], w1[1] + half * a2[1], w1[2] + half * a2[2])
    q3 = (q1[0] + half * p2[0], q1[1] + half * p2[1], q1[2] + half * p2[2], q1[3] + half * p2[3])
    a3, p3 = _compute_acceleration(inertia, inverse, q3, w3, h2, total, z2, gradient), _differentiate_quaternion(q3, w3)
    w4 = (w1[0] + dt * a3[0], w1[1] + dt * a3[1], w1[2] + dt * a3[2])
    q4 = (q1[0] + dt * p3[0], q1[1] + dt * p3[1], q1[2] + dt * p3[2], q1[3] + dt * p3[3])
    a4, p4 = _compute_acceleration(inertia, inverse, q4, w4, h4, total, z4, gradient), _differentiate_quaternion(q4, w4)
    sixth = dt / 6.0
    for i in range(3):
        rotation[i] += sixth * (w1[i] + 2.0 * (w2[i] + w3[i]) + w4[i])
        omega[i] = w1[i] + sixth * (a1[i] + 2.0 * (a2[i] + a3[i]) + a4[i])
        momentum[i] = h4[i]
    norm = 0.0
    for i in range(4):
        q[i] = q1[i] + sixth * (p1[i] + 2.0 * (p2[i] + p3[i]) + p4[i])
        norm += q[i] * q[i]
    scale = 1.0 / math.sqrt(norm)
    for i in range(4):
        q[i] *= scale
