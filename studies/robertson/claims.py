"""What R claims, each beside what was found; the places are those of the paper, the numbers those of the reproduction."""

from __future__ import annotations

from itertools import pairwise

import pandas as pd

from studies.report.claims import Claim, Judge, PaperResults, Verdict, decide_agreement, decide_slip, make_agreement_judge
from studies.robertson.calendar import PERIODS

FACTOR = 1.1  # between simulated and flown numbers that agree
DISTINCT_SIGMAS = 3.0  # sigma
TANGENT_TOLERANCE = 0.15  # relative: tan α of a mended (c, d) against the geometry's


def _describe_requirement(found: PaperResults, period: str, name: str) -> tuple[bool, str]:
    path = f"requirements.{period}.{name}"
    value, limit = found[f"{path}.worst_axis_deg"], found[f"{path}.limit_deg"]
    return bool(found[f"{path}.met"]), f"{name} {value:.3f} of {limit:g} deg on the worst axis"


def _judge_requirements(found: PaperResults) -> tuple[Verdict, str]:
    both = [_describe_requirement(found, PERIODS[-1], name) for name in ("knowledge", "pointing")]
    return decide_agreement(all(met for met, _ in both)), f"Simulated: {', '.join(text for _, text in both)}."


def _judge_stability(found: PaperResults) -> tuple[Verdict, str]:
    value = found[f"requirements.{PERIODS[-1]}.stability.worst_axis_deg"]
    text = f"{value:.4f} deg in a second, but nothing in the nominal spacecraft shakes it: not verified."
    try:
        scan, step = (found[f"stability.size_of_limit.{name}"] for name in ("instrument scan (N m)", "array steps (deg)"))
    except KeyError:
        return "open", text
    return "open", f"{text} The limit would take {scan:.0f} N m of a scan at 31.6 rpm or steps of the arrays of {step:.1f}°."


def _judge_performance(found: PaperResults) -> tuple[Verdict, str]:
    rungs = found.table("ladder")
    first, last = rungs.iloc[0], rungs.iloc[-1]
    text = (
        f"Simulated and flown differ by a factor of {first['factor_18']:.2f} as landed and of {last['factor_18']:.2f} with the "
        f"effects found ({last['factor_unfitted']:.2f}, {last['factor_unfitted_low']:.2f} to "
        f"{last['factor_unfitted_high']:.2f}, on numbers that fitted nothing); something unknown is left with a probability of "
        f"{found['diagnosis.unknown']:.2f}."
    )
    return decide_agreement(last["factor_unfitted_low"] < FACTOR), text


def _judge_yaw_updates(found: PaperResults) -> tuple[Verdict, str]:
    simulated, flown = ([found[f"yaw_update_deg.{one}.{key}"] for one in PERIODS] for key in ("simulated", "flight"))
    falls = all(a > b for a, b in pairwise(simulated))
    shown = [" / ".join(f"{one:.{digits}f}" for one in values) for values, digits in ((simulated, 3), (flown, 2))]
    return decide_agreement(falls), f"Yaw updates fall from upload to upload: {shown[0]} deg simulated, {shown[1]} flown."


