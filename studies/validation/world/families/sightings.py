"""Further families of the references: Sun sensors, magnetometers, satellite navigation, encoders and trackers' processing."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.world.families.base import families, random_reference, reference
from studies.validation.world.families.look import View


def _compute_radial_direction(view: View) -> Array:
    """(m, 3) direction from the Earth to the craft in a circular orbit whose plane the numbers fix."""
    normal = view.direction()
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    angle = 2 * np.pi * view.t / view.references.orbit_period_s + view.phase
    return np.asarray(np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(normal, across))


def _count_in_interval(view: View) -> Array:
    """(m,) number of the reference in its interval."""
    first = np.append(True, np.diff(view.references.interval) != 0)
    rows = np.arange(len(view.t))
    return np.asarray(rows - np.maximum.accumulate(np.where(first, rows, 0)))


@reference("deg", "orbit")
def albedo_pull(view: View) -> Array:
    """The Sun's direction is drawn toward the Earth on the day side. Sunlit clouds shine into the sensor (Wertz, Spacecraft
    Attitude Determination and Control, albedo)."""
    radial, sun = _compute_radial_direction(view), np.roll(view.direction(), 1)
    lit = np.maximum(radial @ sun, 0.0)
    return lit[:, None] * np.cross(view.body @ sun, -np.einsum("nij,nj->ni", view.body, radial))


@reference("deg", "turns")
def soft_iron(view: View) -> Array:
    """The field's direction is bent in proportion to itself. Iron beside the magnetometer is magnetised by it (Wertz,
    Spacecraft Attitude Determination and Control, magnetometers)."""
    field, bent = view.body @ view.direction(), np.zeros((len(view.t), 3))
    bent[:, view.k], bent[:, view.other] = field[:, view.other], field[:, view.k]
    return np.cross(field, bent)


@reference("deg", "orbit")
def field_model(view: View) -> Array:
    """Error has several harmonics of the orbit. The model of the Earth's field is cut off at a low degree (Wertz, Spacecraft
    Attitude Determination and Control, geomagnetic field)."""
    angle = 2 * np.pi * view.t / view.references.orbit_period_s + view.phase
    sizes, phases = view.rng.standard_normal((4, 3)), view.rng.uniform(0, 2 * np.pi, (4, 3))
    harmonics = np.arange(2, 6)[:, None]
    return np.asarray((sizes * np.sin(harmonics * angle[:, None, None] + phases)).sum(axis=1))


@random_reference("deg", "orbit")
def eclipse_noise(view: View) -> Array:
    """Noise is larger for a part of each orbit. In the Earth's shadow only the coarse sensors are left (Wertz, Spacecraft
    Attitude Determination and Control, eclipse)."""
    dark = np.cos(2 * np.pi * view.t / view.references.orbit_period_s + view.phase) > np.cos(np.pi * (0.2 + 0.2 * view.share))
    return dark[:, None] * view.rng.standard_normal((len(view.t), 3))


@random_reference("deg")
def multipath(view: View) -> Array:
    """Error waves at frequencies that change. Echoes interfere with the direct signal as the satellites move (Springer Handbook
    of Global Navigation Satellite Systems, multipath)."""
    out, time = np.zeros(len(view.t)), view.since_start / view.between(0.08, 0.4)
    for interval in np.unique(view.references.interval):
        rows = view.references.interval == interval
        for _ in range(2):
            pace, change, phase = view.rng.uniform(0.3, 1.5), view.rng.uniform(-0.1, 0.1), view.rng.uniform(0, 2 * np.pi)
            out[rows] += np.sin(2 * np.pi * (pace * time[rows] + change * time[rows] ** 2) + phase)
    return out


@random_reference("deg")
def cycle_slips(view: View) -> Array:
    """Error goes up or down by fixed steps at random times until it is started anew. The count of carrier cycles slips
    (Springer Handbook of Global Navigation Satellite Systems, cycle slips)."""
    step = np.diff(view.t, prepend=view.t[0])
    slips = (view.rng.random(len(view.t)) < 1 - np.exp(-step / view.between(0.1, 0.8))) * view.rng.choice(
        [-1.0, 1.0], len(step)
    )
    slips[_count_in_interval(view) == 0] = 0.0
    total = np.cumsum(slips)
    return np.asarray(total - total[np.arange(len(total)) - _count_in_interval(view)])


@reference("deg", "turns")
def encoder_eccentric(view: View) -> Array:
    """Error has one and two waves in a turn of the table. Its encoder's disc is off centre and leans (IEEE Std 1554, rate
    tables)."""
    i, j = (view.k + 1) % 3, (view.k + 2) % 3
    angle = np.arctan2(view.body[:, i, j], view.body[:, i, i])
    return np.sin(angle + view.phase) + (0.2 + view.share) * np.sin(2 * angle - view.phase)


@reference("s", "dense", "turns")
def stale_fixes(view: View) -> Array:
    """References get old, and are fresh again after some. The tracker works more slowly than it is read, and what it had is
    carried on in part (Liebe, IEEE Trans. Aerospace Electronic Systems 38, 2002, update rate)."""
    count = int(view.scaled(2, 9))
    return -view.rates * (np.mod(_count_in_interval(view), count) / (count - 1 or 1))[:, None]


@reference("s", "dense", "turns")
def tracker_extrapolates(view: View) -> Array:
    """References overshoot as the rate changes. The tracker extrapolates its last motion to the time of its output (Liebe, IEEE
    Trans. Aerospace Electronic Systems 38, 2002, latency)."""
    change = view.rates - np.vstack([view.rates[:1], view.rates[:-1]])
    change[_count_in_interval(view) == 0] = 0.0
    return -change


@reference("deg", "turns")
def guide_catalogue(view: View) -> Array:
    """Error has a value of its own in each patch of the sky. Each has its guide stars, and their catalogued places err (Liebe,
    IEEE Trans. Aerospace Electronic Systems 38, 2002, catalogue)."""
    patches = view.rng.standard_normal((int(view.scaled(12, 80)), 3))
    patches /= np.linalg.norm(patches, axis=1)[:, None]
    nearest = (view.body[:, view.other] @ patches.T).argmax(axis=1)
    return view.rng.standard_normal((len(patches), 3))[nearest]


@reference("deg", "dense", "turns")
def dwell_drift(view: View) -> Array:
    """Error grows while it stares and is gone after a turn. Pixels remember the stars that stood on them (Liebe, IEEE Trans.
    Aerospace Electronic Systems 38, 2002, detector)."""
    moving = np.linalg.norm(view.rates, axis=1)
    fast, rested, dwell = moving > 0.2 * moving.max(), np.zeros(len(view.t)), 0.0
    for row, (step, place) in enumerate(zip(np.diff(view.t, prepend=view.t[0]), _count_in_interval(view), strict=True)):
        dwell = 0.0 if fast[row] or place == 0 else dwell + step
        rested[row] = dwell
    return 1 - np.exp(-rested / view.between(0.03, 0.3))


@reference("deg")
def frame_drift(view: View) -> Array:
    """References turn steadily about a direction that is fixed in space. The frame that they are in is taken to rest, and turns
    (Wertz, Spacecraft Attitude Determination and Control, coordinate systems)."""
    span = max(float(view.t[-1] - view.t[0]), 1e-3)
    return (view.body @ view.direction()) * ((view.t - view.t[0]) / span)[:, None]


@reference("deg")
def alternating_heads(view: View) -> Array:
    """Error changes its sign from one reference to the next. Two heads take turns, and their alignment differs (Liebe, IEEE
    Trans. Aerospace Electronic Systems 38, 2002)."""
    return 1.0 - 2.0 * np.mod(_count_in_interval(view), 2)


EFFECTS = families(globals())
