"""The study's cases: tables as the paper would print them, of a known cause, and their diagnosis."""

from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from simulator.scenario import IntervalSection, Scenario
from studies.montecarlo.study import GridConfig, Streams, Study
from studies.natanson import flight
from studies.natanson.flight_diagnosis.builder import NOISE, RATE, TIMING, YAW
from studies.natanson.flight_diagnosis.diagnosis import Effects, diagnose
from studies.natanson.flight_diagnosis.numbers import clock_derivatives
from studies.natanson.flight_diagnosis.table import (
    CELL_DEG,
    CLOCK_S,
    INITIAL_DIGITS,
    PUBLISHED_DIGITS,
    Baseline,
    Table,
    outcomes_apart,
    present,
    reversed_slews,
    rounded,
)
from studies.natanson.flight_diagnosis.timings import TIMINGS
from studies.printed_table import UNKNOWN

KINDS: dict[str, Effects] = {
    "nothing": frozenset(),
    "yaw of 2": frozenset({YAW}),
    "yaw of 6": frozenset({YAW}),
    "both yaws": frozenset({YAW}),
    "rate sign": frozenset({RATE}),
    "one timing": frozenset({TIMING}),
    "four timings": frozenset({TIMING}),
    "common timing": frozenset({TIMING}),
    "noise x3": frozenset({NOISE}),
    "noise /3": frozenset({NOISE}),
    "unknown": frozenset({UNKNOWN}),
    "yaw of 2, four timings": frozenset({YAW, TIMING}),
}
UNKNOWN_SIMULATED_DEG = 0.05


def simulated_motion(kind: str, scenario: Scenario, rng: np.random.Generator) -> tuple[IntervalSection, ...]:
    """The six intervals as flown in a kind of table."""
    sections = list(scenario.interval)
    *own, common = TIMINGS
    chosen = own if "four" in kind else [common] if kind == "common timing" else []
    if kind == "one timing":
        chosen = [own[rng.integers(len(own))]]
    for one in chosen:
        for k, section in one.moved(sections, rng.random(len(one.names))).items():
            sections[k] = section
    flips = {"yaw of 2": (1,), "yaw of 6": (5,), "both yaws": (1, 5), "rate sign": (3,), "yaw of 2, four timings": (1,)}
    for k in flips.get(kind, ()):
        sections[k] = reversed_slews(sections[k])
    return tuple(sections)


def simulated(kind: str, baseline: Baseline, rng: np.random.Generator) -> Table:
    """A table as the paper would print it: noise, least squares for the twelve parameters, and every number rounded."""
    sections = simulated_motion(kind, baseline.scenario, rng)
    factor = {"noise x3": 3.0, "noise /3": 1 / 3}.get(kind, 1.0)
    total, gyro = (factor**2 * v for v in baseline.variances())
    theta, Theta = outcomes_apart(sections)
    for k, section in enumerate(sections):
        theta[k] += clock_derivatives(section) @ rng.uniform(-0.5, 0.5, 2) * CLOCK_S  # Table 1 rounds the times
    H = Theta.reshape(18, 12)
    noise = rng.normal(size=(6, 3)) * np.sqrt(total)[:, None]
    scale = np.linalg.norm(H, axis=0)
    error = np.linalg.lstsq(H / scale, noise.ravel(), rcond=None)[0] / scale
    used = H @ (INITIAL_DIGITS * rng.uniform(-0.5, 0.5, 12))  # what was used has more digits than Table 3
    before = theta + noise + used.reshape(6, 3)
    if kind == "unknown":
        before[rng.integers(6)] += rng.normal(size=3) * UNKNOWN_SIMULATED_DEG
    steps = rng.normal(size=(2, 6, 3)) * np.sqrt(gyro[:, None] * np.array([1.0, 2.0])[:, None, None])
    coarser = before + np.cumsum(steps, axis=0)
    after = noise - (H @ error).reshape(6, 3)
    published = flight.calibration().vector - error
    return Table(
        rounded(before, CELL_DEG), rounded(after, CELL_DEG), rounded(coarser, CELL_DEG), rounded(published, PUBLISHED_DIGITS)
    )


class FlightConfig(GridConfig):
    """The simulated tables.

    Attributes
    ----------
    nothing : tables made of the baseline itself
    each : tables of every other kind
    """

    axes: ClassVar = ("nothing", "each")
    nothing: int = 200
    each: int = 5

    @model_validator(mode="after")
    def _of_the_flight(self) -> Self:
        if self.scenario != "trmm" and not isinstance(self.scenario, Scenario):
            raise ValueError('the flight\'s table belongs to the scenario "trmm"')
        if self.overrides:
            raise ValueError("the flight's table is diagnosed under the scenario as it is, without overrides")
        return self

    def points(self) -> list[str]:
        """Kind of each case."""
        return [kind for kind in KINDS for _ in range(self.each if KINDS[kind] else self.nothing)]


def case(config: FlightConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Diagnose one simulated table."""
    kind = config.points()[number]
    truth = KINDS[kind]
    found = diagnose(simulated(kind, present(), streams.generator("table")), present())
    likeliest = next(iter(found.sets))
    named = frozenset(found.causes)
    return {
        "kind": kind,
        "verdict": found.verdict,
        "causes": ", ".join(found.causes),
        "p_value": found.gap["p_value"],
        "right": found.verdict == {frozenset(): "none", frozenset({UNKNOWN}): "unknown"}[truth]
        if truth <= {UNKNOWN}
        else named == truth,
        "in_group": truth in found.group,
        "false_name": bool(named - truth),
        "likeliest": " + ".join(sorted(likeliest)) or "nothing",
        "truth_probability": found.sets.get(truth, 0.0),
    }


STUDY = Study("studies.natanson.flight_diagnosis:STUDY", FlightConfig, case)
