"""The flight's published numbers against the simulated motion: what is predicted, what its own residuals give, and in words."""

from typing import Any

import numpy as np
import pandas as pd

from simulator.scenario import Scenario
from studies.natanson import flight, flight_gap, own_residuals, slew_directions, slew_timings
from studies.natanson.flight_diagnosis import numbers
from studies.natanson.flight_diagnosis.baselines import centred
from studies.natanson.flight_diagnosis.table import flown, present
from studies.natanson.products import Products
from studies.natanson.slew_timings import TimingFit
from studies.report.console import progress

SECOND_NOTE = (
    "x_old − x_new, in N's units. Sigma is the spread over 60 simulated calibrations. Since the flight's noise is in the "
    "residuals that are calibrated, it is generous: print and the slews' timings alone leave 0.02 to 0.5 in a cell."
)
AGREEMENT_NOTE = (
    "Farthest: the cell farthest from the flight's. Gradient: the flight's residuals after calibration along the column of Θ "
    "of that parameter; least squares leaves none, print 0.001 deg. At 2 s interval 3's yaw has the sign N Table 4 asks for."
)
THREE = {f"{name}_deg": ".3f" for name in ("flight", "flight_calibrated")}
FOUR = {f"{name}_deg": ".4f" for name in ("predicted", "gap", "clean_gap", "clean_gap_common", "clean_gap_each")}
SCAN_NOTE = "All four timings common to all maneuvers, wherever they can be flown; the CSV has each combination."


def flight_part(scenario: Scenario, products: Products, entropy: int) -> None:
    """Tables and summary of the flight's own numbers."""
    add = products.add
    with progress("flight", 5, products.console.quiet) as advance:
        scan = slew_timings.timing_scan(scenario)
        by_value = slew_timings.scan_by_value(scan)
        add("timing_scan", "Clean gap over all four common timings together", scan, shown=by_value, note=SCAN_NOTE)
        advance(1)
        common = slew_timings.fit_common(scenario)
        advance(1)
        each = slew_timings.fit_each(scenario)
        advance(1)
        directions(scenario, products)
        advance(1)
        own_part(scenario, {"assumed": scenario, "common": common.scenario, "each": each.scenario}, products, entropy)
        advance(1)
    compared = flight_gap.comparison(scenario)
    for name, fit in (("common", common), ("each", each)):
        compared[f"clean_gap_{name}_deg"] = (flight_gap.without_noise() - flight_gap.predict(fit.scenario)).ravel()
    add("flight_gap", "Residuals before calibration at 0.5 s: flown and predicted", compared, formats=THREE | FOUR)
    predicted = flight_gap.predict(scenario)
    assumed = flight_gap.clean_gap_rms(predicted)
    covariance = numbers.motion(flown(), present()).covariance
    products.summary |= {
        "clean_gap_rms_deg": {
            "assumed": assumed,
            "common": common.clean_gap_rms_deg,
            "each": each.clean_gap_rms_deg,
        },
        "clean_gap_scan_deg": {
            "min": float(scan["clean_gap_rms_deg"].min()),
            "median": float(scan["clean_gap_rms_deg"].median()),
            "max": float(scan["clean_gap_rms_deg"].max()),
            "timings": len(scan),
            "share_below_assumed": float(np.mean(scan["clean_gap_rms_deg"] < assumed)),
            "held_out": slew_timings.held_out(scan, slew_timings.timing_of(scenario)),
            "centred_smooth": flight_gap.clean_gap_rms(flight_gap.predict(centred(scenario))),
            "print": float(np.sqrt(np.mean(np.diag(covariance)))),
        },
        "flight_gap_rms_deg": {
            "published": flight_gap.gap_rms(predicted),
            "fitted": common.gap_rms_deg,
            "fitted_values": common.count,
            "fitted_each_maneuver": each.gap_rms_deg,
            "fitted_each_maneuver_values": each.count,
            "scan_min": float(scan["gap_rms_deg"].min()),
            "scan_max": float(scan["gap_rms_deg"].max()),
            "centred_smooth": flight_gap.gap_rms(flight_gap.predict(centred(scenario))),
            "floor": flight_gap.floor_rms(),
            "flight_rms": float(flight.rms(flight.residuals("prelaunch").ravel())),
        },
        "flight_noise": flight_gap.noise_from_steps(),
    }
    add("flight_gap_by_interval", "Gap and clean gap by interval (deg RMS)", gap_table(scenario, common, each))
    add("fitted_timings", "Timings fitted to the clean gap", fitted_table(common, each))
    products.show("flight_gap_by_interval", "own_agreement", "table5_second")
    products.console.print(gap_note(products.summary), highlight=False)


