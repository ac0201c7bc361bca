"""Mission Mode as one compiled loop: the spacecraft, its sensors, its computer at 2 Hz and its actuators.

A cycle k at t = k Δt does, in this order: the commanded frame from orbit and yaw command; the gyro's mean rate over the cycle
before; the estimate of `simulator.mission_mode.onboard_attitude`; the Earth sensor; the sun sensor if the Sun is just crossing
the body's XY plane; the torque

    T = −K_p ε − K_i ∫ε − K_d ω_e + ω × (I ω + h) + I ω_c'

with the rate error ω_e = ω − ω_c + ε × ω_c; its distribution to the wheels and the torquers' moment; and the step of
`simulator.mission_mode.rigid_body` to the next cycle. All inputs are in named tuples of numbers and arrays, all that changes is
in `State`, and the output grows with the requested rows only. Steps of a few lines are inlined: a call of each in every cycle
costs up to a fifth of the loop's time.
"""

import math

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.jit_cache import compile_cached
from simulator.mission_mode.magnetic_field import DIPOLE, EARTH_RATE, compute_dipole_field
from simulator.mission_mode.onboard_attitude import compute_sun_azimuth, propagate_error, wrap_angle
from simulator.mission_mode.rigid_body import compute_attitude_matrix, multiply, step_rigid_body
from simulator.mission_mode.state import NEVER, SUN_STEP, Plant, Sensors, Slew, State, Tables, compute_yaw_command, count_orbit
from simulator.mission_mode.target_frame import compute_geodetic_axes, compute_lvlh_axes, compute_rotation_between, turn_about_z
from simulator.mission_mode.wheels import WHEELS, compute_unloading_moment, distribute_torque
from simulator.sensors.earth import compute_roll_pitch, measure_quadrants
from simulator.sensors.horizon import COSINES, SINES
from simulator.sensors.sun import compute_sensor_counts

YEARLY = 2 * math.pi / (365.25 * 86400.0)  # rad/s
SHORTEST_BIAS_INTERVAL = 600.0  # s; updates closer than that set the yaw and leave the bias


@compile_cached
def _simulate_gyro(
    rng: np.random.Generator,
    wander: np.random.Generator,
    plant: Plant,
    sensors: Sensors,
    state: State,
    tables: Tables,
    apparent: Array,
    gyro_turn: Array,
    raw: Array,
) -> None:
    """Simulate the gyro's last cycle: write gyro_turn (3,), rad, apparent ω − G ω_raw and raw ω_raw (3,), rad/s."""
    dt = plant.dt
    # Number by number: an expression of whole arrays takes a second or two to compile, a copy of slices another.
    d_x = state.body_turn[0] / dt - state.true_bias[0]
    d_y = state.body_turn[1] / dt - state.true_bias[1]
    d_z = state.body_turn[2] / dt - state.true_bias[2]
    inverse = sensors.inverse_G
    for i in range(3):
        raw[i] = inverse[i, 0] * d_x + inverse[i, 1] * d_y + inverse[i, 2] * d_z
        raw[i] += sensors.gyro_sigma * rng.standard_normal()
    for i in range(3):
        rate = tables.G[i, 0] * raw[0] + tables.G[i, 1] * raw[1] + tables.G[i, 2] * raw[2]
        apparent[i] = state.body_turn[i] / dt - rate
        gyro_turn[i] = (rate + state.bias[i]) * dt
        if sensors.walk_sigma[i] > 0.0:
            state.true_bias[i] += sensors.walk_sigma[i] * wander.standard_normal()


@compile_cached
def _add_horizon_error(
    rng: np.random.Generator, t: float, A: Array, position: Array, sensors: Sensors, state: State, angles: Array
) -> None:
    """Add to the penetration angles (4,) the error by the horizon's radiance, rad, and advance `state.horizon`.

    A first-order Markov process in each quadrant, and the limb lower by `horizon_season` times the sine of its latitude. The
    line of sight at the nominal angle η from nadir touches the sphere in the limb point, whose unit position is
    r̂ sin η + d cos η, with d the quadrant's horizontal direction and sin η = a/r.
    """
    season = sensors.horizon_season * math.cos(YEARLY * t + sensors.season_phase)
    sine, cosine = math.sin(sensors.earth.nominal), math.cos(sensors.earth.nominal)
    radius = math.sqrt(position[0] ** 2 + position[1] ** 2 + position[2] ** 2)
    for i in range(4):
        if sensors.horizon_sigma > 0.0:
            grown = sensors.horizon_sigma * math.sqrt(1.0 - sensors.horizon_keep**2)
            state.horizon[i] = sensors.horizon_keep * state.horizon[i] + grown * rng.standard_normal()
        sine_of_latitude = sine * position[2] / radius + cosine * (COSINES[i] * A[0, 2] + SINES[i] * A[1, 2])
        angles[i] += state.horizon[i] - season * sine_of_latitude


