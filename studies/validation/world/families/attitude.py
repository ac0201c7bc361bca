"""Families of the reference attitudes: star trackers, horizon and sun sensors, optical motion capture and their processing."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.world.families.base import families, random_reference, reference
from studies.validation.world.families.look import View


@reference("deg", "turns")
def field_waves(view: View) -> Array:
    """Error has waves over the sky. Distortion and catalogue shift stars with their place in the field (Liebe, IEEE Trans.
    Aerospace Electronic Systems 38, 2002, low-frequency error)."""
    return np.sin(view.scaled(3.0, 40.0) * (view.body[:, view.other] @ view.direction()) + view.phase)


@reference("deg", "turns")
def two_heads(view: View) -> Array:
    """Error has two values, one for each of two heads. That which is blinded hands over to the other (Liebe, IEEE Trans.
    Aerospace Electronic Systems 38, 2002)."""
    looks = view.body[:, view.other] @ view.direction()
    return (looks > np.median(looks)).astype(float)


@reference("deg", "turns")
def aberration(view: View) -> Array:
    """Directions are off towards the velocity. Stellar aberration is not corrected (Wertz, Spacecraft Attitude Determination
    and Control)."""
    return np.cross(view.body @ view.direction(), np.eye(3)[view.k])


@reference("deg", "orbit")
def orbital_aberration(view: View) -> Array:
    """Directions are off towards the velocity in orbit. Its aberration is not corrected (Wertz, Spacecraft Attitude
    Determination and Control)."""
    angle = 2 * np.pi * view.t / view.references.orbit_period_s + view.phase
    velocity = np.stack([-np.sin(angle), np.cos(angle) * np.cos(view.share), np.cos(angle) * np.sin(view.share)], axis=1)
    return np.cross(np.einsum("nij,nj->ni", view.body, velocity), np.eye(3)[view.k])


@reference("deg")
def acquisition_tail(view: View) -> Array:
    """Error decays after each acquisition. The tracker's filter settles (Liebe, IEEE Trans. Aerospace Electronic Systems 38,
    2002)."""
    return np.exp(-view.since_start / view.between(0.05, 0.4))


@reference("deg")
def lit_flexure(view: View) -> Array:
    """Error rises and falls while it is lit, and is nil in the dark. The structure bends towards the Sun (Wertz, Spacecraft
    Attitude Determination and Control)."""
    return np.maximum(np.sin(2 * np.pi * view.t / view.between(0.2, 1.2) + view.phase), 0.0) ** 2


@reference("deg", "turns")
def sun_glint(view: View) -> Array:
    """Error appears near one direction. Stray light of a bright body pulls the centroids (Liebe, IEEE Trans. Aerospace
    Electronic Systems 38, 2002)."""
    angle = np.arccos(np.clip(view.body[:, view.other] @ view.direction(), -1, 1))
    return np.exp(-0.5 * ((angle - angle.min()) / view.scaled(0.05, 0.5)) ** 2)


@reference("deg", "turns")
def parallax(view: View) -> Array:
    """Error goes with the pose. Cameras and markers are not where their calibration has them (motion capture residuals; Wertz,
    sensor alignment)."""
    down = view.body @ view.direction()
    return view.on(down[:, view.k] * down[:, (view.k + 1) % 3] + 0.5 * down[:, (view.k + 2) % 3] ** 2)


@reference("deg")
def marker_creep(view: View) -> Array:
    """Error creeps with the logarithm of time. A bracket or a glued marker relaxes (motion capture practice)."""
    return np.log1p(view.since_start / view.between(0.01, 0.1))


@random_reference("s", "dense", "turns")
def late_exposures(view: View) -> Array:
    """References are late by a random time. Exposures wait for the processor (Liebe, IEEE Trans. Aerospace Electronic Systems
    38, 2002)."""
    return -view.rates * view.rng.random(len(view.t))[:, None]


@reference("ppm", "dense", "turns")
def reference_clock(view: View) -> Array:
    """References drift away in time. Their clock is not the gyro's (IEEE Std 1139)."""
    return view.rates * (view.t - view.t[0])[:, None]


@random_reference("deg")
def wrong_stars(view: View) -> Array:
    """A few references are far off. Stars or markers are taken for others (Liebe, IEEE Trans. Aerospace Electronic Systems 38,
    2002)."""
    hit = view.rng.random(len(view.t)) < view.scaled(0.01, 0.1)
    return (hit * np.abs(view.rng.standard_t(3, len(view.t))))[:, None] * view.rng.standard_normal((len(view.t), 3))


@random_reference("deg")
def marker_swap(view: View) -> Array:
    """Error is constant through random episodes. A marker is lost and the fit goes on with the others (motion capture
    practice)."""
    return view.episodes(0.1 + 0.3 * view.share, view.between(0.02, 0.15)).astype(float)


@random_reference("deg")
def cold_clouds(view: View) -> Array:
    """Error has smooth bumps at random times. Cold clouds shift the infrared horizon for minutes (Wertz, Spacecraft Attitude
    Determination and Control)."""
    out = np.zeros(len(view.t))
    width = view.between(0.01, 0.06)
    for interval in np.unique(view.references.interval):
        rows = view.references.interval == interval
        span = float(np.ptp(view.t[rows]))
        for _ in range(1 + view.rng.poisson(span / (12 * width))):
            middle = view.t[rows][0] + span * view.rng.random()
            out[rows] += view.rng.exponential() * np.exp(-0.5 * ((view.t[rows] - middle) / width) ** 2)
    return out


@random_reference("deg", "turns")
def pose_noise(view: View) -> Array:
    """Noise depends on where it looks. Fewer stars or markers are seen there (Liebe, IEEE Trans. Aerospace Electronic Systems
    38, 2002)."""
    looks = np.maximum(view.body[:, view.other] @ view.direction(), 0.0)
    return (looks**2)[:, None] * view.rng.standard_normal((len(view.t), 3))


@random_reference("s", "dense", "turns")
def motion_blur(view: View) -> Array:
    """Noise grows with the rate. Images smear along the motion (Liebe, IEEE Trans. Aerospace Electronic Systems 38, 2002)."""
    return view.rates * view.rng.standard_normal((len(view.t), 1))


EFFECTS = families(globals())
