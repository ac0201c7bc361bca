"""What parts simulated and flown on N, a row a question: the gap before, the effect found, and the gap after."""

from typing import Any

import pandas as pd


def question_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions of a reproduction's summary; the last column is of numbers that fitted nothing."""
    clean, scan, gap = summary["clean_gap_rms_deg"], summary["clean_gap_scan_deg"], summary["flight_gap_rms_deg"]
    second, own, rate = summary["table5_second_iteration"], summary["own_calibration"], summary["minus_y_rate_rpo"]
    rms = summary["own_calibration_rms_deg"]["assumed"]
    gain, gyro = second["gain_space"], second["gyro_space"]
    mixed = gyro["with_G_of_0.5_s"]
    digits = summary["own_digits_changed"]["0.5"]

    def of_second(found: dict[str, Any]) -> str:
        return f"correlation {found['correlation']:.2f}; {found['rms_1e6_G']:.2f}e-6, {found['rms_1e8_deg_s']:.1f}e-8 deg/s"

    rows = [
        (
            "Residuals before less after calibration (18)",
            "noise-free, timings assumed",
            f"{gap['flight_rms']:.3f} deg RMS before",
            f"{clean['assumed']:.4f} deg",
            f"slews' timings; four common fitted: {clean['common']:.4f}, nine: {clean['each']:.4f}",
            f"{scan['held_out']['before']:.4f} to {scan['held_out']['after']:.4f} deg on intervals 2, 4, 6, each held out",
        ),
        (
            "Residuals before calibration (18)",
            "noise-free, R (9) as truth",
            f"{gap['flight_rms']:.3f} deg RMS",
            f"{gap['published']:.4f} deg",
            f"the flight's noise, its residuals after: {gap['floor']:.4f}",
            f"{clean['assumed']:.4f} deg",
        ),
        (
            "Residuals after, from those before, 0.5 s",
            "least squares of the flown ones",
            "N Table 2, calibrated",
            f"{rms['0.5']:.4f} deg",
            f"N's {own['0.5']['steepest']} is not the least-squares one: it leaves {own['0.5']['gradient_deg']:.3f} deg",
            f"{own['0.5']['rms_of_the_others_deg']:.4f} deg without {summary['own_calibration_farthest']['0.5']}",
        ),
        ("The same, 1 s", "least squares", "N Table 2, calibrated", f"{rms['1']:.4f} deg", "none", f"{rms['1']:.4f} deg"),
        (
            "The same, 2 s",
            "least squares",
            "N Table 2, calibrated",
            f"{own['2']['as_printed_deg']:.4f} deg",
            "a sign of Table 2, as Table 4 says",
            f"{rms['2']:.4f} deg",
        ),
        (
            "Second iteration (12 cells)",
            "of the flown residuals, 1 s, in (G, b)",
            "N Table 5",
            of_second(gain),
            "N iterates in gyro space",
            of_second(gyro),
        ),
        (
            "The same, G⁻¹ at 0.5 s",
            "in gyro space",
            "N Table 5",
            f"correlation {gyro['correlation']:.2f}; {gyro['rms_1e6_G']:.2f}e-6",
            "its G⁻¹ is of 0.5 s, as its first iteration's",
            f"correlation {mixed['correlation']:.2f}; {mixed['rms_1e6_G']:.2f}e-6",
        ),
        (
            "Printed digits the second iteration changes, 0.5 s",
            f"{digits['table2']} of 18 in Table 2, {digits['table4']} of 6 in Table 4",
            "none, says N",
            "–",
            "unknown",
            "–",
        ),
        (
            "Rate about x in -y forward",
            "+1 RPO, as printed",
            "N Table 2, interval 4",
            f"{rate['gap_rms_deg']['1']:.3f} deg",
            "it is -1 RPO",
            f"{rate['gap_rms_deg']['-1']:.3f} deg",
        ),
    ]
    names = ["question", "simulated", "flown", "gap before", "effect found", "gap after, on numbers that fitted nothing"]
    return pd.DataFrame(rows, columns=names)
