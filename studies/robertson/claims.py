"""The claims of R, each with its place in the paper and a verdict that is computed from the reproduction."""

from itertools import pairwise

import pandas as pd

from studies.report.claims import Claim, Judge, PaperResults, Verdict, make_judge
from studies.robertson.calendar import PERIODS

FACTOR = 1.1  # between simulated and flown numbers that agree
DISTINCT_SIGMAS = 3.0  # sigma
TANGENT_TOLERANCE = 0.15  # relative: tan α of a corrected (c, d) against the geometry's


def _decide(agrees: bool) -> Verdict:
    return "agrees" if agrees else "open"


def _judge_requirements(found: PaperResults) -> tuple[Verdict, str]:
    path = f"requirements.{PERIODS[-1]}"
    texts = [
        found.say(f"{name} {{{path}.{name}.worst_axis_deg:.3f}} of {{{path}.{name}.limit_deg:g}} deg")
        for name in ("knowledge", "pointing")
    ]
    met = all(found[f"{path}.{name}.met"] for name in ("knowledge", "pointing"))
    return _decide(met), f"Simulated, on the worst axis: {' and '.join(texts)}."


def _judge_performance(found: PaperResults) -> tuple[Verdict, str]:
    rungs = found.table("ladder")
    first, last = rungs.iloc[0], rungs.iloc[-1]
    text = (
        f"The RMS factor between the 18 simulated and flown numbers is {first['factor_18']:.2f} for the spacecraft as landed "
        f"and {last['factor_18']:.2f} with the effects that were found. On the numbers that no size was fitted to it is "
        f"{last['factor_unfitted']:.2f} ({last['factor_unfitted_low']:.2f} to {last['factor_unfitted_high']:.2f}). The rest of "
        f"the misfit has an unknown cause with a probability of {found['diagnosis.unknown']:.2f}."
    )
    return _decide(last["factor_unfitted_low"] < FACTOR), text


def _judge_yaw_updates(found: PaperResults) -> tuple[Verdict, str]:
    simulated, flown = ([found[f"yaw_update_deg.{one}.{key}"] for one in PERIODS] for key in ("simulated", "flight"))
    falls = all(a > b for a, b in pairwise(simulated))
    shown = [" / ".join(f"{one:.{digits}f}" for one in values) for values, digits in ((simulated, 3), (flown, 2))]
    return _decide(falls), f"Mean yaw updates in the three periods: {shown[0]} deg simulated, {shown[1]} deg flown."