def _judge_bias_x(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("ladder_numbers").query("parameter == 'gyro_bias_std_deg_h' and axis == 'x'").set_index("period")
    last = rows.columns[-2]
    before, after = rows.loc["calibration1"], rows.loc["postcalibration"]
    text = (
        f"Flown {before['flight']:.3f} to {after['flight']:.3f} deg/h, simulated {before[last]:.3f} to {after[last]:.3f}: the "
        "scatter before the gyro's upload is not explained."
    )
    ratio = float(rows["last_over_flight"].to_numpy(dtype=float)[0])
    return decide_agreement(1 / FACTOR < ratio < FACTOR), text


def _judge_targeting(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("table2").query("maneuver == '+x to -x'").set_index(["tables", "axis"])
    first, last = rows.loc["calibration1"], rows.loc["postcalibration"]
    better = bool((last["simulated_deg"].abs() < first["simulated_deg"].abs()).all())
    shown = [", ".join(f"{value:+.3f}" for value in part["simulated_deg"]) for part in (first, last)]
    flown = [", ".join(f"{value:+.3f}" for value in part["flight_deg"]) for part in (first, last)]
    return decide_agreement(better), (
        f"Roll, pitch, yaw: {shown[0]} deg before and {shown[1]} after; flown {flown[0]} and {flown[1]}. The gap before is "
        f"{found['slew_gap_deg.+x to -x']:.3f} deg RMS."
    )


def _judge_yaw_residual(found: PaperResults) -> tuple[Verdict, str]:
    row = found.table("table2").query("maneuver == '+x to -x' and tables == 'postcalibration' and axis == 'yaw'").iloc[0]
    apart = abs(row["simulated_minus_flight_deg"]) / row["std_deg"]
    simulated, flown = f"{row['simulated_deg']:+.3f} ± {row['std_deg']:.3f}", f"{row['flight_deg']:+.3f}"
    text = f"Simulated {simulated} deg, {apart:.1f} sigma from the flown {flown}."
    return decide_agreement(apart < DISTINCT_SIGMAS), text


def _judge_heads(found: PaperResults) -> tuple[Verdict, str]:
    checks = found.study("heads", "checks").set_index("check")["value"].astype(float)
    right = checks["share of right answers, R's heads, misalignment and biases"]
    wrong = checks["diagnoses with a wrong name"]
    text = (
        f"Diagnosed from simulated months, the heads are named in {100 * right:.0f} % of them, with {wrong:.0f} wrong names in "
        f"all; an orthogonal calibration would find a misalignment of "
        f"{checks['misalignment that an orthogonal calibration makes of heads alone']:.2f} deg that is not there."
    )
    return decide_agreement(right == 1.0 and wrong == 0), text


def _judge_orientation(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("orientation").set_index(["period", "forward"])["yaw_update_deg"]
    plus, minus = rows["calibration1", "+x"], rows["calibration1", "-x"]
    ends = [rows["postcalibration", one] for one in ("+x", "-x")]
    text = (
        f"Simulated {plus:.3f} deg in +x and {minus:.3f} in -x forward, {ends[0]:.3f} and {ends[1]:.3f} after the upload: the "
        "alignment was made at sun angles of +x forward and used far from them in -x forward."
    )
    return decide_agreement(minus > plus and max(ends) < minus), text


def _make_coefficient_judge(sensor: str) -> Judge:
    def judge(found: PaperResults) -> tuple[Verdict, str]:
        rows = found.table("tangents")
        rows = rows[rows["sensor"] == sensor]
        slipped = rows[(rows["slip"] != 1) & ((rows["tan_alpha"] / rows["geometry"] - 1).abs() < TANGENT_TOLERANCE)]
        parts = [f"{r.number} printed {r.published_1e6:g}e-6, computed {r.computed_1e6:.0f}e-6" for r in rows.itertuples()]
        same_sign = bool((rows["published_1e6"] * rows["computed_1e6"] > 0).all())
        text = f"{'; '.join(parts)}."
        if not same_sign:
            return "open", f"{text} The signs do not agree."
        extra = "".join(f" A power of ten ({one.slip:g}) in {one.number} would make it fit." for one in slipped.itertuples())
        return decide_slip(len(slipped) > 0), text + extra

    return judge


def _judge_boresights(found: PaperResults) -> tuple[Verdict, str]:
    level, raised, best = (found[f"geometry.share_{one}"] for one in ("level", "raised", "best"))
    text = (
        f"Raised {found['geometry.elevation_deg']:.1f}° toward zenith they see the Sun in {100 * raised:.0f} % of an orbit, "
        f"level in {100 * level:.0f} %; the best there is gives {100 * best:.0f} %."
    )
    return decide_agreement(raised > 0.95 * best), text


def _judge_alignment(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("end_to_end_found").iloc[:3]
    pairs = ", ".join(f"{a:+.2f} ({b:+.2f})" for a, b in zip(rows["found"], rows["R"], strict=True))
    near = bool(((rows["found"] - rows["R"]).abs() < 0.05).all())
    return decide_agreement(
        near
    ), f"Calibrated again from end to end, with the heads alone: {pairs} deg about x, y, z; R's in brackets."


def _judge_dates(found: PaperResults) -> tuple[Verdict, str]:
    days = pd.to_numeric(found.table("yaw_maneuvers")["simulated_minus_flight_days"]).dropna()
    text = f"{len(days)} dates are known; the simulated ones are off by {days.min():+.2f} to {days.max():+.2f} days."
    return decide_agreement(bool(days.abs().max() < 1)), text


TABLE3, LADDER = "R Table 3: Mission Mode performance", "The ladder: RMS factor between simulated and flown"
TABLE2, TABLE1 = "R Table 2: attitude error of the yaw maneuver (deg, propagated minus true)", "R Table 1: requirements"
BEFORE, AFTER = (f"bias_z_minus_x_less_plus_x_deg_h.{period}" for period in PERIODS[1:])
COEFFICIENTS = "What (c, d) of R (6) say of tan α"
ROBERTSON_CLAIMS = (
    Claim(
        "R Table 1, Conclusion", "Knowledge and pointing meet the requirements after calibration", TABLE1, _judge_requirements
    ),
    Claim("R Table 1", "So does stability", TABLE1, _judge_stability),
    Claim(
        "R, On-orbit Performance",
        "Before calibration yaw did not meet them",
        TABLE1,
        make_agreement_judge(
            "Simulated: knowledge {requirements.precalibration.knowledge.worst_axis_deg:.3f} of "
            "{requirements.precalibration.knowledge.limit_deg:g} deg on the worst axis.",
            lambda found: not found["requirements.precalibration.knowledge.met"],
        ),
    ),
    Claim("R Table 3", "18 numbers of accuracy, yaw update and bias scatter", LADDER, _judge_performance),
    Claim("R Figures 9, 10", "The uploads reduced the yaw updates", TABLE3, _judge_yaw_updates),
    Claim(
        "R Table 3",
        "The scatter of the x bias rises with the calibration",
        "R Table 3 on every rung (deg, deg/h)",
        _judge_bias_x,
    ),
    Claim("R, Sensor Calibration", "Head misalignment caused the yaw updates", "Study heads", _judge_heads),
    Claim(
        "R, DSS Calibration",
        "“Unexplained”: smaller updates in +x than in -x forward, before the coefficients",
        "Yaw updates by sun angle, sensor and orientation (deg)",
        _judge_orientation,
    ),
    Claim("R (3)", "The misalignment of DSS-2", "From end to end: what was found, beside R's", _judge_alignment),
    Claim("R (6)", "c and d of DSS-1", COEFFICIENTS, _make_coefficient_judge("DSS-1")),
    Claim("R (6)", "c and d of DSS-2", COEFFICIENTS, _make_coefficient_judge("DSS-2")),
    Claim(
        "R, Figure 6",
        "Boresights chosen to maximize the time with sun sensor data",
        "Share of the orbit with sun sensor data, by the boresights' tilt and elevation toward zenith",
        _judge_boresights,
    ),
    Claim(
        "R Figure 8",
        "Spikes by the S filter's restart; smaller with the filter off",
        "R Figure 8: position error while the Sun is in a quadrant's view",
        make_agreement_judge(
            "Largest pitch error on board: {spikes_deg.restarted.pitch_on_board:.3f} deg with the filter restarted wrongly, "
            "{spikes_deg.off.pitch_on_board:.3f} with it off.",
            lambda found: found["spikes_deg.off.pitch_on_board"] < found["spikes_deg.restarted.pitch_on_board"] / 2,
        ),
    ),
    Claim(
        "R (8), Figure 11",
        "Bias depends on orientation until the gyro is calibrated",
        "R (8): gyro bias by orientation (deg/h)",
        make_agreement_judge(
            f"The z bias differs by {{{BEFORE}.simulated:.3f}} deg/h between the orientations before the upload (R (8): "
            f"{{{BEFORE}.formula:.3f}}), by {{{AFTER}.simulated:.4f}} ± {{{AFTER}.standard_error:.4f}} after.",
            lambda found: (
                abs(found[f"{BEFORE}.simulated"] - found[f"{BEFORE}.formula"])
                < DISTINCT_SIGMAS * found[f"{BEFORE}.standard_error"]
                and abs(found[f"{AFTER}.simulated"]) < DISTINCT_SIGMAS * found[f"{AFTER}.standard_error"]
            ),
        ),
    ),
    Claim("R Table 2", "Yaw maneuvers end nearer on all three axes", TABLE2, _judge_targeting),
    Claim("R Table 2", "Yaw error after calibration: −0.045 deg", TABLE2, _judge_yaw_residual),
    Claim("R Figures 9 to 11", "180° yaw maneuvers on their dates", "Yaw maneuvers", _judge_dates),
)
