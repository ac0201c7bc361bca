"""Motion of the spacecraft in one calibration interval, as an analytic body rate.

Every attitude here is that of the frame the orbit's nadir makes, A_li(t), by default LVLH (see `simulator.truth.nadir`),
followed by single-axis turns, A = R(e_m, α_m) … R(e_1, α_1) A_li, and a turn changes a rate to

    ω ← R(e, α) ω + α' e

The first turn is the mode's constant yaw, then come the interval's slews in their order (e is the same in the frames before
and after a turn, so it is a body axis), then the small sway of the attitude control about x, y and z. As long as there is
no inertial hold the attitude therefore has a closed form.

A **slew** by θ in time T has ramps of f T at both ends, during which the rate rises and falls as the smoothstep 3s² − 2s³.
Rate and angular acceleration are continuous, and the peak rate is θ / (T (1 − f)).

An **inertial hold** fades the tracking rate ω_T out and in again by s(t), a smoothstep over each transition:

    ω = s(t) ω_T(t) + p_in(t) δ + p_out(t) r

with p a pulse 30 x²(1 − x)² / T of unit area over a transition. δ is a chosen offset put in while entering. Where the fade
ends depends on how far the orbit went on meanwhile; the constant vector r is solved for so that at the end of the hold the
attitude is that of the mode again. Of the rotations that do it, which differ by full turns, the short one is meant.

Times here are local, τ = t − start of the interval: a small number keeps its digits weeks after the epoch.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import root

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from simulator.truth.integration import NODES, Trajectory, accumulate, compute_magnus_exponent, integrate
from simulator.truth.nadir import compute_pointing_attitude, compute_pointing_rate
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import build_turn_matrix, convert_to_quaternion, separation, turn_frame

AXIS_VECTORS = np.eye(3)
MODE_YAW = {"+x": 0.0, "-x": np.pi, "+y": -np.pi / 2, "-y": np.pi / 2}
"""Yaw from LVLH, rad, of the mode with this body axis along the velocity."""

TRANSITION_STEPS = 600  # sixth-order steps across a transition; the error is rounding
RETURN_TOLERANCE = 1e-12  # rad


def smoothstep(x: Array) -> Array:
    """Compute 3x² − 2x³ on [0, 1], 0 before and 1 after."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3 - 2 * x)


def smoothstep_integral(x: Array) -> Array:
    """Compute ∫₀ˣ of the smoothstep, x³ − x⁴/2, for x in [0, 1]; constant outside."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (1 - x / 2)


def pulse(x: Array) -> Array:
    """Compute 30 x²(1 − x)² on [0, 1], 0 outside: unit area, zero value and slope at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return 30 * x**2 * (1 - x) ** 2


@dataclass(frozen=True)
class Slew:
    """A turn about a fixed axis."""

    axis: Array  # (3,) unit vector, body axes
    angle: float  # rad
    start: float  # s, local time
    duration: float
    ramp_fraction: float = 0.5  # share of the duration that each ramp takes, in (0, 0.5]

    @property
    def stop(self) -> float:
        """End of the slew, s."""
        return self.start + self.duration

    @property
    def knots(self) -> tuple[float, ...]:
        """Local times where a derivative of the rate jumps, s."""
        ramp = self.ramp_fraction * self.duration
        return self.start, self.start + ramp, self.stop - ramp, self.stop

    def angles(self, tau: Array) -> Array:
        """Compute the angle turned so far α(τ), rad; (n,) s → (n,)."""
        f = self.ramp_fraction
        s = (tau - self.start) / self.duration
        falling = np.clip((s - 1 + f) / f, 0.0, 1.0)
        turned_share = (
            f * smoothstep_integral(s / f) + np.clip(s - f, 0.0, 1 - 2 * f) + f * (falling - smoothstep_integral(falling))
        )
        return np.asarray(self.angle / (1 - f) * turned_share)

    def rates(self, tau: Array) -> Array:
        """Compute α'(τ), rad/s; (n,) s → (n,)."""
        f = self.ramp_fraction
        s = (tau - self.start) / self.duration
        peak = self.angle / (self.duration * (1 - f))
        return np.asarray(peak * (smoothstep(s / f) - smoothstep((s - 1 + f) / f)))


