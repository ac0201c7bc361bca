"""What the report of the mission study says around its numbers: findings, and what is not published."""

from __future__ import annotations

from typing import Any

import pandas as pd

from studies.robertson import flown
from studies.robertson.slews import gaps

LEAD = """
The Mission Mode loop of R, flown from launch to the end of April 1998: rigid body, four wheels, control at 2 Hz, roll and pitch
from the Earth sensor, yaw by gyro with two updates an orbit by the sun sensors, R's uploads on their days. `gyrocal reproduce
--paper robertson` makes this page; [docs/mission.md](../../docs/mission.md) says what the loop does. R is Robertson et al.
(1999), N is Natanson (1998). The periods are R's: before December 11, to February 27, March and April. "Ground" here is the
truth; the flight's was a batch solution, whose own errors are in the flight's numbers and not in these.
"""

NOT_PUBLISHED = (
    "**How the sun sensors were mounted.** R gives the alignment that the ground solved for, R (3), and the angles of the β "
    "heads, not how the sensors sat. The default, `solved`, is mounted so that a fit of R's equation (2) over the field of "
    "view finds R (3). So what is uploaded is what is true, and after the upload the updates are near noise by construction: "
    "R's 0.10° between the uploads is not reproduced. Other mountings are in the table below; none gives all of R's values.",
    "**(c, d) of R (6)** are published, but move yaw by 0.005° (DSS-1) and 0.003° (DSS-2) only. With the default mounting "
    "there is nothing left for them to mend; the flight's second fall of the updates, 0.10° to 0.04°, is not explained here.",
    "**The node at launch**, 46°, is chosen so that the Sun crosses the orbit plane on December 13, when N has a yaw maneuver. "
    "The other dates follow, and are a check.",
    "**Inertia, wheels, torquers, gains, disturbances, noises, the sun sensors' tilt and transfer coefficients, the Earth "
    "sensor's S filter and the order of its quadrants** are assumed. The accuracy of roll and pitch is that of the Earth "
    "sensor's assumed noise, and how the penetration biases divide between roll and pitch follows from the assumed order.",
    "**A gyro bias that changes.** The simulated gyro has white noise only: the scatter that remains after calibration is "
    "that of the white noise over an orbit. The flight's, larger, has its gyro's and its batch solutions' in it.",
)


