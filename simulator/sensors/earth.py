"""A static Earth sensor as R describes it: truth to penetration angles, and the roll and pitch formed of them on board.

Quadrants
    Four, each looking at one piece of the CO₂ horizon in a fixed body direction at the azimuths 45, 135, 225, 315 deg about
    body +z (nadir) from +x toward +y. Flying +x forward, +x is east and +y, against the orbit normal, south: the quadrants
    are SE, SW, NW, NE in this order; flying −x forward NW, NE, SE, SW. R names them without saying which body axes they lie
    between, nor in which order it lists its biases.
Penetration angle
    How much farther from +z the horizon lies than nominally, η − asin(a/r₀) (`simulator.sensors.horizon`), so that it grows
    with the Earth's part of the quadrant's view. With roll ρ and pitch ϑ of the body from nadir (A = exp(−[ρ e_x + ϑ e_y]×)
    A_nadir) the nadir is at (−ϑ, ρ, 1) in the body, and the horizon of a sphere at height difference h (as an angle) at

        y_i = h + ρ sin ζ_i − ϑ cos ζ_i                                                                             (1)

    to first order. Each quadrant adds its penetration-angle bias.
Detectors
    Three look at the limb, one above the other, each of width w in penetration angle; together they cover ±1.5 w. Each shows
    the part of its view that the Earth fills, in units of the Earth's radiance, plus an offset o of thermal origin. The
    fourth, S, looks into cold space and shows o alone. On board, the angle is formed of the three signals e_j and a filtered S,

        y = w (Σ_j (e_j − S_f)) − 1.5 w,        so that an error of S_f shows as −3 w (S_f − o)                   (2)

    The offset follows the Sun's direction m in the body: o_i = o₀ + o₁ d_i·m with d_i the direction of the quadrant, a sinusoid
    of the orbit's phase. The Sun in a quadrant's view raises S.
S filter
    S_f ← S_f + g (S − S_f), g = 1 − exp(−Δt/τ). While the Sun is predicted in a quadrant's view, the quadrant is not used and
    its S not filtered. When it returns, the filter starts again at the present S (correct), goes on from where it
    was (held), or from a wrong value (restarted); "off" subtracts S itself, the remedy that R's flight took. The error of a
    wrong start, 3 w (o − S_f), decays with τ: R's figure 8. R does not publish w, τ, o, the size of the Sun's field or what
    the filter started from; the defaults are chosen. Restarted from zero they give the quadrant an error of 0.74 deg, 0.26 deg
    in both roll and pitch; a held filter hardly any, since the offset is much the same when the Sun leaves as when it came.
On board
    (1) for all four is solved by least squares for ρ, ϑ, h, which leaves y₁ − y₂ + y₃ − y₄ alone: the differences of opposite
    quadrants each give the rotation about the axis between them. Three quadrants determine ρ, ϑ, h exactly; the solution is
    that of four with y_k = y_{k−1} + y_{k+1} − y_{k+2} for the one that is missing.
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.jit_cache import compile_cached
from simulator.sensors.horizon import COSINES, POLAR_RADIUS, QUADRANTS, SINES, Horizon, is_hidden
from simulator.sensors.horizon import compute_penetration as compute_penetration
from simulator.truth.orbit import EARTH_RADIUS

Filter = Literal["off", "correct", "held", "restarted"]

OFF, CORRECT, HELD, RESTARTED = 0, 1, 2, 3
FILTER_CODES: dict[Filter, int] = {"off": OFF, "correct": CORRECT, "held": HELD, "restarted": RESTARTED}
LIMB_DETECTORS = 3
NOISE_DRAWS = 2 * QUADRANTS  # standard normal numbers a measurement takes


class Constants(NamedTuple):
    """Numbers of a `TrueEarthSensor` for the compiled functions; angles in rad, radiances in that of the Earth."""

    a: float
    c: float
    nominal: float
    bias: Array
    width: float
    offset: float
    swing: float
    sigma: float
    sigma_s: float
    step: float
    sun_radiance: float
    cos_field: float
    cos_predicted: float
    mode: int
    restart: float


@dataclass(frozen=True)
class TrueEarthSensor:
    """The sensor as built, and its processing on board.

    Raises
    ------
    ValueError
        There are not four biases, a width or time constant is not positive, or the filter is unknown.
    """

    horizon: Horizon = field(default_factory=Horizon)  # the horizon seen and the nominal altitude
    # (4,) penetration-angle biases, rad, in the order of the quadrants
    biases: Array = field(default_factory=lambda: np.zeros(QUADRANTS))
    width: float = math.radians(2.5)  # of a limb detector's view, rad
    offset: float = 0.08  # o₀, in units of the Earth's radiance
    swing: float = 0.02  # o₁
    sigma: float = math.radians(0.02)  # white noise of a quadrant's angle, 1-sigma, rad
    sigma_s: float = 0.002  # white noise of S, 1-sigma, in units of the Earth's radiance
    step: float = 0.0  # quantisation of the angles, rad; 0 for none
    sun_radiance: float = 1.0  # what the Sun in a quadrant's view adds to S, in units of the Earth's radiance
    sun_field: float = math.radians(5.0)  # half angle of the Sun's field about a quadrant's nominal limb, rad
    sun_margin: float = math.radians(0.5)  # added to it where the Sun is predicted, rad
    s_filter: Filter = "correct"  # "off", "correct", "held" or "restarted"
    s_time_constant: float = 60.0  # τ, s
    s_restart: float = 0.0  # S_f from which a restarted filter goes on, in units of the Earth's radiance

    def __post_init__(self) -> None:
        object.__setattr__(self, "biases", np.ascontiguousarray(self.biases, dtype=float))
        if self.biases.shape != (QUADRANTS,):
            raise ValueError(f"biases must be ({QUADRANTS},), not {self.biases.shape}")
        if not (self.width > 0 and self.s_time_constant > 0):
            raise ValueError("width and s_time_constant must be positive")
        if self.s_filter not in FILTER_CODES:
            raise ValueError(f"s_filter must be one of {', '.join(FILTER_CODES)}, not {self.s_filter!r}")

    @property
    def constants(self) -> Constants:
        """For the compiled functions."""
        return Constants(
            *self.horizon.semi_axes,
            self.horizon.nominal,
            self.biases,
            self.width,
            self.offset,
            self.swing,
            self.sigma,
            self.sigma_s,
            self.step,
            self.sun_radiance,
            math.cos(self.sun_field),
            math.cos(self.sun_field + self.sun_margin),
            FILTER_CODES[self.s_filter],
            self.s_restart,
        )

    def gain(self, sample_s: float) -> float:
        """Compute the gain g of the S filter for samples of a length in s."""
        return -math.expm1(-sample_s / self.s_time_constant)


@compile_cached
def compute_sun_cosine(A: Array, sun: Array, quadrant: int, nominal: float) -> float:
    """Compute the cosine between a quadrant's nominal limb direction and the Sun, sun (3,) an inertial unit vector."""
    x = A[0, 0] * sun[0] + A[0, 1] * sun[1] + A[0, 2] * sun[2]
    y = A[1, 0] * sun[0] + A[1, 1] * sun[1] + A[1, 2] * sun[2]
    z = A[2, 0] * sun[0] + A[2, 1] * sun[1] + A[2, 2] * sun[2]
    return math.sin(nominal) * (COSINES[quadrant] * x + SINES[quadrant] * y) + math.cos(nominal) * z