@compile_cached
def _update_yaw(
    rng: np.random.Generator,
    t: float,
    A: Array,
    frame: Array,
    sun: Array,
    error_yaw: float,
    sensors: Sensors,
    state: State,
    tables: Tables,
    updates: Array,
    count: int,
) -> int:
    """Update the yaw if the Sun is in view; return the number of rows of updates so far."""
    s_x = frame[0, 0] * sun[0] + frame[0, 1] * sun[1] + frame[0, 2] * sun[2]
    s_y = frame[1, 0] * sun[0] + frame[1, 1] * sun[1] + frame[1, 2] * sun[2]
    i = 0 if s_x > 0.0 else 1
    noise_alpha, noise_beta = sensors.noise[i] * rng.standard_normal(), sensors.noise[i] * rng.standard_normal()
    n_alpha, n_beta, visible = compute_sensor_counts(
        A,
        sun,
        sensors.alignments[i],
        sensors.heads[i],
        sensors.a[i],
        sensors.b[i],
        sensors.half_fov[i],
        noise_alpha,
        noise_beta,
    )
    if not visible:
        return count
    azimuth = compute_sun_azimuth(float(n_alpha), float(n_beta), tables.a[i], tables.b[i], tables.alignments[i])
    measured = wrap_angle(math.atan2(s_y, s_x) - azimuth)
    size = measured - state.estimate[2]
    interval = t - state.memory[1]
    solve = state.memory[1] > NEVER and interval >= SHORTEST_BIAS_INTERVAL
    if solve:
        state.bias[2] += tables.bias_gain * size / interval
    state.estimate[2] = measured
    state.memory[1], state.memory[2] = t, 0.0
    updates[count, 0], updates[count, 1], updates[count, 2], updates[count, 3] = t, i + 1.0, size, state.bias[2]
    updates[count, 4], updates[count, 5], updates[count, 6] = 1.0 if solve else 0.0, measured, error_yaw
    return count + 1


@compile_cached
def _compute_wanted_torque(
    rate: Array, frame_turn: Array, momentum: Array, integrate: bool, plant: Plant, state: State, tables: Tables, torque: Array
) -> None:
    """Write the torque (3,) of the module's control law; rate (3,) by the gyro and frame_turn (3,), rad."""
    dt, e = plant.dt, state.estimate
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        if integrate:
            total = state.integral[i] + e[i] * dt
            state.integral[i] = min(max(total, -tables.integral_limit), tables.integral_limit)
        slip = rate[i] + (-frame_turn[i] + e[j] * frame_turn[k] - e[k] * frame_turn[j]) / dt
        gyroscopic = rate[j] * (tables.inertia[k] * rate[k] + momentum[k]) - rate[k] * (
            tables.inertia[j] * rate[j] + momentum[j]
        )
        forward = tables.inertia[i] * (frame_turn[i] - state.frame_turn[i]) / (dt * dt)
        torque[i] = (
            gyroscopic
            + forward
            - tables.proportional[i] * e[i]
            - tables.derivative[i] * slip
            - tables.integral[i] * state.integral[i]
        )


