"""What ``gyrocal calibrate`` prints of references by several sensors: their mountings, and whether they agree."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from gyrocal.calibration.trackers import Difference, MountingEstimate
from studies.report import tables

DOUBT = 0.01  # p-value below which two sensors do not agree


def show(console: Console, mountings: MountingEstimate | None, compared: Sequence[Difference]) -> None:
    """Print both; nothing of a single sensor."""
    if mountings is not None:
        shown = mountings.summary()
        sigma = shown["sigma_arcsec"]
        for column in ("misalignment_arcsec", "sigma_arcsec"):
            shown[column] = [tables.format_to_sigma(value, one) for value, one in zip(shown[column], sigma, strict=True)]
        tables.print_table(console, "Misalignments from the mountings as stated, about the sensors' own axes", shown)
    for line in list_remarks(compared):
        console.print(line, highlight=False, markup=False)


def list_remarks(compared: Sequence[Difference]) -> list[str]:
    """A sentence for each two sensors that see at one time."""
    lines = []
    for one in compared:
        if one.dof <= 0:
            continue
        free = ", a constant misalignment taken off" if one.estimated else ""
        judged = "they agree within the stated noise"
        if one.p_value < DOUBT:
            judged = "they differ by more than the stated noise; gyrocal diagnose may say why"
        lines.append(
            f"{one.second} against {one.first}, {one.t_s.size} pairs{free}: χ² = {one.chi2:.1f} with {one.dof} degrees of "
            f"freedom, p = {one.p_value:.2g}; {judged}."
        )
    return lines
