"""A prediction by gyro alone as one page: the attitude and its sigma over time."""

import numpy as np
import pandas as pd

from gyrocal import attitude
from gyrocal.estimation.predict import Prediction
from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import AXIS_COLOURS, AXIS_LINE_STYLES, Line, draw_panels, make_curves

ARCSEC_PER_RAD = float(np.rad2deg(1.0)) * 3600
ROWS = 12  # of the table


def tabulate_prediction(prediction: Prediction) -> pd.DataFrame:
    """Build a row a time: quaternion inertial to body, scalar last, and 1-sigma about the body's axes."""
    q, sigma = attitude.quaternion_from_matrix(prediction.A), prediction.sigma * ARCSEC_PER_RAD
    return pd.DataFrame(
        {"t_s": prediction.t_s}
        | {f"q{k + 1}": q[:, k] for k in range(4)}
        | {f"sigma_{axis}_arcsec": sigma[:, k] for k, axis in enumerate("xyz")}
    )


def build_prediction_page(
    prediction: Prediction, title: str, from_s: float, provenance: ProvenanceFooter | None = None
) -> Page:
    """Build the page of a prediction from the last reference that may be used, at from_s."""
    table, sigma, t = tabulate_prediction(prediction), prediction.sigma * ARCSEC_PER_RAD, prediction.t_s - from_s
    lines = [Line(t, sigma[:, k], axis, AXIS_COLOURS[axis], AXIS_LINE_STYLES[axis]) for k, axis in enumerate("xyz")]
    panel = make_curves(lines, x="s after the last reference", y="sigma (arcsec)", legend="upper left")
    first, last = (f"{row.max():.3g}" for row in sigma[[0, -1]])
    picture = Picture(
        "sigma",
        lambda: draw_panels(panel, size=(8.0, 3.4)),
        f"One sigma of the attitude about x, y and z over {t[-1]:.4g} s, from {first} to {last} arcsec.",
        "One sigma about each body axis, from the references' errors, the gyro's noise, and its parameters.",
    )
    chi2 = f"{prediction.chi2:.1f} of {prediction.dof}"
    reference_check = f"{prediction.used} references are used; their χ² about their predictions is {chi2}."
    shown_rows = table.iloc[np.unique(np.linspace(0, len(table) - 1, ROWS).round().astype(int))]
    attitude_table = PageTable(shown_rows.apply(_format_column), label=f"Attitude from {from_s:g} s by gyro alone")
    section = Section("The attitude", [attitude_table])
    heading = f"By gyro alone the attitude is known to {last} arcsec after {t[-1]:.4g} s"
    return Page(heading, [section], Answer("", picture, reference_check), provenance, f"Prediction of {title}")


def _format_column(column: pd.Series) -> pd.Series:
    """Format a column as texts, all in one form."""
    form = "{:.6f}" if str(column.name).startswith("q") else "{:.1f}" if column.name == "t_s" else "{:.2f}"
    return column.map(form.format)
