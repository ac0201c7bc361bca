"""What N claims, each beside what was found; the places are those of the paper, the numbers those of the reproduction."""

from __future__ import annotations

import numpy as np

from studies.natanson import flight
from studies.report.claims import (
    Claim,
    Judge,
    PaperResults,
    Verdict,
    decide_agreement,
    decide_slip,
    make_agreement_judge,
    make_slip_judge,
)

PREDICTION_TOLERANCE = 0.1  # of the flight's RMS: what a prediction may miss it by
HALF_DIGIT = 5e-6  # of the scale factors in N Table 3
LEAST_INSIDE_SHARE = 0.8  # least share of flown numbers between 5 and 95 % of the simulated ones; nine of ten are expected
TWICE = 2.0
CALIBRATION_STEP_KEYS = tuple(f"own_calibration_rms_deg.assumed.{step}" for step in ("0.5", "1", "2"))
USUAL = "psi == 'full' and resampling == 'skip'"


def _judge_table3_digits(_: PaperResults) -> tuple[Verdict, str]:
    """Half a unit of the last digit: 5e-6 of a scale factor, 0.0005 deg of a misalignment, 5e-7 deg/s of a bias."""
    printed, exact = flight.read_published_parameters("calibrated", 0.5), flight.read_published_calibration()
    G, bias = np.abs(printed.G - exact.G), np.rad2deg(np.abs(printed.bias - exact.bias))
    angles = np.rad2deg(G[~np.eye(3, dtype=bool)])
    inside = np.diag(G).max() <= 5.1e-6 and angles.max() <= 5.1e-4 and bias.max() <= 5.1e-7
    return decide_agreement(bool(inside), "the paper slips"), (
        f"Largest difference: {np.diag(G).max():.1e} of a scale factor, {angles.max():.1e} deg of a misalignment, "
        f"{bias.max():.1e} deg/s of a bias; the misalignment of gyro i against axis j is G_ij."
    )


def _judge_table4_rms(_: PaperResults) -> tuple[Verdict, str]:
    values = flight.read_published_residuals("prelaunch", 0.5)
    printed, paper, true = (
        flight.read_published_statistics("prelaunch", 0.5, "rms"),
        flight.compute_paper_rms(values),
        flight.compute_rms(values),
    )
    wrong = np.abs(printed - true).max() > TWICE * np.abs(printed - paper).max()
    return decide_slip(bool(wrong)), (
        f"Roll before launch: printed {printed[0]:.4f} deg, the RMS of Table 2 is {true[0]:.3f}; the norm over n gives "
        f"{paper[0]:.4f}."
    )


def _judge_table5_steps(_: PaperResults) -> tuple[Verdict, str]:
    before, (inverse, bias) = flight.read_published_parameters("prelaunch"), flight.read_published_corrections(1)
    by_step = {step: flight.read_published_parameters("calibrated", step) for step in flight.FLIGHT_STEPS_S}
    off = {s: np.abs(np.rad2deg(p.bias - before.bias) - bias).max() for s, p in by_step.items()}
    off_G = {s: np.abs(np.linalg.inv(p.G) - np.linalg.inv(before.G) - inverse).max() for s, p in by_step.items()}
    of_bias, of_G = min(off, key=lambda s: off[s]), min(off_G, key=lambda s: off_G[s])
    text = f"Its bias corrections are those of {of_bias:g} s, its G corrections those of G⁻¹ at {of_G:g} s."
    return decide_slip(of_bias != of_G), text


def _make_table4_judge(step: float) -> Judge:
    """Whether N Table 4 at a step lies within the simulated range."""

    def judge(found: PaperResults) -> tuple[Verdict, str]:
        rows = found.table("table4").query(f"{USUAL} and step_s == @step and phase == 'calibrated' and flight == flight")
        inside = int(((rows["p05"] <= rows["flight"]) & (rows["flight"] <= rows["p95"])).sum())
        text = f"{inside} of {len(rows)} numbers of Table 4 lie within the simulated 5 to 95 %"
        try:
            steps = found.study("timestep", "steps").query("resampling == 'skip'").set_index("step_s")["sigma_ratio"]
            text += f"; the parameters' sigmas are ×{steps[step]:.2f} those of 0.5 s"
        except KeyError:
            pass
        return decide_agreement(inside >= LEAST_INSIDE_SHARE * len(rows)), f"{text}."

    return judge


