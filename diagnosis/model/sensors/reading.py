"""Do the raw sensor tables fit the nominal sensors as they are read, and if not, how would they?

At the reference attitudes, carried on by the gyro, each sensor's measurement is predicted from the ephemeris. The Sun is
compared as a direction in the body, the horizon as penetration angles; medians do not mind a few wrong rows. Tables that are
read rightly leave a small part of a degree. Where they leave far more, the ways in which tables of sensors are usually misread
are tried one by one, and those that fit are named. `diagnosis.model.sensors.arcs` estimates attitudes from the tables
themselves; here they come from elsewhere, so that tables which lead to no attitude at all can be judged, too.

Penetration angles are so small that another unit or order of them lies within the errors of those attitudes. Where the arcs'
own fits leave far more than noise, these readings are fitted as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.model.sensors.arcs import arcs_of, fit_arc
from gyrocal.errors import InputError, UnobservableError
from gyrocal.estimation.arc import gyro_arc
from gyrocal.recording import Interval, Recording, reference_rows
from gyrocal.recording.sensor_tables import Ephemeris, PenetrationAngles, SunCounts
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.sun import trmm_sun_sensors

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_ROWS = 400  # of each table that are looked at
FEWEST_ROWS = 5  # of a sensor, below which nothing is said of it
SUN_FITS, EARTH_FITS = np.deg2rad([1.0, 0.1])  # medians up to which a table is taken as it is
HOPELESS = np.deg2rad(5.0)  # a median beyond which it fits nothing, whether or not another reading does
BETTER = 0.5  # times the median as read: another reading must fit so much better
ALIKE = 1.25  # times the best median: as good
GROSS = 3.0  # mean square of residuals in sigmas, from which on other readings of the penetration angles are fitted
MUCH_BETTER = 0.25  # times the mean square as read: another reading must fit so much better
LARGEST = 10.0  # mean square that effects may leave beside the right reading
FITTED = 3  # arcs
UNSEEN = np.deg2rad(45.0)  # error of a quadrant that sees no horizon where one is measured
FULL_SCALE = 2**14 - 1  # of the sun sensors' counts


@dataclass(frozen=True)
class Measured:
    """Rows of one table with the attitudes and the ephemeris at them.

    Attributes
    ----------
    rows : (n,) of the table
    A : (n, 3, 3) attitudes, inertial to body
    sun, position : (n, 3) of the ephemeris
    """

    rows: Indices
    A: Array
    sun: Array
    position: Array


@dataclass(frozen=True)
class Reading:
    """One way to read a table.

    Attributes
    ----------
    words : what is to be changed; empty as it is read
    changes : how many things these are
    error : median error of what is measured, rad; NaN where there are too few rows
    """

    words: str
    changes: int
    error: float


def misread(recording: Recording) -> str | None:
    """What of the sensor tables does not fit, and which reading would; None if they fit or cannot be judged."""
    tables = recording.sensors
    if tables is None or tables.ephemeris is None:
        return None
    found = []
    if tables.sun is not None:
        at = _measured(recording, tables.sun.t_s, np.ones(tables.sun.t_s.size, dtype=bool), tables.ephemeris)
        found.append(_judged("the Sun", SUN_FITS, list(_of_sun(tables.sun, at))))
    if tables.earth is not None:
        at = _measured(recording, tables.earth.t_s, np.asarray(tables.earth.used.any(axis=1)), tables.ephemeris)
        found.append(_judged("the horizon", EARTH_FITS, list(_of_earth(tables.earth, at))))
    return "; ".join(text for text in found if text) or None


def misread_angles(recording: Recording) -> str | None:
    """The same of the penetration angles, by fits of some arcs under each reading; None where no other fits far better."""
    tables = recording.sensors
    if tables is None or tables.earth is None:
        return None
    as_read = _mean_square(recording)
    if as_read < GROSS:
        return None
    earth = tables.earth
    others = {
        "the penetration angles in rad, not deg": replace(earth, angles=np.rad2deg(earth.angles)),
        "the penetration angles divided by 57.296": replace(earth, angles=np.deg2rad(earth.angles)),
    }
    for order in list(permutations(range(4)))[1:]:
        moved = replace(earth, angles=earth.angles[:, order], used=earth.used[:, order])
        others[f"the quadrants in the order {', '.join(str(k + 1) for k in order)}"] = moved
    found = {words: _mean_square(replace(recording, sensors=replace(tables, earth=one))) for words, one in others.items()}
    words, best = min(found.items(), key=lambda one: one[1])
    if best > min(MUCH_BETTER * as_read, LARGEST):
        return None
    return f"their residuals have {as_read:.3g} times the mean square of the noise; {best:.3g} with {words}"


def _mean_square(recording: Recording) -> float:
    """Mean square of the residuals of some arcs under M0, in sigmas; infinite where they do not fit."""
    try:
        grams = [fit_arc(arc) for arc in arcs_of(recording)[0][:FITTED]]
        found = [one.gram(np.empty((len(one.rows.z), 0))) for one in grams]
    except (UnobservableError, InputError):
        return np.inf
    return float(sum(gram[0, 0] for gram, _ in found) / sum(dof for _, dof in found))


def _judged(what: str, fits: float, readings: list[Reading]) -> str:
    """A sentence about one kind of sensor, of readings of which the first is the one as read; empty if that fits."""
    as_read, *others = readings
    if not as_read.error > fits:
        return ""
    lead = f"{what} is {np.rad2deg(as_read.error):.2g} deg from where the reference attitudes and the ephemeris put it"
    best = min((one.error for one in others), default=np.inf)
    if best > min(BETTER * as_read.error, HOPELESS):
        return f"{lead}, and no usual misreading of the tables explains that" if as_read.error > HOPELESS else ""
    good = sorted((one for one in others if one.error <= max(ALIKE * best, fits)), key=lambda one: (one.changes, one.error))
    ways = [one.words for one in good if one.changes == good[0].changes]
    return f"{lead}; {np.rad2deg(best):.2g} deg with {' or '.join(ways[:3])}"


def _of_sun(table: SunCounts, at: Measured) -> Iterator[Reading]:
    """Readings of the counts and of the Sun's direction; the first is as read."""
    counts, sensor = table.counts[at.rows], table.sensor[at.rows]
    seen = _body(at.A, at.sun)
    yield Reading("", 0, _sun_error(counts, sensor, seen))
    turned, mirrored = counts[:, ::-1], FULL_SCALE - counts
    yield Reading("count_alpha and count_beta exchanged", 1, _sun_error(turned, sensor, seen))
    for number in (1, 2):
        own = np.where((sensor == number)[:, None], turned, counts)
        yield Reading(f"count_alpha and count_beta of sensor {number} exchanged", 2, _sun_error(own, sensor, seen))
    yield Reading("sensors 1 and 2 exchanged", 1, _sun_error(counts, 3 - sensor, seen))
    for words, columns in (("count_alpha", [True, False]), ("count_beta", [False, True]), ("both counts", [True, True])):
        error = _sun_error(np.where(columns, mirrored, counts), sensor, seen)
        yield Reading(f"{words} counted from the other end", sum(columns), error)
    for names, changes, Pi in TURNS:
        error = _sun_error(counts, sensor, _body(at.A, at.sun @ Pi.T))
        if names == "-x,-y,-z":
            yield Reading("the Sun's direction reversed", 1, error)
        else:
            yield Reading(f"sun_x, sun_y and sun_z as {names}", changes, error)


