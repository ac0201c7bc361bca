"""Thirty unlisted effects of gyros, references, telemetry and mounting that no other file of families holds."""

import numpy as np
from scipy.signal import lfilter

from simulator.effects.base import Array
from simulator.effects.common import gauss_markov, recursion
from studies.validation.world.families.base import families, random_rate, random_reference, rate, reference, samples, timing
from studies.validation.world.families.look import Look, View, changed, delayed

TINY = 1e-30  # keeps a ratio of zeros finite
BRYAN = (0.28, 0.9)  # share of the body's angle by which a vibration pattern lags behind, from a shell to a disc


def _scaled_to_one(values: Array) -> Array:
    """Values over their largest magnitude; zeros stay zeros."""
    return np.asarray(values / max(float(np.abs(values).max(initial=0.0)), TINY))


def _rates(view: View) -> Array:
    """(m, 3) body rates at the references, rad/s; zero for a single reference."""
    return view.rates if len(view.t) > 1 else np.zeros((len(view.t), 3))


def _starts(view: View) -> Array:
    """(m,) bool, the first reference of each interval."""
    return np.append(True, np.diff(view.references.interval) != 0)


@rate("deg/h", "turns")
def off_centre_load(look: Look) -> Array:
    """Bias follows the acceleration that rotation causes at the gyro's place. The gyro sits off the centre of rotation and its
    proof mass responds to specific force, so ω × (ω × r) + ω' × r appears as a rate (IEEE Std 1431, acceleration
    sensitivity)."""
    arm = look.direction()
    load = np.cross(look.w, np.cross(look.w, arm)) + np.cross(look.acceleration, arm)
    return _scaled_to_one(load[:, look.other])


@rate("ppm", "turns")
def angular_gain_ripple(look: Look) -> Array:
    """Scale factor varies with four waves per turn of the vibration pattern. The angular gain of a whole-angle resonator
    depends on the pattern's place because thickness and electrode gaps vary around the rim (Rozelle, The Hemispherical
    Resonator Gyro, 2009)."""
    gain = BRYAN[0] + (BRYAN[1] - BRYAN[0]) * look.share
    return look.own * np.cos(4 * gain * look.turned[:, look.k] + look.phase)


@rate("deg/h", "turns")
def vibration_rectification(look: Look) -> Array:
    """Bias follows the mean square of the angular acceleration. Nonlinear suspension and loop electronics rectify rough motion
    into a constant (IEEE Std 1431, vibration rectification)."""
    return _scaled_to_one(look.smooth((look.acceleration**2).sum(axis=1), look.between(0.01, 0.1)))


@rate("deg/h")
def helium_exposure(look: Look) -> Array:
    """Bias rises once and returns slowly. A light gas enters the evacuated package, raises the damping and leaves again
    (phones whose resonators stopped beside a helium leak, 2018)."""
    since = np.maximum(look.elapsed - 0.6 * look.share, 0.0)
    fall = look.scaled(0.1, 1.0)
    return np.exp(-since / fall) - np.exp(-since / (0.15 * fall))


@rate("deg/h", "turns")
def modulation_ripple(look: Look) -> Array:
    """Error is periodic in the rate itself. A wrong modulation depth adds an error that repeats with the feedback phase
    between two resets of the ramp (Lefèvre, The Fiber-Optic Gyroscope, digital phase ramp)."""
    period = max(look.fastest, TINY) * look.scaled(0.05, 0.5)
    return np.sin(2 * np.pi * look.own / period + look.phase)


@rate("ppm", "temperature", "turns")
def gradient_misalignment(look: Look) -> Array:
    """Input axis tilts while the temperature changes. The bracket bends by the difference between its quick and its slow end,
    so another axis's rate couples in (Wertz, Space Mission Analysis and Design, thermal distortion)."""
    slow = look.smooth(look.temperature, look.between(0.05, 0.5))
    return look.w[:, look.other] * _scaled_to_one(look.temperature - slow)


