"""The command ``gyrocal calibrate``: the gyro's parameters from a recording."""

from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.parameters import GyroParameters, select
from gyrocal.errors import InputError
from gyrocal.recording import Recording, load
from gyrocal.recording.import_notes import read_estimated_noise, read_import_warnings
from studies.cli.options import (
    EXCLUDE,
    PAGE,
    PATH,
    add_json_option,
    add_output_option,
    compare_conditions,
    end,
    parse_condition,
    read_json,
    write_result,
)

MOST_ITERATIONS = 1000  # convergence takes a few, or does not happen
LARGEST = 1e6  # of a plausible range or an a-priori sigma
CONDITIONS = ("p", "condition")  # quantities of --fail-on


@click.command("calibrate")
@click.argument("recording", type=PATH)
@add_json_option()
@add_output_option("--report", help=PAGE)
@click.option(
    "--truth", type=PATH, help="JSON with the true G and bias_deg_s, as written by simulate --truth; the errors are shown."
)
@click.option(
    "--psi",
    type=click.Choice(["full", "linear"]),
    default="full",
    show_default=True,
    help="Sensitivity ψ of a step's rotation to G and b, N (11): exact, or to first order in the angle turned.",
)
@click.option(
    "--iterations", type=click.IntRange(1, MOST_ITERATIONS), help="Number of iterations; by default until convergence."
)
@click.option(
    "--parametrisation",
    type=click.Choice(["gain", "gyro"]),
    default="gain",
    show_default=True,
    help="Iterate in G and b, or in each gyro's own scale factor s, axis u and bias c, as N did.",
)
@click.option(
    "--solve-for",
    default="all",
    show_default=True,
    help="Parameters (G_xx … b_z; in gyro space s_x, u_xy … c_z) or groups (all, bias, scale, misalignment, gyro_x), comma "
    "separated; a leading - excludes: all,-misalignment. gyro_x is that gyro with "
    "--parametrisation gyro, else row x of G and b_x.",
)
@click.option(
    "--step", "step_s", type=float, help="Propagation step in s, a multiple of the sample interval; one sample by default."
)
@click.option(
    "--resampling",
    type=click.Choice(["skip", "average"]),
    default="average",
    show_default=True,
    help="Rate of a step of several samples: their mean, or the first of them.",
)
@click.option(
    "--covariance",
    type=click.Choice(["full", "references-only"]),
    default="full",
    show_default=True,
    help="Covariance of the residuals: with gyro noise and references shared by neighbours, or the references alone as in N.",
)
@click.option("--prior-sigma-g", type=float, help="A-priori sigma (1-sigma) of each element of G.")
@click.option("--prior-sigma-bias", type=float, help="A-priori sigma of each bias, deg/s.")
@click.option(
    "--plausible-g",
    type=float,
    help="Plausible range of an element of G; that of the gyro's grade by default. A combination that the data do not "
    "determine to within its range is reported as not found.",
)
@click.option("--plausible-bias", type=float, help="Plausible range of a bias, deg/h; that of the gyro's grade by default.")
@click.option(
    "--max-gap",
    "max_gap_s",
    type=float,
    help="Longest run of missing samples, s, over which the last rate is held; longer ones are an error.",
)
@EXCLUDE
@click.option(
    "--fail-on",
    multiple=True,
    metavar="CONDITION",
    help="End with status 3 if this condition holds: 'p<0.001' of the residuals' p-value, or 'condition>100'; repeatable.",
)
@click.option(
    "--against",
    type=PATH,
    metavar="RESULT.json",
    help="Compare with a saved result of --json: the change of each parameter in sigmas.",
)
@click.option(
    "--max-sigma",
    type=float,
    help="With --against, end with status 1 if a parameter, or all together, changed by this many sigmas.",
)
@click.option(
    "--max-change",
    multiple=True,
    metavar="LIMIT",
    help="With --against, end with status 1 if a change exceeds it: 'G_zz<50ppm', 'misalignment<20arcsec', 'b_x<0.1deg/h'; "
    "repeatable.",
)
@add_output_option("--junit", help="Write each --fail-on, --max-sigma and --max-change as a test to this file, JUnit's XML.")
def command(
    recording: Path,
    as_json: Path | None,
    report: Path | None,
    truth: Path | None,
    covariance: str,
    prior_sigma_g: float | None,
    prior_sigma_bias: float | None,
    plausible_g: float | None,
    plausible_bias: float | None,
    solve_for: str,
    parametrisation: Parametrisation,
    fail_on: tuple[str, ...],
    against: Path | None,
    max_sigma: float | None,
    max_change: tuple[str, ...],
    junit: Path | None,
    exclude: list[list[float]] | None,
    **options: Any,
) -> None:
    """Calibrate the gyro of RECORDING, a folder with recording.toml, gyro and attitude tables.

    G and b of ω = G ω_raw + b are found by Davenport's method as in Natanson (1998), here N; see README.md.

    \b
    Example:
      gyrocal simulate trmm /tmp/rec --truth /tmp/truth.json
      gyrocal calibrate /tmp/rec --truth /tmp/truth.json --json /tmp/result.json
      gyrocal calibrate /tmp/rec --report /tmp/calibration.html
      gyrocal calibrate /tmp/rec --parametrisation gyro --solve-for gyro_z
      gyrocal calibrate /tmp/rec --fail-on 'p<0.001' --junit /tmp/calibration.xml
      gyrocal calibrate /tmp/rec --against /tmp/result.json --max-sigma 3 --max-change 'G_zz<50ppm'
    """
    if not all(0 < value < LARGEST for value in (plausible_g, plausible_bias) if value is not None):
        raise InputError(f"--plausible-g and --plausible-bias must be plausible: positive and below {LARGEST:g}")
    plausible_rate = None if plausible_bias is None else float(np.deg2rad(plausible_bias / 3600))
    _check_conditions(fail_on, against, max_sigma, max_change)
    original = load(recording)
    for text in read_import_warnings(recording):
        click.echo(f"implausible: {text}")
    true_parameters = _read_truth(truth) if truth else None

    from diagnosis.plan.invisible import find_invisible_effects
    from gyrocal.calibration.change import compute_change
    from gyrocal.calibration.davenport import calibrate
    from gyrocal.calibration.remainder import add_remainder
    from gyrocal.estimation.held_out import describe_held_out_turns, predict_held_out_turns
    from gyrocal.estimation.remainder_noise import read_calibration
    from gyrocal.masking import find_mask
    from studies.report import calibration as calibration_report
    from studies.report.pages import Section

    saved = read_calibration(against) if against else None
    settings: dict[str, Any] = {
        "solve_for": solve_for,
        "apriori_covariance": _build_prior(
            select(solve_for, select_parameter_space(parametrisation).names), prior_sigma_g, prior_sigma_bias
        ),
        "covariance_model": "full" if covariance == "full" else "references only",
        "plausible_G": plausible_g,
        "plausible_bias": plausible_rate,
        "parametrisation": parametrisation,
        **options,
    }
    mask = find_mask(original, [(first, stop) for first, stop in exclude or ()])
    loaded = mask.apply(original)
    result = calibrate(loaded, **settings)
    result = add_remainder(loaded, result)
    provenance, limits = _describe_input(original) if as_json or against else {}, []
    sigma = np.sqrt(np.diag(result.recommended_covariance))
    parameters = result.parameters
    invisible = find_invisible_effects(loaded, parameters.G, parameters.bias, sigma) if (sigma > 0).all() else ()
    sections = [
        Section("What this recording cannot show", [[effect.describe() for effect in invisible]]),
        Section("Left out, since it was not measured", [mask.describe(original)]),
        Section("Origin of the noise", [calibration_report.describe_import_noise(result, read_estimated_noise(recording))]),
    ]
    if saved is not None:
        is_same = provenance["recording_sha256"] == saved.recording_sha256
        change = compute_change(saved.parameters, saved.covariance, result.parameters, result.recommended_covariance, is_same)
        limits = calibration_report.check_limits(change, max_sigma, max_change)
        sections.append(calibration_report.build_change_section(change, str(against), limits))
    turns = predict_held_out_turns(loaded, **settings)
    held_out = describe_held_out_turns(turns)
    build = partial(calibration_report.build_calibration_page, result, held_out, true_parameters, further_sections=sections)
    masked = {"masked": mask.to_json(), "masked_share": mask.compute_share(original)}
    masked |= {"invisible": [effect.to_json() for effect in invisible]}
    document = result.to_json() | {"held_out_turns": [turn.to_json() for turn in turns], **masked, "provenance": provenance}
    write_result(document, as_json, build, report, loaded)
    known_numbers = dict(zip(CONDITIONS, (float(result.p_value), float(result.observability.condition)), strict=True))
    end("calibrate", str(recording), compare_conditions(fail_on, known_numbers), junit, limits)