@compile_cached
def is_sun_intruding(A: Array, position: Array, sun: Array, quadrant: int, nominal: float, cos_field: float) -> bool:
    """Tell whether the Sun, not eclipsed by the Earth, is within a field about a quadrant's nominal limb direction.

    A (3, 3) is the true attitude, or the estimated one for a prediction; the position, m, and the Sun's unit vector are
    inertial, the limb's nominal angle from +z is in rad.
    """
    return compute_sun_cosine(A, sun, quadrant, nominal) > cos_field and not is_hidden(
        position, sun, EARTH_RADIUS, POLAR_RADIUS
    )


@compile_cached
def sum_limb_signals(angle: float, offset: float, width: float) -> float:
    """Sum of the three limb detectors' signals at a penetration angle, in units of the Earth's radiance."""
    total = 0.0
    for detector in range(LIMB_DETECTORS):
        lower = (detector - 0.5 * LIMB_DETECTORS) * width
        total += min(max((angle - lower) / width, 0.0), 1.0) + offset
    return total


@compile_cached
def filter_s(state: float, S: float, used: bool, was_used: bool, gain: float, mode: int, restart: float) -> float:
    """Filter S by one sample to S_f.

    Parameters
    ----------
    state : S_f before; NaN before the first sample that is filtered
    S : this sample
    used, was_used : whether the quadrant is used now, and was at the sample before
    gain : g
    mode : OFF, CORRECT, HELD or RESTARTED
    restart : S_f that RESTARTED goes on from
    """
    if not used:
        return state
    if mode == OFF or np.isnan(state) or (mode == CORRECT and not was_used):
        return S
    if mode == RESTARTED and not was_used:
        state = restart
    return state + gain * (S - state)