def _judge_eta(_: PaperResults) -> tuple[Verdict, str]:
    """η is half of ∫ (1 − cos φτ) dτ over [0, 1] and φ²: (φ − sin φ)/(2φ³), which is 1/12 where φ is small."""
    phi = 1e-2
    tau = np.linspace(0.0, 1.0, 20001)
    integral = 0.5 * float(np.trapezoid(1.0 - np.cos(phi * tau), tau)) / phi**2
    printed, mended = 0.5 * (1 - np.sin(phi)) / phi**2, 0.5 * (1 - np.sin(phi) / phi) / phi**2
    text = (
        f"At φ = {phi:g} the integral that ψ is gives η = {integral:.4f}; (11) as printed gives {printed:.4g}, with ν(φ) in "
        f"place of sin φ {mended:.4f}."
    )
    return decide_slip(abs(printed - integral) > TWICE * abs(mended - integral)), text


def _judge_sample_count(_: PaperResults) -> tuple[Verdict, str]:
    count = round(float(flight.compute_interval_durations().sum()) / flight.FLIGHT_STEPS_S[0])
    return decide_slip(abs(count / 60_000 - 1) > 0.1), f"The intervals of Table 1 hold {count} samples at 0.5 s."


def _judge_table3_range(found: PaperResults) -> tuple[Verdict, str]:
    rows = found.table("table3").query(f"{USUAL} and flight == flight")
    inside = int(rows["flight_percentile"].between(5, 95).sum())
    text = f"{inside} of {len(rows)} printed values lie within the simulated 5 to 95 %; that holds largely by construction."
    return decide_agreement(inside >= LEAST_INSIDE_SHARE * len(rows)), text


