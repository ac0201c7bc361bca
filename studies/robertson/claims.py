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


def _judge_requirements(results: PaperResults) -> tuple[Verdict, str]:
    path = f"requirements.{PERIODS[-1]}"
    texts = [
        results.say(f"{name} {{{path}.{name}.worst_axis_deg:.3f}} of {{{path}.{name}.limit_deg:g}} deg")
        for name in ("knowledge", "pointing")
    ]
    met = all(results[f"{path}.{name}.met"] for name in ("knowledge", "pointing"))
    return _decide(met), f"Simulated, on the worst axis: {' and '.join(texts)}."


def _judge_performance(results: PaperResults) -> tuple[Verdict, str]:
    rungs = results.table("ladder")
    first, last = rungs.iloc[0], rungs.iloc[-1]
    text = (
        f"The RMS factor between the 18 simulated and flown numbers is {first['factor_18']:.2f} for level boresights and R's "
        f"printed coefficients, and {last['factor_18']:.2f} with the effects that were found. On the numbers that no size was "
        f"fitted to it is {last['factor_unfitted']:.2f} ({last['factor_unfitted_low']:.2f} to "
        f"{last['factor_unfitted_high']:.2f}). The rest of the misfit has an unknown cause with a probability of "
        f"{results['diagnosis.unknown']:.2f}."
    )
    return _decide(last["factor_unfitted_low"] < FACTOR), text


def _judge_yaw_updates(results: PaperResults) -> tuple[Verdict, str]:
    simulated, flown = ([results[f"yaw_update_deg.{period}.{key}"] for period in PERIODS] for key in ("simulated", "flight"))
    falls = all(a > b for a, b in pairwise(simulated))
    texts = [" / ".join(f"{value:.{digits}f}" for value in values) for values, digits in ((simulated, 3), (flown, 2))]
    return _decide(falls), f"Mean yaw updates in the three periods: {texts[0]} deg simulated, {texts[1]} deg flown."


def _judge_bias_x(results: PaperResults) -> tuple[Verdict, str]:
    rows = results.table("ladder_numbers").query("parameter == 'gyro_bias_std_deg_h' and axis == 'x'").set_index("period")
    last = rows.columns[-2]
    before, after = rows.loc["calibration1"], rows.loc["postcalibration"]
    text = (
        f"Flown {before['flight']:.3f} to {after['flight']:.3f} deg/h, simulated {before[last]:.3f} to {after[last]:.3f} "
        "deg/h. The simulated scatter before the gyro's calibration is too large, for an unknown reason."
    )
    ratio = float(rows["last_over_flight"].to_numpy(dtype=float)[0])
    return _decide(1 / FACTOR < ratio < FACTOR), text


def _judge_targeting(results: PaperResults) -> tuple[Verdict, str]:
    rows = results.table("table2").query("maneuver == '+x to -x'").set_index(["tables", "axis"])
    first, last = rows.loc["calibration1"], rows.loc["postcalibration"]
    better = bool((last["simulated_deg"].abs() < first["simulated_deg"].abs()).all())
    simulated = [", ".join(f"{value:+.3f}" for value in part["simulated_deg"]) for part in (first, last)]
    flown = [", ".join(f"{value:+.3f}" for value in part["flight_deg"]) for part in (first, last)]
    return _decide(better), (
        f"Roll, pitch, yaw before calibration: {simulated[0]} deg simulated, {flown[0]} deg flown; after: {simulated[1]} deg "
        f"and {flown[1]} deg. Before calibration the RMS difference is {results['slew_gap_deg.+x to -x']:.3f} deg."
    )


def _judge_yaw_residual(results: PaperResults) -> tuple[Verdict, str]:
    row = results.table("table2").query("maneuver == '+x to -x' and tables == 'postcalibration' and axis == 'yaw'").iloc[0]
    difference_in_sigma = abs(row["simulated_minus_flight_deg"]) / row["std_deg"]
    text = (
        f"Simulated {row['simulated_deg']:+.3f} ± {row['std_deg']:.3f} deg; the flown {row['flight_deg']:+.3f} deg is "
        f"{difference_in_sigma:.1f} sigma away."
    )
    return _decide(difference_in_sigma < DISTINCT_SIGMAS), text


def _judge_heads(results: PaperResults) -> tuple[Verdict, str]:
    checks = results.study("heads", "checks").set_index("check")["value"].astype(float)
    share = checks["share of right answers, R's heads, misalignment and biases"]
    wrong = checks["diagnoses with a wrong name"]
    text = (
        f"In {100 * share:.0f} % of simulated months the diagnosis identifies the heads; it names {wrong:.0f} wrong causes. "
        "An orthogonal calibration would report a misalignment of "
        f"{checks['misalignment that an orthogonal calibration makes of heads alone']:.2f} deg that does not exist."
    )
    return _decide(share == 1.0 and wrong == 0), text


