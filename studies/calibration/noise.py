"""How well each parameter can be known: gyro noise (ARW) against reference noise.

With V = V_ref + V_gyro the covariance of the residuals (`gyrocal.calibration.covariance`), K = P Θᵀ V⁻¹ the gain and P = (Θᵀ
V⁻¹ Θ)⁻¹,

    P = K V Kᵀ = K V_ref Kᵀ + K V_gyro Kᵀ,

so each parameter's variance splits in two, and the gyro's share of it says which noise limits it. Since ∂P = K ∂V Kᵀ,
that share is also the scaling law: V_gyro ∝ ARW² gives ∂ ln σ_j / ∂ ln ARW = share_j, and ∂ ln σ_j / ∂ ln σ_ref = 1 − share_j.
The share depends on the ratio ARW/σ_ref only; where it passes one half the limit changes.

The study is a grid, a case a point of it: one more, the last, has the flight's own noise, the ARW that the spread between the
step sizes of N Table 2 shows (`studies.natanson.flight_gap.noise_from_steps`) with the scenario's references. At the grid's
corners and at the flight's point the formal sigma is set against the spread of estimates over seeds, as a Monte Carlo of its
own.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import ClassVar

import matplotlib as mpl
import numpy as np
import pandas as pd
import scipy.stats
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gyrocal import NAMES, GyroParameters, InputError, attitude
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.covariance import FULL, residual_covariance
from gyrocal.calibration.parameters import BIASES, MISALIGNMENTS, SCALE_FACTORS
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import measurements
from simulator.scenario import override
from simulator.simulate import motion, noise_free_rates, observe, realise
from simulator.truth.motion import Motion
from studies.montecarlo.study import GridConfig, Streams, Study, base_scenario
from studies.natanson import flight_gap
from studies.report import panels
from studies.report.entry import Entry, Report
from studies.report.tables import Table

Array = NDArray[np.float64]

ARW_DEG_PER_SQRT_S = (2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3)
SIGMA_DEG = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)

SHOWN = np.array([1e6] * 9 + [np.rad2deg(1.0) * 3600] * 3)  # ppm, deg/h
UNITS = ("ppm",) * 9 + ("deg_h",) * 3
KEYS = [f"{name}_{unit}" for name, unit in zip(NAMES, UNITS, strict=True)]
GROUPS = {"scale factors": SCALE_FACTORS, "misalignments": MISALIGNMENTS, "biases": BIASES}


class NoiseConfig(GridConfig):
    """What the study runs.

    Attributes
    ----------
    arw_deg_per_sqrt_s, sigma_deg : the grid: angle random walk, and 1-sigma of a reference attitude about each body axis
    seeds : estimates that make the spread at a point that has one
    confidence : of all intervals of the spread together
    """

    axes: ClassVar = ("arw_deg_per_sqrt_s", "sigma_deg")
    arw_deg_per_sqrt_s: tuple[float, ...] = Field(default=ARW_DEG_PER_SQRT_S, min_length=2)
    sigma_deg: tuple[float, ...] = Field(default=SIGMA_DEG, min_length=2)
    seeds: int = Field(default=200, ge=3)
    confidence: float = Field(default=0.99, gt=0.5, lt=1)

    @model_validator(mode="after")
    def _is_a_grid(self) -> "NoiseConfig":
        for name, values in (("arw_deg_per_sqrt_s", self.arw_deg_per_sqrt_s), ("sigma_deg", self.sigma_deg)):
            if min(values) <= 0 or list(values) != sorted(set(values)):
                raise ValueError(f"{name}: must be positive and ascending")
        return self

    def points(self) -> list[tuple[float, float]]:
        """ARW and reference sigma of each point: those of the grid, and last the flight's."""
        return [*product(self.arw_deg_per_sqrt_s, self.sigma_deg), flight_noise(self)]

    def has_spread(self, case: int) -> bool:
        """Whether a point is a corner of the grid or the flight's."""
        last = len(self.sigma_deg) - 1
        return case in (0, last, self.cases - 2 - last, self.cases - 2, self.cases - 1)


@dataclass(frozen=True)
class _Prepared:
    """What all points share: the motion, and Θ and the two parts of V per unit of variance."""

    motion: Motion
    problem: Problem
    truth: Array
    Theta: Array
    V_reference: Array
    V_gyro: Array


