"""How many iterations a calibration needs: one, two, converged, over the size of the initial error, with and without noise.

The calibration is Gauss–Newton: where the residuals at the solution vanish each iteration squares the error (slope 2), and
where noise leaves residuals a small linear part remains. "Left" is the distance from the converged estimate, the only part of
the error that more iterations can remove, as the largest over the parameters in formal sigmas; "error" is that from the truth.

A case starts from the truth plus factors times two directions: "flown", the scenario's a-priori parameters minus the true ones
(TRMM: pre-launch minus flight's result), and "random", of the same norm in G and in b, another in each case.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import field_validator

from gyrocal import GyroParameters, attitude
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import Psi
from gyrocal.calibration.sampling import measurements
from simulator.scenario import Scenario
from simulator.simulate import noise_free_rates, observe, realise
from simulator.truth.motion import Motion
from studies.montecarlo.statistics import crossing, order
from studies.montecarlo.study import Streams, Study, StudyConfig, base_scenario, case_motion, dispersed, observed
from studies.natanson import flight
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

Array = NDArray[np.float64]

FACTORS = (0.3, 0.6, 1.0, 2.0, 3.0, 6.0, 10.0, 20.0, 30.0)
SHOWN = 3  # iterations whose errors and corrections are in the rows
LIMITS = (0.1, 1.0)  # sigma
ROUNDING = 1e-7  # sigma; what is smaller is no longer an error of the iteration
CONVERGED = 1e-6  # sigma; largest last correction of what counts as converged
DIRECTIONS = ("flown", "random")


class IterationsConfig(StudyConfig):
    """What the study runs.

    Attributes
    ----------
    factors : sizes of the initial error, in units of the scenario's own
    iterations : after which an estimate is taken as the converged one
    psi : "full" or "linear"
    """

    cases: int = 100
    factors: tuple[float, ...] = FACTORS
    iterations: int = 8
    psi: Psi = "full"

    @field_validator("factors")
    @classmethod
    def _positive(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or min(value) <= 0 or len(set(value)) < len(value):
            raise ValueError("must be one or more different numbers above zero")
        return value

    @field_validator("iterations")
    @classmethod
    def _enough(cls, value: int) -> int:
        if not SHOWN < value <= 100:
            raise ValueError(f"must be between {SHOWN + 1} and 100")
        return value


@dataclass(frozen=True)
class _Prepared:
    """What cases with the same scenario share."""

    scenario: Scenario
    motion: Motion
    rates: Array
    truth: Array
    initial_error: Array
    problem: Problem


def _prepare(scenario: Scenario) -> _Prepared:
    path = case_motion(scenario)
    plain = observe(scenario, path, gyro_rng=None, reference_rng=None)
    truth = np.concatenate([np.ravel(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s)])
    return _Prepared(
        scenario=scenario,
        motion=path,
        rates=noise_free_rates(scenario, path),
        truth=truth,
        initial_error=GyroParameters(plain.gyro.apriori_G, plain.gyro.apriori_bias).vector - truth,
        problem=Problem.of(plain, measurements(plain)),
    )


@lru_cache(maxsize=2)
def _shared(config: str) -> _Prepared:
    """Preparation of a study without dispersions, made once a process."""
    return _prepare(base_scenario(IterationsConfig.model_validate_json(config)))


def random_direction(rng: np.random.Generator, error: Array) -> Array:
    """(12,) a random direction with the norms that G and b of the error have."""
    out = rng.standard_normal(12)
    for part in (slice(0, 9), slice(9, 12)):
        out[part] *= np.linalg.norm(error[part]) / np.linalg.norm(out[part])
    return out


def case(config: IterationsConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """One case: a row for each direction, with and without noise, and factor."""
    shared = _prepare(dispersed(config, number)) if config.dispersions else _shared(config.model_dump_json())
    directions = {
        "flown": shared.initial_error,
        "random": random_direction(streams.generator("initial_error"), shared.initial_error),
    }
    rows = []
    for noise in (False, True):
        gyro, reference = (streams.generator(name) if noise else None for name in ("gyro_noise", "reference_noise"))
        rates, quaternions = realise(shared.scenario, shared.motion, shared.rates, gyro, reference)
        problem = shared.problem.with_case(rates, attitude.matrix_from_quaternion(quaternions))
        for direction, error in directions.items():
            for factor in config.factors:
                keys = {"direction": direction, "noise": noise, "factor": factor}
                rows.append(keys | _iterated(config, problem, shared.truth, factor * error))
    return rows


def _iterated(config: IterationsConfig, problem: Problem, truth: Array, error: Array) -> dict[str, object]:
    """What each iteration from truth + error leaves; sigmas are the formal ones of the last iteration."""
    result = problem.iterate(truth + error, config.iterations, config.psi)
    sigma = np.sqrt(np.diag(result.P))
    corrections = np.diff(result.x, axis=0)
    left, wrong = (np.abs(result.x - origin) / sigma for origin in (result.x[-1], truth))
    row: dict[str, object] = {
        "residual_deg": float(np.rad2deg(np.linalg.norm(result.theta[0], axis=1).max())),
        "initial_G": float(np.abs(error[:9]).max()),
        "initial_bias_deg_s": float(np.rad2deg(np.abs(error[9:]).max())),
        "converged": bool((np.abs(corrections[-1]) / sigma).max() < CONVERGED),
    }
    for k in range(SHOWN + 1):
        for name, values in (("left", left[k]), ("error", wrong[k])):
            row[f"{name}_{k}_G_sigma"], row[f"{name}_{k}_bias_sigma"] = float(values[:9].max()), float(values[9:].max())
    row["error_converged_G_sigma"], row["error_converged_bias_sigma"] = float(wrong[-1, :9].max()), float(wrong[-1, 9:].max())
    for k in range(SHOWN):
        row[f"correction_{k + 1}_G"] = float(np.abs(corrections[k, :9]).max())
        row[f"correction_{k + 1}_bias_deg_s"] = float(np.rad2deg(np.abs(corrections[k, 9:]).max()))
    return row


STUDY = Study("studies.calibration.iterations:STUDY", IterationsConfig, case, observed)


def _left(rows: pd.DataFrame, k: int) -> pd.Series:
    """Largest of what iteration k leaves in G and b, sigma."""
    return rows[[f"left_{k}_G_sigma", f"left_{k}_bias_sigma"]].max(axis=1)


def after_each(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per direction, noise and factor: medians over the cases of what is left and of the corrections.

    Cases that do not converge count in `converged`, a share, and are left out of the rest.
    """
    values = [name for name in rows if str(name).startswith(("residual_", "initial_", "left_", "error_", "correction_"))]
    keys = ["direction", "noise", "factor"]
    table = rows[rows["converged"]].groupby(keys)[values].median()
    table.insert(0, "converged", rows.groupby(keys)["converged"].mean())
    return table.reset_index()