@dataclass(frozen=True)
class Sway:
    """Small sinusoidal attitude motion left by the attitude control, about x, then y, then z.

    Its phase runs with mission time, so that it goes on through intervals that touch.
    """

    amplitude: Array  # (3,) rad
    period: Array  # (3,) s
    phase: Array  # (3,) rad at the epoch

    def angles(self, start_s: float, tau: Array) -> Array:
        """Compute α per axis at the local times τ of an interval, rad; (n,) s → (n, 3)."""
        return np.asarray(self.amplitude * np.sin(self._compute_phase(start_s, tau)))

    def rates(self, start_s: float, tau: Array) -> Array:
        """Compute α' per axis at the local times τ of an interval, rad/s; (n,) s → (n, 3)."""
        return np.asarray(self.amplitude * (2 * np.pi / self.period) * np.cos(self._compute_phase(start_s, tau)))

    def _compute_phase(self, start_s: float, tau: Array) -> Array:
        # start + τ, weeks after the epoch, would be rounded to 5e-10 s and roughen the rate.
        return np.asarray(2 * np.pi / self.period * (np.mod(start_s, self.period) + tau[:, None]) + self.phase)


@dataclass(frozen=True)
class Hold:
    """An inertial hold; the body rate is zero between the transitions."""

    start: float  # s, local time, transitions included
    stop: float
    transition: float  # duration of each transition, s
    offset: Array  # (3,) δ, rad in body axes, put in during the first transition

    @property
    def knots(self) -> tuple[float, ...]:
        """Local times where a derivative of the rate jumps, s."""
        return self.start, self.start + self.transition, self.stop - self.transition, self.stop

    def fade(self, tau: Array, omega: Array) -> Array:
        """Compute s(τ) ω_T + p_in(τ) δ, rad/s, s being 1 outside the hold and 0 inside; (n,), (n, 3) → (n, 3)."""
        entering = (tau - self.start) / self.transition
        tracking_share = 1 - smoothstep(entering) + smoothstep((tau - self.stop + self.transition) / self.transition)
        return tracking_share[:, None] * omega + (pulse(entering) / self.transition)[:, None] * self.offset

    def compute_return_pulse(self, tau: Array) -> Array:
        """Compute p_out(τ), 1/s; (n,) → (n,)."""
        return pulse((tau - self.stop + self.transition) / self.transition) / self.transition


