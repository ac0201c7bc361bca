"""Residuals of the sensors' measurements, and which sensors depart from their nominal models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import chdtrc

from diagnosis.answer import Finding
from diagnosis.model.sensors.arcs import FittedArc, fit_arc
from diagnosis.model.sensors.columns import Held, held_error
from diagnosis.model.sensors.tables import Tables
from diagnosis.sensor_result import RESIDUALS
from simulator.effects.sensor import SENSOR_EFFECTS

Array = NDArray[np.float64]

ANGLES = {0: ("penetration 1", "penetration 2", "penetration 3", "penetration 4"), 1: ("alpha", "beta"), 2: ("alpha", "beta")}
NAMES = {0: "ESA", 1: "DSS-1", 2: "DSS-2"}
RIVALS = {  # signal and words for residuals that follow the columns of a rival
    "smooth error of DSS-1": ("DSS-1", "residuals of DSS-1 follow where the Sun is in its field of view"),
    "smooth error of DSS-2": ("DSS-2", "residuals of DSS-2 follow where the Sun is in its field of view"),
    "Earth sensor at orbit harmonics": ("ESA", "quadrants of the Earth sensor are off at the orbit's harmonics"),
    "Earth sensor near the Sun": ("ESA", "quadrants of the Earth sensor are off near the Sun"),
}


@dataclass(frozen=True)
class ResidualSettings:
    """Constants of `diagnosis.model.sensors.residuals`."""

    seen: float = 1e-5  # relative singular value of a sensor's columns, below which one adds nothing to the others


SETTINGS = ResidualSettings()


TINY = 1e-300


def residual_table(fits: Sequence[FittedArc], held: Mapping[str, Held]) -> pd.DataFrame:
    """Residuals of all measurements under M0, and of a fit with some effects taken off the measurements."""
    parts = [pd.DataFrame(columns=RESIDUALS)] if not fits else []
    for before in fits:
        arc = before.arc
        after = fit_arc(arc, *held_error(arc.sightings, held)) if held else before
        for series, number, old, new in zip(arc.series, arc.numbers, before.residuals, after.residuals, strict=True):
            looked = arc.sightings.sun_angles[arc.sightings.sun_sensor == number] if number else None
            for k, angle in enumerate(ANGLES[number]):
                values = (
                    NAMES[number],
                    angle,
                    arc.name,
                    series.t,
                    np.nan if looked is None else np.rad2deg(looked[:, 0]),
                    np.nan if looked is None else np.rad2deg(looked[:, 1]),
                    np.rad2deg(old[:, k]),
                    np.rad2deg(new[:, k]),
                )
                parts.append(pd.DataFrame(dict(zip(RESIDUALS, values, strict=True))))
    return pd.concat(parts, ignore_index=True)


def findings(tables: Tables, rate: float) -> tuple[Finding, ...]:
    """Tests of each sensor by itself: chi-square of the columns that an error of it may have, the strongest first.

    Parameters
    ----------
    tables : about M0
    rate : of false alarms
    """
    found = []
    for group in tables.groups:
        finding = SENSOR_EFFECTS[group.effect].finding if group.listed else RIVALS.get(group.effect)
        if finding is None:
            continue
        basis = scipy.linalg.orth(np.hstack(group.columns), rcond=SETTINGS.seen)
        chi2, count = float(np.sum((basis.T @ tables.y) ** 2)), basis.shape[1]
        p = float(max(chdtrc(count, chi2), TINY)) if count else 1.0
        if p < rate:
            signal, text = finding
            sentence = f"{text} (χ² {chi2:.4g}, {count} expected)"
            found.append(Finding(signal, None, None, None, "chi2", chi2, p, sentence))
    return tuple(sorted(found, key=lambda one: -one.value))
