"""How many iterations a calibration needs: one, two, converged, over the size of the initial error, with and without noise.

The calibration is Gauss–Newton: if the residuals at the solution vanish, each iteration squares the error (slope 2); with
residuals from noise a small linear part remains. "Left" is the distance from the converged estimate, the only part of the error
that more iterations can remove, as the largest over the parameters in formal sigmas.

A case starts from the truth plus factors times two directions: "flown", the scenario's a-priori parameters minus the true ones
(TRMM: pre-launch minus flight's result), and "random", of the same norm in G and in b, drawn anew in each case.
"""

from typing import Any

import numpy as np
import pandas as pd
from pydantic import field_validator

from gyrocal.arrays import Array
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Psi
from gyrocal.calibration.sampling import prepare_measurements
from studies.calibration.shared_truth import Different, NoiseFreeSimulation, build_once, make_noise_generators
from studies.calibration.summaries import find_level_crossing, fit_log_slope
from studies.montecarlo.study import Streams, Study, StudyConfig, observed
from studies.report import panels
from studies.report.checks import Check, bound_above, bound_below
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table, summarise_groups

FACTORS = (0.3, 0.6, 1.0, 2.0, 3.0, 6.0, 10.0, 20.0, 30.0)
SHOWN_ITERATIONS = 3  # iterations in the rows, with their distances and corrections
LIMITS = (0.1, 1.0)  # sigma
ITERATION_TOLERANCE_SIGMAS = 1e-7  # sigma; smaller distances are rounding errors
CONVERGED = 1e-6  # sigma; largest last correction of a converged run
ERROR_DIRECTIONS = ("flown", "random")


class IterationsConfig(StudyConfig):
    """What the study runs."""

    cases: int = 100
    factors: Different = FACTORS  # sizes of the initial error, in units of the scenario's own
    iterations: int = 8  # after which an estimate is taken as the converged one
    psi: Psi = "full"  # "full" or "linear"

    @field_validator("iterations")
    @classmethod
    def _check_iterations(cls, value: int) -> int:
        if not SHOWN_ITERATIONS < value <= 100:
            raise ValueError(f"must be between {SHOWN_ITERATIONS + 1} and 100")
        return value


@build_once
def _prepare_problem(config: IterationsConfig, flown: NoiseFreeSimulation) -> tuple[NoiseFreeSimulation, Problem]:
    """Build the calibration problem of a simulated scenario, once for all its cases."""
    return flown, Problem.build(flown.plain, prepare_measurements(flown.plain))


def draw_error_direction(rng: np.random.Generator, error: Array) -> Array:
    """Draw a random direction (12,) with the norms that G and b of the error have."""
    out = rng.standard_normal(12)
    for part in (slice(0, 9), slice(9, 12)):
        out[part] *= np.linalg.norm(error[part]) / np.linalg.norm(out[part])
    return out


