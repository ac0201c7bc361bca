"""What the causes of a diagnosis cost in pointing: how far they turn an attitude that is carried by gyro."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from simulator.effects.base import ON_REFERENCES
from simulator.effects.sensor import ALL_EFFECTS

HOUR = 3600.0
ARCSEC_PER_DEG = 3600.0  # a degree


def describe_pointing_cost(regressors: pd.DataFrame, orbit_s: float) -> str:
    """The largest angle by which the causes turn an attitude that is carried by gyro, within an orbit or an hour.

    The calibration, which takes part of a cause into G and b, is made without it; what is left is what is told.

    Parameters
    ----------
    regressors : as of `diagnosis.result.Details`
    orbit_s : period, NaN if unknown
    """
    if regressors.empty:
        return "It is in the samples themselves and turns no attitude that could be measured here."
    on_references = regressors["cause"].map(_is_reference_error)
    gyro = regressors[~on_references]
    if gyro.empty:
        size, axis, interval = _find_worst_change(regressors, math.inf)[0]
        return (
            f"The references err by up to {size} arcsec about {axis}, in {interval}. An attitude carried by gyro errs only as "
            "far as the calibration took that into scale, alignment and bias."
        )
    window, name = (orbit_s, "an orbit") if math.isfinite(orbit_s) else (HOUR, "an hour")
    (size, axis, interval), length = _find_worst_change(gyro, window)
    within = name if 0.9 * window < length <= window else f"{length / 60:.0f} min"
    return f"Carried by gyro, the attitude errs by up to {size} arcsec about {axis} in {within}, in {interval}."


def _is_reference_error(label: str) -> bool:
    """Whether a cause is an error of the references, which turns no attitude that is carried by gyro."""
    name = label.partition(":")[0]
    return name in ALL_EFFECTS and ALL_EFFECTS[name].stage in ON_REFERENCES


def _find_worst_change(regressors: pd.DataFrame, window: float) -> tuple[tuple[str, str, str], float]:
    """The largest change of an angle within a window, arcsec, its axis and interval; and the time that it spans."""
    keys = ["interval", "axis"]
    together = regressors.groupby([*keys, "t_s"], sort=False)["regressor_deg"].sum().reset_index()
    found = max(
        ((_compute_largest_change(part, window), key) for key, part in together.groupby(keys, sort=False)),
        key=lambda one: one[0][0],
    )
    (angle, length), (interval, axis) = found
    return (f"{float(f'{angle * ARCSEC_PER_DEG:.3g}'):g}", str(axis), str(interval)), length


def _compute_largest_change(part: pd.DataFrame, window: float) -> tuple[float, float]:
    """Largest change of an angle within a window, deg, and the time that the window spans, s; of an interval at least."""
    t, angle = part["t_s"].to_numpy(), part["regressor_deg"].to_numpy()
    if t.size < 2:
        return 0.0, 0.0
    step = float(np.diff(t).min())
    if step > window:
        return float(np.ptp(angle)), float(np.ptp(t))
    length = min(window, float(np.ptp(t)))
    # What is within a window from one time on is within one up to the last of these, and the other way round.
    windows = pd.Series(angle, pd.to_timedelta(t, unit="s")).sort_index().rolling(pd.Timedelta(length, "s"), closed="both")
    return float((windows.max() - windows.min()).max()), length
