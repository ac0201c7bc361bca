"""The claims of N, each with its place in the paper and a verdict that is computed from the reproduction."""

import numpy as np

from studies.natanson import flight
from studies.report.claims import Claim, Judge, PaperResults, Verdict, make_judge

PREDICTION_TOLERANCE = 0.1  # of the flight's RMS: largest RMS error of a prediction that agrees
HALF_DIGIT = 5e-6  # of the scale factors in N Table 3
LEAST_INSIDE_SHARE = 0.8  # least share of flown numbers between 5 and 95 % of the simulated ones; nine of ten are expected
TWICE = 2.0
RECALIBRATED = tuple(f"own_calibration_rms_deg.{step}" for step in ("0.5", "1", "2"))
USUAL = "psi == 'full' and resampling == 'skip'"


def _decide_slip(contradicts: bool) -> Verdict:
    return "the paper slips" if contradicts else "agrees"


def _judge_eta(_: PaperResults) -> tuple[Verdict, str]:
    """Judge N (11): η is ½ ∫ (1 − cos φτ) dτ / φ² over [0, 1], (φ − sin φ)/(2φ³), which is 1/12 for small φ."""
    phi = 1e-2
    tau = np.linspace(0.0, 1.0, 20001)
    integral = 0.5 * float(np.trapezoid(1.0 - np.cos(phi * tau), tau)) / phi**2
    printed, corrected = 0.5 * (1 - np.sin(phi)) / phi**2, 0.5 * (1 - np.sin(phi) / phi) / phi**2
    text = (
        f"For a short step ψ must become I Δt, but the printed η diverges. At φ = {phi:g} it is {printed:.4g}; the integral "
        f"that defines ψ gives {integral:.4f}, and (1 − ν(φ)) in place of (1 − sin φ) gives {corrected:.4f}."
    )
    return _decide_slip(abs(printed - integral) > TWICE * abs(corrected - integral)), text


def _judge_sample_count(_: PaperResults) -> tuple[Verdict, str]:
    count = round(float(flight.compute_interval_durations().sum()) / flight.FLIGHT_STEPS_S[0])
    text = f"The intervals of Table 1 hold {count} samples at 0.5 s. N's round number may include samples outside of them."
    return ("our reading" if abs(count / 60_000 - 1) > 0.1 else "agrees"), text


def _judge_table3_range(results: PaperResults) -> tuple[Verdict, str]:
    rows = results.table("table3").query(f"{USUAL} and flight == flight")
    inside = int(rows["flight_percentile"].between(5, 95).sum())
    text = (
        f"{inside} of {len(rows)} printed values lie between the 5th and 95th percentile of the simulated ones. Most of this "
        "agreement is by construction, since the simulated truth is the flight's own calibration R (9)."
    )
    return ("agrees" if inside >= LEAST_INSIDE_SHARE * len(rows) else "open"), text


def _judge_table3_digits(_: PaperResults) -> tuple[Verdict, str]:
    """Judge N Table 3 by half a unit of its last digit: 5e-6 in a scale factor, 0.0005 deg, and 5e-7 deg/s in a bias."""
    printed, exact = flight.read_published_parameters("calibrated", 0.5), flight.read_published_calibration()
    G, bias = np.abs(printed.G - exact.G), np.rad2deg(np.abs(printed.bias - exact.bias))
    angles = np.rad2deg(G[~np.eye(3, dtype=bool)])
    inside = np.diag(G).max() <= 5.1e-6 and angles.max() <= 5.1e-4 and bias.max() <= 5.1e-7
    return _decide_slip(not inside), (
        f"Largest difference: {np.diag(G).max():.1e} of a scale factor, {angles.max():.1e} deg of a misalignment, "
        f"{bias.max():.1e} deg/s of a bias. The misalignment of gyro i against axis j is G_ij."
    )


def _judge_table4_rms(_: PaperResults) -> tuple[Verdict, str]:
    values = flight.read_published_residuals("prelaunch", 0.5)
    printed, paper, true = (
        flight.read_published_statistics("prelaunch", 0.5, "rms"),
        flight.compute_paper_rms(values),
        flight.compute_rms(values),
    )
    is_paper_form = np.abs(printed - true).max() > TWICE * np.abs(printed - paper).max()
    return _decide_slip(bool(is_paper_form)), (
        f"Roll before calibration is printed as {printed[0]:.4f} deg. The RMS of Table 2's six values is {true[0]:.3f} deg; "
        f"their norm divided by six is {paper[0]:.4f} deg."
    )


