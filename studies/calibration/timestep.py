"""Skipping samples against averaging them, for steps of 0.5 to 8 s, over seeds.

Skipping holds one sample over a step of f samples, as N section V did: the integrated gyro noise has f times the variance.
Averaging uses them all: the noise stays, and what remains is the error of holding a mean rate over the step while the rate
changes, of second order in Δt. A row is one case calibrated one way:

- ``error_``: recovered minus injected, of all noise
- ``gyro_``: the same of the gyro's noise alone, the references being exact
- ``held_``: the same without noise, which is the bias that the step itself makes
- ``sigma_``: the formal sigma; ``nees`` that of the error and ``held_nees`` what the bias alone adds to it
- ``step_arw_deg_per_sqrt_s``: the angle random walk by the spread of the 18 pre-launch residuals between this step and the next
  finer one, both by skipping, as `studies.natanson.flight_gap.noise_from_steps` takes it from the flight

G is dimensionless, b in deg/s.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import field_validator

from gyrocal import NAMES, GyroParameters, attitude
from gyrocal.calibration.problem import Iterates, Problem
from gyrocal.calibration.sampling import Resampling, measurements
from simulator.scenario import Scenario
from simulator.simulate import noise_free_rates, observe, realise
from simulator.truth.motion import Motion
from studies.montecarlo import statistics
from studies.montecarlo.statistics import crossing, order, span
from studies.montecarlo.study import Streams, Study, StudyConfig, base_scenario, case_motion, dispersed, observed
from studies.natanson import flight, flight_gap
from studies.natanson.paper_tables import PARAMETER_UNIT, PARAMETER_UNIT_NAMES
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

Array = NDArray[np.float64]
Way = tuple[float, Resampling]

STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
ITERATIONS = 3  # leaves less than 1e-6 sigma; see studies.calibration.iterations
LIMIT = 0.1  # formal sigmas of bias that count as none


class TimestepConfig(StudyConfig):
    """What the study runs.

    Attributes
    ----------
    steps_s : step sizes, rising
    """

    cases: int = 100
    steps_s: tuple[float, ...] = STEPS_S

    @field_validator("steps_s")
    @classmethod
    def _rising(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or value[0] <= 0 or any(b <= a for a, b in pairwise(value)):
            raise ValueError("must be one or more rising numbers above zero")
        return value

    def ways(self, sample_s: float) -> list[Way]:
        """Every way a case is calibrated; the sample itself is neither skipped nor averaged, and under "skip"."""
        return [(step, "skip") for step in self.steps_s] + [(step, "average") for step in self.steps_s if step > sample_s]


@dataclass(frozen=True)
class _Prepared:
    """What cases with the same scenario share.

    Attributes
    ----------
    T_s : (m, 1) time between the references of each residual
    held : (12,) noise-free error of each way
    """

    scenario: Scenario
    motion: Motion
    rates: Array
    truth: Array
    initial: Array
    T_s: Array
    problems: dict[Way, Problem]
    held: dict[Way, Array]


def _prepare(config: TimestepConfig, scenario: Scenario) -> _Prepared:
    path = case_motion(scenario)
    plain = observe(scenario, path, gyro_rng=None, reference_rng=None)
    prepared = {way: measurements(plain, *way) for way in config.ways(scenario.gyro.sample_s)}
    problems = {way: Problem.of(plain, measured) for way, measured in prepared.items()}
    truth = np.concatenate([np.ravel(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s)])
    initial = GyroParameters(plain.gyro.apriori_G, plain.gyro.apriori_bias).vector
    return _Prepared(
        scenario=scenario,
        motion=path,
        rates=noise_free_rates(scenario, path),
        truth=truth,
        initial=initial,
        T_s=next(iter(prepared.values())).elapsed_s[:, None],
        problems=problems,
        held={way: problem.iterate(initial, ITERATIONS).x[-1] - truth for way, problem in problems.items()},
    )


@lru_cache(maxsize=2)
def _shared(config: str) -> _Prepared:
    """Preparation of a study without dispersions, made once a process."""
    parsed = TimestepConfig.model_validate_json(config)
    return _prepare(parsed, base_scenario(parsed))


def case(config: TimestepConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """One case: a row for each way."""
    shared = _prepare(config, dispersed(config, number)) if config.dispersions else _shared(config.model_dump_json())
    noise, reference = (streams.generator(name) for name in ("gyro_noise", "reference_noise"))
    rates, quaternions = realise(shared.scenario, shared.motion, shared.rates, noise, reference)
    A, A_true = (attitude.matrix_from_quaternion(q) for q in (quaternions, shared.motion.quaternions))
    rows: list[dict[str, object]] = []
    finer: tuple[float, Array] | None = None
    for way, problem in shared.problems.items():
        step, resampling = way
        result = problem.with_case(rates, A).iterate(shared.initial, ITERATIONS)
        gyro = problem.with_case(rates, A_true).iterate(shared.initial, ITERATIONS)
        row: dict[str, object] = {"step_s": step, "resampling": resampling}
        row |= _values(shared, result, gyro, shared.held[way])
        arw = np.nan
        if resampling == "skip":
            if finer is not None:
                arw = step_arw(result.theta[0] - finer[1], shared.T_s, (step - finer[0]) / shared.scenario.gyro.sample_s)
            finer = step, result.theta[0]
        rows.append(row | {"step_arw_deg_per_sqrt_s": arw})
    return rows


def _values(shared: _Prepared, result: Iterates, gyro: Iterates, held: Array) -> dict[str, float]:
    """Errors, sigmas and NEES of one way."""
    sigma, error = np.sqrt(np.diag(result.P)), result.x[-1] - shared.truth
    columns = {"error": error, "gyro": gyro.x[-1] - shared.truth, "held": held, "sigma": sigma}
    out = {
        f"{label}_{name}": float(value)
        for label, vector in columns.items()
        for name, value in zip(NAMES, vector * PARAMETER_UNIT, strict=True)
    }
    both = statistics.nees(np.stack([error, held]), np.stack([result.P, result.P]))
    return out | {"nees": float(both[0]), "held_nees": float(both[1])}


def step_arw(difference: Array, T_s: Array, samples: float) -> float:
    """Angle random walk from residuals (m, 3) rad of two skipped steps, `samples` samples apart, over T_s (m, 1); deg/√s.

    A step of f samples held by skipping has f times the noise variance ARW² T of the full stream, and shares with a finer step
    just so much that their difference has the variance (f₂ − f₁) ARW² T.
    """
    return float(np.rad2deg(np.sqrt(np.mean(difference**2 / (samples * T_s)))))


STUDY = Study("studies.calibration.timestep:STUDY", TimestepConfig, case, observed)


def choose(rows: pd.DataFrame, step_s: float, resampling: str) -> pd.DataFrame:
    """Rows of one way; those of the full stream, for which there is but one, under either name."""
    of_step = rows[rows["step_s"] == step_s]
    return of_step[of_step["resampling"] == resampling] if resampling in set(of_step["resampling"]) else of_step


def _cells(rows: pd.DataFrame, label: str) -> Array:
    return rows[[f"{label}_{name}" for name in NAMES]].to_numpy()


def by_parameter(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per way and parameter: bias with its standard error, the bias without noise, spread, formal sigma."""
    out = []
    for (resampling, step), part in rows.groupby(["resampling", "step_s"]):
        errors = _cells(part, "error")
        spread = errors.std(axis=0, ddof=1) if len(part) > 1 else np.full(len(NAMES), np.nan)
        columns = {
            "parameter": NAMES,
            "unit": PARAMETER_UNIT_NAMES,
            "bias": errors.mean(axis=0),
            "standard_error": spread / np.sqrt(len(part)),
            "held": _cells(part, "held").mean(axis=0),
            "spread": spread,
            "gyro_spread": np.sqrt(np.mean((_cells(part, "gyro") - _cells(part, "held")) ** 2, axis=0)),
            "formal_sigma": np.sqrt(np.mean(_cells(part, "sigma") ** 2, axis=0)),
        }
        out.append(pd.DataFrame({"resampling": resampling, "step_s": step} | columns))
    return pd.concat(out, ignore_index=True)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per way and step.

    Returns
    -------
    bias_sigma, held_sigma : largest over the parameters of the mean error, and of the noise-free one, in formal sigmas
    held_most : the parameter of the latter
    bias_z : largest difference of the two in standard errors
    spread_over_formal : RMS over the parameters
    sigma_ratio, spread_ratio, gyro_ratio : formal sigma, spread and the gyro noise's part of it, over those of the full stream,
        RMS over the parameters
    nees with its 99 % bounds, whether it is inside, and what the bias alone adds
    """
    table = by_parameter(rows)
    finest = rows["step_s"].min()
    whole = table[table["step_s"] == finest].groupby("parameter", sort=False).first()
    out = []
    for resampling in ("skip", "average"):
        for step in sorted(set(rows["step_s"])):
            part = choose(rows, step, resampling)
            own = table[(table["step_s"] == step) & (table["resampling"] == part["resampling"].iloc[0])].set_index("parameter")
            check = statistics.nees_check(part["nees"].to_numpy(), len(NAMES))
            out.append(
                {
                    "resampling": resampling,
                    "step_s": step,
                    "bias_sigma": (own["bias"].abs() / own["formal_sigma"]).max(),
                    "held_sigma": (own["held"].abs() / own["formal_sigma"]).max(),
                    "held_most": (own["held"].abs() / own["formal_sigma"]).idxmax(),
                    "bias_z": ((own["bias"] - own["held"]).abs() / own["standard_error"]).max(),
                    "spread_over_formal": _rms(own["spread"] / own["formal_sigma"]),
                    "sigma_ratio": _rms(own["formal_sigma"] / whole["formal_sigma"]),
                    "spread_ratio": _rms(own["spread"] / whole["spread"]),
                    "gyro_ratio": _rms(own["gyro_spread"] / whole["gyro_spread"]),
                    "nees": check.value,
                    "nees_lower": check.lower,
                    "nees_upper": check.upper,
                    "nees_inside": check.inside,
                    "held_nees": part["held_nees"].mean(),
                }
            )
    return pd.DataFrame(out)


def gyro_order(rows: pd.DataFrame, resampling: str) -> tuple[float, float]:
    """Order in Δt of the gyro noise's part of the spread, and its standard error by leaving out one case at a time."""
    steps = sorted(set(rows["step_s"]))
    parts = [choose(rows, step, resampling).sort_values("case") for step in steps]
    squares = np.stack([(_cells(part, "gyro") - _cells(part, "held")) ** 2 for part in parts])
    sums = squares.sum(axis=1)
    n = squares.shape[1]
    if n < 2 or len(steps) < 2:
        return float("nan"), float("nan")

    def slopes(of: Array) -> Array:
        ratio = np.sqrt(np.mean(of / of[:1], axis=-1))
        return np.asarray(np.polyfit(np.log(steps), np.log(ratio), 1)[0])

    without = slopes(sums[:, None] - squares)
    return float(slopes(sums[:, None])[0]), float(np.sqrt((n - 1) * np.var(without)))


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(values**2)))


