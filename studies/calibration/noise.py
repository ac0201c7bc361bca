"""How well each parameter can be known: gyro noise (ARW) against reference noise.

With V = V_ref + V_gyro the covariance of the residuals (`gyrocal.calibration.covariance`), K = P Θᵀ V⁻¹ the gain and P = (Θᵀ
V⁻¹ Θ)⁻¹,

    P = K V Kᵀ = K V_ref Kᵀ + K V_gyro Kᵀ,

so each parameter's variance splits in two, and the gyro's share of it shows which noise limits the parameter. Since
∂P = K ∂V Kᵀ, the share is also the scaling law: V_gyro ∝ ARW² gives ∂ ln σ_j / ∂ ln ARW = share_j, and
∂ ln σ_j / ∂ ln σ_ref = 1 − share_j. The share depends on the ratio ARW/σ_ref only; the limit changes where it is one half.

The study is a grid, a case a point of it. The last point has the flight's own noise: the ARW from the spread between the step
sizes of N Table 2 (`studies.natanson.flight_gap.estimate_noise_from_steps`) with the scenario's references. At the grid's
corners and at the flight's point the formal sigma is compared with the spread of estimates over seeds, by Monte Carlo.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import scipy.stats
from pydantic import Field

from gyrocal import NAMES, InputError
from gyrocal.arrays import Array
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.covariance import compute_residual_covariance, integrate_white_noise
from gyrocal.calibration.parameters import BIAS_NAMES, MISALIGNMENT_NAMES, SCALE_FACTORS
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import override
from studies.calibration.shared_truth import NoiseFreeSimulation, Rising, build_once, make_noise_generators
from studies.montecarlo.study import GridConfig, Streams, Study, load_base_scenario
from studies.natanson import flight_gap
from studies.report import panels
from studies.report.checks import Check, check_extremes
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES, name_columns

ARW_GRID_DEG_PER_SQRT_S = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3)
SIGMA_GRID_DEG = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)

SIGMAS, SPREADS = name_columns("sigma"), name_columns("spread")
GYRO_SHARE_COLUMNS = [f"gyro_share_{name}" for name in NAMES]
PARAMETER_GROUPS = {"scale factors": SCALE_FACTORS, "misalignments": MISALIGNMENT_NAMES, "biases": BIAS_NAMES}


class NoiseConfig(GridConfig):
    """What the study runs."""

    axes: ClassVar = ("arw_deg_per_sqrt_s", "sigma_deg")
    # arw_deg_per_sqrt_s, sigma_deg: the grid: angle random walk, and 1-sigma of a reference attitude about each body axis
    arw_deg_per_sqrt_s: Rising = Field(default=ARW_GRID_DEG_PER_SQRT_S, min_length=2)
    sigma_deg: Rising = Field(default=SIGMA_GRID_DEG, min_length=2)
    seeds: int = Field(default=200, ge=3)  # estimates that make the spread at a point that has one
    confidence: float = Field(default=0.99, gt=0.5, lt=1)  # of all intervals of the spread together

    def points(self) -> list[tuple[float, float]]:
        """List ARW and reference sigma of each point: those of the grid, and last the flight's."""
        return [*product(self.arw_deg_per_sqrt_s, self.sigma_deg), estimate_flight_noise(self)]

    def has_spread(self, case: int) -> bool:
        """Check whether a point is a corner of the grid or the flight's."""
        last = len(self.sigma_deg) - 1
        return case in (0, last, self.cases - 2 - last, self.cases - 2, self.cases - 1)


@dataclass(frozen=True)
class _CovarianceParts:
    """Common to all points: the simulation without noise, Θ (3m, 12), and the two parts of V (3m, 3m) per unit variance."""

    flown: NoiseFreeSimulation
    problem: Problem
    Theta: Array
    V_reference: Array
    V_gyro: Array


@build_once
def _prepare_covariances(config: NoiseConfig, flown: NoiseFreeSimulation) -> _CovarianceParts:
    """Compute Θ and both parts of V at the true parameters, once for all points."""
    prepared = prepare_measurements(flown.plain)
    problem = Problem.build(flown.plain, prepared)
    propagation = propagate(prepared.arcs, flown.truth[:9].reshape(3, 3), flown.truth[9:])
    residual_indices, unit_variance = problem.references[:3], np.tile(np.eye(3), (len(problem.A), 1, 1))
    walk = integrate_white_noise(prepared.elapsed_s, 1.0)
    V_reference = compute_residual_covariance(propagation.R, *residual_indices, unit_variance, 0.0 * walk)
    V_gyro = compute_residual_covariance(propagation.R, *residual_indices, 0.0 * unit_variance, walk)
    Theta = accumulation.build_sensitivity(propagation.S, problem.columns, problem.scale)
    return _CovarianceParts(flown, problem, Theta, V_reference, V_gyro)


