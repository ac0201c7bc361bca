"""Figures: the flight's table against the prediction, and the probabilities of the hypotheses."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from studies.natanson import flight
from studies.natanson.flight_diagnosis.baselines import Diagnosis, evidence_table
from studies.natanson.flight_diagnosis.verdict import SURE
from studies.report.panels import STYLE, save


def gap_figure(found: Diagnosis, path: Path) -> Path:
    """Flown and predicted residuals above; below flown minus predicted before and after, and the flight's after calibration."""
    flown_deg, closed = flight.residuals("prelaunch"), found.closure
    after = closed.after.reshape(6, 3)
    sigma = closed.sigma.reshape(6, 3)
    x = np.arange(1, 7)
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 5.0), layout="constrained")
        panels = drawing.subplots(2, 3, sharey="row", sharex=True)
        for j, name in enumerate(flight.ROTATIONS):
            top, low = panels[0, j], panels[1, j]
            top.plot(x, found.prediction[:, j], "_", color="#00798c", markersize=13, markeredgewidth=2, label="predicted")
            top.plot(x, (flown_deg - after)[:, j], "x", color="#30343f", markersize=5, label="with the explanation")
            top.plot(x, flown_deg[:, j], "o", color="#d1495b", markersize=4, label="flown")
            low.axhline(0, color="0.4", linewidth=0.8)
            low.bar(x, flight.residuals("calibrated")[:, j], width=0.7, color="0.85", label="flown, after calibration")
            style: dict[str, Any] = {"capsize": 2, "markersize": 4, "linewidth": 1}
            before = (flown_deg - found.prediction)[:, j]
            low.errorbar(x - 0.15, before, sigma[:, j], fmt="s", color="#00798c", label="gap before", **style)
            low.errorbar(x + 0.15, after[:, j], sigma[:, j], fmt="o", color="#30343f", label="gap after", **style)
            top.set_title(name, loc="left")
            low.set_xticks(x)
            low.set_xlabel("calibration interval")
        panels[0, 0].set_ylabel("residual (deg)")
        panels[1, 0].set_ylabel("flown − predicted (deg)")
        panels[0, 2].legend(fontsize=7)
        panels[1, 2].legend(fontsize=7)
        drawing.suptitle(
            f"Baseline: {found.trial.baseline.name}; explanation: {found.judgement.best.label}; bars: 1σ of print", fontsize=9
        )
        return save(drawing, path)


def evidence_figure(found: Sequence[Diagnosis], path: Path, most: int = 6, lowest: float = -12.0) -> Path:
    """Probability of the likeliest sets of families under each baseline."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(10.0, 2.1 * ((len(found) + 1) // 2)), layout="constrained")
        panels = drawing.subplots((len(found) + 1) // 2, 2, sharex=True, squeeze=False)
        for axes, diagnosis in zip(panels.ravel(), found, strict=False):
            table = evidence_table(diagnosis).head(most).iloc[::-1]
            length = np.maximum(table["log10_probability"].to_numpy(), lowest) - lowest
            done = " + ".join(sorted(diagnosis.trial.done))
            named = [bool(done) and set(diagnosis.trial.done) <= set(name.split(" + ")) for name in table["hypothesis"]]
            axes.barh(table["hypothesis"], length, left=lowest, color=["#d1495b" if hit else "#00798c" for hit in named])
            axes.set_title(f"baseline: {diagnosis.trial.baseline.name}", loc="left", fontsize=9)
            axes.axvline(np.log10(1 - SURE), color="0.4", linewidth=0.8, linestyle="--")
            axes.set_xlim(lowest, 0)
        for axes in panels[-1]:
            axes.set_xlabel("log$_{10}$ probability (red: has what was done)")
        return save(drawing, path)