def _judge_table5_steps(_: PaperResults) -> tuple[Verdict, str]:
    before, (inverse, bias) = flight.read_published_parameters("prelaunch"), flight.read_published_corrections(1)
    by_step = {step: flight.read_published_parameters("calibrated", step) for step in flight.FLIGHT_STEPS_S}
    bias_errors = {s: np.abs(np.rad2deg(p.bias - before.bias) - bias).max() for s, p in by_step.items()}
    G_errors = {s: np.abs(np.linalg.inv(p.G) - np.linalg.inv(before.G) - inverse).max() for s, p in by_step.items()}
    bias_step, G_step = min(bias_errors, key=lambda s: bias_errors[s]), min(G_errors, key=lambda s: G_errors[s])
    text = (
        f"By Table 3 the bias corrections are those of the step of {bias_step:g} s. The corrections to G are those of G⁻¹ at "
        f"{G_step:g} s."
    )
    return _decide_slip(bias_step != G_step), text


def _make_table4_judge(step: float) -> Judge:
    """Make a judge that tests whether N Table 4 at a step lies within the simulated range."""

    def judge(results: PaperResults) -> tuple[Verdict, str]:
        rows = results.table("table4").query(f"{USUAL} and step_s == @step and phase == 'calibrated' and flight == flight")
        inside = int(((rows["p05"] <= rows["flight"]) & (rows["flight"] <= rows["p95"])).sum())
        text = f"{inside} of {len(rows)} numbers of Table 4 at {step:g} s lie between the 5th and 95th simulated percentile."
        return ("agrees" if inside >= LEAST_INSIDE_SHARE * len(rows) else "open"), text

    return judge