def _check_conditions(fail_on: tuple[str, ...], against: Path | None, max_sigma: float | None, limits: tuple[str, ...]) -> None:
    """Raise `InputError`, before the work, for conditions and limits that cannot be tested."""
    for text in fail_on:
        parse_condition(text, CONDITIONS)
    if against is None and (max_sigma is not None or limits):
        raise InputError("--max-sigma and --max-change limit a change: give the saved result with --against RESULT.json")
    if max_sigma is not None and not 0 < max_sigma < LARGEST:
        raise InputError(f"--max-sigma {max_sigma:g}: must be positive and below {LARGEST:g}")
    for text in limits:
        from studies.report.calibration import parse_limit

        parse_limit(text)


def _describe_input(recording: Recording) -> dict[str, str | None]:
    """Return the span of the recording's intervals as dates, its hash, and the commit that calibrates it."""
    from simulator.adopted_scenario import hash_recording
    from studies.montecarlo.manifest import read_commit

    epoch = datetime.fromisoformat(recording.epoch)
    offset = epoch.utcoffset()
    start = np.datetime64(epoch.replace(tzinfo=None), "ms") - np.timedelta64(offset or 0, "ms")
    ends = min(interval.start_s for interval in recording.intervals), max(interval.stop_s for interval in recording.intervals)
    valid_from, valid_until = (str(start + np.timedelta64(round(1e3 * end), "ms")) for end in ends)
    return {
        "valid_from": valid_from,
        "valid_until": valid_until,
        "time_scale": recording.time_scale,
        "recording_sha256": hash_recording(recording),
        "commit": read_commit(),
    }


def _read_truth(path: Path) -> GyroParameters:
    """Read the true G and b from a file of `simulate --truth`."""

    def convert(document: Any) -> GyroParameters:
        bias = np.deg2rad(np.array(document["bias_deg_s"], dtype=float))
        return GyroParameters(np.array(document["G"], dtype=float), bias)

    return read_json(path, "a truth file with G and bias_deg_s", convert)


def _build_prior(names: tuple[str, ...], sigma_G: float | None, sigma_bias: float | None) -> np.ndarray | None:
    """Build the a-priori covariance from sigmas of G without unit and of b in deg/s."""
    if sigma_G is None and sigma_bias is None:
        return None
    if sigma_G is None or sigma_bias is None:
        raise InputError("give both --prior-sigma-g and --prior-sigma-bias, or neither")
    if not (1e-15 < sigma_G < LARGEST and 1e-15 < sigma_bias < LARGEST):
        raise InputError("--prior-sigma-g and --prior-sigma-bias must be positive and below 1e6")
    from gyrocal.calibration.observability import BIAS_LETTERS

    return np.diag([(np.deg2rad(sigma_bias) if name.startswith(BIAS_LETTERS) else sigma_G) ** 2 for name in names])
