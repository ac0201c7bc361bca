"""A prediction by gyro alone as one page: how far its attitude is off after which time, and what it rests on."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from gyrocal import attitude
from gyrocal.estimation.predict import Prediction
from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import AXIS_COLOURS, AXIS_LINE_STYLES, Line, draw_panels, make_curves

ARCSEC_PER_DEG = 3600.0  # a degree
ROWS = 12  # of the table


def tabulate_prediction(found: Prediction) -> pd.DataFrame:
    """A row a time: inertial to body, scalar last, and 1-sigma about the body's axes."""
    q, sigma = attitude.quaternion_from_matrix(found.A), np.rad2deg(found.sigma) * ARCSEC_PER_DEG
    return pd.DataFrame(
        {"t_s": found.t_s}
        | {f"q{k + 1}": q[:, k] for k in range(4)}
        | {f"sigma_{axis}_arcsec": sigma[:, k] for k, axis in enumerate("xyz")}
    )


def build_prediction_page(
    found: Prediction, title: str, from_s: float, table: pd.DataFrame, made: ProvenanceFooter | None = None
) -> str:
    """The whole page.

    Parameters
    ----------
    found : the prediction
    title : of the recording
    from_s : time of the last reference that may be used, s
    table : a row a time, as the command writes it
    made : for the footer
    """
    sigma = np.rad2deg(found.sigma) * ARCSEC_PER_DEG
    last, length = sigma[-1].max(), found.t_s[-1] - from_s
    chosen = np.unique(np.linspace(0, len(table) - 1, ROWS).round().astype(int))
    picture = Picture(
        "sigma",
        lambda: _draw_figure(found.t_s - from_s, sigma),
        f"One sigma of the attitude about x, y and z over {length:.4g} s, from {sigma[0].max():.3g} to {last:.3g} arcsec.",
        "One sigma about each body axis: what is left of the references' errors, the gyro's noise, and its parameters.",
    )
    used = f"{found.used} references are used; their χ² about their predictions is {found.chi2:.1f} of {found.dof}."
    rows = table.iloc[chosen].apply(_format_column)
    heading = f"By gyro alone the attitude is known to {last:.3g} arcsec after {length:.4g} s"
    short = f"Prediction of {title}"
    sections = [Section("The attitude", [PageTable(rows, label=f"{short} from {from_s:g} s")])]
    return Page(heading, sections, Answer("", picture, used), made, short).render_html()


def _format_column(column: pd.Series) -> pd.Series:
    """Texts of a column, all in one form."""
    form = "{:.6f}" if str(column.name).startswith("q") else "{:.1f}" if column.name == "t_s" else "{:.2f}"
    return column.map(form.format)


def _draw_figure(t: np.ndarray, sigma: np.ndarray) -> Figure:
    lines = [Line(t, sigma[:, k], axis, AXIS_COLOURS[axis], AXIS_LINE_STYLES[axis]) for k, axis in enumerate("xyz")]
    panel = make_curves(lines, x="s after the last reference", y="sigma (arcsec)", legend="upper left")
    return draw_panels(panel, size=(8.0, 3.4))
