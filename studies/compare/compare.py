"""A recording compared with scenarios: statistics beside the distribution of the flights, and the gap before and after."""

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
from studies.compare.bench import FlightStatistics, PreparedScenario
from studies.compare.gap import Gap, compute_gap
from studies.compare.measure import MeasurementSetup, RecordingStatistics

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
    fitted: bool  # whether its sizes, or its G and b, were found on this very recording
    flights: int  # their number
    # A row a statistic, `COMPARISON_COLUMNS`; percentile in 0 … 1 with ties counted half, empty where the scenario took the
    # number over from the recording.
    statistics: pd.DataFrame
    gap: Gap  # of the attitude, before and after
    samples: Gap | None  # of the samples; None where too few of them are quiet

    @property
    def names(self) -> list[str]:
        """Names of the statistics, in words."""
        parts = self.statistics[["statistic", "of", "axis"]].itertuples(index=False)
        return [" ".join(part for part in row if part) for row in parts]

    @property
    def by_chance(self) -> float:
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
            "extreme": {"count": self.extreme[0], "of": self.extreme[1], "expected": self.by_chance},
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
        """The result as one object, format 1."""
        own = {"format": 1, "recording": self.recording, "runs": self.runs, "seed": self.seed}
        return own | {"scenarios": [standing.to_json() for standing in self.standings]}


def compare(
    recording: Recording,
    scenarios: Sequence[tuple[str, AdoptedScenario]],
    *,
    runs: int = 200,
    seed: int = 0,
    jobs: int = 1,
    progress: Display | None = None,
) -> Comparison:
    """Fly scenarios, and M0 on the recording's own plan, and see where the recording stands.

    Parameters
    ----------
    recording : what is compared
    scenarios : name and scenario of each
    runs : flights of each
    seed : root of the random streams; flights depend on it and their number only
    jobs : processes
    progress : (label, flights) to a context with a function that is told how many more are done
    """
    if runs < FEWEST_FLIGHTS:
        raise InputError(f"{runs} runs: at least {FEWEST_FLIGHTS} are needed for a distribution")
    with threadpool_limits(1, user_api="blas"):
        found = calibrate(recording)
        if found.dof < 1:
            raise InputError(f"{recording.title}: no more residuals than parameters; there is nothing to compare")
        ruler = MeasurementSetup.build(recording, found.parameters)
        baseline = AdoptedScenario("the baseline on the recording's own plan", ReplayPlan(recording, found.G, found.bias))
        named = [(BASELINE, baseline), *scenarios]
        benches = [PreparedScenario.build(scenario, recording, ruler, name) for name, scenario in named]
        bare = ruler.measure(recording)
        standings: list[ScenarioComparison] = []
        floors = (float("nan"), float("nan"))
        for (name, scenario), bench in zip(named, benches, strict=True):
            flights = simulate_flights(bench, name, runs, seed, jobs, progress)
            if not standings:
                floors = (float(np.mean([f.before for f in flights])), float(np.mean([f.before_samples for f in flights])))
            measured = ruler.measure(bench.stated.subtract_from(recording))
            standings.append(build_scenario_comparison(name, scenario, bench, bare, measured, flights, floors))
    return Comparison(recording.title, runs, seed, tuple(standings))


def simulate_flights(
    bench: PreparedScenario, name: str, runs: int, seed: int, jobs: int, progress: Display | None
) -> list[FlightStatistics]:
    """All flights of a scenario, in the order of their numbers."""
    parts = [range(first, min(first + CHUNK_FLIGHTS, runs)) for first in range(0, runs, CHUNK_FLIGHTS)]
    pool = joblib.Parallel(n_jobs=jobs, return_as="generator", max_nbytes=None)
    out: list[FlightStatistics] = []
    with nullcontext(lambda count: None) if progress is None else progress(f"compare: {name}", runs) as advance:
        for flights in pool(joblib.delayed(_fly_cases)(bench, seed, part) for part in parts):
            out += flights
            advance(len(flights))
    return out


def build_scenario_comparison(
    name: str,
    scenario: AdoptedScenario,
    bench: PreparedScenario,
    bare: RecordingStatistics,
    measured: RecordingStatistics,
    flights: Sequence[FlightStatistics],
    floors: tuple[float, float],
) -> ScenarioComparison:
    """Compute the percentiles of a recording, measured as it is (bare) and under a scenario, among the scenario's flights.

    The floors are E m_0 under M0, of attitude and samples.
    """
    under = np.array([flight.under.mean_square for flight in flights])
    samples = np.array([flight.under.samples for flight in flights])
    errors = np.column_stack([[flight.error for flight in flights], under])
    recorded = bare.mean_square, measured.mean_square
    own = compute_gap(recorded, (floors[0], float(under.mean())), errors, shift=bench.size_error)
    of_samples = None
    if np.isfinite([bare.samples, floors[1], *samples]).all():
        errors = np.column_stack([[flight.before_samples for flight in flights], samples])
        of_samples = compute_gap((bare.samples, measured.samples), (floors[1], float(samples.mean())), errors)
    return ScenarioComparison(
        name=name,
        title=scenario.title,
        effects=tuple(effect.label() for effect in scenario.effects),
        fitted=bench.fitted,
        flights=len(flights),
        statistics=tabulate_statistics(measured, [flight.under for flight in flights], bench.fitted),
        gap=own,
        samples=of_samples,
    )


def tabulate_statistics(measured: RecordingStatistics, flights: Sequence[RecordingStatistics], fitted: bool) -> pd.DataFrame:
    """A row for each statistic that the recording and all flights have.

    If the scenario's G and b are those that were fitted to the recording, the calibrated parameters are not judged.
    """
    keys = list(measured.statistics)
    value = np.array([measured.statistics[key] for key in keys])
    drawn = np.array([[flight.statistics.get(key, np.nan) for key in keys] for flight in flights])
    both = np.isfinite(drawn).all(axis=0) & np.isfinite(value)
    chosen = [key for key, known in zip(keys, both, strict=True) if known]
    out = summarise_distribution(drawn[:, both], value[both]).rename(columns={"flight": "recording"})
    names = pd.DataFrame(chosen, columns=list(COMPARISON_COLUMNS[:4]))
    out = pd.concat([names, out], axis=1)
    out["judged"] = (out["std"] > 0) & ~(fitted & (out["statistic"] == "parameter"))
    out["percentile"] = (out["flight_percentile"] / 100).where(out["judged"])
    out["z"] = ((out["recording"] - out["mean"]) / out["std"]).where(out["judged"])
    return out[list(COMPARISON_COLUMNS)]


def _fly_cases(bench: PreparedScenario, seed: int, cases: range) -> list[FlightStatistics]:
    """Flights of some numbers, in a worker."""
    with threadpool_limits(1, user_api="blas"):
        return [bench.fly(seed, case) for case in cases]
