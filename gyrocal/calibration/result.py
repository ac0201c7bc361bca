"""Result of a calibration: parameters with their covariance, residuals, and undetermined combinations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib import metadata
from typing import TYPE_CHECKING, Any

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.estimated_noise import compute_chi2_p
from gyrocal.calibration.gyro_space import Parametrisation, select_parameter_space
from gyrocal.calibration.mounting import Mounting, compute_mounting
from gyrocal.calibration.observability import BIAS_LETTERS, Observability
from gyrocal.calibration.parameters import AXIS_NAMES, GyroParameters
from gyrocal.calibration.plausible_ranges import PlausibleRanges
from gyrocal.calibration.problem import ROTATION_NAMES
from gyrocal.calibration.propagation import Psi
from gyrocal.calibration.remainder_processes import NOMINAL, WITH_REMAINDER, Remainder
from gyrocal.calibration.verdict import (
    CalibrationVerdict,
    decide_verdict,
    find_combinations_lost_to_misfit,
    find_implausible_values,
)
from gyrocal.recording.recording_data import format_html, format_text

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


DEGREES = np.array([1.0] * 9 + [np.rad2deg(1.0)] * 3)  # of twelve parameters, biases in deg/s
PLAUSIBLE_PRIOR = "plausible ranges"  # in options["prior_from"]


@dataclass(frozen=True)
class CalibrationResult:
    """Result of a calibration.

    Attributes
    ----------
    recording : title of the recording
    parameters : calibrated G and b
    initial : G and b the calibration started from
    solved_for : names of the estimated parameters, of the parametrisation
    own_covariance : (12, 12) of the parametrisation's twelve, zero for held ones; biases in rad/s, the others dimensionless
    covariance_model : "full", "references only", or "given" for a C per interval or one V of all residuals
    psi : "full" or "linear"
    corrections : the change of (G, b) made by each iteration
    converged : the last correction was within the tolerance
    residuals : a row per interval and reference time: interval, t_s, then before/after roll, pitch, yaw by the full rotation
        vector (N 16) and by the linear form (N 29), and sigma, what the covariance model expects of each, in degrees
    observability : singular values and combinations not found
    options : of the calibration (step_s, resampling, max_gap_s, held_s, prior sigmas by parameter, iterations), for the record
    chi2, dof : weighted square sum of the residuals after, with a prior's own term, and its degrees of freedom
    parametrisation : "gain" or "gyro", see `gyrocal.calibration.gyro_space`
    attenuation : (12,) expected error of G and b by the noise of the rates, see `gyrocal.calibration.attenuation`; None
        with other covariances than the full one
    plausible : grade of the gyro and plausible ranges of G and b; they are the a-priori sigmas where the data leave a
        combination free and no a-priori covariance is given
    remainder : misfit beyond the stated noise, and the covariance with it; None until `remainder.add_remainder`
        estimates it
    noise_degrees : degrees of freedom of a noise level that was estimated from the recording; infinite if it is stated
    """

    recording: str
    parameters: GyroParameters
    initial: GyroParameters
    solved_for: tuple[str, ...]
    own_covariance: Array
    covariance_model: str
    psi: Psi
    corrections: tuple[GyroParameters, ...]
    converged: bool
    residuals: pd.DataFrame
    observability: Observability
    chi2: float
    dof: int
    options: Mapping[str, Any]
    parametrisation: Parametrisation
    attenuation: Array | None
    plausible: PlausibleRanges
    noise_degrees: float
    remainder: Remainder | None = None

    @property
    def G(self) -> Array:
        """(3, 3) calibrated G."""
        return self.parameters.G

    @property
    def bias(self) -> Array:
        """(3,) calibrated b, rad/s."""
        return self.parameters.bias

    @property
    def covariance(self) -> Array:
        """(12, 12) of G and b in the order of `gyrocal.NAMES`; b in rad/s. In (G, b) zero for held parameters."""
        J = select_parameter_space(self.parametrisation).jacobian(self.parameters)
        return self.own_covariance if self.parametrisation == "gain" else np.asarray(J @ self.own_covariance @ J.T)

    @property
    def sigma(self) -> Array:
        """(12,) formal 1-sigma of G and b in the order of `gyrocal.NAMES`."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def recommended(self) -> str:
        """Which sigmas are recommended: "nominal", or "with_remainder" where the residuals do not fit the stated noise."""
        return WITH_REMAINDER if self.remainder is not None and self.remainder.is_significant else NOMINAL

    @property
    def recommended_covariance(self) -> Array:
        """(12, 12) of G and b that is recommended; b in rad/s."""
        return self.remainder.covariance if self.remainder is not None and self.remainder.is_significant else self.covariance

    @property
    def p_value(self) -> float:
        """Probability of a larger chi2 if the noise is as stated; NaN without degrees of freedom."""
        return compute_chi2_p(self.chi2, self.dof, self.noise_degrees) if self.dof > 0 else float("nan")

    @property
    def has_plausible_prior(self) -> bool:
        """Whether the plausible ranges served as a-priori sigmas, since the data leave a combination free."""
        return self.options.get("prior_from") == PLAUSIBLE_PRIOR

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Solved-for parameters with a sigma of the data alone beyond their plausible range."""
        if not self.has_plausible_prior:
            return ()
        prior = self.options["prior_sigma"]
        space = select_parameter_space(self.parametrisation)
        sigma = dict(zip(space.names, np.sqrt(np.diag(self.own_covariance)), strict=True))
        # As much information from the data as from the prior leaves 1/sqrt(2) of its sigma.
        return tuple(name for name in self.solved_for if sigma[name] > prior[name] / np.sqrt(2))

    @property
    def unobservable_sigma(self) -> tuple[float, ...]:
        """1-sigma of each combination not found, in the unit of the parameter it begins with; biases in rad/s."""
        if not self.observability.unobservable:
            return ()
        ranges, covariance = self._select_solved()
        directions = self.observability.directions / ranges
        sigma = np.abs(self.observability.leads) * np.sqrt(np.einsum("kp,pq,kq->k", directions, covariance, directions))
        return tuple(sigma.tolist())

    def _select_solved(self) -> tuple[Array, Array]:
        """Select the plausible ranges (p,) of the solved-for parameters, and their covariance (p, p)."""
        names = select_parameter_space(self.parametrisation).names
        columns = np.array([names.index(name) for name in self.solved_for])
        return self.plausible.vector(columns >= 9), self.own_covariance[np.ix_(columns, columns)]

    @cached_property
    def mounting(self) -> Mounting:
        """Mounting of the gyro in the body, and scale, from G by polar decomposition."""
        return compute_mounting(self.G, self.covariance[:9, :9], self.initial.G, self.plausible.G)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Values that no gyro of this grade has, a sentence each."""
        implausible = tuple(find_implausible_values(self.mounting, self.G, self.bias, self.sigma[9:], self.plausible))
        if self.options.get("prior_from") is not None:
            return implausible
        ranges, covariance = self._select_solved()
        return (*implausible, *find_combinations_lost_to_misfit(covariance, ranges, self.solved_for, self.chi2, self.dof))

    @cached_property
    def verdict(self) -> CalibrationVerdict:
        """Whether the calibration may be believed, with which sigmas, and why."""
        return decide_verdict(self)

    def summary(self) -> pd.DataFrame:
        """Tabulate initial and calibrated value, correction and sigma; a row a parameter, biases in deg/s."""
        import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

        space = select_parameter_space(self.parametrisation)
        initial, final = space.vector(self.initial) * DEGREES, space.vector(self.parameters) * DEGREES
        return pd.DataFrame(
            {
                "parameter": space.names,
                "unit": ["1"] * 9 + ["deg/s"] * 3,
                "initial": initial,
                "calibrated": final,
                "correction": final - initial,
                "sigma": np.sqrt(np.diag(self.own_covariance)) * DEGREES,
                "solved": [name in self.solved_for for name in space.names],
            }
        )

    def to_frame(self) -> pd.DataFrame:
        """Return `summary`, under the name that other libraries give such a table."""
        return self.summary()

    def _list_facts(self) -> list[tuple[str, str]]:
        """List the results, a row a quantity."""
        deg = np.rad2deg(1.0)
        rows = [
            ("recording", self.recording),
            ("iterations", f"{len(self.corrections)}, {'converged' if self.converged else 'NOT converged'}"),
            ("chi2", f"{self.chi2:.1f} of {self.dof}, p = {self.p_value:.3g}"),
        ]
        for i, axis in enumerate(AXIS_NAMES):
            values = " ".join(f"{value:+.6f}" for value in self.G[i])
            rows.append(
                (f"G_{axis}x … G_{axis}z", f"{values}  ± {' '.join(f'{s:.1e}' for s in self.sigma[3 * i : 3 * i + 3])}")
            )
        for i, axis in enumerate(AXIS_NAMES):
            rows.append((f"b_{axis}", f"{deg * self.bias[i]:+.6g} ± {deg * self.sigma[9 + i]:.2g} deg/s"))
        if self.observability.unobservable:
            rows.append(("not found", "; ".join(self.observability.unobservable)))
        return [*rows, ("verdict", " ".join([self.verdict.summary, *self.verdict.reasons]))]

    def __repr__(self) -> str:
        return format_text("CalibrationResult", self._list_facts())

    def _repr_html_(self) -> str:
        return format_html("CalibrationResult", self._list_facts())

    @property
    def bias_deg_s(self) -> Array:
        """(3,) calibrated b, deg/s."""
        return self.parameters.bias_deg_s

    @property
    def sigma_bias_deg_s(self) -> Array:
        """(3,) formal 1-sigma of b, deg/s."""
        return np.asarray(np.rad2deg(self.sigma[9:]))

    def _select_residuals(self, label: str) -> pd.DataFrame:
        """Select the columns of the residuals "before" or "after", or of their "sigma", deg."""
        return self.residuals[[f"{label}_{name}_deg" for name in ROTATION_NAMES]]

    def plot_residuals(self, ax: Axes | None = None, *, before: bool = False) -> Axes:
        """Plot residuals after the calibration over time, deg, with the sigma of each; those before too if asked.

        They are drawn on ax, or on one of a new figure.
        """
        ax, table = ax or _make_axes(), self.residuals
        for k, name in enumerate(ROTATION_NAMES):
            after, sigma = table[f"after_{name}_deg"], table[f"sigma_{name}_deg"]
            ax.errorbar(table["t_s"], after, sigma, fmt=".", color=f"C{k}", elinewidth=0.6, label=name)
            if before:
                ax.plot(
                    table["t_s"], table[f"before_{name}_deg"], "o", fillstyle="none", color=f"C{k}", label=f"{name}, before"
                )
        ax.axhline(0.0, color="0.4", linewidth=0.8)
        title = f"{self.recording}: chi2 {self.chi2:.1f} of {self.dof}"
        ax.set(xlabel="t_s, s since the epoch", ylabel="residual, deg", title=title)
        ax.legend()
        return ax

    def plot_parameters(self, ax: Axes | None = None) -> Axes:
        """Plot corrections of the solved-for parameters in sigmas, on ax or on one of a new figure; labels give the values."""
        ax, table = ax or _make_axes(), self.summary().query("solved")
        places = np.arange(len(table))[::-1]
        ax.errorbar((table["correction"] / table["sigma"]).to_numpy(), places, xerr=1.0, fmt="o", capsize=3)
        units = table["unit"].replace("1", "").radd(" ").str.rstrip()
        values = zip(table["parameter"], table["calibrated"], table["sigma"], units, strict=True)
        labels = [f"{name} = {value:.6g} ± {sigma:.1g}{unit}" for name, value, sigma, unit in values]
        ax.set_yticks(places, labels)
        ax.axvline(0.0, color="0.4", linewidth=0.8)
        ax.set(xlabel="calibrated minus initial, in sigma", title=self.recording)
        return ax

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values, degrees and deg/s."""
        remainder, sigma = self.remainder, self.sigma * DEGREES
        times = self.residuals[["interval", "t_s"]].to_dict("records")
        before_after = zip(*(self._select_residuals(label).to_numpy().tolist() for label in ("before", "after")), strict=True)
        rows = [row | {"before_deg": a, "after_deg": b} for row, (a, b) in zip(times, before_after, strict=True)]
        return {
            "format": 1,
            "recording": self.recording,
            "psi": self.psi,
            "parametrisation": self.parametrisation,
            "iterations": len(self.corrections),
            "converged": self.converged,
            "G": self.G.tolist(),
            "bias_deg_s": np.rad2deg(self.bias).tolist(),
            "sigma_G": sigma[:9].reshape(3, 3).tolist(),
            "sigma_bias_deg_s": sigma[9:].tolist(),
            "attenuation_G": None if self.attenuation is None else self.attenuation[:9].reshape(3, 3).tolist(),
            "parameters": list(self.solved_for),
            "estimates": self.summary().query("solved").drop(columns="solved").to_dict("records"),
            "covariance": _convert_covariance(self.covariance).tolist(),
            "covariance_model": self.covariance_model,
            "corrections": [{"G": step.G.tolist(), "bias_deg_s": np.rad2deg(step.bias).tolist()} for step in self.corrections],
            "residuals": rows,
            "unobservable": list(self.observability.unobservable),
            "unobservable_sigma": self._convert_unobservable_sigma(),
            "undetermined_parameters": list(self.undetermined),
            "plausible_ranges": self.plausible.to_json(),
            "mounting": self.mounting.to_json(),
            "warnings": list(self.warnings),
            "verdict": asdict(self.verdict),
            "condition": self.observability.condition if np.isfinite(self.observability.condition) else None,
            "chi2": self.chi2,
            "degrees_of_freedom": self.dof,
            "p_value": self.p_value if self.dof > 0 else None,
            "initial": {"G": self.initial.G.tolist(), "bias_deg_s": np.rad2deg(self.initial.bias).tolist()},
            "options": dict(self.options),
            "version": metadata.version("gyrocal"),
            "gyros": self.parameters.table().to_dict("records"),
            "sigma_nominal": sigma.tolist(),
            "sigma_with_remainder": None if remainder is None else (remainder.sigma * DEGREES).tolist(),
            "covariance_with_remainder": None if remainder is None else _convert_covariance(remainder.covariance).tolist(),
            "recommended": self.recommended,
            "remainder": None if remainder is None else remainder.to_json(),
        }

    def _convert_unobservable_sigma(self) -> list[float]:
        """Convert `unobservable_sigma` of combinations of biases alone to deg/s."""
        return [
            float(np.rad2deg(sigma)) if text.split()[1].startswith(BIAS_LETTERS) else sigma
            for text, sigma in zip(self.observability.unobservable, self.unobservable_sigma, strict=True)
        ]


def _convert_covariance(covariance: Array) -> Array:
    """Convert a covariance (12, 12) to biases in deg/s."""
    return np.asarray(covariance * np.outer(DEGREES, DEGREES))


def _make_axes() -> Axes:
    import matplotlib.pyplot as plt

    return plt.subplots()[1]