def estimate_flight_noise(config: NoiseConfig) -> tuple[float, float]:
    """Estimate the ARW (deg/sqrt(s)) of the flight's residuals, and the scenario's RMS reference sigma (deg)."""
    sigma = load_base_scenario(config).reference.sigma_deg
    return flight_gap.estimate_noise_from_steps()["arw_deg_per_sqrt_s"], float(np.sqrt(np.mean(np.square(sigma))))


def compute_formal_sigmas(prepared: _CovarianceParts, arw: float, sigma: float) -> tuple[Array, Array]:
    """Compute the formal sigma (12,), G dimensionless and b rad/s, and the gyro's share (12,) of each variance.

    The arw is in rad/√s, the sigma of a reference attitude about each axis in rad.
    """
    V_gyro = arw**2 * prepared.V_gyro
    weighted = np.linalg.solve(sigma**2 * prepared.V_reference + V_gyro, prepared.Theta)
    P = np.linalg.inv(prepared.Theta.T @ weighted)
    K = P @ weighted.T
    return prepared.problem.scale * np.sqrt(np.diag(P)), np.diag(K @ V_gyro @ K.T) / np.diag(P)


def run_case(config: NoiseConfig, case: int, streams: Streams) -> dict[str, object]:
    """Compute formal sigmas and the gyro's shares at a point, and at some points the spread over seeds."""
    prepared = _prepare_covariances(config, case)
    arw_deg, sigma_deg = config.points()[case]
    sigmas, shares = compute_formal_sigmas(prepared, np.deg2rad(arw_deg), np.deg2rad(sigma_deg))
    row: dict[str, object] = {"arw_deg_per_sqrt_s": arw_deg, "sigma_deg": sigma_deg, "flight": case == config.cases - 1}
    row |= dict(zip([*SIGMAS, *GYRO_SHARE_COLUMNS], [*(sigmas * PPM_DEG_H).tolist(), *shares.tolist()], strict=True))
    row["seeds"] = config.seeds if config.has_spread(case) else 0
    if config.has_spread(case):
        spread = simulate_estimates(config, prepared, arw_deg, sigma_deg, streams).std(axis=0, ddof=1)
        row |= dict(zip(SPREADS, (spread * PPM_DEG_H).tolist(), strict=True))
    return row


def simulate_estimates(
    config: NoiseConfig, prepared: _CovarianceParts, arw_deg: float, sigma_deg: float, streams: Streams
) -> Array:
    """Simulate (seeds, 12) estimates after two iterations from the a-priori parameters; G dimensionless, b rad/s."""
    levels = {"gyro.arw_deg_per_sqrt_s": arw_deg} | {f"reference.sigma_deg.{axis}": sigma_deg for axis in range(3)}
    flown = replace(prepared.flown, scenario=override(prepared.flown.scenario, levels))
    variance = np.tile(np.deg2rad(sigma_deg) ** 2 * np.eye(3), (len(prepared.problem.A), 1, 1))
    problem = replace(prepared.problem, arw=float(np.deg2rad(arw_deg)), noise=variance)
    noise = make_noise_generators(streams)
    cases = (problem.replace_case(*flown.realise(noise)) for _ in range(config.seeds))
    return np.array([case.iterate(flown.initial, 2).check_convergence().x[-1] for case in cases])


STUDY = Study("studies.calibration.noise:STUDY", NoiseConfig, run_case)


def _select_flight_row(rows: pd.DataFrame) -> pd.Series:
    """Return the row with the flight's own noise."""
    flight_rows = rows[rows["flight"]]
    if len(flight_rows) != 1:
        raise InputError("noise: the case with the flight's noise failed; run the study again with its failed cases")
    return flight_rows.iloc[0]


def build_flight_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Build the table of the twelve parameters at the flight's own noise."""
    flown = _select_flight_row(rows)
    keys = {"sigma": SIGMAS, "spread": SPREADS, "gyro_share": GYRO_SHARE_COLUMNS}
    values = {name: flown[columns].to_numpy(float) for name, columns in keys.items()}
    table = pd.DataFrame({"parameter": NAMES, "unit": PPM_DEG_H_NAMES, **values})
    limited = np.where(table["gyro_share"] > 0.5, "gyro", "references")
    return table.assign(limited_by=limited, crossing_arw_deg_per_sqrt_s=find_share_crossings(rows) * flown["sigma_deg"])


def find_share_crossings(rows: pd.DataFrame) -> Array:
    """Find (12,) ARW/σ_ref, 1/sqrt(s), at a gyro's share of one half, interpolated; NaN outside the grid."""
    ratio = np.log((rows["arw_deg_per_sqrt_s"] / rows["sigma_deg"]).to_numpy())
    order = np.argsort(ratio)
    shares = rows[GYRO_SHARE_COLUMNS].to_numpy()[order]
    # The logit is nearly a straight line: a share of s²/(1 + s²) has 2 ln s.
    logits = np.log(shares / (1 - shares))
    return np.array([np.exp(np.interp(0.0, column, ratio[order], left=np.nan, right=np.nan)) for column in logits.T])


