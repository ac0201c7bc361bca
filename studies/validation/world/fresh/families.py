"""Effects outside the library: faults of gyros, telemetry, mounts and references that docs/effects.md does not list."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import iirpeak, lfilter

from simulator.effects.base import Array
from simulator.effects.common import gauss_markov
from simulator.truth.rotation import separation
from studies.validation.world.families.base import families, random_rate, random_reference, rate, reference, samples, timing
from studies.validation.world.families.look import Look, View, changed, delayed

TINY = 1e-30  # keeps a division by the largest value finite where all values are zero
ORBIT_DARK = 0.25  # least share of an orbit in the Earth's shadow; about 0.4 is the most in a low orbit


def _scale_to_one(values: Array) -> Array:
    """Values over their largest amount."""
    return np.asarray(values / max(float(np.abs(values).max()), TINY))


def _find_starts(view: View) -> NDArray[np.bool_]:
    """(m,) bool, whether a reference is the first of its interval."""
    return np.asarray(np.append(True, np.diff(view.references.interval) != 0))


@rate("deg/h", "turns")
def lever_arm_acceleration(look: Look) -> Array:
    """Bias follows the acceleration that the rotation makes at the place of the gyro. The gyro sits away from the centre of
    rotation, and its g-sensitivity turns ω' × r + ω × (ω × r) into a rate (IEEE Std 1431, linear acceleration sensitivity)."""
    arm = look.direction()
    pull = np.cross(look.acceleration, arm) + np.cross(look.w, np.cross(look.w, arm))
    return _scale_to_one(pull[:, look.other])


@rate("ppm", "turns")
def scale_hysteresis(look: Look) -> Array:
    """Scale factor is larger while the rate grows than while it falls. The magnet of the torquer or the piezoelectric drive
    follows its load along a hysteresis loop (IEEE Std 813, scale factor hysteresis)."""
    amount = np.abs(look.own)
    growth = amount - look.smooth(amount, look.between(0.002, 0.02))
    return look.own * np.tanh(growth / max(0.02 * look.fastest, TINY))


@rate("ppm", "turns")
def even_nonlinearity(look: Look) -> Array:
    """Reading errs with the square of its own rate, whichever its sign. A demodulator whose halves differ rectifies a part of
    the signal (IEEE Std 952, even-order scale factor nonlinearity)."""
    return look.own**2 / max(look.fastest, TINY)


@rate("deg/h", "temperature")
def activity_dip(look: Look) -> Array:
    """Bias deviates within a narrow band of temperature only. A parasitic mode crosses the drive frequency there and takes
    energy from it (activity dips; Vig, Quartz Crystal Resonators and Oscillators; IEEE Std 1431)."""
    low, span = float(look.temperature.min()), max(float(np.ptp(look.temperature)), TINY)
    away = (look.temperature - low - (0.1 + 0.8 * look.share) * span) / (span * look.scaled(0.02, 0.12))
    return 1 / (1 + away**2)


@rate("deg/h", "orbit")
def eclipse_charging(look: Look) -> Array:
    """Bias is at one level in the Earth's shadow, jumps at sunrise and decays until sunset. The current that recharges the
    battery makes a magnetic field, and it tapers (Wertz, Spacecraft Attitude Determination and Control, residual dipole)."""
    place = np.mod(look.t / look.stream.orbit_period_s + look.phase / (2 * np.pi), 1.0)
    dark = ORBIT_DARK + 0.15 * look.share
    return np.where(place < dark, -0.5, np.exp(-look.scaled(1.0, 8.0) * (place - dark)))


@rate("deg/h", "turns")
def valve_current(look: Look) -> Array:
    """Bias is positive or negative while a thruster accelerates the body one way or the other, and zero between. The solenoids
    of its valves make a magnetic field beside the gyro (IEEE Std 952, magnetic sensitivity)."""
    torque = look.acceleration[:, look.other]
    enough = np.quantile(np.abs(torque), 0.6 + 0.35 * look.share)
    return np.where(np.abs(torque) > enough, np.sign(torque), 0.0)


@rate("deg/h", "turns")
def wake_transient(look: Look) -> Array:
    """Bias jumps at the beginning of each motion and relaxes. The gyro saves power while the body rests, and its loops settle
    anew after waking (application notes of low-power MEMS gyros, wake-up time)."""
    moving, tau = np.linalg.norm(look.w, axis=1), look.between(0.01, 0.1)
    wake = np.quantile(moving, 0.35 + 0.5 * look.share)
    out = np.zeros(len(look.t))
    for p in look.stream.intervals:
        begin: float | None = None
        for row in range(p.start, p.stop):
            if moving[row] < 0.6 * wake:
                begin = None
            elif begin is None and moving[row] > wake:
                begin = float(look.t[row])
            out[row] = 0.0 if begin is None else np.exp((begin - look.t[row]) / tau)
    return out


@rate("ppm", "turns", "temperature")
def axis_tilt_temperature(look: Look) -> Array:
    """Input axis tilts in proportion to the temperature. Glue and bracket expand unequally at both sides of the gyro (IEEE Std
    952, input axis misalignment thermal sensitivity)."""
    return look.w[:, look.other] * look.temperature


