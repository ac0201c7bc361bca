"""The command ``gyrocal predict``: the attitude propagated with the gyro alone."""

from functools import partial
from pathlib import Path

import click
import numpy as np

from gyrocal.errors import InputError
from gyrocal.recording import load
from studies.cli.options import PATH, add_json_option, add_output_option, write_result
from studies.montecarlo.files import write_csv

FEWEST_S = 1e-6


@click.command("predict")
@click.argument("recording", type=PATH)
@click.option(
    "--from",
    "from_s",
    type=float,
    required=True,
    help="Start of the prediction, s from the epoch; later references are not used.",
)
@add_output_option("--out", help="Write the prediction as CSV: t_s, q1 … q4, sigma_x_arcsec … z.")
@click.option("--step", "step_s", type=click.FloatRange(FEWEST_S), help="s between rows; by default a row at each gyro sample.")
@add_output_option("--report", help="Write a page with the figure (HTML, needs no network) to this file.")
@add_json_option("the prediction, and how its start fits,")
@click.option(
    "--calibration",
    type=PATH,
    help="Result of 'gyrocal calibrate --json' to start from: G, b, their recommended covariance, and the remainder.",
)
@click.option(
    "--prior-sigma-g", type=float, help="A-priori 1-sigma of each element of G; by default the range of the gyro's grade."
)
@click.option(
    "--prior-sigma-bias", type=float, help="A-priori 1-sigma of each bias, deg/s; by default the range of the gyro's grade."
)
@click.option("--prior-mounting", type=float, default=0.0, help="A-priori 1-sigma of a rotation of all gyros together, deg.")
@click.option("--prior-scale", type=float, default=0.0, help="A-priori 1-sigma of a common scale factor.")
def command(
    recording: Path,
    from_s: float,
    out: Path | None,
    step_s: float | None,
    report: Path | None,
    as_json: Path | None,
    calibration: Path | None,
    prior_sigma_g: float | None,
    prior_sigma_bias: float | None,
    prior_mounting: float,
    prior_scale: float,
) -> None:
    """Propagate the attitude of RECORDING with the gyro alone from a time on, with its covariance.

    The start attitude is estimated from the references up to that time, of the interval that contains it. G and b are estimated
    from the same references, with the a-priori parameters and their sigmas. With --calibration the parameters and their
    covariance are those of an earlier calibration, and its remainder is added to the noise. See docs/predict.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --seed 1
      gyrocal predict /tmp/rec --from 3000 --out /tmp/prediction.csv --report /tmp/prediction.html
      gyrocal simulate trmm_series /tmp/earlier --seed 2
      gyrocal calibrate /tmp/earlier --json /tmp/result.json
      gyrocal predict /tmp/rec --from 3000 --calibration /tmp/result.json
    """
    loaded = load(recording)

    from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
    from gyrocal.estimation.predict import list_step_times, predict, prior_covariance
    from gyrocal.estimation.remainder_noise import RemainderNoise, read_calibration
    from studies.report.prediction import build_prediction_page, tabulate_prediction

    ranges = estimate_plausible_ranges(loaded, use_rests=False)
    sigma_g = ranges.G if prior_sigma_g is None else prior_sigma_g
    sigma_bias = ranges.bias if prior_sigma_bias is None else float(np.deg2rad(prior_sigma_bias))
    P0 = prior_covariance(sigma_g, sigma_bias, float(np.deg2rad(prior_mounting)), prior_scale, loaded.gyro.apriori_G)
    noise = RemainderNoise()
    if calibration is not None:
        priors = (prior_sigma_g, prior_sigma_bias, prior_mounting or None, prior_scale or None)
        if any(prior is not None for prior in priors):
            raise InputError("--calibration has the covariance of G and b: leave out --prior-sigma-g and the other priors")
        saved = read_calibration(calibration)
        loaded, P0, noise = saved.apply(loaded), saved.covariance, saved.noise
    times = None if step_s is None else list_step_times(loaded, from_s, step_s)
    prediction = predict(loaded, from_s, times, P0, noise)
    table = tabulate_prediction(prediction)
    if out:
        write_csv(out, table, digits=12)
    header = {"recording": loaded.title, "from_s": from_s}
    header |= {"used": prediction.used, "chi2": prediction.chi2, "dof": prediction.dof}
    document = header | {"prediction": table.to_dict("records")} if as_json else None
    write_result(document, as_json, partial(build_prediction_page, prediction, loaded.title, from_s), report, loaded)