@lru_cache(maxsize=2)
def _prepared(text: str) -> _Prepared:
    """Prepared once a process; keyed by JSON, since a configuration may arrive as another object."""
    scenario = base_scenario(NoiseConfig.model_validate_json(text))
    path = motion(scenario)
    plain = observe(scenario, path, gyro_rng=None, reference_rng=None)
    prepared = measurements(plain)
    problem = Problem.of(plain, prepared)
    truth = GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
    pass_ = propagate(prepared.arcs, truth.G, truth.bias)
    where = (prepared.arcs.arc, prepared.start, prepared.row, prepared.elapsed_s)
    ones, none = np.ones_like(problem.sigma), np.zeros((0, 3, 3))
    V_reference = residual_covariance(pass_.R, *where, ones, 0.0, FULL, none)
    V_gyro = residual_covariance(pass_.R, *where, ones, 1.0, FULL, none) - V_reference
    Theta = accumulation.sensitivity(pass_.S, problem.columns, problem.scale)
    return _Prepared(path, problem, truth.vector, Theta, V_reference, V_gyro)


def flight_noise(config: NoiseConfig) -> tuple[float, float]:
    """ARW (deg/sqrt(s)) of the flight's residuals, and the scenario's reference sigma (deg) as the root mean square axis."""
    sigma = base_scenario(config).reference.sigma_deg
    return flight_gap.noise_from_steps()["arw_deg_per_sqrt_s"], float(np.sqrt(np.mean(np.square(sigma))))


def formal(shared: _Prepared, arw: float, sigma: float) -> tuple[Array, Array]:
    """Formal sigma (12,), G dimensionless and b rad/s, and the gyro's share (12,) of each parameter's variance.

    Parameters
    ----------
    arw : rad/sqrt(s)
    sigma : of a reference attitude about each axis, rad
    """
    V_gyro = arw**2 * shared.V_gyro
    weighted = np.linalg.solve(sigma**2 * shared.V_reference + V_gyro, shared.Theta)
    P = np.linalg.inv(shared.Theta.T @ weighted)
    K = P @ weighted.T
    return shared.problem.scale * np.sqrt(np.diag(P)), np.diag(K @ V_gyro @ K.T) / np.diag(P)


def case(config: NoiseConfig, case: int, streams: Streams) -> dict[str, object]:
    """Formal sigmas at a point, the gyro's shares, and at some points the spread over seeds (missing elsewhere)."""
    shared = _prepared(config.model_dump_json())
    flown = case == config.cases - 1
    arw_deg, sigma_deg = config.points()[case]
    sigmas, shares = formal(shared, np.deg2rad(arw_deg), np.deg2rad(sigma_deg))
    row: dict[str, object] = {"arw_deg_per_sqrt_s": arw_deg, "sigma_deg": sigma_deg, "flight": flown}
    row |= {f"sigma_{key}": float(value) for key, value in zip(KEYS, sigmas * SHOWN, strict=True)}
    row |= {f"gyro_share_{name}": float(value) for name, value in zip(NAMES, shares, strict=True)}
    row["seeds"] = config.seeds if config.has_spread(case) else 0
    if config.has_spread(case):
        spread = estimates(config, shared, arw_deg, sigma_deg, streams).std(axis=0, ddof=1)
        row |= {f"spread_{key}": float(value) for key, value in zip(KEYS, spread * SHOWN, strict=True)}
    return row


def estimates(config: NoiseConfig, shared: _Prepared, arw_deg: float, sigma_deg: float, streams: Streams) -> Array:
    """(seeds, 12) estimates after two iterations from the a-priori parameters; G dimensionless, b rad/s."""
    levels = {"gyro.arw_deg_per_sqrt_s": arw_deg} | {f"reference.sigma_deg.{axis}": sigma_deg for axis in range(3)}
    scenario = override(base_scenario(config), levels)
    sigma = np.full_like(shared.problem.sigma, np.deg2rad(sigma_deg))
    problem = replace(shared.problem, arw=float(np.deg2rad(arw_deg)), sigma=sigma)
    rates = noise_free_rates(scenario, shared.motion)
    start = GyroParameters(np.array(scenario.gyro.apriori_G), np.deg2rad(scenario.gyro.apriori_bias_deg_s)).vector
    gyro, reference = streams.generator("gyro_noise"), streams.generator("reference_noise")
    found = []
    for _ in range(config.seeds):
        noisy, quaternions = realise(scenario, shared.motion, rates, gyro, reference)
        found.append(problem.with_case(noisy, attitude.matrix_from_quaternion(quaternions)).iterate(start, 2).x[-1])
    return np.array(found)