def findings(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[str]:
    """Sentences with the numbers, each with what the flight has and the difference; none on what was not flown."""
    update, accuracy = summary["yaw_update_deg"], summary["yaw_accuracy_deg"]
    sentences = [
        "Yaw updates: " + _beside(update, 2) + ".",
        "Yaw accuracy on board: " + _beside(accuracy, 3) + ". Seeds do not explain the differences: their range is below "
        f"{summary['largest_seed_range_deg']:.4f}° in any accuracy or update.",
        _requirements(tables["requirements"]),
        _biases(tables["biases"]),
        _scatter(tables["bias_scatter"]),
        _slews(tables["table2"]),
        _which_slew(tables["table2"]),
        _spikes(summary["spikes_deg"]),
        _orientation(tables["orientation"]),
        _dates(tables["yaw_maneuvers"]),
    ]
    return [one for one in sentences if one]


def _beside(values: dict[str, dict[str, float | None]], digits: int) -> str:
    words = {"precalibration": "before any upload", "calibration1": "with the alignment", "postcalibration": "calibrated"}
    cells = []
    for period, one in values.items():
        simulated, flight = one["simulated"], one["flight"]
        if simulated is not None and flight is not None:
            cells.append(f"{words[period]} {simulated:.3f}° (flight {flight:.{digits}f}°, {simulated - flight:+.3f}°)")
    return "; ".join(cells)


def _requirements(table: pd.DataFrame) -> str:
    flown_ones = table[table["simulated_deg"].notna()]
    where = ", ".join(
        f"{row.requirement} of {row.axis} {row.simulated_deg:.2f}° of {row.limit_deg:g}° in {row.period}"
        for row in flown_ones[~flown_ones["met"]].itertuples()
    )
    calibrated = flown_ones[flown_ones["period"] == "postcalibration"]
    worst = ", ".join(
        f"{name} {value:.3f}° of {flown.requirement(str(name)):g}°"
        for name, value in calibrated.groupby("requirement", sort=False)["simulated_deg"].max().items()
    )
    return f"R's requirements: not met: {where or 'none'}" + (f"; calibrated, the worst axis: {worst}." if worst else ".")


def _biases(table: pd.DataFrame) -> str:
    rows = table[(table["axis"] == "z") & (table["forward"] == "-x minus +x")].set_index("period")
    if rows["simulated_deg_h"].isna().any():
        return ""
    before, after = rows.loc["calibration1"], rows.loc["postcalibration"]
    return (
        f"Bias of the z gyro, −x minus +x forward: {before['simulated_deg_h']:.3f} deg/h before the gyro's upload (R (8): "
        f"{before['formula_deg_h']:.3f}), {after['simulated_deg_h']:+.4f} ± {after['standard_error_deg_h']:.4f} after."
    )


def _scatter(table: pd.DataFrame) -> str:
    if table["prelaunch_G"].isna().any():
        return ""
    cells = "; ".join(
        f"{row.axis}: flight {row.flight:.3f}, with N's pre-launch G {row.prelaunch_G:.3f}, with G = I {row.G_is_I:.3f}"
        for row in table.itertuples()
    )
    return (
        f"Scatter of the bias before the gyro's upload by orientation alone, deg/h: {cells}. The flight's x and z are nearer "
        "to the pre-launch G's than to those of G = I, which R (8) is written for; x is unlike either, y is alike in both."
    )


def _slews(table: pd.DataFrame) -> str:
    best = min(gaps(table).items(), key=lambda item: item[1])[0]
    cells = []
    for tables, words in (("calibration1", "before"), ("postcalibration", "after")):
        numbers = [
            f"{row.axis} {row.simulated_deg:+.3f} ± {row.std_deg:.3f}° (flight {row.flight_deg:+.3f}°, "
            f"{row.simulated_minus_flight_deg:+.3f}°)"
            for row in table[(table["maneuver"] == best) & (table["tables"] == tables)].itertuples()
        ]
        cells.append(f"{words} the gyro's calibration " + ", ".join(numbers))
    return f"Yaw maneuver from {signed(best)}, propagated minus true: " + "; ".join(cells) + "."


def _which_slew(table: pd.DataFrame) -> str:
    by_size = sorted(gaps(table).items(), key=lambda item: item[1])
    cells = " and ".join(f"{value:.3f}° from {signed(name)}" for name, value in by_size)
    before = table[table["tables"] == "calibration1"]
    apart = (before["published_bias_deg"] - before["flight_by_N_deg"]).abs().max()
    return (
        "R does not say which maneuver Table 2 is of. Simulated minus flown before calibration, RMS over the axes, is "
        f"{cells}; the line above is on the first, with the yaw bias that was solved for on board before it. With the bias "
        f"of before launch instead, G and b alone give N's residuals of both maneuvers within {apart:.2f}°."
    )


def _spikes(values: dict[str, dict[str, float]]) -> str:
    return (
        "Sun in a quadrant of the Earth sensor, largest pitch error on board and true: "
        + ", ".join(f"S filter {state} {one['pitch_on_board']:.3f}° and {one['pitch']:.3f}°" for state, one in values.items())
        + ". The size is that of the assumed offset of the S detector; R has a figure of it and no number."
    )


def _orientation(table: pd.DataFrame) -> str:
    rows = table[table["period"] == "calibration1"].set_index("forward")["yaw_update_deg"]
    if rows.isna().any():
        return ""
    return (
        f"Between the uploads, yaw updates are {rows['+x']:.3f}° in +x forward and {rows['-x']:.3f}° in −x forward. R saw the "
        f"smaller ones in +x forward and did not know why; here they are in {signed(str(rows.idxmin()))} forward."
    )


def _dates(table: pd.DataFrame) -> str:
    near = table[table["flight"] != ""]
    if near.empty:
        return ""
    cells = ", ".join(f"{row.flight_utc} {row.simulated_minus_flight_days:+.1f} days" for row in near.itertuples())
    return (
        f"{len(table)} yaw maneuvers against R's six; the first, two days after launch, may be the one that R's do not have. "
        f"Simulated minus flown where a date is published: {cells}."
    )


def signed(name: str) -> str:
    """A direction of flight with a minus that is one."""
    return name.replace("-", "−")