@rate("ppm", "turns")
def gravity_sag(look: Look) -> Array:
    """Mounting sags under its own weight, in a direction that depends on the attitude. A soft bracket tilts by arm × gravity,
    and the gyro's axes are misaligned by this small angle (Titterton and Weston, Strapdown Inertial Navigation Technology)."""
    weight = look.attitude @ look.direction()
    return np.cross(look.w, np.cross(np.eye(3)[look.k], weight))


@rate("deg/s")
def reaction_wheel_whine(look: Look) -> Array:
    """Tone changes its frequency as the body turns. A reaction wheel's imbalance shakes the gyro's bracket, and the wheel's
    speed and force follow the momentum that the body takes (Bialke, reaction wheel disturbances, AAS 97-038)."""
    hz, slope = (0.03 + 0.4 * look.share) / look.sample_s, 0.3 * look.scaled(0.1, 1.0)
    speed = 1 + slope * look.own / max(look.fastest, TINY)
    cycles = hz * (look.t + slope * look.turned[:, look.k] / max(look.fastest, TINY))
    return speed**2 * np.sin(2 * np.pi * cycles + look.phase)


@rate("ppm", "turns")
def common_power_division(look: Look) -> Array:
    """Scale factor grows with the square of another axis's rate. Axes of an open-loop fibre gyro share one source, and all are
    divided by a total power that falls as 1 − cos φ when one of them turns (Lefèvre, The Fiber-Optic Gyroscope)."""
    return look.own * (look.w[:, look.other] / max(look.fastest, TINY)) ** 2


@rate("deg/h", "turns")
def torquer_remanence(look: Look) -> Array:
    """Bias keeps the sign of the last strong turn. A large torquer current magnetises the iron of a spinning-mass gyro, and
    the remanent field holds a torque until a strong turn the other way (IEEE Std 517, torquer hysteresis)."""
    strong = np.abs(look.own) > (0.3 + 0.5 * look.share) * np.abs(look.own).max()
    last = np.maximum.accumulate(np.where(strong, np.arange(len(strong)), -1))
    return np.where(last < 0, 0.0, np.sign(look.own[last]))


@rate("ppm", "turns")
def panel_bending(look: Look) -> Array:
    """Misalignment varies as a sine of time. A solar array or an antenna rotates on its drive and bends the panel that carries
    the gyro (Wertz, Space Mission Analysis and Design, structural distortion)."""
    return np.cross(look.w, np.sin(look.cycle(0.3, 3.0))[:, None] * look.direction())


@rate("deg/s")
def loudspeaker_bursts(look: Look) -> Array:
    """Tone appears in bursts. Sound near the drive resonance shakes a micromechanical gyro, and its alias shows while a
    speaker plays (Son et al., Rocking Drones with Intentional Sound Noise, USENIX Security 2015)."""
    playing = np.sin(look.cycle(0.1, 0.6)) > 0.6 * look.share
    tone = np.sin(2 * np.pi * (0.03 + 0.42 * look.pace) * look.t / look.sample_s + 3 * look.phase)
    return np.where(playing, tone, 0.0)


@random_rate("deg/h")
def stress_releases(look: Look) -> Array:
    """Bias jumps at random times by heavy-tailed amounts. Solder, glue and fused joints release their stress in small cracks
    (Titterton and Weston, Strapdown Inertial Navigation Technology)."""
    step = np.diff(look.t, prepend=look.t[0])
    released = look.rng.random(len(step)) < -np.expm1(-step / look.between(0.15, 1.5))
    return np.cumsum(np.where(released, np.clip(look.rng.standard_t(1.5, len(step)), -10, 10), 0.0))


@random_rate("deg/h")
def wandering_drift(look: Look) -> Array:
    """Slope of the bias is a random walk. Mirrors and fillings age at a pace that itself changes, so the bias is an integrated
    random walk (Farrenkopf, J. Guidance and Control 1, 1978, extended by a drift rate)."""
    step = np.diff(look.elapsed, prepend=look.elapsed[0])
    slope = np.cumsum(np.sqrt(step) * look.rng.standard_normal(len(step)))
    return np.cumsum(slope * step)