def directions(scenario: Scenario, products: Products) -> None:
    """Signs: of the residual, of the rate in -y forward, of the yaws."""
    add = products.add
    sign = add("residual_sign", "Sign of the residual", flight_gap.residual_sign(scenario))
    rate = add("minus_y_rate", "Interval 4: rate about x", slew_directions.minus_y_rate_test(scenario))
    yaw = add("yaw_directions", "Intervals 2 and 6: direction of the yaw", slew_directions.yaw_direction_test(scenario))
    best = rate.sort_values("gap_rms_deg").iloc[0]
    products.summary |= {
        "minus_y_rate_rpo": {
            "favoured": int(best["rate_rpo"]),
            "gap_rms_deg": {str(int(r["rate_rpo"])): float(r["gap_rms_deg"]) for _, r in rate.iterrows()},
            "fitted_gap_rms_deg": {str(int(r["rate_rpo"])): float(r["fitted_gap_rms_deg"]) for _, r in rate.iterrows()},
        },
        "yaw_direction_deg": {
            str(k): int(rows.sort_values("gap_rms_deg").iloc[0]["yaw_deg"]) for k, rows in yaw.groupby("interval")
        },
        "residual_sign_gap_rms_deg": {
            "N (16)": float(sign["gap_rms_deg"][0]),
            "N (29) as printed": float(sign["gap_rms_deg"][1]),
        },
    }


def own_part(scenario: Scenario, timings: dict[str, Scenario], products: Products, entropy: int) -> None:
    """What the flight's own residuals give: calibrations beside N's, and N Table 5's second iteration.

    Parameters
    ----------
    timings : the scenario with the timings assumed, and with those fitted, by name
    """
    add, by_timings = products.add, {name: own_residuals.steps(one) for name, one in timings.items()}
    found = by_timings["assumed"]
    agreement = own_residuals.agreement(found)
    residuals, parameters = own_residuals.residuals(found), own_residuals.parameters(found)
    flips, sigma = own_residuals.flipped(found), own_residuals.spread(scenario, entropy)
    second = own_residuals.second_iteration(scenario, sigma)
    own = "and what its residuals before give"
    add("own_agreement", "The flight's own residuals calibrated, beside N's", agreement, note=AGREEMENT_NOTE)
    add("own_residuals", f"N Table 2's calibrated columns, {own}", residuals, formats=dict.fromkeys(residuals, ".3f"))
    shown = parameters.map(lambda value: value if isinstance(value, str) else f"{value:.6f}")
    add("own_parameters", "N Table 3's calibrated columns, and what N Table 2's residuals give", parameters, shown=shown)
    add("own_digits", "Printed digits the second iteration changes, of the flight's residuals", flips)
    title = "N Table 5: second iteration in both parametrisations, of the flight's residuals"
    add("table5_second", title, second, note=SECOND_NOTE, formats=dict.fromkeys(second, ".2f"))
    products.summary |= {
        "own_calibration_rms_deg": {
            name: {f"{row['step_s']:g}": row["rms_difference_deg"] for row in own_residuals.agreement(one).to_dict("records")}
            for name, one in by_timings.items()
        },
        "own_calibration": {
            f"{row['step_s']:g}": {
                "as_printed_deg": row["as_printed_deg"],
                "rms_of_the_others_deg": row["rms_of_the_others_deg"],
                "steepest": row["steepest"],
                "gradient_deg": row["gradient_deg"],
            }
            for row in agreement.to_dict("records")
        },
        "own_calibration_farthest": {f"{row['step_s']:g}": row["farthest"] for row in agreement.to_dict("records")},
        "own_digits_changed": {
            f"{row['step_s']:g}": {"table2": row["table2_of_18"], "table4": row["table4_of_6"]}
            for row in flips.to_dict("records")
        },
        "table5_second_iteration": own_residuals.judged(second),
    }


def gap_note(summary: dict[str, Any]) -> str:
    """What the gaps mean, in words."""
    gap, scan, noise = summary["flight_gap_rms_deg"], summary["clean_gap_scan_deg"], summary["flight_noise"]
    return (
        f"Clean gap: {scan['timings']} other common timings give {scan['min']:.4f} to {scan['max']:.4f} deg, "
        f"{100 * scan['share_below_assumed']:.0f} % of them less than the assumed ones; slews in the middle of their intervals "
        f"and all ramp, at the same peak rate, {scan['centred_smooth']:.4f} deg (gap {gap['centred_smooth']:.4f}). "
        f"Print leaves {scan['print']:.4f} deg. "
        f"Gap: its floor is the flight's residual after calibration, {gap['floor']:.4f} deg; other timings give "
        f"{gap['scan_min']:.4f} to {gap['scan_max']:.4f}. The spread between the flight's step sizes says "
        f"gyro noise is {noise['residual_rms_deg']:.4f} deg RMS in a residual (ARW {noise['arw_deg_per_sqrt_s']:.2e} deg/√s), "
        f"of which a calibration of 12 parameters to 18 numbers leaves {noise['residual_rms_deg'] * np.sqrt(6 / 18):.4f} deg."
    )