NATANSON_CLAIMS = (
    Claim("N (11)", "η(φ) = 0.5 (1 − sin φ)/φ²", _judge_eta),
    Claim(
        "N (29)",
        "θ ≈ ½ [δA23 − δA32, …]",
        make_judge(
            "Equations (16) and (29) give θ opposite signs. The flight's residuals of Table 2 are predicted to "
            "{residual_sign_gap_rms_deg.N (16):.3f} deg RMS with the sign of (16), to "
            "{residual_sign_gap_rms_deg.N (29) as printed:.3f} deg with that of (29).",
            lambda results: (
                results["residual_sign_gap_rms_deg.N (29) as printed"] > TWICE * results["residual_sign_gap_rms_deg.N (16)"]
            ),
            "the paper slips",
            "agrees",
        ),
    ),
    Claim(
        "N (31), (32)",
        "The covariance P follows from the measurement covariance C",
        make_judge(
            "N does not say what C contains. With the errors of the references alone the mean NEES is "
            "{nees_references_only.value:.1f}, where {nees.dof} is right; with gyro noise and shared references in C it is "
            "{nees.value:.1f}.",
            lambda results: not results["nees_references_only.inside"],
            "our reading",
            "agrees",
        ),
    ),
    Claim(
        "N V, Figure 2",
        "-y forward turns about x with +1 RPO",
        make_judge(
            "Table 2's residuals of interval 4 are predicted to {minus_y_rate_rpo.gap_rms_deg.-1:.3f} deg RMS with -1 RPO and "
            "to {minus_y_rate_rpo.gap_rms_deg.1:.3f} deg with +1 RPO. With z to nadir and y against the velocity only -1 RPO "
            "is possible.",
            lambda results: results["minus_y_rate_rpo.favoured"] == -1,
            "the paper slips",
            "agrees",
        ),
    ),
    Claim("N V", "About 60 000 points for all six maneuvers", _judge_sample_count),
    Claim(
        "N Table 2, pre-launch",
        "18 residuals before calibration",
        make_judge(
            "The flight's residuals before minus after calibration have an RMS of {flight_gap_rms_deg.flight_rms:.3f} deg. The "
            "noise-free simulation with assumed slew timings predicts them to {clean_gap_rms_deg.assumed:.4f} deg RMS. "
            "{clean_gap_scan_deg.timings} other timings give {clean_gap_scan_deg.min:.4f} to {clean_gap_scan_deg.max:.4f} deg; "
            "rounding of the printed digits alone gives {clean_gap_scan_deg.print:.4f} deg.",
            lambda results: (
                results["clean_gap_rms_deg.assumed"] < PREDICTION_TOLERANCE * results["flight_gap_rms_deg.flight_rms"]
            ),
        ),
    ),
    Claim(
        "N Table 2, calibrated",
        "The residuals after calibration, at three steps",
        make_judge(
            "A least-squares calibration from the flight's residuals before calibration gives those after to "
            f"{' / '.join(f'{{{path}:.4f}}' for path in RECALIBRATED)} deg RMS "
            "at 0.5 / 1 / 2 s. The gyro noise in a residual is {flight_noise.residual_rms_deg:.4f} deg RMS.",
            lambda results: max(results[path] for path in RECALIBRATED) < results["flight_noise.residual_rms_deg"] / TWICE,
        ),
    ),
    Claim(
        "N Table 2, 2 s",
        "Interval 3, yaw: −0.042 deg",
        make_judge(
            "Table 4's mean yaw of 0.0123 deg needs +0.042 deg. A least-squares calibration from the residuals before misses "
            "this column by {own_calibration.2.as_printed_deg:.4f} deg RMS as printed, by {own_calibration_rms_deg.2:.4f} deg "
            "with the other sign.",
            lambda results: results["own_calibration.2.as_printed_deg"] > TWICE * results["own_calibration_rms_deg.2"],
            "the paper slips",
            "agrees",
        ),
    ),
    Claim("N Table 3", "The calibrated parameters at three steps", _judge_table3_range),
    Claim(
        "N Table 3, 0.5 s",
        "The bias of the z gyro",
        make_judge(
            "The printed {own_calibration.0.5.steepest} is not the least-squares solution of N's own residuals: their "
            "component along the sensitivity of this bias is {own_calibration.0.5.gradient_deg:.3f} deg and should be zero. "
            "At 1 s the largest component of any parameter is {own_calibration.1.gradient_deg:.3f} deg.",
            lambda results: results["own_calibration.0.5.gradient_deg"] > TWICE * results["own_calibration.1.gradient_deg"],
            "our reading",
            "agrees",
        ),
    ),
    Claim("N Table 3, R (9)", "Two prints of one calibration", _judge_table3_digits),
    Claim("N Table 4", "“RMS Residuals”", _judge_table4_rms),
    Claim("N V, Table 4", "Every other measurement can be skipped without noticeable effect", _make_table4_judge(1.0)),
    Claim("N V, Table 4", "Skipping three of four still gives reasonably good results", _make_table4_judge(2.0)),
    Claim("N Table 5, 1st iteration", "Corrections of G and of the biases, of one calibration", _judge_table5_steps),
    Claim(
        "N Table 5, 2nd iteration",
        "Its corrections",
        make_judge(
            "Recalculated from the flight's residuals in each gyro's own parameters, the 12 corrections correlate with the "
            "printed ones by {table5_second_iteration.gyro_space:.2f}; in (G, b) by {table5_second_iteration.gain_space:.2f}.",
            lambda results: results["table5_second_iteration.gyro_space"] > 0.9,
        ),
    ),
    Claim(
        "N V, Table 5",
        "The second iteration has no effect on the values in Tables 2 and 4, to the precision shown",
        make_judge(
            "Recalculated from the flight's residuals at 0.5 s, the second iteration changes "
            "{own_digits_changed.0.5.table2} of 18 printed digits of Table 2 and {own_digits_changed.0.5.table4} of 6 of Table "
            "4. N's conclusion holds: the change of G is {second_iteration_median.G:.1e}.",
            lambda results: results["own_digits_changed.0.5.table2"] + results["own_digits_changed.0.5.table4"] > 0,
            "our reading",
            "agrees",
        ),
    ),
    Claim(
        "N V",
        "The linear terms of ψ suffice",
        make_judge(
            f"Linear ψ changes G by {{psi_difference_max.G:.1e}}. Half a printed digit of a scale factor is {HALF_DIGIT:.0e}.",
            lambda results: results["psi_difference_max.G"] < HALF_DIGIT,
        ),
    ),
)
