"""Eighteen unlisted effects of gyros, references, telemetry and mounting that no other file of families holds."""

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import gauss_markov
from simulator.truth.rotation import separation
from studies.validation.world.families.base import families, random_rate, random_reference, rate, reference, samples, timing
from studies.validation.world.families.look import Look, View, changed, delayed

TINY = 1e-30  # keeps a ratio of zeros finite


def _scaled_to_one(values: Array) -> Array:
    """Values over their largest magnitude; zeros stay zeros."""
    return np.asarray(values / max(float(np.abs(values).max(initial=0.0)), TINY))


def _starts(view: View) -> Array:
    """(m,) bool, the first reference of each interval."""
    return np.append(True, np.diff(view.references.interval) != 0)


@rate("deg/h", "turns")
def cabin_pressure(look: Look) -> Array:
    """Bias follows the height that was climbed since the start. Air pressure loads the case and its filling gas, and falls as
    the carrier climbs along one of its axes (IEEE Std 813, pressure sensitivity)."""
    return _scaled_to_one(look.each(lambda p: np.cumsum(look.attitude[p, look.other] @ look.direction())))


@rate("deg/h", "orbit")
def rod_switching(look: Look) -> Array:
    """Bias has three levels, by how the Earth's field changes. Torque rods beside the gyro are switched against that change
    and rest while it is small (Stickler and Alfriend, J. Spacecraft and Rockets 13, 1976)."""
    angle = 2 * np.pi * look.t / look.stream.orbit_period_s + look.phase
    field = np.stack([np.cos(angle), 0.4 + 0 * angle, 2 * np.sin(angle)], axis=1)
    along = np.einsum("nj,nj->n", look.attitude[:, look.other], field)
    change = look.each(lambda p: np.gradient(along[p], look.t[p]))
    return np.where(np.abs(change) > np.quantile(np.abs(change), 0.2 + 0.5 * look.share), -np.sign(change), 0.0)


@rate("deg/h")
def charge_memory(look: Look) -> Array:
    """Bias builds up while the gyro runs and falls back while it is off, so that each start goes on from what is left. Layers
    charge under the drive voltage of a micromechanical gyro (Shea et al., IEEE Trans. Device and Materials Reliability 4)."""
    rise, fall = look.between(0.2, 2.0), look.length * (0.5 + 20 * look.share)
    out, left, end = np.empty(len(look.t)), 0.0, look.t[0]
    for p in look.stream.intervals:
        left *= np.exp((end - look.t[p.start]) / fall)
        out[p] = 1 - (1 - left) * np.exp(-look.since_start[p] / rise)
        left, end = out[p.stop - 1], look.t[p.stop - 1]
    return out


@rate("deg/h", "temperature")
def drive_beat(look: Look) -> Array:
    """Bias swings at a frequency that the temperature changes. Drives of two axes are near in frequency and couple through the
    supply, and the temperature moves them apart (Weinberg and Kourepenis, J. Microelectromechanical Systems 15, 2006)."""
    apart = 1 + (0.3 + 0.6 * look.share) * look.temperature / max(float(np.ptp(look.temperature)), TINY)
    return np.sin(2 * np.pi * np.cumsum(apart) * look.sample_s / look.between(0.03, 0.4) + look.phase)


@rate("deg/h")
def turn_on_bias(look: Look) -> Array:
    """Bias is constant within an interval and another one in the next. It does not repeat from one switching on to the next
    (IEEE Std 952, bias repeatability)."""
    return look.each(lambda p: np.full(p.stop - p.start, look.rng.standard_normal()))


@rate("ppm", "turns")
def mount_play(look: Look) -> Array:
    """Mount has two positions, and a strong jerk the other way turns it from one to the other. Worn screw holes leave play, and
    the inertia of the gyro holds it at one end (Nordin and Gutman, Automatica 38, 2002, backlash)."""
    push = look.acceleration[:, look.other]
    strong = np.abs(push) > (0.2 + 0.6 * look.share) * np.abs(push).max()
    side = np.sign(push[np.maximum.accumulate(np.where(strong, np.arange(len(push)), 0))])
    return np.cross(look.w, side[:, None] * look.direction())


@random_rate("ppm", "turns")
def wheel_hunting(look: Look) -> Array:
    """Scale factor swings in a narrow band about its mean. The rotor of a spinning-mass gyro hunts about the synchronous speed,
    and its angular momentum with it (Wrigley, Hollister and Denhard, Gyroscopic Theory, Design, and Instrumentation, 1969)."""
    angle, coherent = look.cycle(0.01, 0.15), look.between(0.01, 0.15) * (2 + 8 * look.share)
    sine, cosine = (gauss_markov(look.rng, look.t, coherent) for _ in range(2))
    return look.own * (sine * np.sin(angle) + cosine * np.cos(angle))


@random_rate("deg/h")
def popcorn_noise(look: Look) -> Array:
    """Bias hops at random between two levels. A defect in the first transistor of the readout catches a carrier and lets it go
    (Kirton and Uren, Advances in Physics 38, 1989, random telegraph signals)."""
    step = np.diff(look.t, prepend=look.t[0])
    hops = look.rng.random(len(step)) < -0.5 * np.expm1(-2 * step / look.between(0.02, 0.4))
    return np.where(np.cumsum(hops) % 2 == 1, 1.0, 0.0)