def _judge_bias_x(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("ladder_numbers").query("parameter == 'gyro_bias_std_deg_h' and axis == 'x'").set_index("period")
    last = rows.columns[-2]
    before, after = rows.loc["calibration1"], rows.loc["postcalibration"]
    text = (
        f"Flown {before['flight']:.3f} to {after['flight']:.3f} deg/h, simulated {before[last]:.3f} to {after[last]:.3f} "
        "deg/h. The simulated scatter before the gyro's calibration is too large, for an unknown reason."
    )
    ratio = float(rows["last_over_flight"].to_numpy(dtype=float)[0])
    return _decide(1 / FACTOR < ratio < FACTOR), text


def _judge_targeting(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("table2").query("maneuver == '+x to -x'").set_index(["tables", "axis"])
    first, last = rows.loc["calibration1"], rows.loc["postcalibration"]
    better = bool((last["simulated_deg"].abs() < first["simulated_deg"].abs()).all())
    shown = [", ".join(f"{value:+.3f}" for value in part["simulated_deg"]) for part in (first, last)]
    flown = [", ".join(f"{value:+.3f}" for value in part["flight_deg"]) for part in (first, last)]
    return _decide(better), (
        f"Roll, pitch, yaw before calibration: {shown[0]} deg simulated, {flown[0]} deg flown; after: {shown[1]} deg and "
        f"{flown[1]} deg. Before calibration the RMS difference is {found['slew_gap_deg.+x to -x']:.3f} deg."
    )


def _judge_yaw_residual(found: PaperResults) -> tuple[Verdict, str]:
    row = found.table("table2").query("maneuver == '+x to -x' and tables == 'postcalibration' and axis == 'yaw'").iloc[0]
    apart = abs(row["simulated_minus_flight_deg"]) / row["std_deg"]
    text = (
        f"Simulated {row['simulated_deg']:+.3f} ± {row['std_deg']:.3f} deg; the flown {row['flight_deg']:+.3f} deg is "
        f"{apart:.1f} sigma away."
    )
    return _decide(apart < DISTINCT_SIGMAS), text


def _judge_heads(found: PaperResults) -> tuple[Verdict, str]:
    checks = found.study("heads", "checks").set_index("check")["value"].astype(float)
    right = checks["share of right answers, R's heads, misalignment and biases"]
    wrong = checks["diagnoses with a wrong name"]
    text = (
        f"In {100 * right:.0f} % of simulated months the diagnosis identifies the heads; it names {wrong:.0f} wrong causes. "
        "An orthogonal calibration would report a misalignment of "
        f"{checks['misalignment that an orthogonal calibration makes of heads alone']:.2f} deg that does not exist."
    )
    return _decide(right == 1.0 and wrong == 0), text


def _judge_orientation(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("orientation").set_index(["period", "forward"])["yaw_update_deg"]
    plus, minus = rows["calibration1", "+x"], rows["calibration1", "-x"]
    ends = [rows["postcalibration", one] for one in ("+x", "-x")]
    text = (
        f"Simulated updates with the alignment: {plus:.3f} deg in +x and {minus:.3f} deg in -x forward; with the coefficients "
        f"{ends[0]:.3f} and {ends[1]:.3f} deg. The alignment was made at the sun angles of +x forward, and the Sun is far from "
        "these angles in -x forward."
    )
    return _decide(minus > plus and max(ends) < minus), text


def _make_coefficient_judge(sensor: str) -> Judge:
    def judge(found: PaperResults) -> tuple[Verdict, str]:
        rows = found.table("tangents")
        rows = rows[rows["sensor"] == sensor]
        slipped = rows[(rows["slip"] != 1) & ((rows["tan_alpha"] / rows["geometry"] - 1).abs() < TANGENT_TOLERANCE)]
        parts = [f"{r.number} printed {r.published_1e6:g}e-6, computed {r.computed_1e6:.0f}e-6" for r in rows.itertuples()]
        text = f"For boresights {found['geometry.elevation_deg']:.1f}° toward zenith: {'; '.join(parts)}."
        if not (rows["published_1e6"] * rows["computed_1e6"] > 0).all():
            return "open", f"{text} The signs do not agree."
        extra = "".join(f" With a factor of {one.slip:g} in {one.number} the two agree." for one in slipped.itertuples())
        return ("our reading" if len(slipped) else "agrees"), text + extra

    return judge


def _judge_boresights(found: PaperResults) -> tuple[Verdict, str]:
    text = found.say(
        "Raised {geometry.elevation_deg:.1f}° toward zenith the sensors see the Sun in {geometry.share_raised:.0%} of an "
        "orbit, level in {geometry.share_level:.0%}; the largest share of any elevation is {geometry.share_best:.0%}."
    )
    return _decide(found["geometry.share_raised"] > 0.95 * found["geometry.share_best"]), text


def _judge_alignment(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("alignment")
    pairs = ", ".join(f"{a:+.2f} ({b:+.2f})" for a, b in zip(rows["found"], rows["R"], strict=True))
    near = bool(((rows["found"] - rows["R"]).abs() < 0.05).all())
    return _decide(
        near
    ), f"Estimated from simulated telemetry with the heads alone: {pairs} deg about x, y, z; R's in brackets."


def _judge_dates(found: PaperResults) -> tuple[Verdict, str]:
    days = pd.to_numeric(found.table("yaw_maneuvers")["simulated_minus_flight_days"]).dropna()
    text = f"{len(days)} dates are published; the simulated ones differ by {days.min():+.2f} to {days.max():+.2f} days."
    return _decide(bool(days.abs().max() < 1)), text


BEFORE, AFTER = (f"bias_z_minus_x_less_plus_x_deg_h.{period}" for period in PERIODS[1:])
ROBERTSON_CLAIMS = (
    Claim("R Table 1, Conclusion", "Knowledge and pointing meet the requirements after calibration", _judge_requirements),
    Claim(
        "R Table 1",
        "Stability meets the requirement",
        make_judge(
            "Not verified: TRMM's sources of jitter are not published, and the nominal spacecraft has none. Simulated: "
            f"{{requirements.{PERIODS[-1]}.stability.worst_axis_deg:.4f}} deg in a second.",
            lambda found: False,
        ),
    ),
    Claim(
        "R, On-orbit Performance",
        "Before calibration yaw did not meet them",
        make_judge(
            "Simulated knowledge on the worst axis: {requirements.precalibration.knowledge.worst_axis_deg:.3f} of "
            "{requirements.precalibration.knowledge.limit_deg:g} deg.",
            lambda found: not found["requirements.precalibration.knowledge.met"],
        ),
    ),
    Claim("R Table 3", "18 numbers of accuracy, yaw update and bias scatter", _judge_performance),
    Claim("R Figures 9, 10", "The uploads reduced the yaw updates", _judge_yaw_updates),
    Claim("R Table 3", "The scatter of the x bias rises with the calibration", _judge_bias_x),
    Claim("R, Sensor Calibration", "Head misalignment caused the yaw updates", _judge_heads),
    Claim(
        "R, DSS Calibration",
        "“Unexplained”: smaller updates in +x than in -x forward, before the coefficients",
        _judge_orientation,
    ),
    Claim("R (3)", "The misalignment of DSS-2", _judge_alignment),
    Claim("R (6)", "c and d of DSS-1", _make_coefficient_judge("DSS-1")),
    Claim("R (6)", "c and d of DSS-2", _make_coefficient_judge("DSS-2")),
    Claim("R, Figure 6", "Boresights chosen to maximize the time with sun sensor data", _judge_boresights),
    Claim(
        "R Figure 8",
        "Spikes by the S filter's restart; smaller with the filter off",
        make_judge(
            "Largest pitch error on board: {spikes_deg.restarted.pitch_on_board:.3f} deg with the filter restarted wrongly, "
            "{spikes_deg.off.pitch_on_board:.3f} deg with it off.",
            lambda found: found["spikes_deg.off.pitch_on_board"] < found["spikes_deg.restarted.pitch_on_board"] / 2,
        ),
    ),
    Claim(
        "R (8), Figure 11",
        "Bias depends on orientation until the gyro is calibrated",
        make_judge(
            f"The z bias differs between the orientations by {{{BEFORE}.simulated:.3f}} deg/h before the calibration, by "
            f"{{{AFTER}.simulated:.4f}} ± {{{AFTER}.standard_error:.4f}} deg/h after it. R (8) gives "
            f"{{{BEFORE}.formula:.3f}} deg/h before.",
            lambda found: (
                abs(found[f"{BEFORE}.simulated"] - found[f"{BEFORE}.formula"])
                < DISTINCT_SIGMAS * found[f"{BEFORE}.standard_error"]
                and abs(found[f"{AFTER}.simulated"]) < DISTINCT_SIGMAS * found[f"{AFTER}.standard_error"]
            ),
        ),
    ),
    Claim("R Table 2", "Yaw maneuvers end nearer on all three axes", _judge_targeting),
    Claim("R Table 2", "Yaw error after calibration: −0.045 deg", _judge_yaw_residual),
    Claim("R Figures 9 to 11", "180° yaw maneuvers on their dates", _judge_dates),
)