def flight_table(rows: pd.DataFrame) -> pd.DataFrame:
    """The twelve parameters at the flight's own noise."""
    flown = _flight(rows)
    crossing = crossings(rows)
    share = np.array([flown[f"gyro_share_{name}"] for name in NAMES])
    return pd.DataFrame(
        {
            "parameter": NAMES,
            "unit": [unit.replace("_", "/") for unit in UNITS],
            "sigma": [flown[f"sigma_{key}"] for key in KEYS],
            "spread": [flown[f"spread_{key}"] for key in KEYS],
            "gyro_share": share,
            "limited_by": np.where(share > 0.5, "gyro", "references"),
            "crossing_arw_deg_per_sqrt_s": crossing * flown["sigma_deg"],
        }
    )


def _flight(rows: pd.DataFrame) -> pd.Series:
    chosen = rows[rows["flight"]]
    if len(chosen) != 1:
        raise InputError("noise: the case with the flight's noise failed; run the study again with its failed cases")
    return chosen.iloc[0]


def crossings(rows: pd.DataFrame) -> Array:
    """(12,) ARW/σ_ref, 1/sqrt(s), where the gyro's share is one half, interpolated in its logarithm; NaN outside the grid."""
    ratio = np.log((rows["arw_deg_per_sqrt_s"] / rows["sigma_deg"]).to_numpy())
    order = np.argsort(ratio)
    shares = rows[[f"gyro_share_{name}" for name in NAMES]].to_numpy()[order]
    # The logit is nearly a straight line: a share of s²/(1 + s²) has 2 ln s.
    logits = np.log(shares / (1 - shares))
    return np.array([np.exp(np.interp(0.0, column, ratio[order], left=np.nan, right=np.nan)) for column in logits.T])


def spread_table(config: NoiseConfig, rows: pd.DataFrame) -> pd.DataFrame:
    """Spread over seeds by formal sigma, a row a point and parameter, with χ² limits of all of them together.

    Returns
    -------
    arw_deg_per_sqrt_s, sigma_deg, parameter, unit, sigma, spread, its interval spread_low to spread_high, and whether the
    formal sigma is inside.
    """
    chosen = rows[rows["seeds"] > 0]
    tail = (1 - config.confidence) / (2 * len(NAMES) * max(len(chosen), 1))
    out = []
    for point in chosen.to_dict("records"):
        dof = point["seeds"] - 1
        high, low = np.sqrt(dof / scipy.stats.chi2.ppf([tail, 1 - tail], dof))
        for name, unit, key in zip(NAMES, UNITS, KEYS, strict=True):
            sigma, spread = point[f"sigma_{key}"], point[f"spread_{key}"]
            line = {"arw_deg_per_sqrt_s": point["arw_deg_per_sqrt_s"], "sigma_deg": point["sigma_deg"], "parameter": name}
            line |= {"unit": unit.replace("_", "/"), "sigma": sigma, "spread": spread}
            line |= {"spread_low": low * spread, "spread_high": high * spread, "inside": low * spread <= sigma <= high * spread}
            out.append(line)
    return pd.DataFrame(out)


def limits_table(rows: pd.DataFrame) -> pd.DataFrame:
    """How many of the twelve parameters the gyro limits, reference sigma down, ARW across."""
    grid = rows[~rows["flight"]]
    limited = (grid[[f"gyro_share_{name}" for name in NAMES]] > 0.5).sum(axis=1)
    table = grid.assign(limited=limited).pivot_table(index="sigma_deg", columns="arw_deg_per_sqrt_s", values="limited")
    table = table.astype(int)
    table.columns = [f"ARW {arw:g}" for arw in table.columns]
    return table.reset_index()


