"""R's own statistics, the geometry, the ladder and its diagnosis, and the story from end to end: tables, figures, summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from simulator.mission_mode.flight import MissionRun
from studies.report.panels import DARK, RED, TEAL, Draw, Line, curves, sheet
from studies.robertson import all_data, diagnosis, end_to_end, geometry, ladder, printed_coefficients, stability
from studies.robertson.calendar import PERIODS
from studies.robertson.figures import YELLOW
from studies.robertson.performance import AXES, within
from studies.robertson.windows import NUMBERS, published, simulated

BINS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)

TITLES = {
    "statistics": "R Table 3 by what it is compared with (deg, deg/h)",
    "ladder": "The ladder: RMS factor between simulated and flown",
    "ladder_numbers": "R Table 3 on every rung (deg, deg/h)",
    "diagnosis": "What parts the nominal from the flight",
    "diagnosis_sizes": "Sizes of the likeliest explanation",
    "diagnosis_left": "Flown minus simulated with the listed effects of that explanation, in sigmas",
    "all_data_ladder": "R's other data on every rung: Table 2, R (3), R (6), orientation signs",
    "all_data_numbers": "R's other data, number by number",
    "all_data": "What the other data change in the diagnosis",
    "printed_coefficients": "How probably R (6) is as printed, has lost zeros, or is something else",
    "sun_angles": "Yaw updates by sun angle, sensor and orientation (deg)",
    "availability": "Share of the orbit with sun sensor data, by the boresights' tilt and elevation toward zenith",
    "tangents": "What (c, d) of R (6) say of tan α",
    "chance": "Probability that random digits do as well as R (6)'s, slips allowed",
    "end_to_end": "From end to end: yaw updates by sun angle (deg)",
    "end_to_end_found": "From end to end: what was found, beside R's",
    "table2_change": "R Table 2, before minus after calibration (deg)",
    "stability": "R Table 1's stability with assumed sources of jitter",
}
NOTES = {
    "statistics": "Single orbits through each period, the spacecraft as landed: boresights level, (c, d) as printed. "
    "onboard_minus_true has the scatter of the batch's bias too, since no other solution has one. later_tables: before "
    "December 11 the ground may have used the tables that were uploaded then; R does not say.",
    "ladder": "factor: exp of the RMS logarithm of simulated over flown; 18: all of R Table 3, 12: attitude and updates, 6: "
    "yaw, unfitted: those that no size was fitted on, of the 12 and of all. low, high: 16 to 84 % over windows drawn anew. "
    "Sizes are fitted on the postcalibration period only; the time constant of 250 s is assumed, and which effects are rungs "
    "was chosen with all 18 numbers in view.",
    "diagnosis": "Probability that a cause is at work, in any set; the rest is below 2 %.",
    "all_data_ladder": "R less simulated; no size was fitted on any of it. Sigmas: Table 2's of what R leaves open (duration, "
    "yaw bias), R (3)'s of the early orbits. R (3) is nearly put in, by the mounting. ln B: how much less likely R (6) is than "
    "of the nominal mounting. Ratios: R saw both above one.",
    "all_data_numbers": "change: before less after calibration, yaw maneuver from +x to −x, deg. m: of DSS-2, deg.",
    "printed_coefficients": "Of the nominal mounting, with prior shares, chosen, of 0.6, 0.1, 0.1, 0.2. sigma: of how it is "
    "computed.",
    "all_data": "Probability that a cause is at work: of Table 3 alone, and with the other data and signs in the same linear "
    "model; causes of 2 % in either.",
    "sun_angles": "Months of the nominal spacecraft, all updates of the period.",
    "availability": "Averaged over the sun angles of a year; the nominal spacecraft has a tilt of 20° and 29.4°.",
    "tangents": "Published over the head's angle, as printed and with the power of ten that comes nearest to the geometry. "
    "computed: for the least error at the updates of the nominal spacecraft.",
    "end_to_end": "Sensors as designed but for the heads; alignment at sun angles of 8 to 12°.",
    "table2_change": "The noise of the one flown maneuver is in both of R's columns and cancels, as for N.",
    "stability": "Largest peak to peak within a second over an orbit of the calibrated spacecraft, by the loop's cycle. size: "
    "assumed, not TRMM's. closed_form: on the axis moved most; size_of_limit: that which alone uses up 0.1°. Steps of the "
    "arrays last two cycles here while the body drifts back, so that less is flown. The body is rigid; one that rings "
    "moves more. `gyrocal mission OUT --calibrated --effect scan_torque=1` or `--effect array_step=0.1` flies one.",
}


@dataclass(frozen=True)
class AgainstFlight:
    """What the section is made of.

    Attributes
    ----------
    tables : by the names of `TITLES`
    figures : by name, with their titles
    summary : for summary.json
    """

    tables: dict[str, pd.DataFrame]
    figures: dict[str, tuple[str, Draw]]
    summary: dict[str, Any]


def section(
    windows: dict[tuple[str, ...], pd.DataFrame],
    further: dict[tuple[str, ...], dict[str, float]],
    months: Sequence[MissionRun],
    table2: pd.DataFrame,
    entropy: int,
) -> AgainstFlight:
    """All of it; one story is flown here."""
    rungs, found, story = ladder.ladder(windows), diagnosis.diagnose(windows), end_to_end.story(entropy)
    together = all_data.diagnose(windows, further)
    share, numbers = geometry.availability_table(), geometry.tangents()
    updates = sun_angles(months)
    tables = {
        "statistics": statistics(windows[ladder.LANDED]),
        "ladder": pd.DataFrame(rungs),
        "ladder_numbers": ladder.numbers_table(windows, published()),
        **diagnosis.tables(found),
        "all_data_ladder": all_data.rungs_table(windows, further),
        "all_data_numbers": all_data.numbers_table(further),
        "all_data": all_data.probabilities_table(found, together),
        "printed_coefficients": printed_coefficients.readings(ladder.NOMINAL),
        "sun_angles": updates,
        "availability": share,
        "tangents": numbers,
        "chance": pd.DataFrame([{"numbers": name, "probability": p} for name, p in geometry.chance().items()]),
        "end_to_end": story.updates,
        "end_to_end_found": story.compared(),
        "table2_change": table2_change(table2),
        "stability": stability.stability_table(entropy),
    }
    figures = {
        "figure6_geometry": ("R Figure 6: fields of view of the sun sensors", geometry.figure6()),
        "ladder": ("The ladder from the Mission Mode as landed to the flight", ladder_figure(pd.DataFrame(rungs))),
        "figure10_sun_angle": ("Yaw updates against the sun angle", sun_angle_figure(months)),
    }
    summary = {
        "ladder": rungs,
        "diagnosis": told(found),
        "diagnosis_all_data": told(together),
        "geometry": geometry.geometry_summary(share, numbers),
        "end_to_end": {
            "updates_deg": story.updates.to_dict("records"),
            "c_d": [list(one) for one in story.factors],
            "m_dss_2_deg": story.misalignment.tolist(),
        },
        "stability": stability.told(tables["stability"]),
    }
    return AgainstFlight(tables, figures, summary)


def told(found: diagnosis.Diagnosis) -> dict[str, Any]:
    """A diagnosis for the summary."""
    closed = found.closed
    return {
        "verdict": diagnosis.verdict(found),
        "probabilities": found.probabilities,
        "unknown": found.attribution.unknown,
        "periods_held_out": None if closed is None else {"before": closed.before, "after": closed.after, "floor": closed.floor},
    }


def statistics(rows: pd.DataFrame) -> pd.DataFrame:
    """The 18 numbers of one set of windows against the truth, the ground, and a ground with the tables found later."""
    early = rows[rows["period"] == PERIODS[0]]
    kinds = {name: simulated(rows, name) for name in ("onboard_minus_true", "onboard_minus_ground")}
    out = []
    for number in NUMBERS:
        parameter, axis, period = number
        row: dict[str, Any] = {"parameter": parameter, "axis": axis, "period": period, "flight": published()[number]}
        row |= {name: values[number] for name, values in kinds.items()}
        own = period == PERIODS[0] and parameter == "attitude_accuracy_deg"
        row["later_tables"] = float(early[f"later_onboard_minus_ground_{axis}_deg"].mean()) if own else np.nan
        out.append(row)
    return pd.DataFrame(out)


def sun_angles(months: Sequence[MissionRun]) -> pd.DataFrame:
    """Mean size of the yaw updates, a row a period, orientation, sensor and bin of the sun angle."""
    out = []
    for period in PERIODS:
        updates = pd.concat([within(run.updates, period) for run in months])
        place = pd.cut(updates["sun_angle_deg"].abs(), BINS_DEG, labels=[f"{a:g} to {b:g}" for a, b in pairwise(BINS_DEG)])
        for (forward, sensor, angle), own in updates.groupby(["forward", "sensor", place], observed=True):
            row = {"period": period, "forward": forward, "sensor": f"DSS-{sensor}", "sun_angle_deg": angle}
            out.append(row | {"updates": len(own), "yaw_update_deg": float(own["update_deg"].abs().mean())})
    return pd.DataFrame(out)


def table2_change(table2: pd.DataFrame) -> pd.DataFrame:
    """R Table 2 before minus after calibration, flown, simulated and by G and b alone."""
    out = []
    keys = ["maneuver", "axis"]
    before, after = (table2[table2["tables"] == name].set_index(keys) for name in ("calibration1", "postcalibration"))
    for maneuver in before.index.get_level_values(0).unique():
        for axis in AXES:
            row: dict[str, Any] = {"maneuver": maneuver, "axis": axis}
            for name in ("flight_deg", "simulated_deg", "noise_free_deg", "flight_by_N_deg"):
                row[name] = float(before.loc[(maneuver, axis), name] - after.loc[(maneuver, axis), name])
            out.append(row | {"simulated_minus_flight_deg": row["simulated_deg"] - row["flight_deg"]})
    return pd.DataFrame(out)


def ladder_figure(rungs: pd.DataFrame) -> Draw:
    """The four factors rung by rung."""
    x = np.arange(1, len(rungs) + 1)
    colours = {"factor_18": DARK, "factor_12": RED, "factor_6": TEAL, "factor_unfitted": YELLOW}
    words = {"factor_18": "all 18", "factor_12": "12 of attitude", "factor_6": "6 of yaw", "factor_unfitted": "not fitted"}
    lines = [Line(x, rungs[name], words[name], colour, "o-") for name, colour in colours.items()]
    names = ", ".join(f"{k} {name}" for k, name in zip(x, rungs["effect"], strict=True))
    panel = curves(lines, x="rung", y="RMS factor, simulated to flown", ticks=x.tolist(), levels=(1.3,))
    return sheet(panel, size=(8.0, 3.8), columns=1, legend="outside lower center", title=names)


def sun_angle_figure(months: Sequence[MissionRun]) -> Draw:
    """Size of each update against the sun angle, a panel a period."""
    panels = []
    for period in PERIODS:
        updates = pd.concat([within(run.updates, period) for run in months])
        lines = []
        for forward, colour in (("+x", RED), ("-x", TEAL)):
            own = updates[updates["forward"] == forward]
            lines.append(Line(own["sun_angle_deg"], own["update_deg"].abs(), f"{forward} forward", colour, ".", size=2.0))
        panels.append(curves(lines, title=period, x="sun angle (deg)", y="update (deg)" if period == PERIODS[0] else ""))
    return sheet(*panels, size=(9.0, 3.2), columns=3, legend="outside upper right")