def _judge_orientation(results: PaperResults) -> tuple[Verdict, str]:
    rows = results.table("orientation").set_index(["period", "forward"])["yaw_update_deg"]
    plus, minus = rows["calibration1", "+x"], rows["calibration1", "-x"]
    calibrated = [rows["postcalibration", forward] for forward in ("+x", "-x")]
    text = (
        f"Simulated updates with the alignment: {plus:.3f} deg in +x and {minus:.3f} deg in -x forward; with the coefficients "
        f"{calibrated[0]:.3f} and {calibrated[1]:.3f} deg. The alignment was made at the sun angles of +x forward, and the Sun "
        "is far from these angles in -x forward."
    )
    return _decide(minus > plus and max(calibrated) < minus), text


def _make_coefficient_judge(sensor: str) -> Judge:
    """Make the judge of a sensor's printed c and d, by the |tan α| of the boresights' geometry."""

    def judge(results: PaperResults) -> tuple[Verdict, str]:
        rows = results.table("tangents")
        rows = rows[rows["sensor"] == sensor]
        slipped = rows[(rows["slip"] != 1) & ((rows["tan_alpha"] / rows["geometry"] - 1).abs() < TANGENT_TOLERANCE)]
        parts = [f"{r.number} printed {r.published_1e6:g}e-6, computed {r.computed_1e6:.0f}e-6" for r in rows.itertuples()]
        text = f"For boresights {results['geometry.elevation_deg']:.1f}° toward zenith: {'; '.join(parts)}."
        if not (rows["published_1e6"] * rows["computed_1e6"] > 0).all():
            return "open", f"{text} The signs do not agree."
        corrections = "".join(f" With a factor of {row.slip:g} in {row.number} the two agree." for row in slipped.itertuples())
        return ("our reading" if len(slipped) else "agrees"), text + corrections

    return judge


def _judge_boresights(results: PaperResults) -> tuple[Verdict, str]:
    text = results.say(
        "Raised {geometry.elevation_deg:.1f}° toward zenith the sensors see the Sun in {geometry.share_raised:.0%} of an "
        "orbit, level in {geometry.share_level:.0%}; the largest share of any elevation is {geometry.share_best:.0%}."
    )
    return _decide(results["geometry.share_raised"] > 0.95 * results["geometry.share_best"]), text


def _judge_alignment(results: PaperResults) -> tuple[Verdict, str]:
    rows = results.table("alignment")
    pairs = ", ".join(f"{a:+.2f} ({b:+.2f})" for a, b in zip(rows["found"], rows["R"], strict=True))
    agrees = bool(((rows["found"] - rows["R"]).abs() < 0.05).all())
    text = f"Estimated from simulated telemetry with the heads alone: {pairs} deg about x, y, z; R's in brackets."
    return _decide(agrees), text


def _judge_dates(results: PaperResults) -> tuple[Verdict, str]:
    days = pd.to_numeric(results.table("yaw_maneuvers")["simulated_minus_flight_days"]).dropna()
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
            lambda results: False,
        ),
    ),
    Claim(
        "R, On-orbit Performance",
        "Before calibration yaw did not meet them",
        make_judge(
            "Simulated knowledge on the worst axis: {requirements.precalibration.knowledge.worst_axis_deg:.3f} of "
            "{requirements.precalibration.knowledge.limit_deg:g} deg.",
            lambda results: not results["requirements.precalibration.knowledge.met"],
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
            lambda results: results["spikes_deg.off.pitch_on_board"] < results["spikes_deg.restarted.pitch_on_board"] / 2,
        ),
    ),
    Claim(
        "R (8), Figure 11",
        "Bias depends on orientation until the gyro is calibrated",
        make_judge(
            f"The z bias differs between the orientations by {{{BEFORE}.simulated:.3f}} deg/h before the calibration, by "
            f"{{{AFTER}.simulated:.4f}} ± {{{AFTER}.standard_error:.4f}} deg/h after it. R (8) gives "
            f"{{{BEFORE}.formula:.3f}} deg/h before.",
            lambda results: (
                abs(results[f"{BEFORE}.simulated"] - results[f"{BEFORE}.formula"])
                < DISTINCT_SIGMAS * results[f"{BEFORE}.standard_error"]
                and abs(results[f"{AFTER}.simulated"]) < DISTINCT_SIGMAS * results[f"{AFTER}.standard_error"]
            ),
        ),
    ),
    Claim("R Table 2", "Yaw maneuvers end nearer on all three axes", _judge_targeting),
    Claim("R Table 2", "Yaw error after calibration: −0.045 deg", _judge_yaw_residual),
    Claim("R Figures 9 to 11", "180° yaw maneuvers on their dates", _judge_dates),
)
