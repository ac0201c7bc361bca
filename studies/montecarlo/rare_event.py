"""Probability that a column of a study passes a limit, down to some 1e-6, by adaptive importance sampling.

The dispersions are functions of independent standard normal numbers z. Non-parametric adaptive importance sampling (P. Zhang,
J. Am. Stat. Assoc. 91 (1996) 1245; NAIS of OpenTURNS) draws cases, fits a mixture of kernels h(z) to the worst tenth of them,
draws from h, and goes on until h covers the region beyond the limit. The kernels may stand in several regions. The runs that
are left are then drawn from the last h, independently, and with the standard normal density f

    p = mean of 1{beyond} f(z)/h(z)

has no bias and the standard error of a mean, whatever h is, as long as h misses no region; a region that no earlier case came
near is missed by the standard error too. Each case has its own noise streams: p is over noise and dispersions, weights are of
the dispersions alone. An event that noise alone makes rare needs as many runs as plain Monte Carlo.

Kernels fit poorly in many dimensions: with more than `MOST_DISPERSIONS` a study is refused.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from gyrocal.errors import InputError
from simulator import scenario as scenarios
from studies.montecarlo.backends import Name, open_backend
from studies.montecarlo.cases import Task, build_killed_result, run_cases, run_single_threaded
from studies.montecarlo.criterion_text import check_criterion_column, match_criterion
from studies.montecarlo.dispersions import SMALLEST_U, correlate_shares, evaluate_at_shares
from studies.montecarlo.study import Study, StudyConfig, find_study_folder, load_base_scenario, resolve_config

Array = NDArray[np.float64]

RUNS = 10_000  # unless stated
FEWEST_RUNS = 1000
MOST_LEVELS = 7  # in the first half of the runs; each takes the probability down by about LEVEL_SHARE
LEVEL_SHARE = 0.1  # of them, those that the next level's kernels stand on
MOST_DISPERSIONS = 10  # in more, standard errors were found too small on closed forms
ACCURATE = 0.2  # relative standard error above which an answer is called inaccurate
EVENT_FORM = re.compile(r"\s*([^<>\s]+)\s*([<>])\s*(?P<limit>\S+)\s*")


class _RunsSpentError(Exception):
    """The levels have not reached the limit within half of the runs."""


@dataclass(frozen=True)
class RareEvent:
    """Probability of a rare event.

    Attributes
    ----------
    event : as text
    probability : NaN if the limit was not reached
    standard_error : of the probability
    runs : cases that were run
    beyond : of those drawn from the last density, the ones beyond the limit
    failed : cases that ended with an error or without a value; they count as beyond the limit
    """

    event: str
    probability: float
    standard_error: float
    runs: int
    beyond: int
    failed: int = 0

    def __str__(self) -> str:
        failed = f", {self.failed} of them failed and count as beyond the limit" if self.failed else ""
        if math.isnan(self.probability):
            return f"{self.event}: the limit was not reached in {self.runs} runs{failed}; use more --cases."
        accurate = self.beyond and self.standard_error <= ACCURATE * self.probability
        poor = "" if accurate else "; too inaccurate to use, run more --cases"
        return (
            f"P({self.event}) = {self.probability:.2e} ± {self.standard_error:.1e} (1 sigma, {self.runs} runs{failed}){poor}."
        )


@dataclass(frozen=True)
class RareLimit:
    """Limit that a column seldom passes."""

    column: str
    sign: str
    limit: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """The limit of a text such as "error_deg > 0.4".

        Raises
        ------
        InputError
            It is not of that form.
        """
        usage = "give it as COLUMN>LIMIT or COLUMN<LIMIT, e.g. 'error_deg>0.4'"
        match, limit = match_criterion(EVENT_FORM, text, "--rare", usage)
        return cls(match[1], match[2], limit)

    def measure_excess(self, rows: list[Mapping[str, Any]]) -> float:
        """How far the worst row of a case is beyond the limit, in the column's unit; NaN of a failed case or without a value.

        Raises
        ------
        InputError
            There is no such column, or it holds no numbers.
        """
        if any(row["error"] for row in rows):
            return math.nan
        for row in rows:
            check_criterion_column(self.column, row, [row.get(self.column)], "--rare")
        values = [math.nan if row[self.column] is None else float(row[self.column]) for row in rows]
        excess = [value - self.limit if self.sign == ">" else self.limit - value for value in values]
        return math.nan if any(map(math.isnan, excess)) else max(excess)


def estimate_rare_probability(
    excess: Callable[[Array], Array], dimensions: int, runs: int, seed: int
) -> tuple[float, float, int]:
    """P(excess > 0) of independent standard normal numbers, its standard error, and how many draws lay beyond at the end.

    Parameters
    ----------
    excess : (n, d) numbers to (n,) excesses; called for several levels, then for the runs that are left
    dimensions : d
    runs : in all
    seed : of the draws

    Raises
    ------
    InputError
        OpenTURNS is not installed.
    """
    try:
        import openturns as ot
    except ImportError:
        raise InputError("--rare needs openturns: pip install 'gyrocal[rare]'") from None
    used = 0
    fault: BaseException | None = None

    def evaluate(points: Any) -> Array:
        nonlocal used, fault
        try:
            if used + len(points) > runs // 2:  # the other half is for the estimate
                raise _RunsSpentError
            used += len(points)
            return excess(np.array(points))[:, None]
        except BaseException as error:
            fault = error
            raise

    ot.RandomGenerator.SetSeed(seed % 2**32)
    normal = ot.Normal(dimensions)
    values = ot.CompositeRandomVector(ot.PythonFunction(dimensions, 1, func_sample=evaluate), ot.RandomVector(normal))
    levels = ot.NAIS(ot.ThresholdEvent(values, ot.Greater(), 0.0), LEVEL_SHARE)
    levels.setMaximumOuterSampling(1)
    levels.setBlockSize(runs // (2 * MOST_LEVELS))
    try:
        levels.run()
    except RuntimeError:  # what OpenTURNS makes of every exception of the function
        if isinstance(fault, _RunsSpentError):
            return math.nan, math.nan, 0
        if fault is None:
            raise
        raise fault from None
    density = levels.getResult().getAuxiliaryDistribution()
    points = density.getSample(runs - used)
    ratio = np.exp(np.array(normal.computeLogPDF(points)) - np.array(density.computeLogPDF(points)))[:, 0]
    beyond = excess(np.array(points)) > 0
    weights = ratio * beyond
    return float(weights.mean()), float(weights.std(ddof=1) / math.sqrt(len(weights))), int(beyond.sum())


def run_rare_event(
    study: Study,
    config: StudyConfig,
    event: RareLimit,
    runs: int = RUNS,
    backend: Name = "loky",
    jobs: int | None = None,
    scheduler: str | None = None,
) -> RareEvent:
    """Estimate the probability of an event over the dispersions and the noise of a study.

    Raises
    ------
    InputError
        The study has no dispersions or too many, too few runs, or no such column; OpenTURNS is not installed.
    """
    ready = resolve_config(config)
    scenario, paths = load_base_scenario(ready), tuple(ready.dispersions)
    if not 1 <= len(paths) <= MOST_DISPERSIONS:
        raise InputError(
            f"--rare: needs 1 to {MOST_DISPERSIONS} dispersions, and there are {len(paths)}; change the dispersions"
        )
    if runs < FEWEST_RUNS:
        raise InputError(f"--rare: needs at least {FEWEST_RUNS} runs; give --cases {RUNS} or leave it out")
    plain = ready.model_copy(update={"dispersions": {}, "correlations": (), "sampler": "random"})
    folder = find_study_folder(study)
    count = failed = 0

    def build_task(number: int, point: Array) -> Task:
        shares = np.clip(ndtr(point), SMALLEST_U, 1 - 2 * SMALLEST_U).tolist()
        values = evaluate_at_shares(ready.dispersions, scenario, correlate_shares(paths, shares, ready.correlations))
        document = plain.model_dump(mode="json") | {"scenario": scenarios.override(scenario, values).model_dump(mode="json")}
        return Task(study.name, json.dumps(document), range(number, number + 1), folder)

    with run_single_threaded():
        workers = open_backend(backend, run_cases, jobs, scheduler)
        finished = False

        def measure(points: Array) -> Array:
            nonlocal count, failed
            found = np.full(len(points), math.nan)
            tasks = (build_task(count + k, point) for k, point in enumerate(points))
            for task, result in workers.results(tasks):
                rows = (result or build_killed_result(task)).rows
                found[task.cases.start - count] = event.measure_excess(list(rows))
            count += len(points)
            failed += int(np.isnan(found).sum())
            return np.where(np.isnan(found), 1.0 + abs(event.limit), found)

        try:
            answer = estimate_rare_probability(measure, len(paths), runs, ready.entropy)
            finished = True
        finally:
            workers.close(finished)
    text = f"{event.column} {event.sign} {event.limit:.12g}"
    return RareEvent(text, *answer[:2], count, answer[2], failed)