def gap_table(scenario: Scenario, common: TimingFit, each: TimingFit) -> pd.DataFrame:
    """Gap and clean gap RMS of each interval and of all, for the scenario's timings and both fits, and the gap's floor."""
    predicted = {
        "timings assumed": flight_gap.predict(scenario),
        f"{common.count} common fitted": flight_gap.predict(common.scenario),
        f"{each.count} fitted": flight_gap.predict(each.scenario),
    }
    cells, clean = flight.residuals("prelaunch"), flight_gap.without_noise()
    columns = {"flight": cells}
    columns |= {f"clean gap, {name}": clean - values for name, values in predicted.items()}
    columns |= {f"gap, {name}": cells - values for name, values in predicted.items()}
    columns["gap's floor"] = flight.residuals("calibrated")
    table = pd.DataFrame({"interval": [*(str(k + 1) for k in range(len(cells))), "all"]})
    for name, values in columns.items():
        table[name] = [*flight.rms(values.T), float(flight.rms(values.ravel()))]
    return table


def fitted_table(common: TimingFit, each: TimingFit) -> pd.DataFrame:
    """Fitted timings, and whether they stopped at the bound of what can be flown."""
    return pd.DataFrame(
        [
            {"fit": name, "timing": timing, "fitted": value, "at_bound": timing in fit.at_bound, "degrees_of_freedom": fit.dof}
            for name, fit in (("common", common), ("each maneuver", each))
            for timing, value in fit.timings.items()
        ]
    )


def summary_rows(summary: dict[str, Any]) -> dict[str, str]:
    """The questions on the flight, and the answers of this run."""
    clean, scan, gap = summary["clean_gap_rms_deg"], summary["clean_gap_scan_deg"], summary["flight_gap_rms_deg"]
    rate, own, second = (
        summary["minus_y_rate_rpo"],
        summary["own_calibration_rms_deg"]["assumed"],
        summary["table5_second_iteration"],
    )
    digits = summary["own_digits_changed"]

    def told(space: str) -> str:
        found, mixed = second[space], second[space]["with_G_of_0.5_s"]
        return (
            f"correlation {found['correlation']:.2f} ({mixed['correlation']:.2f} with G⁻¹ at 0.5 s, as its first iteration); "
            f"RMS {found['rms_1e6_G']:.2f}e-6 and {found['rms_1e8_deg_s']:.1f}e-8 deg/s; "
            f"{found['cells_beyond_3_sigma']} of 12 cells beyond 3 sigma"
        )

    return {
        "Is the flight's motion predicted?": f"clean gap {clean['assumed']:.4f} deg RMS of "
        f"{gap['flight_rms']:.3f}, timings assumed; {scan['min']:.4f} to {scan['max']:.4f} with others; "
        f"print leaves {scan['print']:.4f}",
        "And with timings fitted?": f"clean gap {clean['common']:.4f} deg RMS with four common, {clean['each']:.4f} with nine",
        "And with the flight's noise?": f"gap {gap['published']:.4f} deg RMS, timings assumed; floor {gap['floor']:.4f}",
        "Do its residuals before give those after?": "to "
        + " / ".join(f"{own[step]:.4f}" for step in ("0.5", "1", "2"))
        + " deg RMS at 0.5 / 1 / 2 s, by a calibration with simulated motion",
        "N Table 5's 2nd iteration, in gyro space?": told("gyro_space"),
        "And in (G, b)?": told("gain_space"),
        "Does that change a printed digit?": "of the flight's N Table 2: "
        + " / ".join(str(digits[step]["table2"]) for step in ("0.5", "1", "2"))
        + " of 18 cells at 0.5 / 1 / 2 s; Table 4: "
        + " / ".join(str(digits[step]["table4"]) for step in ("0.5", "1", "2"))
        + " of 6",
        "Rate about x in -y forward?": f"{rate['favoured']:+d} RPO: gap {rate['gap_rms_deg']['-1']:.3f} deg against "
        f"{rate['gap_rms_deg']['1']:.3f} ({rate['fitted_gap_rms_deg']['1']:.3f} with any timing that can be flown)",
    }