def _sun_error(counts: Array, sensor: NDArray[np.int64], seen: Array) -> float:
    """Median angle between where a sun sensor sees the Sun and where it is, of the sensor that is worse; NaN without rows."""
    errors = []
    for number, model in enumerate(trmm_sun_sensors(), start=1):
        own = sensor == number
        if own.sum() >= FEWEST_ROWS:
            cosine = np.einsum("ni,ni->n", model.body_vector(counts[own]), seen[own])
            errors.append(float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))
    return max(errors, default=np.nan)


def _of_earth(table: PenetrationAngles, at: Measured) -> Iterator[Reading]:
    """Readings of the position; the first is as read."""
    angles, used = table.angles[at.rows], table.used[at.rows]
    expected = _penetration(at.A, at.position)
    yield Reading("", 0, _earth_error(angles, used, expected))
    for names, changes, Pi in TURNS:
        error = _earth_error(angles, used, _penetration(at.A, at.position @ Pi.T))
        yield Reading(f"position_x, position_y and position_z as {names}", changes, error)


def _penetration(A: Array, position: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return EarthModel(EarthSensor(np.zeros(4)), position).predict(A, np.arange(len(A)))


def _earth_error(angles: Array, used: NDArray[np.bool_], expected: Array) -> float:
    """Median error of the quadrants that are used; NaN without rows."""
    if used.any(axis=1).sum() < FEWEST_ROWS:
        return np.nan
    error = np.abs(angles[used] - expected[used])
    return float(np.median(np.where(np.isfinite(error), error, UNSEEN)))


def _body(A: Array, direction: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", A, direction))


# ---- attitudes at the rows -----------------------------------------------------------------------------------------------


def _measured(recording: Recording, t_s: Array, usable: NDArray[np.bool_], ephemeris: Ephemeris) -> Measured:
    """Some rows of a table, with the attitudes that the references and the gyro give at them."""
    chosen = np.flatnonzero(usable)
    chosen = chosen[:: max(1, -(-chosen.size // MOST_ROWS))]
    rows, attitudes = [np.zeros(0, dtype=np.intp)], [np.zeros((0, 3, 3))]
    for interval in recording.intervals:
        own = chosen[(t_s[chosen] >= interval.start_s) & (t_s[chosen] <= interval.stop_s)]
        found = _carried(recording, interval, t_s[own]) if own.size else None
        if found is not None:
            rows.append(own[found[0]])
            attitudes.append(found[1])
    kept = np.concatenate(rows)
    place = ephemeris.rows(t_s[kept])
    return Measured(kept, np.concatenate(attitudes), ephemeris.sun[place], ephemeris.position[place])


def _carried(recording: Recording, interval: Interval, t_s: Array) -> tuple[NDArray[np.bool_], Array] | None:
    """Which of some times the interval's first reference can be carried to, and the attitudes there; None where it cannot."""
    gyro, references = recording.gyro, recording.attitudes
    row = reference_rows(references.t_s, interval)[0]
    later = t_s > references.t_s[row] + gyro.sample_s
    if not later.any():
        return None
    kept = (gyro.t_s > interval.start_s - 1.5 * gyro.sample_s) & (gyro.t_s < interval.stop_s)
    own = replace(gyro, t_s=gyro.t_s[kept], rates=gyro.rates[kept])
    try:
        path = gyro_arc(own, np.append(references.t_s[row], t_s[later]), gyro.apriori_G)
    except InputError:  # a gap of the stream, which the arcs are refused for
        return None
    A = path.carried(gyro.apriori_bias)[0] @ Rotation.from_quat(references.quaternions[row]).inv().as_matrix()
    return later, A[path.node(t_s[later])]


def _turns() -> list[tuple[str, int, Array]]:
    """The 47 other orders and signs of three axes, and how many axes each moves."""
    out = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        Pi = np.zeros((3, 3))
        Pi[range(3), order] = signs
        names = ",".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for sign, k in zip(signs, order, strict=True))
        out.append((names, int(np.sum(np.diag(Pi) != 1)), Pi))
    return [one for one in out if one[1]]


TURNS = _turns()