def convergence(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per direction and noise: slopes of log left over log left before, median over cases, and the ratio at factor 1.

    Columns slope_k: of what iteration k leaves over what was left before it, across the factors; two is quadratic.
    """
    good = rows[rows["converged"]].assign(**{f"left_{k}": _left(rows, k) for k in range(SHOWN + 1)})
    out = []
    for (direction, noise), part in good.groupby(["direction", "noise"]):
        row: dict[str, object] = {"direction": direction, "noise": noise}
        for k in (1, 2):
            slopes = []
            for _, one in part.groupby("case"):
                clear = one[one[f"left_{k}"] > ROUNDING]
                slopes.append(order(clear[f"left_{k - 1}"], clear[f"left_{k}"]))
            row[f"slope_{k}"] = float(np.nanmedian(slopes)) if np.isfinite(slopes).any() else np.nan
        nearest = part[part["factor"] == min(part["factor"], key=lambda factor: abs(np.log(factor)))]
        row["factor"] = nearest["factor"].iloc[0]
        row["second_over_first"] = float((nearest["left_2"] / nearest["left_1"]).median())
        out.append(row)
    return pd.DataFrame(out)


def enough(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per direction, noise and iteration: the factor from which it leaves more than each of `LIMITS`.

    By the median over the cases, and for each limit by the 95 % quantile; interpolated, NaN where the factors do not reach it.
    """
    good = rows[rows["converged"]]
    out = []
    for (direction, noise), part in good.groupby(["direction", "noise"]):
        for k in (1, 2):
            by_factor = _left(part, k).groupby(part["factor"])
            row: dict[str, object] = {"direction": direction, "noise": noise, "iterations": k}
            for limit in LIMITS:
                for name, share in (("median", 0.5), ("p95", 0.95)):
                    left = by_factor.quantile(share)
                    row[f"factor_{limit:g}_sigma_{name}"] = crossing(left.index, left, limit)
            out.append(row)
    return pd.DataFrame(out)


def second_iteration(rows: pd.DataFrame) -> pd.DataFrame:
    """The second iteration's largest correction in G and b at factor 1 with noise, beside the largest of N Table 5.

    The flight's is of G⁻¹ or of G, which does not matter to its size. Empty without that factor.
    """
    chosen = rows[(rows["direction"] == "flown") & rows["noise"] & (rows["factor"] == 1) & rows["converged"]]
    G, bias = flight.corrections(2)
    published = {"correction_2_G": float(np.abs(G).max()), "correction_2_bias_deg_s": float(np.abs(bias).max())}
    out = []
    for name, flown in published.items() if len(chosen) else ():
        values = chosen[name]
        out.append(
            {
                "quantity": name.removeprefix("correction_2_"),
                "flight": flown,
                "median": values.median(),
                "p05": values.quantile(0.05),
                "p95": values.quantile(0.95),
                "flight_percentile": 100 * float((values < flown).mean()),
            }
        )
    return pd.DataFrame(out)


def _chosen(table: pd.DataFrame, direction: str, noise: bool, **values: float) -> pd.Series | None:
    """The row of a table, or None."""
    mask = (table["direction"] == direction) & (table["noise"] == noise)
    for name, value in values.items():
        mask &= table[name] == value
    return table[mask].iloc[0] if mask.any() else None


def _findings(rows: pd.DataFrame) -> list[str]:
    slopes, needed, beside, medians = convergence(rows), enough(rows), second_iteration(rows), after_each(rows)
    out = []
    for direction in DIRECTIONS:
        quiet, noisy = (_chosen(slopes, direction, noise) for noise in (False, True))
        if quiet is not None and noisy is not None:
            out.append(
                f"Error {direction}: without noise what an iteration leaves grows with the power {quiet['slope_1']:.2f} "
                f"(first) and {quiet['slope_2']:.2f} (second) of what was left before it; 2 is quadratic. At factor "
                f"{quiet['factor']:g} the second leaves {quiet['second_over_first']:.1e} of what the first left, with noise "
                f"{noisy['second_over_first']:.1e}."
            )
    for direction in DIRECTIONS:
        one, two = (_chosen(needed, direction, True, iterations=k) for k in (1, 2))
        if one is not None and two is not None:
            first = ", ".join(f"{limit:g} sigma from {_at(one, limit)}" for limit in LIMITS)
            second = ", ".join(f"{limit:g} sigma from {_at(two, limit)}" for limit in LIMITS)
            out.append(f"Error {direction}, with noise: one iteration leaves more than {first}; two leave more than {second}.")
    flown = _chosen(medians, "flown", True, factor=1.0)
    if flown is not None:
        two_left = max(flown["left_2_G_sigma"], flown["left_2_bias_sigma"])
        out.append(
            f"The scenario's own initial error ({flown['initial_G']:.2g} in G, {flown['initial_bias_deg_s']:.2g} deg/s in b, "
            f"residuals of up to {flown['residual_deg']:.2f} deg) is left at {flown['left_1_G_sigma']:.2g} sigma in G and "
            f"{flown['left_1_bias_sigma']:.2g} sigma in b by one iteration, at {two_left:.1e} by two; the noise's own error is "
            f"{flown['error_converged_G_sigma']:.2g} sigma (largest of nine) in G."
        )
    for row in beside.to_dict("records"):
        unit = "deg/s in b" if "bias" in row["quantity"] else "in G"
        out.append(
            f"Second iteration's largest correction: flight {row['flight']:.1g} {unit} (N Table 5), simulated "
            f"{row['median']:.2g} ({row['p05']:.2g} to {row['p95']:.2g}, 5-95 %; flight at {row['flight_percentile']:.0f} %)."
        )
    failed = rows[~rows["converged"]]
    if len(failed):
        out.append(
            f"{len(failed)} of {len(rows)} runs did not converge, from factor {failed['factor'].min():g} on; they count "
            "nowhere else."
        )
    else:
        out.append(f"All {len(rows)} runs converged, up to a factor of {rows['factor'].max():g}.")
    return out


def _at(row: pd.Series, limit: float) -> str:
    """Median factor, with that of the worst twentieth where it is another."""
    median, worst = (f"{row[f'factor_{limit:g}_sigma_{name}']:.2g}" for name in ("median", "p95"))
    text = "a factor beyond the grid" if median == "nan" else f"factor {median}"
    return text if worst in ("nan", median) else f"{text} ({worst} in 5 % of the cases)"


def report(config: IterationsConfig, rows: pd.DataFrame) -> Report:
    """What each iteration leaves, how fast, and from what initial error one is not enough."""
    medians = after_each(rows)
    short = ["direction", "noise", "factor", "converged", "residual_deg"]
    short += [f"left_{k}_{what}_sigma" for k in range(SHOWN + 1) for what in ("G", "bias")]
    corrections = [f"correction_{k}_{what}" for k in range(1, SHOWN + 1) for what in ("G", "bias_deg_s")]
    errors = [name for name in medians if str(name).startswith("error_")]
    tables = {
        "enough": Table("From what initial error one or two iterations leave too much", enough(rows)),
        "convergence": Table("Order of convergence", convergence(rows)),
        "second_iteration": Table("Second iteration's corrections beside N Table 5", second_iteration(rows)),
        "left": Table("Left after each iteration (distance from converged, sigma; medians)", medians[short]),
        "corrections": Table("Corrections (largest of G, and of b; medians)", medians[[*short[:3], *corrections]]),
        "errors": Table("Error from the truth (sigma, medians)", medians[[*short[:3], *errors]]),
    }
    return Report(tables, {"iterations": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "one, two, converged iterations over the size of the initial error", report)

COLOURS = {0: "0.6", 1: "#d1495b", 2: "#00798c", 3: "#30343f"}
WORDS = {0: "at the start", 1: "after one", 2: "after two", 3: "after three"}
FLOOR = 1e-9  # sigma; the figure ends there


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """What iterations leave over the size of the initial error, a panel a direction."""
    good = rows[rows["converged"]]
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = drawing.subplots(1, len(DIRECTIONS), sharey=True)
        for axes, direction in zip(panels, DIRECTIONS, strict=True):
            _panel(axes, good[good["direction"] == direction])
            axes.set_title(
                {"flown": "pre-launch − truth", "random": "random directions of the same norm"}[direction],
                loc="left",
                fontsize=9,
            )
            axes.set_xlabel("factor on the initial error")
        panels[0].set_ylabel("distance from converged (formal sigma)")
        panels[1].legend(fontsize=7, loc="lower right", title="solid: noise, 5–95 %; dotted: none", title_fontsize=7)
        return save(drawing, path)


def _panel(axes: Axes, rows: pd.DataFrame) -> None:
    for k in (0, 1, 2):
        for noise, line in ((False, ":"), (True, "-")):
            part = rows[rows["noise"] == noise]
            left = _left(part, k).groupby(part["factor"])
            median = left.median()
            axes.loglog(median.index, median, line, color=COLOURS[k], label=WORDS[k] if noise else None)
            if noise:
                axes.fill_between(
                    median.index, left.quantile(0.05), left.quantile(0.95), color=COLOURS[k], alpha=0.2, linewidth=0
                )
    for limit in LIMITS:
        axes.axhline(limit, color="0.4", linewidth=0.8, linestyle="--")
    axes.set_ylim(bottom=FLOOR)