def build_spread_table(config: NoiseConfig, rows: pd.DataFrame) -> pd.DataFrame:
    """Build the spread over seeds with its χ² interval, a row a point and parameter, and test the formal sigma.

    The intervals have the stated confidence all together.
    """
    points = rows[rows["seeds"] > 0]
    tail = (1 - config.confidence) / (2 * len(NAMES) * max(len(points), 1))
    out = []
    for point in points.to_dict("records"):
        dof = point["seeds"] - 1
        high, low = np.sqrt(dof / scipy.stats.chi2.ppf([tail, 1 - tail], dof))
        sigma, spread = (np.array([point[key] for key in keys]) for keys in (SIGMAS, SPREADS))
        line = {name: point[name] for name in ("arw_deg_per_sqrt_s", "sigma_deg")}
        line |= {"parameter": NAMES, "unit": PPM_DEG_H_NAMES, "sigma": sigma, "spread": spread}
        line |= {"spread_low": low * spread, "spread_high": high * spread}
        out.append(pd.DataFrame(line | {"inside": (low * spread <= sigma) & (sigma <= high * spread)}))
    return pd.concat(out, ignore_index=True)


FLIGHT_NOTE = (
    "The sigma of a parameter goes with ARW^s σ_ref^(1 − s), s the share of the gyro's noise in its variance. Above the ARW of "
    "its crossing the gyro's noise limits a parameter, below it the references do."
)
SPREAD_NOTE = "The bounds of the formal sigma by the spread over seeds are those of all points and parameters together."


def _build_checks(rows: pd.DataFrame, spreads: pd.DataFrame) -> list[Check]:
    """Build the checks: the flight's noise, the parameters it limits, and formal sigmas against the spread."""
    table, flown = build_flight_table(rows), _select_flight_row(rows)
    checks = [Check("ARW of the flight", flown["arw_deg_per_sqrt_s"], None, "deg/√s")]
    checks.append(Check("sigma of its references", flown["sigma_deg"], None, "deg"))
    limited = int((table["limited_by"] == "gyro").sum())
    checks.append(Check("parameters limited by the gyro at the flight's noise", limited, None, f"of {len(table)}"))
    count, inside = len(spreads), int(spreads["inside"].sum())
    checks.append(Check(f"formal sigmas within the spread's interval, of {count}", inside, (count, count), "", SPREAD_NOTE))
    return [*checks, *check_extremes("spread over seeds by formal sigma", spreads["spread"] / spreads["sigma"])]


def report(config: NoiseConfig, rows: pd.DataFrame) -> Report:
    """Report the sigmas at the flight's noise, the limiting noise, and the spread that confirms them."""
    spreads = build_spread_table(config, rows)
    table = Table("Sigma of each parameter at the flight's own noise", build_flight_table(rows), FLIGHT_NOTE)
    return Report({"flight": table}, {"sigma_over_arw": _draw_figure(rows, spreads)}, tuple(_build_checks(rows, spreads)))


def _draw_figure(rows: pd.DataFrame, spreads: pd.DataFrame) -> panels.Draw:
    """Draw the largest sigma of each group of parameters over ARW, a line for each reference sigma.

    Red squares are the spreads of the Monte Carlo for the parameter with the largest sigma of the group.
    """
    grid = rows[~rows["flight"]].sort_values("arw_deg_per_sqrt_s")
    shades = panels.make_shades(sorted(grid["sigma_deg"].unique()))
    axes: dict[str, Any] = {"log": "xy", "x": "ARW (deg/√s)", "at": [_select_flight_row(rows)["arw_deg_per_sqrt_s"]]}
    curves = []
    for group, members in PARAMETER_GROUPS.items():
        keys = [SIGMAS[NAMES.index(name)] for name in members]
        lines = []
        for level, colour in shades.items():
            part = grid[grid["sigma_deg"] == level]
            lines.append(Line(part["arw_deg_per_sqrt_s"], part[keys].max(axis=1), f"{level:g}", colour))
        group_spreads = spreads[spreads["parameter"].isin(members)].sort_values("sigma")
        worst = group_spreads.groupby(["arw_deg_per_sqrt_s", "sigma_deg"], as_index=False).last()
        ranges = worst["spread_low"], worst["spread_high"], True
        lines.append(Line(worst["arw_deg_per_sqrt_s"], worst["spread"], "spread of seeds", panels.RED, "s", *ranges))
        unit = "deg/h" if group == "biases" else "ppm"
        curves.append(panels.make_curves(lines, title=f"worst of the {group}", y=f"sigma ({unit})", **axes))
    legend: dict[str, Any] = {"legend": "outside right center", "legend_title": "reference\nsigma (deg)"}
    return panels.build_sheet(*curves, size=(8.6, 3.2), title="dotted: the flight's ARW", **legend)


ENTRY = Entry(STUDY, "how gyro and reference noise limit each parameter", report)
