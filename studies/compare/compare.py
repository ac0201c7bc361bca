"""Compare a recording with scenarios: percentiles of its statistics among simulated flights, and the gap before and after."""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, dataclass
from typing import Any

import joblib
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from gyrocal import calibrate
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.adopted_scenario import AdoptedScenario, ReplayPlan
from studies.calibration.summaries import summarise_distribution
from studies.compare.gap import Gap, compute_gap
from studies.compare.measure import MeasurementSetup, RecordingStatistics
from studies.compare.prepared_scenario import FlightStatistics, PreparedScenario

Display = Callable[[str, int], AbstractContextManager[Callable[[int], None]]]

BASELINE = "M0"
CHUNK_FLIGHTS = 5  # flights that are handed out together
FEWEST_FLIGHTS = 20
EXTREME = 0.01  # percentile from either end that counts as extreme
COMPARISON_COLUMNS = ("statistic", "of", "axis", "unit", "recording", "mean", "std", "p05", "p95", "percentile", "z", "judged")


@dataclass(frozen=True)
class ScenarioComparison:
    """Percentiles of a recording among the simulations of one scenario."""

    name: str  # of the scenario
    title: str  # its own
    effects: tuple[str, ...]  # labels of its effects
    fitted: bool  # whether its sizes, or its G and b, were fitted to this recording
    flights: int  # their number
    # A row a statistic, `COMPARISON_COLUMNS`; percentile in 0 … 1 with ties counted half, empty if the scenario has the number
    # from the recording.
    statistics: pd.DataFrame
    gap: Gap  # of the attitude, before and after
    samples: Gap | None  # of the samples; None where too few of them are quiet

    @property
    def names(self) -> list[str]:
        """Names of the statistics, in words."""
        parts = self.statistics[["statistic", "of", "axis"]].itertuples(index=False)
        return [" ".join(part for part in row if part) for row in parts]

    @property
    def expected_extreme(self) -> float:
        """Expected number of these among the judged statistics by chance: of N simulations few have so extreme a rank."""
        ranks = 2 * math.ceil(EXTREME * self.flights)
        return self.extreme[1] * ranks / (self.flights + 1)

    @property
    def extreme(self) -> tuple[int, int]:
        """Number of judged statistics among the most extreme 2 %, and of all judged statistics."""
        percentile = self.statistics.loc[self.statistics["judged"], "percentile"]
        return int(((percentile < EXTREME) | (percentile > 1 - EXTREME)).sum()), len(percentile)

    def to_json(self) -> dict[str, Any]:
        """Return plain values as in docs/compare.md."""
        return {
            "scenario": self.name,
            "title": self.title,
            "effects": list(self.effects),
            "fitted_to_this_recording": self.fitted,
            "gap": asdict(self.gap),
            "gap_of_samples": None if self.samples is None else asdict(self.samples),
            "extreme": {"count": self.extreme[0], "of": self.extreme[1], "expected": self.expected_extreme},
            "statistics": self.statistics.to_dict("records"),
        }