def report(config: NoiseConfig, rows: pd.DataFrame) -> Report:
    """Sigmas at the flight's noise, what limits them, scaling laws, and the spread that confirms them."""
    table, spreads = flight_table(rows), spread_table(config, rows)
    flown = _flight(rows)
    G, b = table.iloc[:9], table.iloc[9:]
    best, worst = G.sort_values("sigma").iloc[0], G.sort_values("sigma").iloc[-1]
    least, most = (table.sort_values("gyro_share").iloc[k] for k in (0, -1))
    by_gyro = table.loc[table["limited_by"] == "gyro", "parameter"].tolist()
    by_references = table.loc[table["limited_by"] == "references", "parameter"].tolist()
    arw, sigma = flown["arw_deg_per_sqrt_s"], flown["sigma_deg"]
    ratio = spreads["spread"] / spreads["sigma"]
    first, last = table["crossing_arw_deg_per_sqrt_s"].min(), table["crossing_arw_deg_per_sqrt_s"].max()
    findings = (
        f"At the flight's own noise (ARW {arw:.2e} deg/√s, references {sigma:g} deg) the sigma of G goes from "
        f"{best['sigma']:.0f} ppm ({best['parameter']}) to {worst['sigma']:.0f} ppm ({worst['parameter']}), "
        f"that of b from {b['sigma'].min():.4f} to {b['sigma'].max():.4f} deg/h.",
        f"There the gyro's noise limits {len(by_gyro)} of the 12 ({', '.join(by_gyro) or 'none'}) and the references limit "
        f"{len(by_references)} ({', '.join(by_references) or 'none'}).",
        f"Scaling laws there: σ ∝ ARW^s σ_ref^(1 − s) with s, the gyro's share of the variance, from {least['gyro_share']:.2f} "
        f"({least['parameter']}) to {most['gyro_share']:.2f} ({most['parameter']}).",
        f"With these references the limit changes from references to gyro between an ARW of {first:.2e} and {last:.2e} deg/√s, "
        "by parameter; the crossing ARW is proportional to the reference sigma.",
        f"Formal sigma against the spread of {config.seeds} seeds: {int(spreads['inside'].sum())} of {len(spreads)} inside "
        f"their χ² intervals ({config.confidence:.0%} for all together); ratio {ratio.min():.3f} to {ratio.max():.3f}.",
    )
    tables = {
        "flight": Table("Sigma of each parameter at the flight's own noise", table),
        "limits": Table(
            "Parameters limited by the gyro, of 12 (reference sigma down, ARW in deg/√s across)", limits_table(rows)
        ),
        "spread": Table("Spread over seeds and formal sigma", spreads),
    }
    return Report(tables, {"sigma_over_arw": partial(_figure, rows, spreads)}, findings=findings)


def _panel(axes: Axes, rows: pd.DataFrame, spreads: pd.DataFrame, names: tuple[str, ...], colours: dict[float, str]) -> None:
    """Largest sigma of a group of parameters over ARW, a line for each reference sigma."""
    keys = [f"sigma_{key}" for key in KEYS if key[: len(names[0])] in names]
    grid = rows[~rows["flight"]].assign(largest=lambda frame: frame[keys].max(axis=1))
    for level, colour in colours.items():
        line = grid[grid["sigma_deg"] == level].sort_values("arw_deg_per_sqrt_s")
        axes.loglog(line["arw_deg_per_sqrt_s"], line["largest"], "o-", markersize=2, color=colour, label=f"{level:g}")
    chosen = spreads[spreads["parameter"].isin(names)].sort_values("sigma")
    worst = chosen.groupby(["arw_deg_per_sqrt_s", "sigma_deg"], as_index=False).last()
    axes.errorbar(
        worst["arw_deg_per_sqrt_s"],
        worst["spread"],
        yerr=[worst["spread"] - worst["spread_low"], worst["spread_high"] - worst["spread"]],
        fmt="s",
        color="#d1495b",
        markersize=4,
        capsize=3,
        markerfacecolor="white",
        zorder=5,
        label="spread of seeds",
    )
    axes.set_xlabel("ARW (deg/√s)")


def _figure(rows: pd.DataFrame, spreads: pd.DataFrame, path: Path) -> Path:
    levels = sorted(rows.loc[~rows["flight"], "sigma_deg"].unique())
    shades = mpl.colormaps["viridis"](np.linspace(0, 0.85, len(levels)))
    colours = {level: mpl.colors.to_hex(shade) for level, shade in zip(levels, shades, strict=True)}
    flown = _flight(rows)["arw_deg_per_sqrt_s"]
    with mpl.rc_context(panels.STYLE):
        figure = Figure(figsize=(8.6, 3.2), layout="constrained")
        grid = figure.subplots(1, 3)
        for axes, (name, members) in zip(grid, GROUPS.items(), strict=True):
            _panel(axes, rows, spreads, members, colours)
            axes.axvline(flown, color="0.4", linestyle=":", linewidth=1)
            axes.set_title(f"worst of the {name}", loc="left", fontsize=9)
            axes.set_ylabel("sigma (deg/h)" if name == "biases" else "sigma (ppm)")
        handles, labels = grid[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", fontsize=8, title="reference\nsigma (deg)", title_fontsize=8)
        figure.suptitle("dotted: the flight's ARW", fontsize=8, x=0.01, ha="left")
        return panels.save(figure, path)


STUDY = Study("studies.calibration.noise:STUDY", NoiseConfig, case)
ENTRY = Entry(STUDY, "how gyro and reference noise limit each parameter", report)
