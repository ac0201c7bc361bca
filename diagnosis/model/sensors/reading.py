"""Readings of the raw sensor tables: which usual misreading fits where the tables as read do not.

Tables of sensors are usually misread in few ways: angles or sensors exchanged, axes in another order or with another sign,
angles in another unit. Where one arc as read leaves far more than noise, it is fitted under each of these readings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product
from operator import itemgetter

import numpy as np

from diagnosis.model.sensors.arcs import build_arc, fit_arc, is_steady
from gyrocal.arrays import Array
from gyrocal.errors import InputError, UnobservableError
from gyrocal.recording import Interval, Recording
from gyrocal.recording.sensor_tables import SensorTables, SunCounts

GROSS = 3.0  # from which on the tables as read are doubted
BETTER = 0.25  # share of it that another reading may leave
LARGEST = 10.0  # that effects may leave beside the right reading
ALIKE = 1.25  # times the least of all readings, within which another one is as good
ARCS = 3  # the middle one of these many stands for all; the others may be worse by something else
SHOWN = 3  # readings stated at most
FULL_SCALE = 2**14 - 1  # of the sun sensors' counts


def find_misreading(recording: Recording) -> str | None:
    """Find out whether the sensor tables fit otherwise than as read, in words; None if they fit or cannot be judged."""
    tables = recording.sensors
    if tables is None or tables.ephemeris is None or tables.sun is None or tables.earth is None:
        return None
    steady = [one for one in recording.intervals if is_steady(recording.gyro, one)][:ARCS]
    if not steady:
        return None
    as_read, arc = sorted([(_compute_mean_square(recording, tables, one), one) for one in steady], key=itemgetter(0))[
        len(steady) // 2
    ]
    if as_read < GROSS:
        return None
    others = [
        (changes, _compute_mean_square(recording, read, arc), words) for changes, words, read in _list_misreadings(tables)
    ]
    best = min(left for _, left, _ in others)
    hopeless = np.isinf(as_read)
    lead = "no attitude fits them" if hopeless else f"their residuals have {as_read:.3g} times the mean square of the noise"
    if best > min(BETTER * as_read, LARGEST):
        return f"{lead}, and no usual misreading of the tables explains that" if hopeless else None
    good = sorted(one for one in others if one[1] <= ALIKE * best)
    ways = [words for changes, _, words in good if changes == good[0][0]]
    return f"{lead}; {best:.3g} with {' or '.join(ways[:SHOWN])}"


def _compute_mean_square(recording: Recording, tables: SensorTables, interval: Interval) -> float:
    """Mean square of the residuals of an interval's arc under M0, in sigmas; infinite where it does not fit."""
    try:
        arc = build_arc(recording, tables, interval)
        fitted = None if arc is None else fit_arc(arc)
    except (UnobservableError, InputError):
        fitted = None
    if fitted is None:
        return np.inf
    gram, dof = fitted.gram(np.empty((len(fitted.rows.z), 0)))
    return float(gram[0, 0] / dof)


def _list_misreadings(tables: SensorTables) -> Iterator[tuple[int, str, SensorTables]]:
    """List the usual misreadings: how many things are changed, which in words, and the tables read this way."""
    sun, earth, ephemeris = tables.sun, tables.earth, tables.ephemeris
    assert sun is not None
    assert earth is not None
    assert ephemeris is not None
    for words, changes, counts in _list_count_misreadings(sun):
        yield changes, words, replace(tables, sun=replace(sun, counts=counts))
    yield 1, "sensors 1 and 2 exchanged", replace(tables, sun=replace(sun, sensor=3 - sun.sensor))
    yield 1, "the Sun's direction reversed", replace(tables, ephemeris=replace(ephemeris, sun=-ephemeris.sun))
    for names, changes, Pi in _list_axis_turns():
        changed = replace(ephemeris, sun=ephemeris.sun @ Pi.T)
        yield changes, f"sun_x, sun_y and sun_z as {names}", replace(tables, ephemeris=changed)
        changed = replace(ephemeris, position=ephemeris.position @ Pi.T)
        yield changes, f"position_x, position_y and position_z as {names}", replace(tables, ephemeris=changed)
    for words, factor in (("in rad, not deg", np.rad2deg(1.0)), ("divided by 57.296", np.deg2rad(1.0))):
        scaled = replace(earth, angles=factor * earth.angles)
        yield 1, f"the penetration angles {words}", replace(tables, earth=scaled)
    for order in list(permutations(range(4)))[1:]:
        reordered = replace(earth, angles=earth.angles[:, order], used=earth.used[:, order])
        yield 1, f"the quadrants in the order {', '.join(str(k + 1) for k in order)}", replace(tables, earth=reordered)


def _list_count_misreadings(sun: SunCounts) -> Iterator[tuple[str, int, Array]]:
    """List misreadings of the sun sensors' counts: in words, number of changes, and the counts read in this way."""
    exchanged, mirrored = sun.counts[:, ::-1], FULL_SCALE - sun.counts
    yield "count_alpha and count_beta exchanged", 1, exchanged
    for number in (1, 2):
        counts = np.where((sun.sensor == number)[:, None], exchanged, sun.counts)
        yield f"count_alpha and count_beta of sensor {number} exchanged", 2, counts
    for words, columns in (("count_alpha", [True, False]), ("count_beta", [False, True]), ("both counts", [True, True])):
        yield f"{words} counted from the other end", sum(columns), np.where(columns, mirrored, sun.counts)


def _list_axis_turns() -> Iterator[tuple[str, int, Array]]:
    """The other orders and signs of three axes, in words, how many axes each moves, and its matrix (3, 3)."""
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        Pi = np.zeros((3, 3))
        Pi[range(3), order] = signs
        moved = int(np.sum(np.diag(Pi) != 1))
        if moved:
            names = ",".join(f"{'-' if sign < 0 else ''}{'xyz'[k]}" for sign, k in zip(signs, order, strict=True))
            yield names, moved, Pi