@dataclass(frozen=True)
class Comparison:
    """The whole result: M0 first, then the scenarios as given."""

    recording: str
    runs: int
    seed: int
    standings: tuple[ScenarioComparison, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the result as one object, format 1."""
        header = {"format": 1, "recording": self.recording, "runs": self.runs, "seed": self.seed}
        return header | {"scenarios": [standing.to_json() for standing in self.standings]}


def compare(
    recording: Recording,
    scenarios: Sequence[tuple[str, AdoptedScenario]],
    *,
    runs: int = 200,
    seed: int = 0,
    jobs: int = 1,
    progress: Display | None = None,
) -> Comparison:
    """Simulate scenarios, and M0 on the recording's own plan, and compute the recording's percentiles among them.

    Parameters
    ----------
    recording : what is compared
    scenarios : name and scenario of each
    runs : flights of each
    seed : root of the random streams; flights depend on it and their number only
    jobs : processes
    progress : called with a label and the number of flights; it returns a context manager of a function that is called with
        each number of further flights that are finished
    """
    if runs < FEWEST_FLIGHTS:
        raise InputError(f"{runs} runs: at least {FEWEST_FLIGHTS} are needed for a distribution")
    with threadpool_limits(1, user_api="blas"):
        calibration = calibrate(recording)
        if calibration.dof < 1:
            raise InputError(f"{recording.title}: no more residuals than parameters; there is nothing to compare")
        setup = MeasurementSetup.build(recording, calibration.parameters)
        plan = ReplayPlan(recording, calibration.G, calibration.bias)
        baseline = AdoptedScenario("the baseline on the recording's own plan", plan)
        all_scenarios = [(BASELINE, baseline), *scenarios]
        prepared_scenarios = [PreparedScenario.build(scenario, recording, setup, name) for name, scenario in all_scenarios]
        unchanged = setup.measure(recording)
        standings: list[ScenarioComparison] = []
        floors = (float("nan"), float("nan"))
        for (name, scenario), prepared in zip(all_scenarios, prepared_scenarios, strict=True):
            flights = simulate_flights(prepared, name, runs, seed, jobs, progress)
            if not standings:  # the baseline's flights, whose misfit is noise alone
                floors = (float(np.mean([f.before for f in flights])), float(np.mean([f.before_samples for f in flights])))
            measured = setup.measure(prepared.stated.subtract_from(recording))
            standings.append(build_scenario_comparison(name, scenario, prepared, unchanged, measured, flights, floors))
    return Comparison(recording.title, runs, seed, tuple(standings))


def simulate_flights(
    prepared: PreparedScenario, name: str, runs: int, seed: int, jobs: int, progress: Display | None
) -> list[FlightStatistics]:
    """Simulate all flights of a scenario, in the order of their numbers."""
    parts = [range(first, min(first + CHUNK_FLIGHTS, runs)) for first in range(0, runs, CHUNK_FLIGHTS)]
    pool = joblib.Parallel(n_jobs=jobs, return_as="generator", max_nbytes=None)
    all_flights: list[FlightStatistics] = []
    with nullcontext(lambda count: None) if progress is None else progress(f"compare: {name}", runs) as advance:
        for flights in pool(joblib.delayed(_fly_cases)(prepared, seed, part) for part in parts):
            all_flights += flights
            advance(len(flights))
    return all_flights


def build_scenario_comparison(
    name: str,
    scenario: AdoptedScenario,
    prepared: PreparedScenario,
    plain: RecordingStatistics,
    measured: RecordingStatistics,
    flights: Sequence[FlightStatistics],
    floors: tuple[float, float],
) -> ScenarioComparison:
    """Compute the percentiles of a recording, measured unchanged (plain) and under a scenario, among the scenario's flights.

    The floors are E m_0 under M0, of attitude and samples.
    """
    mean_squares = np.array([flight.under.mean_square for flight in flights])
    samples = np.array([flight.under.samples for flight in flights])
    errors = np.column_stack([[flight.error for flight in flights], mean_squares])
    recorded = plain.mean_square, measured.mean_square
    attitude_gap = compute_gap(recorded, (floors[0], float(mean_squares.mean())), errors, shift=prepared.size_error)
    samples_gap = None
    if np.isfinite([plain.samples, floors[1], *samples]).all():
        errors = np.column_stack([[flight.before_samples for flight in flights], samples])
        samples_gap = compute_gap((plain.samples, measured.samples), (floors[1], float(samples.mean())), errors)
    return ScenarioComparison(
        name=name,
        title=scenario.title,
        effects=tuple(effect.label() for effect in scenario.effects),
        fitted=prepared.fitted,
        flights=len(flights),
        statistics=tabulate_statistics(measured, [flight.under for flight in flights], prepared.fitted),
        gap=attitude_gap,
        samples=samples_gap,
    )


def tabulate_statistics(measured: RecordingStatistics, flights: Sequence[RecordingStatistics], fitted: bool) -> pd.DataFrame:
    """Build a row for each statistic that the recording and all flights have.

    If the scenario's G and b are those that were fitted to the recording, the calibrated parameters are not judged.
    """
    keys = list(measured.statistics)
    value = np.array([measured.statistics[key] for key in keys])
    simulated = np.array([[flight.statistics.get(key, np.nan) for key in keys] for flight in flights])
    is_complete = np.isfinite(simulated).all(axis=0) & np.isfinite(value)
    complete_keys = [key for key, complete in zip(keys, is_complete, strict=True) if complete]
    table = summarise_distribution(simulated[:, is_complete], value[is_complete]).rename(columns={"flight": "recording"})
    names = pd.DataFrame(complete_keys, columns=list(COMPARISON_COLUMNS[:4]))
    table = pd.concat([names, table], axis=1)
    table["judged"] = (table["std"] > 0) & ~(fitted & (table["statistic"] == "parameter"))
    table["percentile"] = (table["flight_percentile"] / 100).where(table["judged"])
    table["z"] = ((table["recording"] - table["mean"]) / table["std"]).where(table["judged"])
    return table[list(COMPARISON_COLUMNS)]


def _fly_cases(prepared: PreparedScenario, seed: int, cases: range) -> list[FlightStatistics]:
    """Simulate the flights of some numbers, in a worker."""
    with threadpool_limits(1, user_api="blas"):
        return [prepared.fly(seed, case) for case in cases]