@random_rate("ppm", "turns")
def foam_mount(look: Look) -> Array:
    """Misalignment wanders at random and returns. Foam, a strap or a silicone pad carries the gyro and lets it tilt by small
    angles (Titterton and Weston, Strapdown Inertial Navigation Technology, anti-vibration mounts)."""
    settle = look.between(0.02, 0.5)
    tilt = np.stack([gauss_markov(look.rng, look.t, settle) for _ in range(3)], axis=1)
    return np.cross(look.w, tilt)


@random_rate("deg/s")
def bracket_resonance(look: Look) -> Array:
    """Random narrow-band rate whose angle stays bounded. Wind or pumps drive a lightly damped bracket that the references do
    not ride on (Meirovitch, Fundamentals of Vibrations, random response of an oscillator)."""
    angle, damping = look.scaled(0.03, 0.8), 0.02 + 0.2 * look.share
    pole = np.exp(-damping * angle)
    driven = lfilter([1.0, -1.0], [1.0, -2 * pole * np.cos(angle), pole**2], look.rng.standard_normal(len(look.t)))
    return np.asarray(driven / max(float(np.sqrt(np.mean(driven**2))), TINY))


@timing("filter", "share", "turns", sign="positive")
def stabiliser_highpass(look: Look, raw: Array, size: float) -> Array:
    """Slow rates are taken out in part. Gyros for image stabilisation subtract a slow mean of the rate, as they serve only to
    cancel shake (Sachs et al., image stabilisation technology overview, InvenSense)."""
    settle = look.between(0.05, 0.5)
    return np.stack([raw[:, axis] - size * look.smooth(raw[:, axis], settle) for axis in range(3)], axis=1)


@timing("filter", "s", "turns", sign="positive")
def speed_adaptive_lag(look: Look, raw: Array, size: float) -> Array:
    """Lag is long in slow motion and short in fast motion. A filter opens its bandwidth with the speed to hide tremor (Casiez
    et al., 1€ Filter, CHI 2012)."""
    knee = look.scaled(0.03, 0.5) * max(look.fastest, TINY)
    decay = size / (size + look.sample_s * (1 + np.linalg.norm(raw, axis=1) / knee))
    decay[[part.start for part in look.stream.intervals]] = 0.0
    return np.stack([recursion(decay, (1 - decay) * raw[:, axis]) for axis in range(3)], axis=1)


@timing("clock", "s", "turns", sign="positive")
def tag_ticks(look: Look, raw: Array, size: float) -> Array:
    """Tags are rounded to the ticks of a coarse counter. The remainder of each tag runs through a sawtooth that beats with the
    sampling (CCSDS 301.0-B, time code formats, resolution)."""
    return delayed(look, raw, size * (np.mod(look.t / size + look.share, 1.0) - 0.5))


@samples("pickup", "deg/s", sign="positive")
def code_leak(look: Look, values: Array, size: float) -> Array:
    """One pseudo-random pattern repeats without end. A code that breaks up the dead band, or excites the self-test, is not
    subtracted completely (Lefèvre, The Fiber-Optic Gyroscope, random modulation)."""
    code = look.rng.choice([-1.0, 1.0], round(look.scaled(15, 511)))
    return changed(values, look.k, values[:, look.k] + size * np.resize(code, len(values)))


@samples("resolution", "deg/s", "turns", sign="positive")
def period_counter(look: Look, values: Array, size: float) -> Array:
    """Resolution grows coarse with the square of a frequency. The gyro puts out a frequency around a carrier, and a counter
    measures its period in whole ticks (IEEE Std 1431, digital output)."""
    own, carrier = values[:, look.k], 1.2 + 2 * look.share
    full = max(float(np.abs(own).max(initial=0.0)), size)
    ticks = np.maximum(np.round(full / size / (carrier + own / full)), 1.0)
    return changed(values, look.k, full * (full / size / ticks - carrier))