@compile_cached
def measure_quadrants(
    A: Array,
    A_onboard: Array,
    position: Array,
    sun: Array,
    noise: Array,
    gain: float,
    constants: Constants,
    state: Array,
    used: Mask,
    angles: Array,
) -> None:
    """Measure one sample of all four quadrants.

    Parameters
    ----------
    A : (3, 3) true attitude
    A_onboard : (3, 3) attitude the Sun's intrusion is predicted with
    position : (3,) inertial, m
    sun : (3,) inertial unit vector
    noise : (8,) standard normal numbers: four of the angles, four of S
    gain : g of the S filter, see `TrueEarthSensor.gain`
    constants : of the sensor
    state : (4,) S_f, NaN before the first sample; brought up to date
    used : (4,) quadrants used at the sample before, all True before the first; brought up to date
    angles : (4,) penetration angles as formed on board, rad; written. A quadrant that is not used has its S subtracted
        unfiltered.
    """
    for i in range(QUADRANTS):
        offset = constants.offset + constants.swing * compute_sun_cosine(A, sun, i, constants.nominal)
        true = compute_penetration(A, position, i, constants.a, constants.c, constants.nominal)
        S = offset + constants.sigma_s * noise[QUADRANTS + i]
        if is_sun_intruding(A, position, sun, i, constants.nominal, constants.cos_field):
            S += constants.sun_radiance
        use = not is_sun_intruding(A_onboard, position, sun, i, constants.nominal, constants.cos_predicted)
        state[i] = filter_s(state[i], S, use, used[i], gain, constants.mode, constants.restart)
        used[i] = use
        signal = sum_limb_signals(true + constants.bias[i], offset, constants.width)
        level = state[i] if use else S
        angle = constants.width * (signal - LIMB_DETECTORS * level - 0.5 * LIMB_DETECTORS) + constants.sigma * noise[i]
        angles[i] = round(angle / constants.step) * constants.step if constants.step > 0.0 else angle


@compile_cached
def compute_roll_pitch(angles: Array, used: Mask) -> tuple[float, float]:
    """Compute roll ρ and pitch ϑ of the body from the horizon's bisector, rad, of angles (4,) and flags (4,).

    NaN with fewer than three quadrants.
    """
    lost = -1
    for i in range(QUADRANTS):
        if not used[i]:
            if lost >= 0:
                return np.nan, np.nan
            lost = i
    roll, pitch = 0.0, 0.0
    for i in range(QUADRANTS):
        angle = angles[i] if i != lost else angles[i - 1] + angles[(i + 1) % QUADRANTS] - angles[i - 2]
        roll += 0.5 * SINES[i] * angle
        pitch -= 0.5 * COSINES[i] * angle
    return roll, pitch


def observe(
    rng: np.random.Generator, sensor: TrueEarthSensor, t: Array, A: Array, position: Array, sun: Array
) -> tuple[Array, Mask]:
    """Simulate penetration angles of a series; the Sun's intrusion is predicted with the true attitude.

    Parameters
    ----------
    rng : source of randomness
    sensor : the sensor
    t : (n,) s, ascending
    A : (n, 3, 3) true attitudes
    position : (n, 3) inertial, m
    sun : (n, 3) inertial unit vectors

    Returns
    -------
    angles : (n, 4) rad
    used : (n, 4)
    """
    angles, used = np.empty((len(t), QUADRANTS)), np.empty((len(t), QUADRANTS), dtype=np.bool_)
    gains = -np.expm1(-np.diff(t, prepend=t[:1]) / sensor.s_time_constant)
    A, position, sun = (np.ascontiguousarray(x, dtype=float) for x in (A, position, sun))
    _observe(rng, sensor.constants, gains, A, position, sun, angles, used)
    return angles, used


@compile_cached
def _observe(
    rng: np.random.Generator,
    constants: Constants,
    gains: Array,
    A: Array,
    position: Array,
    sun: Array,
    angles: Array,
    used: Mask,
) -> None:
    state, flags, noise = np.full(QUADRANTS, np.nan), np.ones(QUADRANTS, dtype=np.bool_), np.empty(NOISE_DRAWS)
    for k in range(len(gains)):
        for j in range(NOISE_DRAWS):
            noise[j] = rng.standard_normal()
        measure_quadrants(A[k], A[k], position[k], sun[k], noise, gains[k], constants, state, flags, angles[k])
        used[k] = flags