@compile_cached
def _compute_outer_torque(
    rng: np.random.Generator,
    t: float,
    A: Array,
    lvlh: Array,
    sun: Array,
    momentum: Array,
    plant: Plant,
    sensors: Sensors,
    tables: Tables,
    torque: Array,
) -> float:
    """Write the torque (3,) of the air and of the moments in the field, body axes; return the largest moment of a torquer."""
    body, r = plant.body, -plant.radius
    b_x, b_y, b_z = compute_dipole_field(
        r * lvlh[2, 0], r * lvlh[2, 1], r * lvlh[2, 2], plant.sidereal + EARTH_RATE * t, DIPOLE
    )
    B_x, B_y, B_z = multiply(A, b_x, b_y, b_z)
    m_x, m_y, m_z = 0.0, 0.0, 0.0
    if tables.unloading > 0.0:
        sigma = sensors.magnetometer_sigma
        m_x, m_y, m_z = compute_unloading_moment(
            momentum[0],
            momentum[1],
            momentum[2],
            B_x + sigma * rng.standard_normal(),
            B_y + sigma * rng.standard_normal(),
            B_z + sigma * rng.standard_normal(),
            tables.unloading,
            body.dipole_limit,
        )
    largest = max(abs(m_x), abs(m_y), abs(m_z))
    m_x, m_y, m_z = m_x + body.residual_dipole[0], m_y + body.residual_dipole[1], m_z + body.residual_dipole[2]
    height = -(lvlh[2, 0] * sun[0] + lvlh[2, 1] * sun[1] + lvlh[2, 2] * sun[2])
    force = -body.drag * (1.0 + body.drag_swing * height)
    v_x, v_y, v_z = multiply(A, lvlh[0, 0], lvlh[0, 1], lvlh[0, 2])
    f_x, f_y, f_z = force * v_x, force * v_y, force * v_z
    arm = body.pressure_arm
    torque[0] = m_y * B_z - m_z * B_y + arm[1] * f_z - arm[2] * f_y
    torque[1] = m_z * B_x - m_x * B_z + arm[2] * f_x - arm[0] * f_z
    torque[2] = m_x * B_y - m_y * B_x + arm[0] * f_y - arm[1] * f_x
    return largest


@compile_cached(inline="always")
def _interpolate_sun(t: float, table: Array, sun: Array) -> None:
    """Write the direction of the Sun (3,) at t from its table, a row every `SUN_STEP`."""
    index = int(t / SUN_STEP)
    fraction = t / SUN_STEP - index
    for i in range(3):
        sun[i] = (1.0 - fraction) * table[index, i] + fraction * table[index + 1, i]


@compile_cached(inline="always")
def _project_wheels(axes: Array, by_wheel: Array, total: Array) -> None:
    """Write the sum (3,) over the wheels, in body axes, of a momentum or a torque by wheel along their axes (3, WHEELS)."""
    for i in range(3):
        total[i] = 0.0
        for j in range(WHEELS):
            total[i] += axes[i, j] * by_wheel[j]


@compile_cached(inline="always")
def _update_roll_and_pitch(limbs: Array, biases: Array, quadrants: Mask, angles: Array, estimate: Array) -> None:
    """Replace roll and pitch of the on-board estimate (3,) by those of the Earth sensor, its biases (4,) taken out, rad."""
    for j in range(4):
        angles[j] = limbs[j] - biases[j]
    roll, pitch = compute_roll_pitch(angles, quadrants)
    if not (math.isnan(roll) or math.isnan(pitch)):  # a quadrant that misses the Earth shows nothing
        estimate[0], estimate[1] = roll, pitch


@compile_cached
def _write_telemetry(
    t: float, error: Array, raw: Array, limbs: Array, used: int, normal: bool, state: State, row: Array
) -> None:
    """Write one row (21,) of telemetry, in the order of TELEMETRY."""
    row[0], row[7] = t, state.bias[2]
    row[12], row[13] = used, 1.0 if normal else 0.0
    for i in range(3):
        row[1 + i], row[4 + i], row[14 + i] = error[i], state.estimate[i], raw[i]
    for j in range(WHEELS):
        row[8 + j] = state.wheels[j]
    for j in range(4):
        row[17 + j] = limbs[j]


@compile_cached(inline="always")
def _shift_errors(past: Array, error: Array) -> None:
    """Move the rows of the past attitude errors (n, 3) down by one, and write the present one (3,) into the first."""
    for i in range(3):
        for j in range(len(past) - 1, 0, -1):
            past[j, i] = past[j - 1, i]
        past[0, i] = error[i]


