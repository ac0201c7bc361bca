"""The output of ``gyrocal next``: the test of the prediction, then its intervals and axes."""

import pandas as pd
from rich.console import Console

from diagnosis.next_recording import RecordingPrediction
from studies.report import tables

NEXT_RECORDING_NOTE = (
    "residual: root mean square of the attitude residuals; band: its expectation; effect: expected part of the identified "
    "effects; p: of this interval and axis alone"
)


def describe_prediction(found: RecordingPrediction) -> list[str]:
    """The result in sentences."""
    with_effects = f" with {', '.join(found.causes)}" if found.causes else ""
    one = found.predicted
    out = [
        f"{found.following}, predicted from {', '.join(found.recordings)}{with_effects}: χ² {one.chi2:.1f} of {one.dof}, "
        f"p = {one.p_value:.2g}"
    ]
    if found.causes:
        out.append(f"With G and b alone: p = {found.baseline.p_value:.2g}")
    if found.verdict in ("unknown", "not identifiable"):
        out.append(f"The recordings before have a gap whose cause is {found.verdict}: it is not in the prediction")
    if found.left_out:
        out.append(f"Named, but not in the prediction: {', '.join(found.left_out)}")
    return [*out, *found.notes]


def show(console: Console, found: RecordingPrediction) -> None:
    """Print all of it."""
    for line in describe_prediction(found):
        console.print(line, highlight=False, markup=False, emoji=False)
    bands = pd.DataFrame([vars(band) for band in found.predicted.bands])
    tables.print_table(console, "Residuals by interval and axis", bands, NEXT_RECORDING_NOTE)