def run_case(config: IterationsConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """Calibrate a case from each direction and factor, with and without noise, a row each."""
    flown, prepared = _prepare_problem(config, number)
    initial_error = flown.initial - flown.truth
    directions = {"flown": initial_error, "random": draw_error_direction(streams.generator("initial_error"), initial_error)}
    rows = []
    for noise in (False, True):
        problem = prepared.replace_case(*flown.realise(make_noise_generators(streams) if noise else None))
        for direction, error in directions.items():
            for factor in config.factors:
                keys = {"direction": direction, "noise": noise, "factor": factor}
                rows.append(keys | _run_iterations(config, problem, flown.truth, factor * error))
    return rows


def _run_iterations(config: IterationsConfig, problem: Problem, truth: Array, error: Array) -> dict[str, object]:
    """Compute the distance after each iteration from truth + error; sigmas are the formal ones of the last iteration."""
    result = problem.iterate(truth + error, config.iterations, config.psi)
    sigma = np.sqrt(np.diag(result.P))
    corrections = np.diff(result.x, axis=0)
    distances = np.abs(result.x - result.x[-1]) / sigma
    row: dict[str, object] = {"converged": bool((np.abs(corrections[-1]) / sigma).max() < CONVERGED)}
    for k in range(SHOWN_ITERATIONS + 1):
        row[f"left_{k}_G_sigma"], row[f"left_{k}_bias_sigma"] = float(distances[k, :9].max()), float(distances[k, 9:].max())
    for k in range(SHOWN_ITERATIONS):
        row[f"correction_{k + 1}_G"] = float(np.abs(corrections[k, :9]).max())
        row[f"correction_{k + 1}_bias_deg_s"] = float(np.rad2deg(np.abs(corrections[k, 9:]).max()))
    return row


STUDY = Study("studies.calibration.iterations:STUDY", IterationsConfig, run_case, observed)


def _compute_remaining_error(rows: pd.DataFrame, k: int) -> pd.Series:
    """Compute the largest distance in G and b after iteration k, sigma."""
    return rows[[f"left_{k}_G_sigma", f"left_{k}_bias_sigma"]].max(axis=1)


def estimate_convergence_orders(rows: pd.DataFrame) -> pd.DataFrame:
    """Estimate slope_k, log distance after over before iteration k, and the ratio at factor 1, by direction and noise."""
    converged = rows[rows["converged"]].assign(**{f"left_{k}": _compute_remaining_error(rows, k) for k in (0, 1, 2)})

    def fit_orders(part: pd.DataFrame) -> dict[str, object]:
        row: dict[str, object] = {}
        for k in (1, 2):
            clear = part[part[f"left_{k}"] > ITERATION_TOLERANCE_SIGMAS]
            slopes = [fit_log_slope(case[f"left_{k - 1}"], case[f"left_{k}"]) for _, case in clear.groupby("case")]
            row[f"slope_{k}"] = float(np.nanmedian(slopes)) if np.isfinite(slopes).any() else np.nan
        nearest = part[part["factor"] == min(part["factor"], key=lambda factor: abs(np.log(factor)))]
        ratio = float((nearest["left_2"] / nearest["left_1"]).median())
        return row | {"factor": nearest["factor"].iloc[0], "second_over_first": ratio}

    return summarise_groups(converged.sort_values(["direction", "noise"], kind="stable"), ["direction", "noise"], fit_orders)


def find_limiting_factors(rows: pd.DataFrame) -> pd.DataFrame:
    """Find the factor from which k iterations leave more than each of `LIMITS`, by direction, noise and iterations.

    By the median over the cases, and for each limit by the 95 % quantile; interpolated, NaN where the factors do not reach it.
    """
    out = []
    for (direction, noise), part in rows[rows["converged"]].groupby(["direction", "noise"]):
        for k in (1, 2):
            by_factor = _compute_remaining_error(part, k).groupby(part["factor"])
            row: dict[str, object] = {"direction": direction, "noise": noise, "iterations": k}
            for limit in LIMITS:
                for name, probability in (("median", 0.5), ("p95", 0.95)):
                    distances = by_factor.quantile(probability)
                    row[f"factor_{limit:g}_sigma_{name}"] = find_level_crossing(distances.index, distances, limit)
            out.append(row)
    return pd.DataFrame(out)


QUADRATIC = "Without noise an iteration of Gauss–Newton leaves the square of the error before it, a slope of 2."
LINEAR = "Noise leaves residuals, and with them a small part that an iteration reduces by a factor only."


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    """Check the orders of convergence, the distances for the scenario's own error, and the runs that did not converge."""
    checks = []
    slopes = estimate_convergence_orders(rows).set_index(["direction", "noise"])
    for direction in (name for name in ERROR_DIRECTIONS if (name, False) in slopes.index):
        for k, ordinal in ((1, "first"), (2, "second")):
            name = f"power of what was left that the {ordinal} iteration leaves, {direction} error, no noise"
            checks.append(Check(name, slopes[f"slope_{k}"][(direction, False)], (1.9, 2.1), "", QUADRATIC))
        ratio = slopes["second_over_first"].loc[direction]
        if True in ratio.index:
            name = f"what the second iteration leaves by what the first left, {direction} error, noise by no noise"
            # A quotient of differences of 1e-8, whose sixth digit is the machine's.
            checks.append(Check(name, float(f"{ratio[True] / ratio[False]:.4g}"), bound_below(10), "", LINEAR))
    flown = rows[(rows["direction"] == "flown") & rows["noise"] & (rows["factor"] == 1) & rows["converged"]]
    for k in (1, 2) if len(flown) else ():
        distance = round(flown[[f"left_{k}_G_sigma", f"left_{k}_bias_sigma"]].median().max(), 8)  # above rounding errors
        name = f"left of the scenario's own error by {k} iteration(s), largest, median"
        checks.append(Check(name, distance, bound_above(LIMITS[0]), "sigma"))
    failed = rows[~rows["converged"]]
    checks.append(Check(f"runs that did not converge, of {len(rows)}", len(failed), (0, 0)))
    return [*checks, Check("smallest factor of a run that did not converge", failed["factor"].min())]


def report(config: IterationsConfig, rows: pd.DataFrame) -> Report:
    """Report the error after each iteration, its order, and the initial error from which one iteration is not enough."""
    limits = Table("From what initial error one or two iterations leave too much", find_limiting_factors(rows))
    return Report({"enough": limits}, {"iterations": _draw_figure(rows[rows["converged"]])}, tuple(_build_checks(rows)))


ENTRY = Entry(STUDY, "one, two, converged iterations over the size of the initial error", report)

ITERATION_STYLES = {0: (panels.GREY, "at the start"), 1: (panels.RED, "after one"), 2: (panels.TEAL, "after two")}
DIRECTION_TITLES = {"flown": "pre-launch − truth", "random": "random directions of the same norm"}


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """Draw the error after iterations over the initial error, a panel for each direction."""

    def build_lines(part: pd.DataFrame) -> list[Line]:
        """Build the median without noise, dotted, and the median and 5 to 95 % with noise, by number of iterations."""
        out = []
        for k, (colour, label) in ITERATION_STYLES.items():
            distances = _compute_remaining_error(part, k)
            noise_free, noisy = (distances[rows].groupby(part["factor"][rows]) for rows in (~part["noise"], part["noise"]))
            median, low, high = (noisy.quantile(probability) for probability in (0.5, 0.05, 0.95))
            out.append(Line(noise_free.median().index, noise_free.median(), "", colour, ":"))
            out.append(Line(median.index, median, label, colour, "-", low, high))
        return out

    axes: dict[str, Any] = {"log": "xy", "levels": LIMITS, "x": "factor on the initial error", "legend": "lower right"}
    axes |= {"y": "distance from converged (formal sigma)", "legend_title": "solid: noise, 5–95 %; dotted: none"}
    parts = {direction: rows[rows["direction"] == direction] for direction in ERROR_DIRECTIONS}
    curves = [panels.make_curves(build_lines(part), title=DIRECTION_TITLES[name], **axes) for name, part in parts.items()]
    return panels.build_sheet(*curves, size=(9.0, 3.6), sharey=True)