@compile_cached
def fly(
    rng: np.random.Generator,
    extra: np.random.Generator,
    wander: np.random.Generator,
    first: int,
    last: int,
    plant: Plant,
    sensors: Sensors,
    tables: Tables,
    slew: Slew,
    state: State,
    every: int,
    telemetry: Array,
    updates: Array,
    count: int,
    orbits: Array,
) -> int:
    """Fly the cycles first … last − 1.

    Parameters
    ----------
    rng : source of randomness
    extra, wander : those of the horizon's noise and of the walk of the gyro's bias, so that the rest is the same with and
        without
    first, last : numbers of cycles; cycle k is at k Δt
    plant, sensors, tables, slew : constant through these cycles
    state : brought up to date
    every : cycles from one row of telemetry to the next
    telemetry : (rows, 21) as TELEMETRY; row k // every is written, as far as there are rows
    updates : (rows, 7) as UPDATES
    count : rows of updates used so far
    orbits : (r, 24) rows by orbit as ORBIT_COLUMNS; added to

    Returns
    -------
    rows of updates used
    """
    dt, body = plant.dt, plant.body
    lvlh, frame, A = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    error, frame_turn, gyro_turn = np.empty(3), np.empty(3), np.empty(3)
    apparent, rate, momentum, torque, outer = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    noise, angles, wheel_torque, reaction = np.empty(8), np.empty(4), np.empty(WHEELS), np.empty(3)
    sun, position, raw, limbs = np.empty(3), np.empty(3), np.empty(3), np.empty(4)
    period = 2.0 * math.pi / plant.mean_motion
    for k in range(first, last):
        t = k * dt
        u, node = plant.latitude_argument + plant.mean_motion * t, plant.node + plant.nodal_rate * t
        compute_lvlh_axes(u, node + plant.on_board[0], plant.on_board[1], plant.on_board[2], lvlh)
        compute_geodetic_axes(lvlh, plant.radius, frame)
        turn_about_z(frame, compute_yaw_command(t, slew))
        compute_rotation_between(state.frame, frame, frame_turn)
        compute_lvlh_axes(u, node, plant.cos_i, plant.sin_i, lvlh)
        for i in range(3):
            position[i] = -plant.radius * lvlh[2, i]
        _interpolate_sun(t, plant.sun, sun)
        _project_wheels(plant.axes, state.wheels, momentum)
        compute_attitude_matrix(state.q, A)
        compute_rotation_between(frame, A, error)
        slewing = slew.duration > 0.0 and slew.start < t <= slew.start + slew.duration
        if slewing:
            state.memory[1], state.memory[2] = NEVER, 1.0
        elif slew.duration > 0.0 and t <= slew.start:
            for i in range(3):
                state.probe[i] = error[i]
        # On board.
        _simulate_gyro(rng, wander, plant, sensors, state, tables, apparent, gyro_turn, raw)
        propagate_error(state.estimate, gyro_turn, frame_turn)
        if slewing:
            propagate_error(state.probe, gyro_turn, frame_turn)
        for j in range(8):
            noise[j] = rng.standard_normal()
        measure_quadrants(
            A, frame, position, sun, noise, sensors.earth_gain, sensors.earth, state.s_filter, state.quadrants, limbs
        )
        _add_horizon_error(extra, t, A, position, sensors, state, limbs)
        used = 0
        for j in range(4):
            used += 1 if state.quadrants[j] else 0
        if used >= 3 and not slewing:
            _update_roll_and_pitch(limbs, tables.penetration_biases, state.quadrants, angles, state.estimate)
        height = frame[2, 0] * sun[0] + frame[2, 1] * sun[1] + frame[2, 2] * sun[2]
        if height * state.memory[0] < 0.0 and not slewing:
            count = _update_yaw(rng, t, A, frame, sun, error[2], sensors, state, tables, updates, count)
        state.memory[0] = height
        for i in range(3):
            rate[i] = gyro_turn[i] / dt
        _compute_wanted_torque(rate, frame_turn, momentum, not slewing, plant, state, tables, torque)
        # Actuators, and what the body does of it.
        distribute_torque(torque, plant.distribution, state.wheels, body.torque_limit, body.momentum_limit, dt, wheel_torque)
        largest = _compute_outer_torque(rng, t, A, lvlh, sun, momentum, plant, sensors, tables, outer)
        normal = state.memory[2] == 0.0
        count_orbit(orbits[int(t / period)], error, apparent, normal, used == 3, momentum, largest, state)
        row = k // every
        if k % every == 0 and row < len(telemetry):
            _write_telemetry(t, error, raw, limbs, used, normal, state, telemetry[row])
        _shift_errors(state.past, error)
        for i in range(3):
            state.frame_turn[i], state.body_turn[i] = frame_turn[i], 0.0
            for j in range(3):
                state.frame[i, j] = frame[i, j]
        state.memory[3] += 1.0
        _project_wheels(plant.axes, wheel_torque, reaction)
        for j in range(WHEELS):
            state.wheels[j] += wheel_torque[j] * dt
        step_rigid_body(
            state.q,
            state.omega,
            momentum,
            body.inertia,
            plant.inverse,
            outer,
            reaction,
            lvlh[2],
            lvlh[0],
            plant.mean_motion,
            plant.gradient,
            dt,
            state.body_turn,
        )
    return count