@dataclass(frozen=True)
class Profile:
    """Motion of one interval."""

    orbit: CircularOrbit  # the orbit whose LVLH frame is tracked
    start_s: float  # of the interval, s since the epoch
    stop_s: float
    yaw: float  # of the mode that the interval starts in, rad from LVLH
    slews: tuple[Slew, ...] = ()  # in time order, not overlapping
    hold: Hold | None = None  # inertial hold, not overlapping a slew
    sway: Sway | None = None  # attitude motion on top of all that

    @property
    def moving_spans(self) -> tuple[tuple[float, float], ...]:
        """Local start and stop of the parts without constant rate, slews and transitions, s."""
        spans = [(slew.start, slew.stop) for slew in self.slews]
        if self.hold:
            start, hold_start, hold_stop, stop = self.hold.knots
            spans += [(start, hold_start), (hold_stop, stop)]
        return tuple(spans)

    @property
    def knots(self) -> Array:
        """Local times where a derivative of the rate jumps, s; (k,) sorted."""
        parts = [slew.knots for slew in self.slews] + ([self.hold.knots] if self.hold else [])
        return np.unique(np.concatenate(parts)) if parts else np.empty(0)

    def compute_tracking_rate(self, tau: Array) -> Array:
        """Compute the body rate of mode and slews alone, without hold and sway, rad/s; (n,) s → (n, 3)."""
        omega = turn_frame(AXIS_VECTORS[2], np.full(tau.shape, self.yaw), compute_pointing_rate(self.orbit, self.start_s + tau))
        for slew in self.slews:
            omega = turn_frame(slew.axis, slew.angles(tau), omega) + slew.rates(tau)[:, None] * slew.axis
        return omega

    def compute_tracking_attitude(self, tau: Array) -> Array:
        """Compute the attitude of mode and slews alone in closed form, inertial to body; (n,) s → (n, 3, 3)."""
        A = build_turn_matrix(AXIS_VECTORS[2], np.full(tau.shape, self.yaw)) @ compute_pointing_attitude(
            self.orbit, self.start_s + tau
        )
        for slew in self.slews:
            A = build_turn_matrix(slew.axis, slew.angles(tau)) @ A
        return A

    def rate(self, tau: Array) -> Array:
        """Compute the body rate, rad/s; (n,) local time, s → (n, 3)."""
        omega = self.compute_tracking_rate(tau)
        if self.hold:
            omega = self.hold.fade(tau, omega) + self.hold.compute_return_pulse(tau)[:, None] * self.return_rotation
        if self.sway:
            angles, rates = self.sway.angles(self.start_s, tau), self.sway.rates(self.start_s, tau)
            for axis in range(3):
                omega = turn_frame(AXIS_VECTORS[axis], angles[:, axis], omega) + rates[:, axis, None] * AXIS_VECTORS[axis]
        return omega

    def attitude(self, tau: Array) -> Array:
        """Compute the attitude in closed form, inertial to body, valid outside of a hold; (n,) s → (n, 3, 3)."""
        A = self.compute_tracking_attitude(tau)
        if self.sway:
            angles = self.sway.angles(self.start_s, tau)
            for axis in range(3):
                A = build_turn_matrix(AXIS_VECTORS[axis], angles[:, axis]) @ A
        return A

    @cached_property
    def return_rotation(self) -> Array:
        """The vector r that brings the attitude back to the mode at the end of the hold, rad; (3,).

        The first guess is the whole rotation that is missing at the end when r = 0, as a rotation vector and hence the short
        way; the solver then only corrects for its mixing with the tracking rate.
        """
        hold = self.hold
        if hold is None:
            return np.zeros(3)
        start, hold_start, hold_stop, stop = hold.knots
        start_attitude, stop_attitude = (
            convert_to_quaternion(self.compute_tracking_attitude(np.array([time])))[0] for time in (start, stop)
        )
        entry_grid = np.linspace(start, hold_start, TRANSITION_STEPS + 1)
        entry = integrate(lambda tau: hold.fade(tau, self.compute_tracking_rate(tau)), entry_grid, start_attitude)
        grid = np.linspace(hold_stop, stop, TRANSITION_STEPS + 1)
        step = np.diff(grid)
        times = (grid[:-1, None] + step[:, None] * NODES).ravel()
        fading = hold.fade(times, self.compute_tracking_rate(times))
        pulses = hold.compute_return_pulse(times)[:, None]

        def compute_miss(r: Array) -> Array:
            sigma, _ = compute_magnus_exponent((fading + pulses * r).reshape(-1, 3, 3), step)
            return separation(accumulate(entry.quaternions[-1], sigma)[-1], stop_attitude)

        # A rotation r in body axes takes A to exp(−[r×]) A, hence the sign.
        solution = root(compute_miss, -compute_miss(np.zeros(3)), options={"xtol": 1e-15})
        if np.linalg.norm(compute_miss(solution.x)) > RETURN_TOLERANCE:
            raise InputError("inertial hold: no smooth way back to the mode was found; lengthen transition_s")
        return np.asarray(solution.x)


def integrate_trajectory(profile: Profile, tau: Array, substeps: int = 1) -> Trajectory:
    """Integrate the true attitude at local times (n + 1,) from 0, strictly increasing, with all knots that they span."""
    return integrate(profile.rate, tau, convert_to_quaternion(profile.attitude(tau[:1]))[0], substeps)