BEFORE = "Residuals before calibration at 0.5 s: flown and predicted"
OWN = "The flight's own residuals calibrated, beside N's"
TABLE2, TABLE3 = "N Table 2: residuals (deg)", "N Table 3: calibration parameters"
TABLE4_TITLE = "N Table 4: mean and RMS over the intervals (deg)"
TABLE5 = "N Table 5: corrections to b (deg/s) and G⁻¹, iterated in (G, b)"
TABLE5_SECOND = "N Table 5: second iteration in both parametrisations, of the flight's residuals"
CHANGED_DIGITS_NOTE = "Printed digits the second iteration changes, of the flight's residuals"
PSI_SWEEP = "Linear against full ψ over slew rate and step, noise-free"
NATANSON_CLAIMS = (
    Claim("N (11)", "η(φ) = 0.5 (1 − sin φ)/φ²", PSI_SWEEP, _judge_eta, "η of (11)"),
    Claim(
        "N (29)",
        "θ ≈ ½ [δA23 − δA32, …]",
        "Sign of the residual",
        make_slip_judge(
            "By the sign of (16) the flown residuals are missed by {residual_sign_gap_rms_deg.N (16):.3f} deg RMS, with (29) "
            "as printed by {residual_sign_gap_rms_deg.N (29) as printed:.3f}.",
            lambda found: (
                found["residual_sign_gap_rms_deg.N (29) as printed"] > TWICE * found["residual_sign_gap_rms_deg.N (16)"]
            ),
        ),
        "the sign of (29)",
    ),
    Claim(
        "N (31), (32)",
        "The covariance P follows from the references' C alone",
        "Consistency of the claimed covariance",
        make_slip_judge(
            "The references' errors alone give a mean NEES of {nees_references_only.value:.1f}, where {nees.dof} is right; "
            "with gyro noise and shared references in C it is {nees.value:.1f}.",
            lambda found: not found["nees_references_only.inside"],
        ),
        "gyro noise missing in the covariance",
    ),
    Claim(
        "N V, Figure 2",
        "-y forward turns about x with +1 RPO",
        "Interval 4: rate about x",
        make_slip_judge(
            "The residuals of interval 4 are missed by {minus_y_rate_rpo.gap_rms_deg.1:.3f} deg RMS with +1 RPO and by "
            "{minus_y_rate_rpo.gap_rms_deg.-1:.3f} with -1 RPO; with z to nadir and y against the velocity, geometry gives -1.",
            lambda found: found["minus_y_rate_rpo.favoured"] == -1,
        ),
        "the sign of the rate in -y forward",
    ),
    Claim("N V", "About 60 000 points for all six maneuvers", TABLE2, _judge_sample_count, "the count of samples"),
    Claim(
        "N Table 2, pre-launch",
        "18 residuals before calibration",
        BEFORE,
        make_agreement_judge(
            "Predicted from R (9), without noise, to {clean_gap_rms_deg.assumed:.4f} deg RMS of "
            "{flight_gap_rms_deg.flight_rms:.3f} with the slews' timings assumed; {clean_gap_rms_deg.each:.4f} with nine "
            "fitted; print alone leaves {clean_gap_scan_deg.print:.4f}.",
            lambda found: found["clean_gap_rms_deg.assumed"] < PREDICTION_TOLERANCE * found["flight_gap_rms_deg.flight_rms"],
        ),
    ),
    Claim(
        "N Table 2, calibrated",
        "The residuals after calibration, at three steps",
        OWN,
        make_agreement_judge(
            "Least squares of the flown residuals before gives those after to "
            f"{' / '.join(f'{{{one}:.4f}}' for one in CALIBRATION_STEP_KEYS)} deg RMS "
            "at 0.5 / 1 / 2 s; the flight's own scatter is {flight_noise.residual_rms_deg:.4f}.",
            lambda found: max(found[one] for one in CALIBRATION_STEP_KEYS) < found["flight_noise.residual_rms_deg"] / TWICE,
        ),
    ),
    Claim(
        "N Table 2, 2 s",
        "Interval 3, yaw: −0.042 deg",
        OWN,
        make_slip_judge(
            "As printed, least squares misses the column by {own_calibration.2.as_printed_deg:.4f} deg RMS; with the other "
            "sign of interval 3, yaw, as N Table 4's mean has it, by {own_calibration_rms_deg.assumed.2:.4f}.",
            lambda found: found["own_calibration.2.as_printed_deg"] > TWICE * found["own_calibration_rms_deg.assumed.2"],
        ),
        "a sign in Table 2",
    ),
    Claim("N Table 3", "The calibrated parameters at three steps", TABLE3, _judge_table3_range),
    Claim(
        "N Table 3, 0.5 s",
        "The bias of the z gyro",
        OWN,
        make_slip_judge(
            "The printed {own_calibration.0.5.steepest} leaves a gradient of {own_calibration.0.5.gradient_deg:.3f} deg at "
            "0.5 s; at 1 s the largest of any is {own_calibration.1.gradient_deg:.3f}.",
            lambda found: found["own_calibration.0.5.gradient_deg"] > TWICE * found["own_calibration.1.gradient_deg"],
        ),
        "the z bias of Table 3",
    ),
    Claim("N Table 3, R (9)", "Two prints of one calibration", TABLE3, _judge_table3_digits),
    Claim("N Table 4", "“RMS Residuals”", TABLE4_TITLE, _judge_table4_rms, "the RMS of Table 4"),
    Claim(
        "N V, Table 4",
        "Every other measurement can be skipped without noticeable effect",
        TABLE4_TITLE,
        _make_table4_judge(1.0),
    ),
    Claim("N V, Table 4", "Skipping three of four still gives reasonably good results", TABLE4_TITLE, _make_table4_judge(2.0)),
    Claim(
        "N Table 5, 1st iteration",
        "Corrections of G and of the biases, of one calibration",
        TABLE5,
        _judge_table5_steps,
        "the step sizes of Table 5",
    ),
    Claim(
        "N Table 5, 2nd iteration",
        "Its corrections",
        TABLE5_SECOND,
        make_agreement_judge(
            "Made again from the flown residuals, in each gyro's own parameters: correlation "
            "{table5_second_iteration.gyro_space.correlation:.2f} over 12 cells, "
            "{table5_second_iteration.gyro_space.cells_beyond_3_sigma} beyond 3 sigma; in (G, b) it would be "
            "{table5_second_iteration.gain_space.correlation:.2f}.",
            lambda found: (
                found["table5_second_iteration.gyro_space.correlation"] > 0.9
                and found["table5_second_iteration.gyro_space.cells_beyond_3_sigma"] == 0
            ),
        ),
    ),
    Claim(
        "N V, Table 5",
        "The second iteration has no effect on the values in Tables 2 and 4, to the precision shown",
        CHANGED_DIGITS_NOTE,
        make_slip_judge(
            "Of the flown residuals at 0.5 s it changes {own_digits_changed.0.5.table2} of 18 printed digits of Table 2 and "
            "{own_digits_changed.0.5.table4} of 6 of Table 4; it is small all the same: {second_iteration_median.G:.1e} in G.",
            lambda found: found["own_digits_changed.0.5.table2"] + found["own_digits_changed.0.5.table4"] > 0,
        ),
        "digits that the second iteration changes",
    ),
    Claim(
        "N V",
        "The linear terms of ψ suffice",
        "Largest difference between full and linear ψ",
        make_agreement_judge(
            "Linear ψ differs by {psi_difference_max.G:.1e} in G; half a printed digit of a scale factor is "
            f"{HALF_DIGIT:.0e}.",
            lambda found: found["psi_difference_max.G"] < HALF_DIGIT,
        ),
    ),
)