def step_noise(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per step: the angle random walk by the spread to the next finer one, simulated and, where both flew, in flight."""
    out = []
    skipped = rows[rows["resampling"] == "skip"]
    for finer, step in pairwise(sorted(set(skipped["step_s"]))):
        values = skipped[skipped["step_s"] == step]["step_arw_deg_per_sqrt_s"]
        row = {
            "from_s": finer,
            "to_s": step,
            "median": values.median(),
            "p05": values.quantile(0.05),
            "p95": values.quantile(0.95),
        }
        row["flight"] = row["flight_percentile"] = np.nan
        if finer in flight.STEPS and step in flight.STEPS:
            difference = np.deg2rad(flight.residuals("prelaunch", step) - flight.residuals("prelaunch", finer))
            row["flight"] = step_arw(difference, flight.durations()[:, None], (step - finer) / flight.STEPS[0])
            row["flight_percentile"] = 100 * float((values < row["flight"]).mean())
        out.append(row)
    return pd.DataFrame(out, columns=["from_s", "to_s", "median", "p05", "p95", "flight", "flight_percentile"])


def _findings(rows: pd.DataFrame) -> list[str]:
    table, steps = summary(rows), step_noise(rows)
    skip, average = (table[table["resampling"] == name] for name in ("skip", "average"))
    finest, last = skip["step_s"].min(), skip.iloc[-1]
    longest = f"{last['step_s']:g} s"
    out = []
    if len(skip) > 1:
        power, uncertain = gyro_order(rows, "skip")
        out.append(
            f"Skipping multiplies the gyro noise's part of the spread by (Δt/{finest:g} s)^({power:.3f} ± {uncertain:.3f}), "
            f"×{last['gyro_ratio']:.2f} at {longest} (sqrt: ×{np.sqrt(last['step_s'] / finest):.2f}); with the references' "
            f"part, which stays, ×{last['spread_ratio']:.2f}, and the formal sigma ×{last['sigma_ratio']:.2f}."
        )
        mean = average.iloc[-1]
        out.append(
            f"Averaging leaves the gyro noise's part at ×{span(average['gyro_ratio'], 4)} and the formal sigma at "
            f"×{span(average['sigma_ratio'], 4)} at all steps."
        )
        out.append(
            f"{_bias(average, finest)} At {longest} it is {mean['held_sigma']:.2g} sigma (in {mean['held_most']}); skipping "
            f"has {last['held_sigma']:.2g}."
        )
    out.append(
        f"The mean error over the cases differs from the bias without noise by at most {table['bias_z'].max():.1f} standard "
        f"errors (largest of {len(NAMES)} parameters and all ways, on the same noise)."
    )
    outside = table[~table["nees_inside"]]
    where = "; ".join(f"{row.resampling} {row.step_s:g} s: {row.nees:.2f}" for row in outside.itertuples())
    out.append(
        f"NEES of {span(table['nees'], 4)} over all ways for 12 parameters, 99 % bounds [{table['nees_lower'].iloc[0]:.2f}, "
        f"{table['nees_upper'].iloc[0]:.2f}]: "
        + (f"OUTSIDE at {where}." if len(outside) else "all inside.")
        + f" The bias adds {average['held_nees'].max():.2g} at most by averaging, {skip['held_nees'].max():.2g} by skipping."
    )
    flown = steps[steps["flight"].notna()]
    for row in flown.to_dict("records"):
        out.append(
            f"Spread of the pre-launch residuals between {row['from_s']:g} and {row['to_s']:g} s by skipping: an angle random "
            f"walk of {row['median']:.2g} deg/√s simulated ({row['p05']:.2g} to {row['p95']:.2g}, 5-95 %), {row['flight']:.2g} "
            "in flight."
        )
    if len(flown):
        noise = flight_gap.noise_from_steps()
        out.append(
            f"The flight's spreads together say {noise['arw_deg_per_sqrt_s']:.2g} deg/√s ± "
            f"{100 * noise['relative_sigma']:.0f} %."
        )
    return out


def _bias(average: pd.DataFrame, finest: float) -> str:
    """Where holding the mean rate makes a bias that counts."""
    at = crossing(average["step_s"], average["held_sigma"], LIMIT)
    slope = order(average["step_s"], average["held_sigma"])
    lead = f"The bias from holding a mean rate grows with Δt^{slope:.2f}"
    if not np.isnan(at):
        return f"{lead} and reaches {LIMIT:g} formal sigma at Δt = {at:.2g} s."
    side = "above" if average["held_sigma"].iloc[0] >= LIMIT else "below"
    return f"{lead} and is {side} {LIMIT:g} formal sigma from {finest:g} s on, throughout these steps."


def report(config: TimestepConfig, rows: pd.DataFrame) -> Report:
    """What skipping and averaging cost in noise and in bias."""
    tables = {
        "steps": Table("Skipping and averaging (largest or RMS over the parameters; ratios to the full stream)", summary(rows)),
        "step_noise": Table("Angle random walk by the spread between steps (deg/√s)", step_noise(rows)),
        "parameters": Table("Bias and spread of each parameter", by_parameter(rows)),
    }
    return Report(tables, {"timestep": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "skipping against averaging samples, steps of 0.5 to 8 s", report)

LOOKS = {"skip": ("#d1495b", "o-"), "average": ("#00798c", "s-")}


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """Noise, bias and NEES of skipping and averaging over the step."""
    table = summary(rows)
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.6, 3.2), layout="constrained")
        noise, bias, nees = drawing.subplots(1, 3)
        for name, (colour, look) in LOOKS.items():
            part = table[table["resampling"] == name]
            noise.loglog(part["step_s"], part["gyro_ratio"], look, color=colour, markersize=4, label=name)
            noise.loglog(part["step_s"], part["spread_ratio"], ":", color=colour)
            bias.loglog(part["step_s"], part["held_sigma"], look, color=colour, markersize=4)
            nees.semilogx(part["step_s"], part["nees"], look, color=colour, markersize=4)
        steps = np.array(sorted(set(rows["step_s"])))
        noise.loglog(steps, np.sqrt(steps / steps[0]), "--", color="0.5", linewidth=1, label="sqrt Δt")
        noise.set_title("noise / that of the full stream", loc="left", fontsize=9)
        noise.legend(fontsize=7, title="solid: gyro's part; dotted: all", title_fontsize=7, loc="upper left")
        bias.axhline(LIMIT, color="0.4", linewidth=0.8, linestyle="--")
        bias.set_title("bias without noise (formal sigma)", loc="left", fontsize=9)
        nees.axhspan(table["nees_lower"].iloc[0], table["nees_upper"].iloc[0], color="0.9")
        nees.margins(y=0.15)
        nees.set_title("mean NEES; grey: 99 % bounds", loc="left", fontsize=9)
        for axes in (noise, bias, nees):
            axes.set_xticks(steps, [f"{step:g}" for step in steps])
            axes.set_xticks([], minor=True)
            axes.set_xlabel("step Δt (s)")
        noise.set_yticks([1, 2, 4], ["1", "2", "4"])
        noise.set_yticks([], minor=True)
        return save(drawing, path)