@samples("pickup", "deg/s", sign="positive")
def settling_noise(look: Look, values: Array, size: float) -> Array:
    """Extra noise decays after each start. A laser, a wheel or an amplitude control is still settling when the readings begin
    (IEEE Std 952, warm-up)."""
    calm = np.exp(-look.since_start / look.between(0.04, 0.4))
    return changed(values, look.k, values[:, look.k] + size * calm * look.rng.standard_normal(len(values)))


@samples("pickup", "share", "turns")
def multiplexer_memory(look: Look, values: Array, size: float) -> Array:
    """Reading holds a part of another axis's reading one sample before. The capacitor of a shared converter keeps charge of
    the channel before (Kester, Data Conversion Handbook, multiplexers)."""
    before = look.each(lambda p: np.concatenate([values[p][:1], values[p][:-1]])[:, look.other])
    return changed(values, look.k, values[:, look.k] + size * before)


@reference("s", "dense", "turns")
def rolling_shutter(view: View) -> Array:
    """Delay of the references depends on the attitude. A rolling shutter reads rows one after another, and the target's row
    moves as the camera turns (Hedborg et al., Rolling Shutter Bundle Adjustment, CVPR 2012)."""
    row = view.body[:, view.other] @ view.direction()
    return -_rates(view) * row[:, None]


@reference("deg", "turns")
def hard_iron(view: View) -> Array:
    """Field's direction is pulled toward a direction fixed in the body. A magnetised part adds a constant field to the
    magnetometer's reading (Gebre-Egziabher et al., J. Aerospace Engineering 19, 2006)."""
    return np.cross(view.body @ view.direction(), np.eye(3)[view.k])


@reference("deg", "turns")
def refraction(view: View) -> Array:
    """Sightings are lifted toward the zenith, more so near the horizon. Air bends light by about the tangent of the zenith
    angle (Smart, Textbook on Spherical Astronomy, refraction)."""
    zenith = view.body @ view.direction()
    return np.cross(np.eye(3)[view.k], zenith) / np.hypot(zenith[:, [view.k]], 0.15)


@reference("deg")
def fix_sawtooth(view: View) -> Array:
    """Error grows steadily and falls to zero at each fix. An onboard filter carries the attitude on with a biased gyro between
    rare star fixes (Lefferts, Markley and Shuster, J. Guidance 5, 1982)."""
    return np.mod(view.t / view.between(0.07, 0.7) + view.share, 1.0)


@reference("deg", "dense", "turns")
def leaning_vertical(view: View) -> Array:
    """Error about one axis lags behind the rate about another. A vertical from accelerometers leans into the curve, because
    the centripetal acceleration is taken for gravity (Farrell, Aided Navigation, attitude and heading reference systems)."""
    decay = np.exp(-np.diff(view.t, prepend=view.t[0]) / view.between(0.02, 0.3))
    decay[_starts(view)] = 0.0
    return _scaled_to_one(recursion(decay, (1 - decay) * _rates(view)[:, view.other]))


@random_reference("deg")
def loop_closures(view: View) -> Array:
    """Error is a random walk that returns to zero at random times. Visual odometry drifts until it meets a place again (Mur-
    Artal and Tardós, ORB-SLAM2, IEEE Trans. Robotics 33, 2017)."""
    step = np.where(_starts(view), 0.0, np.diff(view.t, prepend=view.t[0])) / view.length
    keeps = np.where(_starts(view), 0.0, view.rng.random(len(step)) < np.exp(-step / view.scaled(0.1, 1.0)))
    drive = np.sqrt(step)[:, None] * view.rng.standard_normal((len(step), 3))
    return np.stack([recursion(keeps, keeps * drive[:, axis]) for axis in range(3)], axis=1)


@random_reference("deg", "turns")
def star_poor_fields(view: View) -> Array:
    """Noise grows as the boresight leaves the Milky Way. Fewer stars are seen near the galactic poles, and their mean is less
    accurate (Liebe, IEEE Trans. Aerospace Electronic Systems 38, 2002, star density)."""
    latitude = np.abs(view.body[:, view.other] @ view.direction())
    return (latitude**2)[:, None] * view.rng.standard_normal((len(view.t), 3))


EFFECTS = families(globals())
