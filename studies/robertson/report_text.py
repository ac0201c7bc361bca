"""What the report of the mission study says around its tables: what is found, and what is not published."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from studies.report.checks import Check, bound_above, check_extremes
from studies.robertson.slews import compute_slew_gaps

LEAD = """
The Mission Mode loop of R, flown from launch to the end of April 1998: rigid body, four wheels, control at 2 Hz, roll and pitch
from the Earth sensor, yaw by gyro with two updates an orbit by the sun sensors, R's uploads on their days. `gyrocal reproduce
--paper robertson` makes this page; [docs/mission.md](../../docs/mission.md) says what the loop does. R is Robertson et al.
(1999), N is Natanson (1998). The periods are R's: before December 11, to February 27, March and April. R's attitude accuracy
is on board minus ground batch. The months are compared with the truth; R's own statistic, and everything of the ladder, is
formed of single orbits with a ground batch over the flown telemetry.
"""

NOT_PUBLISHED = (
    "**How the sun sensors were mounted.** R gives the alignment that the ground solved for, R (3), and the angles of the β "
    "heads, not how the sensors sat. The boresights are raised to where R's own words put them, 29.4° toward zenith. The "
    "default, `solved`, is mounted so that the ground's fit, made at sun angles of 8 to 12°, finds R (3): after its upload the "
    "updates are near noise at those angles and grow away from them. R's 0.10° between the uploads is reached in part.",
    "**(c, d) of R (6)** as printed move yaw by 0.005° (DSS-1) and 0.003° (DSS-2) only. Computed for the raised boresights, "
    "DSS-1's are the printed ones with a zero slipped in c; DSS-2's are so in c, with two zeros, and not in d, whose sign is "
    "the other one. The months fly the computed ones.",
    "**R's asymmetry of +x and −x forward** follows from the sun angle: before February 27 +x forward has the Sun within 15° "
    "of the XZ plane, where the alignment was made, and −x forward up to 58°. An alignment made near one sun angle is used far "
    "from it; see the tables by sun angle and from end to end.",
    "**What is left.** The diagnosis keeps something unknown beside what it finds. Of single numbers: roll before any upload "
    "is too large, updates with the alignment too small, and the scatter of the x bias with the alignment is three times the "
    "flight's. That last one is the sum of R (8)'s share and of the ground's yaw reference, whose error ψ looks like a bias of "
    "∓n ψ about x; in the flight the two cancelled more than here.",
    "**The node at launch**, 46°, is chosen so that the Sun crosses the orbit plane on December 13, when N has a yaw maneuver. "
    "The other dates follow, and are a check.",
    "**Inertia, wheels, torquers, gains, disturbances, noises, the sun sensors' tilt and transfer coefficients, the Earth "
    "sensor's S filter and the order of its quadrants** are assumed. The accuracy of roll and pitch is that of the Earth "
    "sensor's assumed noise, and how the penetration biases divide between roll and pitch follows from the assumed order.",
    "**A gyro bias that changes.** The simulated gyro has white noise only: the scatter that remains after calibration is "
    "that of the white noise over an orbit. The flight's, larger, has its gyro's and its batch solutions' in it.",
)


SLEWS_NOTE = (
    "R does not say which maneuver its Table 2 is of. The simulated ones have the yaw bias that was solved for on board; with "
    "that of before launch instead, G and b alone should give N's residuals of both maneuvers."
)
SCATTER = "The scatter that orientation alone gives with N's pre-launch G, and with G = I, which R (8) is written for."
SPIKES = "The size of the spikes is that of the assumed offset of the S detector; R has a figure of it and no number."
ORIENTATION = "Between the uploads R saw the smaller yaw updates in +x forward and did not know why."
DATES = "R has six yaw maneuvers; the first one here, two days after launch, may be the one that R's do not have."


def build_mission_checks(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> list[Check]:
    """Build the checks against R; a note without a value where nothing was simulated."""
    seeds, by_slew = summary["largest_seed_range_deg"], compute_slew_gaps(tables["table2"])
    out = [Check("range over the seeds of an accuracy or update, largest", _replace_missing(seeds), None, "deg")]
    for name, one in summary["requirements"]["postcalibration"].items():
        # Nothing in the nominal spacecraft shakes it, so that its stability is no answer to R's requirement.
        limit = None if name == "stability" else bound_above(one["limit_deg"])
        out.append(Check(f"R's {name}, calibrated, worst axis", _replace_missing(one["worst_axis_deg"]), limit, "deg"))
    difference = tables["biases"].query("axis == 'z' and forward == '-x minus +x'")
    for period, value in zip(difference["period"], difference["simulated_minus_formula_deg_h"], strict=True):
        out.append(Check(f"z bias in {period}, −x less +x forward, simulated minus R (8)", value, None, "deg/h"))
    for row in tables["bias_scatter"].to_dict("records"):
        for name in ("prelaunch_G", "G_is_I"):
            apart = row[name] - row["flight"]
            out.append(Check(f"scatter of the bias {row['axis']} by {name}, minus the flight's", apart, None, "deg/h", SCATTER))
    for maneuver, value in by_slew.items():
        name = f"yaw maneuver from {format_direction(maneuver)} before calibration, simulated minus R, RMS over axes"
        out.append(Check(name, value, None, "deg", SLEWS_NOTE))
    before = tables["table2"].query("tables == 'calibration1'")
    apart = (before["published_bias_deg"] - before["flight_by_N_deg"]).abs().max()
    out.append(Check("yaw maneuvers by G and the published b alone, minus N's, largest", apart, None, "deg", SLEWS_NOTE))
    for state, one in summary["spikes_deg"].items():
        for kind, where in (("pitch_on_board", "on board"), ("pitch", "true")):
            out.append(Check(f"largest pitch error {where}, S filter {state}", one[kind], None, "deg", SPIKES))
    updates = tables["orientation"].query("period == 'calibration1'").set_index("forward")["yaw_update_deg"]
    apart = updates["+x"] - updates["-x"]
    out.append(Check("yaw updates between the uploads, +x less −x forward", apart, None, "deg", ORIENTATION))
    out.append(Check("yaw maneuvers", len(tables["yaw_maneuvers"]), None, "", DATES))
    days = tables["yaw_maneuvers"]["simulated_minus_flight_days"]
    out += check_extremes("yaw maneuver, simulated minus flown", days, None, "days", DATES)
    return out


def _replace_missing(number: float | None) -> float:
    return math.nan if number is None else number


def format_direction(name: str) -> str:
    """A direction of flight with a minus that is one."""
    return name.replace("-", "−")
