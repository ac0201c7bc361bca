"""What is left of the turns between attitudes over different times, after everything found is undone."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from diagnosis.model.linearise import linearised
from gyrocal import Attitudes, Interval
from studies.report.tables import by_group
from studies.validation.real_gyro.prediction import Fit, Rung, undone
from studies.validation.real_gyro.trials import Loaded, Row

LAGS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
FEWEST = 8  # turns over a time
SHORT_S, LONG_S = 0.05, 2.0  # what is shown of them; over more than that not every trial has enough turns


def turn_rows(one: Loaded, found: Fit, rung: Rung) -> list[Row]:
    """Mean squares of what is left of the turns in motion, over each time, for the slower and the faster half of them."""
    trial, recording = one.trial, undone(one, rung, found.delay)
    t, tracked = trial.t_s, trial.tracked
    spans = [(interval.start_s, interval.stop_s) for interval in one.recording.intervals if interval.activity != "rest"]
    rows: list[Row] = []
    for lag in LAGS_S:
        ends = [
            (int(a), int(b))
            for first, stop in trial.phases
            for a, b in pairwise(np.arange(first, stop, trial.samples(lag)))
            if tracked[a] and tracked[b] and any(low <= t[a] and t[b] <= high for low, high in spans)
        ]
        if len(ends) < FEWEST:
            continue
        used = np.unique(np.array(ends))
        turns = replace(
            recording,
            attitudes=Attitudes(t[used], trial.quaternions[used], np.full((used.size, 3), 1e-3)),
            intervals=tuple(Interval(str(k), "", float(t[a]), float(t[b])) for k, (a, b) in enumerate(ends)),
        )
        model = linearised(turns, found.G, found.bias)
        begin, end = model.at_reference[::2], model.at_reference[1::2]
        turned = Rotation.from_matrix(end @ begin.transpose(0, 2, 1)).as_rotvec()  # in inertial axes, as the residuals
        angle = np.linalg.norm(turned, axis=1)
        left = np.rad2deg(model.residuals[1::2])
        squares = np.square(left).sum(axis=1)
        along = np.square(np.einsum("mi,mi->m", left, turned) / np.maximum(angle, 1e-12))
        slow = angle < np.median(angle)
        rows += [
            {
                "kind": "turns",
                "trial": one.number,
                "name": which,
                "lag_s": lag,
                "count": float(np.count_nonzero(own)),
                "series_deg2": float(squares[own].mean()),
                "along_deg2": float(along[own].mean()),
            }
            for which, own in (("slower", slow), ("faster", ~slow))
        ]
    return rows


def remaining(rows: pd.DataFrame) -> pd.DataFrame:
    """What is left of the turns, a row per trial: mean squares over time as white error of the references plus a random walk.

    A turn over a time T has the variance 2 s² + w² T per axis; the share along the turn would be a third if it had no
    preference.
    """

    def line(part: pd.DataFrame) -> dict[str, object]:
        def mean(column: str) -> pd.Series:
            return (part[column] * part["count"]).groupby(part["lag_s"]).sum() / part["count"].groupby(part["lag_s"]).sum()

        squares = mean("series_deg2")
        T = squares.index.to_numpy(float)
        # Relative errors are alike at all times.
        X = np.column_stack([np.full(T.size, 6.0), 3.0 * T]) / squares.to_numpy()[:, None]
        white, walk = np.linalg.lstsq(X, np.ones(T.size), rcond=None)[0]
        by_rate = part.groupby("name")["series_deg2"].mean()
        return {
            "white_deg": float(np.sqrt(max(white, 0.0))),
            "walk_deg_per_sqrt_s": float(np.sqrt(max(walk, 0.0))),
            **{f"rms_{lag:g}_s_deg": float(np.sqrt(squares.get(lag, np.nan))) for lag in (SHORT_S, LONG_S)},
            "faster_over_slower": float(np.sqrt(by_rate["faster"] / by_rate["slower"])),
            "share_along_turn": float((mean("along_deg2") / squares).mean()),
        }

    table = by_group(rows[rows["kind"] == "turns"], ["unit", "trial"], line)
    stated = ["rate_deg_s", "stated_sigma_deg", "stated_arw_deg_per_sqrt_s"]
    return table.merge(rows[rows["kind"] == "trial"][["trial", *stated]], on="trial")