@rate("ppm", "turns")
def sunlit_bracket(look: Look) -> Array:
    """Input axis tilts with the sunlight on one side of the mount. The bracket warms there within its thermal time constant and
    bends (Wertz, Spacecraft Attitude Determination and Control, alignment)."""
    lit = np.maximum(look.attitude[:, look.k] @ look.direction(), 0.0)
    return look.w[:, look.other] * look.smooth(lit, look.between(0.005, 0.05))


@rate("ppm", "turns")
def gravity_scale(look: Look) -> Array:
    """Scale factor follows the component of gravity along the input axis. Weight shifts the rotor in the field of its torquer
    (IEEE Std 813, acceleration-sensitive scale factor)."""
    return look.own * (look.attitude[:, look.k] @ look.direction())


@rate("ppm", "turns")
def fluid_swirl(look: Look) -> Array:
    """Reading takes up a part of the recent rate about another axis. Fluid around the float keeps swirling after the case has
    stopped, and drags it along (IEEE Std 517, flotation fluid)."""
    tau = look.between(0.01, 0.1)
    return look.smooth(look.smooth(look.w[:, look.other], tau), 0.3 * tau)


@rate("deg/h")
def battery_knee(look: Look) -> Array:
    """Bias is steady and runs away toward the end of each interval. The battery's voltage falls steeply at the end of its
    charge, and the bias follows the supply (IEEE Std 1431, supply voltage sensitivity; Linden, Handbook of Batteries)."""
    used = look.each(lambda p: look.since_start[p] / max(float(look.since_start[p.stop - 1]), look.sample_s))
    return np.exp(look.scaled(4.0, 25.0) * (used - 1))


@random_rate("ppm", "turns")
def loose_bracket(look: Look) -> Array:
    """All input axes tilt together by a small angle that wanders at random. A screw of the bracket is loose (Wertz, Spacecraft
    Attitude Determination and Control, alignment)."""
    tau = look.between(0.02, 0.3)
    tilt = np.stack([gauss_markov(look.rng, look.t, tau) for _ in range(3)], axis=1)
    return np.cross(look.w, tilt)


@random_rate("deg/h")
def settling_wander(look: Look) -> Array:
    """Bias wanders widely after each switching on and calms down. Condensate and stress in the sensor redistribute until they
    are in equilibrium (IEEE Std 1431, bias stabilisation after turn-on)."""
    calm = np.exp(-look.since_start / (look.length * (0.08 + 0.4 * look.share)))
    return calm * gauss_markov(look.rng, look.t, look.between(0.01, 0.08))


@random_rate("deg/h")
def room_cycling(look: Look) -> Array:
    """Bias goes up and down with a period that is not steady. The air conditioning of the room or the cabin switches as people
    and weather load it (IEEE Std 952, thermal environment of tests)."""
    period, step = look.between(0.06, 0.5), np.diff(look.t, prepend=look.t[0])
    coherent = period * (1.5 + 5 * look.share)
    lost = np.cumsum(np.sqrt(2 * step / coherent) * look.rng.standard_normal(len(look.t)))
    angle = 2 * np.pi * look.t / period + look.phase + lost
    return np.sin(angle) + 0.3 * np.sin(2 * angle + 1.0)


@timing("clock", "s", "turns")
def clock_step(look: Look, raw: Array, size: float) -> Array:
    """The tags are late from one moment on. The ground sets the clock on board by a command, and a leap second or a wrong time
    comes with it (CCSDS 301.0, time code formats)."""
    rows = np.arange(len(raw))
    return delayed(look, raw, size * (rows >= (0.1 + 0.8 * look.share) * len(raw)).astype(float))


@timing("filter", "share", "turns", sign="positive")
def structural_notch(look: Look, raw: Array, size: float) -> Array:
    """A narrow band of the motion is missing in the output. A notch filter keeps a mode of the structure out of the control
    loop, and it is set too low (Wie, Space Vehicle Dynamics and Control, notch filters)."""
    numerator, denominator = iirpeak(min(2 * look.sample_s / look.between(0.01, 0.1), 0.8), 1.0 + 2 * look.share)
    band = look.each(lambda p: lfilter(numerator, denominator, raw[p, look.k] - raw[p.start, look.k]))
    return changed(raw, look.k, raw[:, look.k] - size * band)


@samples("range", "share", "turns", sign="positive")
def shared_range(look: Look, values: Array, size: float) -> Array:
    """All axes read low while the length of the rate vector is beyond a limit. The axes share one supply of torque current, and
    its limit scales them together (IEEE Std 813, torquer power)."""
    norm = np.linalg.norm(values, axis=1)
    limit = (1 - size) * max(float(np.linalg.norm(look.stream.raw, axis=1).max()), TINY)
    return np.asarray(values * np.minimum(1.0, limit / np.maximum(norm, TINY))[:, None])