@timing("clock", "s", "turns")
def clock_pull_in(look: Look, raw: Array, size: float) -> Array:
    """Tags swing about the right time after each start and come to rest there. A loop of second order steers the clock to a
    time signal (Mills, RFC 5905, clock discipline)."""
    angle = 2 * np.pi * look.since_start / look.between(0.15, 1.0)
    return delayed(look, raw, size * np.exp(-(0.05 + 0.25 * look.share) * angle) * np.cos(angle + look.phase))


@timing("clock", "s", "turns", "temperature", sign="positive")
def thermal_throttling(look: Look, raw: Array, size: float) -> Array:
    """Samples are late while it is warm. The computer lowers its speed above a temperature, and tags what its queue hands over
    (Brooks and Martonosi, Dynamic Thermal Management, HPCA 2001)."""
    warm = look.temperature - np.quantile(look.temperature, 0.2 + 0.6 * look.share)
    return delayed(look, raw, size * _scaled_to_one(np.maximum(warm, 0.0)))


@samples("pickup", "share", "turns", sign="positive")
def intensity_noise(look: Look, values: Array, size: float) -> Array:
    """Noise grows in proportion to the rate. Fluctuations of the light multiply the signal of an open-loop fibre gyro (Lefèvre,
    The Fiber-Optic Gyroscope, relative intensity noise)."""
    return changed(values, look.k, values[:, look.k] + size * look.own * look.rng.standard_normal(len(values)))


@samples("resolution", "deg/s", "turns", sign="positive")
def missing_codes(look: Look, values: Array, size: float) -> Array:
    """Readings never lie just above some levels. The heavy bits of the converter are a little too heavy, so that codes are
    missing at the major carries (IEEE Std 1241, differential nonlinearity)."""
    above = np.mod(values[:, look.k], look.fastest * look.scaled(0.03, 0.5))
    return changed(values, look.k, values[:, look.k] + np.maximum(size - above, 0.0))


@samples("telemetry", "deg/s", sign="positive")
def ripple_carry(look: Look, values: Array, size: float) -> Array:
    """One carry is missing in some samples where the high byte changes. A counter is read while the carry still runs through
    it (Horowitz and Hill, The Art of Electronics, ripple counters)."""
    high = np.floor(values[:, look.k] / size)
    before = look.each(lambda p: np.append(high[p.start], high[p][:-1]))
    caught = look.rng.random(len(high)) < look.scaled(0.03, 0.5)
    return changed(values, look.k, values[:, look.k] + size * np.where(caught, np.clip(before - high, -1, 1), 0.0))


@reference("share", "dense", "turns", sign="positive")
def coarse_interpolation(view: View) -> Array:
    """References between rare fixes lie on straight lines. The ground interpolates an attitude file of a low rate, and leans on
    it by a share (Shoemake, Animating Rotation with Quaternion Curves, SIGGRAPH 1985)."""
    rows, starts, q = np.arange(len(view.t)), _starts(view), view.references.quaternions
    place = rows - np.maximum.accumulate(np.where(starts, rows, 0))
    nodes = np.flatnonzero((place % int(view.scaled(2, 8)) == 0) | np.append(starts[1:], True))
    first, last = nodes[np.searchsorted(nodes, rows, "right") - 1], nodes[np.searchsorted(nodes, rows)]
    share = ((view.t - view.t[first]) / np.where(first < last, view.t[last] - view.t[first], 1.0))[:, None]
    side = np.where((q[first] * q[last]).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    return separation(q, (1 - share) * q[first] + share * side * q[last])


@reference("deg", "dense", "turns")
def boom_bending(view: View) -> Array:
    """Error grows with the square of the rate. Centrifugal load bends the boom that carries the magnetometer or star camera of
    the references (Kane, Ryan and Banerjee, J. Guidance 10, 1987)."""
    arm = view.direction()
    return _scaled_to_one(np.cross(arm, view.rates * (view.rates @ arm)[:, None]))


@reference("deg", "dense", "turns")
def gyrocompass_swing(view: View) -> Array:
    """Heading error swings after each turn and dies away slowly. A gyrocompass is deflected by the turn and returns in damped
    oscillations (Schuler, Physikalische Zeitschrift 24, 1923, ballistic deflection)."""
    up, step = view.body @ view.direction(), np.diff(view.t, append=view.t[-1])
    push = np.einsum("ni,ni->n", up, view.rates) * step
    pole = (1j - 0.05 - 0.3 * view.share) * 2 * np.pi / view.between(0.15, 1.5)
    swing, out = 0j, np.zeros(len(view.t))
    for row, first in enumerate(_starts(view)):
        swing = 0j if first else (swing + push[row - 1]) * np.exp(pole * step[row - 1])
        out[row] = swing.imag
    return up * _scaled_to_one(out)[:, None]


@random_reference("deg")
def dark_current(view: View) -> Array:
    """Noise grows steadily through the recording. Protons damage the star camera's detector, and its dark current rises
    (Hopkinson, Dale and Marshall, IEEE Trans. Nuclear Science 43, 1996)."""
    return ((view.t - view.t[0]) / max(float(np.ptp(view.t)), TINY))[:, None] * view.rng.standard_normal((len(view.t), 3))


@random_reference("deg", "turns")
def tag_slips(view: View) -> Array:
    """Reference frame slips by random angles in fast motion and stays there. Suction cups or straps let the sensor of the
    references move on the body (Johnson and Tyack, IEEE J. Oceanic Engineering 28, 2003)."""
    moving = (view.rates**2).sum(axis=1)
    slips = view.rng.random(len(moving)) < view.scaled(3, 30) * moving / max(float(moving.sum()), TINY)
    return np.cumsum(slips[:, None] * view.rng.standard_normal((len(moving), 3)), axis=0)


EFFECTS = families(globals())
