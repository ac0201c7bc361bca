"""Residuals of the sensors' measurements, and which sensors depart from their nominal models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import scipy.linalg
from scipy.special import chdtrc

from diagnosis.answer import Finding
from diagnosis.model.sensors.arcs import FittedArc, fit_arc
from diagnosis.model.sensors.columns import HeldAmplitudes, compute_held_error
from diagnosis.model.sensors.tables import Tables
from diagnosis.sensor_result import SENSOR_RESIDUAL_COLUMNS
from simulator.effects.sensor import SENSOR_EFFECTS

SENSOR_ANGLE_NAMES = {
    0: ("penetration 1", "penetration 2", "penetration 3", "penetration 4"),
    1: ("alpha", "beta"),
    2: ("alpha", "beta"),
}
SENSOR_NAMES = {0: "ESA", 1: "DSS-1", 2: "DSS-2"}
RIVAL_FINDINGS = {  # signal and words for residuals that follow the columns of a rival
    "smooth error of DSS-1": ("DSS-1", "residuals of DSS-1 follow where the Sun is in its field of view"),
    "smooth error of DSS-2": ("DSS-2", "residuals of DSS-2 follow where the Sun is in its field of view"),
    "Earth sensor at orbit harmonics": ("ESA", "quadrants of the Earth sensor are off at the orbit's harmonics"),
    "Earth sensor near the Sun": ("ESA", "quadrants of the Earth sensor are off near the Sun"),
}

SEEN = 1e-5  # relative singular value of a sensor's columns, below which one adds nothing to the others

LEAST_POSITIVE = 1e-300


def tabulate_sensor_residuals(fits: Sequence[FittedArc], held: Mapping[str, HeldAmplitudes]) -> pd.DataFrame:
    """Residuals of all measurements under M0, and of a fit with some effects taken off the measurements."""
    parts = [pd.DataFrame(columns=SENSOR_RESIDUAL_COLUMNS)] if not fits else []
    for before in fits:
        arc = before.arc
        after = fit_arc(arc, *compute_held_error(arc.sightings, held)) if held else before
        for series, number, old, new in zip(arc.series, arc.numbers, before.residuals, after.residuals, strict=True):
            looked = arc.sightings.sun_angles[arc.sightings.sun_sensor == number] if number else None
            for k, angle in enumerate(SENSOR_ANGLE_NAMES[number]):
                values = (
                    SENSOR_NAMES[number],
                    angle,
                    arc.name,
                    series.t,
                    np.nan if looked is None else np.rad2deg(looked[:, 0]),
                    np.nan if looked is None else np.rad2deg(looked[:, 1]),
                    np.rad2deg(old[:, k]),
                    np.rad2deg(new[:, k]),
                )
                parts.append(pd.DataFrame(dict(zip(SENSOR_RESIDUAL_COLUMNS, values, strict=True))))
    return pd.concat(parts, ignore_index=True)


def list_sensor_findings(tables: Tables, rate: float) -> tuple[Finding, ...]:
    """Tests of each sensor by itself: chi-square of the columns that an error of it may have, the strongest first.

    Parameters
    ----------
    tables : about M0
    rate : of false alarms
    """
    found = []
    for group in tables.groups:
        finding = SENSOR_EFFECTS[group.effect].finding if group.listed else RIVAL_FINDINGS.get(group.effect)
        if finding is None:
            continue
        basis = scipy.linalg.orth(np.hstack(group.columns), rcond=SEEN)
        chi2, count = float(np.sum((basis.T @ tables.y) ** 2)), basis.shape[1]
        p = float(max(chdtrc(count, chi2), LEAST_POSITIVE)) if count else 1.0
        if p < rate:
            signal, text = finding
            sentence = f"{text} (χ² {chi2:.4g}, {count} expected)"
            found.append(Finding(signal, None, None, None, "chi2", chi2, p, sentence))
    return tuple(sorted(found, key=lambda one: -one.value))