@samples("telemetry", "share", sign="positive")
def linear_resampling(look: Look, values: Array, size: float) -> Array:
    """Each sample leans to the one before by a share that rises and falls back regularly. The ground interpolates between the
    samples to a grid of a slightly different rate, and their noise beats (Crochiere and Rabiner, 1983)."""
    before = look.each(lambda p: np.vstack([values[p.start : p.start + 1], values[p][:-1]]))
    share = size * np.mod(look.cycle(0.02, 0.3) / (2 * np.pi), 1.0)[:, None]
    return (1 - share) * values + share * before


@samples("pickup", "deg/s", sign="positive")
def array_drive(look: Look, values: Array, size: float) -> Array:
    """Short ringing comes at regular times. Each step of the motor that turns the solar array shakes the panel of the gyro at
    its resonance (Wie, Space Vehicle Dynamics and Control, solar array drive disturbances)."""
    period = max(look.between(0.004, 0.05), 25 * look.sample_s)
    since = np.mod(look.t + look.share * period, period) / look.sample_s
    ring = np.exp(-since / (3 + 9 * look.share)) * np.sin(2 * np.pi * look.scaled(0.06, 0.3) * since)
    return changed(values, look.k, values[:, look.k] + size * ring)


@reference("share", "turns", "dense", sign="positive")
def fusion_lag(view: View) -> Array:
    """References trail behind the motion and catch up slowly. The filter that fuses the sensors of the references trusts its
    prediction too much (Farrell, Aided Navigation, complementary filters)."""
    step, tau = np.diff(view.t, append=view.t[-1]), view.between(0.005, 0.06)
    turn = np.einsum("nji,nj->ni", view.body, view.rates * step[:, None])  # inertial axes, to the next reference
    out, lag = np.zeros((len(view.t), 3)), np.zeros(3)
    for row, first in enumerate(_find_starts(view)):
        lag = np.zeros(3) if first else lag
        out[row] = view.body[row] @ lag
        lag = np.exp(-step[row] / tau) * (lag + turn[row])
    return out


@reference("share", "turns", sign="positive")
def frozen_pose(view: View) -> Array:
    """References stand still in part for spells, all axes at once. The camera or the tracker loses sight of its markers or
    stars and repeats its last solution (motion capture practice, occlusion)."""
    frozen = view.episodes(0.08 + 0.25 * view.share, view.between(0.02, 0.15)) > 0
    frozen[int(view.share * (len(frozen) - 1))] = True
    held = np.maximum.accumulate(np.where(frozen & ~_find_starts(view), 0, np.arange(len(frozen))))
    return separation(view.references.quaternions, view.references.quaternions[held])


@reference("deg")
def frame_jump(view: View) -> Array:
    """References turn once by a fixed angle in space within an interval and stay there. The room's cameras are calibrated anew,
    or are knocked, while the recording runs (motion capture practice)."""
    later = np.append(np.flatnonzero(~_find_starts(view)), len(view.t))
    moment = later[int((0.05 + 0.9 * view.share) * (len(later) - 1))]
    return (view.body @ view.direction()) * (np.arange(len(view.t)) >= moment)[:, None]


@reference("deg", "turns")
def lens_distortion(view: View) -> Array:
    """Error grows with the cube of a beacon's distance from the camera's axis. The radial distortion of the lens is not
    corrected (Brown, Close-Range Camera Calibration, Photogrammetric Engineering 37, 1971)."""
    seen, axis = view.body @ view.direction(), np.eye(3)[view.k]
    return (1 - seen[:, view.k] ** 2)[:, None] * np.cross(seen, axis)


@reference("deg", "turns")
def remounted_markers(view: View) -> Array:
    """The frame of the references is turned against the body by another angle in each interval. The markers, or the camera,
    were taken off and put on again between the runs (Della Croce, Gait and Posture 21, 2005, landmark misplacement)."""
    _, number = np.unique(view.references.interval, return_inverse=True)
    return view.rng.standard_normal((int(number.max()) + 1, 3))[number]


@random_reference("deg", "turns")
def odometry_drift(view: View) -> Array:
    """Heading error walks at random as the body turns and is put right at regular amounts of turning. Visual odometry drifts
    about the vertical until it sees a known place (Scaramuzza and Fraundorfer, IEEE Robotics and Automation Magazine 18,
    2011)."""
    gone = np.diff(view.t, prepend=view.t[0]) * np.linalg.norm(np.vstack([view.rates[:1], view.rates[:-1]]), axis=1)
    gone[_find_starts(view)] = 0.0
    total = np.cumsum(gone)
    laps = np.floor(total / max(float(total[-1]) / view.scaled(3.0, 25.0), TINY))
    walk = np.cumsum(np.sqrt(gone / max(float(gone.mean()), TINY)) * view.rng.standard_normal(len(gone)))
    closed = _find_starts(view) | (np.diff(laps, prepend=0.0) > 0)
    since = walk - walk[np.maximum.accumulate(np.where(closed, np.arange(len(walk)), 0))]
    return (view.body @ view.direction()) * since[:, None]


EFFECTS = families(globals())
