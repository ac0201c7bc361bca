"""The study's cases: tables as the paper would print them, of a known cause, and their diagnosis."""

from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from simulator.scenario import IntervalSection, Scenario
from studies.montecarlo.study import GridConfig, Streams, Study
from studies.natanson import flight
from studies.natanson.flight_diagnosis.builder import NOISE, RATE, TIMING, YAW
from studies.natanson.flight_diagnosis.diagnosis import Effects, diagnose
from studies.natanson.flight_diagnosis.misfit_numbers import differentiate_by_clock
from studies.natanson.flight_diagnosis.table import (
    CELL_DEG,
    CLOCK_S,
    INITIAL_DIGITS,
    PUBLISHED_DIGITS,
    Baseline,
    ResidualTable,
    load_present_baseline,
    reverse_slews,
    round_to_digits,
    simulate_each_interval,
)
from studies.natanson.flight_diagnosis.timings import TIMINGS
from studies.printed_table import UNKNOWN_NAME

EFFECTS_BY_KIND: dict[str, Effects] = {
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
    "unknown": frozenset({UNKNOWN_NAME}),
    "yaw of 2, four timings": frozenset({YAW, TIMING}),
}
UNKNOWN_SIMULATED_DEG = 0.05


def draw_flown_intervals(kind: str, scenario: Scenario, rng: np.random.Generator) -> tuple[IntervalSection, ...]:
    """The six intervals as flown in a kind of table."""
    sections = list(scenario.interval)
    *own, common = TIMINGS
    chosen = own if "four" in kind else [common] if kind == "common timing" else []
    if kind == "one timing":
        chosen = [own[rng.integers(len(own))]]
    for one in chosen:
        for k, section in one.apply_timings(sections, rng.random(len(one.names))).items():
            sections[k] = section
    flips = {"yaw of 2": (1,), "yaw of 6": (5,), "both yaws": (1, 5), "rate sign": (3,), "yaw of 2, four timings": (1,)}
    for k in flips.get(kind, ()):
        sections[k] = reverse_slews(sections[k])
    return tuple(sections)


def simulate_table(kind: str, baseline: Baseline, rng: np.random.Generator) -> ResidualTable:
    """A table as the paper would print it: noise, least squares for the twelve parameters, and every number rounded."""
    sections = draw_flown_intervals(kind, baseline.scenario, rng)
    factor = {"noise x3": 3.0, "noise /3": 1 / 3}.get(kind, 1.0)
    total, gyro = (factor**2 * v for v in baseline.variances())
    theta, Theta = simulate_each_interval(sections)
    for k, section in enumerate(sections):
        theta[k] += differentiate_by_clock(section) @ rng.uniform(-0.5, 0.5, 2) * CLOCK_S  # Table 1 rounds the times
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
    published = flight.read_published_calibration().vector - error
    return ResidualTable(
        round_to_digits(before, CELL_DEG),
        round_to_digits(after, CELL_DEG),
        round_to_digits(coarser, CELL_DEG),
        round_to_digits(published, PUBLISHED_DIGITS),
    )


class FlightConfig(GridConfig):
    """The simulated tables."""

    axes: ClassVar = ("nothing", "each")
    nothing: int = 200  # tables made of the baseline itself
    each: int = 5  # tables of every other kind

    @model_validator(mode="after")
    def _require_flight_scenario(self) -> Self:
        if self.scenario != "trmm" and not isinstance(self.scenario, Scenario):
            raise ValueError('the flight\'s table belongs to the scenario "trmm"')
        if self.overrides:
            raise ValueError("the flight's table is diagnosed under the scenario as it is, without overrides")
        return self

    def points(self) -> list[str]:
        """Kind of each case."""
        return [kind for kind in EFFECTS_BY_KIND for _ in range(self.each if EFFECTS_BY_KIND[kind] else self.nothing)]


def run_case(config: FlightConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Diagnose one simulated table."""
    kind = config.points()[number]
    truth = EFFECTS_BY_KIND[kind]
    found = diagnose(simulate_table(kind, load_present_baseline(), streams.generator("table")), load_present_baseline())
    likeliest = next(iter(found.sets))
    named = frozenset(found.causes)
    return {
        "kind": kind,
        "verdict": found.verdict,
        "causes": ", ".join(found.causes),
        "p_value": found.gap["p_value"],
        "right": found.verdict == {frozenset(): "none", frozenset({UNKNOWN_NAME}): "unknown"}[truth]
        if truth <= {UNKNOWN_NAME}
        else named == truth,
        "in_group": truth in found.group,
        "false_name": bool(named - truth),
        "likeliest": " + ".join(sorted(likeliest)) or "nothing",
        "truth_probability": found.sets.get(truth, 0.0),
    }


STUDY = Study("studies.natanson.flight_diagnosis:STUDY", FlightConfig, run_case)
