"""The flight's table under the present baseline and under deliberately wrong ones, and the document of each."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from simulator.scenario import Scenario
from studies.natanson.flight_diagnosis.closing import Closure, closure
from studies.natanson.flight_diagnosis.families import NOISE, RATE, TIMING, UNKNOWN, Families, flip_families
from studies.natanson.flight_diagnosis.gap import gap_test, where
from studies.natanson.flight_diagnosis.numbers import noise_factor, prepare
from studies.natanson.flight_diagnosis.table import Baseline, Table, flown, present, reversed_slews, sign_of
from studies.natanson.flight_diagnosis.timings import TIMINGS
from studies.natanson.flight_diagnosis.verdict import FALSE_ALARM, Judgement, diagnose
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS

Array = NDArray[np.float64]


def centred(scenario: Scenario) -> Scenario:
    """Slews in the middle of their intervals and nothing but ramps, as slow as the rate of the assumed ones peaks."""
    sections = list(scenario.interval)
    for k in (*YAW_INTERVALS, MINUS_Y):
        section, timed = sections[k], TIMINGS[k]
        u = np.full((1, len(timed.names)), 0.5)
        u[0, -1] = 1.0
        low, high = timed.durations()
        wanted = min(abs(section.slew[0].angle_deg) / 0.2, 0.95 * (section.stop_s - section.start_s))
        u[0, 1] = np.log(wanted / low) / np.log(high / low)
        timings = timed.values(u)[0]
        if k == MINUS_Y:
            stay = 3600.0
            timings[2], timings[0] = stay, 0.5 * (section.stop_s - section.start_s - timings[1] - stay)
        sections[k] = timed.section(timings, sign_of(section))
    return scenario.model_copy(update={"interval": tuple(sections)})


@dataclass(frozen=True)
class Trial:
    """A baseline the flight is diagnosed under, and what was done to it on purpose."""

    baseline: Baseline
    done: Families
    flips: tuple[int, ...] = ()


def trials() -> list[Trial]:
    """The present baseline first, then the deliberately wrong ones."""
    right = present()

    def wrong(name: str, flips: tuple[int, ...]) -> Trial:
        sections = tuple(reversed_slews(s) if k in flips else s for k, s in enumerate(right.scenario.interval))
        return Trial(Baseline(name, right.scenario.model_copy(update={"interval": sections})), flip_families(flips)[0], flips)

    return [
        Trial(right, frozenset()),
        wrong("yaw of 2 reversed", (1,)),
        wrong("yaw of 6 reversed", (5,)),
        wrong("both yaws reversed", (1, 5)),
        wrong("rate of 4 at +1 RPO", (3,)),
        Trial(Baseline("slews centred and smooth", centred(right.scenario)), frozenset({TIMING})),
        Trial(replace(right, name="noise three times", noise_factor=3.0), frozenset({NOISE})),
        Trial(replace(right, name="noise a third", noise_factor=1 / 3), frozenset({NOISE})),
    ]


@dataclass(frozen=True)
class Diagnosis:
    """A table's diagnosis under one baseline."""

    trial: Trial
    judgement: Judgement
    gap: dict[str, float]
    where: pd.DataFrame
    closure: Closure
    noise: tuple[float, float]
    prediction: Array

    def row(self) -> dict[str, Any]:
        """For the table of all baselines."""
        found, closed = self.judgement, self.closure
        members = [name for name, p in found.members().items() if p >= 0.5]
        return {
            "baseline": self.trial.baseline.name,
            "done": " + ".join(sorted(self.trial.done)) or "nothing",
            "verdict": found.verdict,
            "causes": " + ".join(found.causes) or "none",
            "named_what_was_done": "yes"
            if self.trial.done and self.trial.done <= set(found.causes)
            else "no"
            if self.trial.done
            else "",
            "which": ", ".join(members) or "none",
            "unknown_probability": found.includes[UNKNOWN],
            "before_deg": closed.rms_deg["before"],
            "after_deg": closed.rms_deg["after"],
            "floor_deg": closed.rms_deg["floor"],
            "noise_factor": self.noise[0],
        }

    def document(self) -> dict[str, Any]:
        """In the form of `gyrocal diagnose`."""
        found, closed = self.judgement, self.closure
        places = self.where[(self.where["p_holm"] < FALSE_ALARM)].sort_values("p_holm")
        before, after, floor = closed.rms_deg["before"], closed.rms_deg["after"], closed.rms_deg["floor"]
        return {
            "format": 1,
            "recording": f"N Table 2 under the baseline: {self.trial.baseline.name}",
            "verdict": found.verdict,
            "gap": {"present": found.p_value <= FALSE_ALARM, "false_alarm_rate": FALSE_ALARM, **self.gap},
            "where": [
                {
                    "signal": "attitude",
                    "interval": f"m{row['interval']}",
                    "axis": row["axis"],
                    "statistic": "chi2",
                    "value": float(row["chi2"]),
                    "p_value": float(row["p_holm"]),
                    "text": f"interval {row['interval']} {row['axis']}: {row['beyond_calibration_deg']:+.4f} "
                    f"± {row['sigma_deg']:.4f} deg",
                }
                for _, row in places.iterrows()
            ],
            "causes": [self._cause(name) for name in found.causes],
            "alternatives": [
                {"effects": sorted(families) or ["none"], "probability": p} for families, p in list(found.sets.items())[1:6]
            ],
            "group": [sorted(families) for families in found.group],
            "members": found.members(),
            "unknown_probability": found.includes[UNKNOWN],
            "unknown_deg": dict(zip(("size", "sigma"), found.unknown_deg(), strict=True)),
            "best": found.best.label,
            "closure": {
                "measure": "RMS of flown minus predicted, deg",
                "before": before,
                "after": after,
                "floor": floor,
                "closed": None if before <= floor else 1 - (after - floor) / (before - floor),
                "whitened_mean_square": closed.whitened,
            },
        }

    def _cause(self, name: str) -> dict[str, Any]:
        found = self.judgement
        out: dict[str, Any] = {"effect": name, "axis": None, "probability": found.includes[name], "group": [name]}
        if name == NOISE:
            return out | {"size": self.noise[0], "sigma": self.noise[1], "unit": "factor"}
        if name == TIMING:
            values = {key: {"mean": mean, "sigma": sigma} for key, (mean, sigma) in self.closure.sizes.items()}
            return out | {"size": None, "sigma": None, "unit": "s", "parameters": values}
        flips = [k + 1 for k in found.best.flips if (k == MINUS_Y) == (name == RATE)]
        size, unit = (2.0, "RPO") if name == RATE else (360.0, "deg")
        return out | {"size": size, "sigma": 0.0, "unit": unit, "parameters": {"intervals": flips}}


def examine(table: Table, trial: Trial) -> Diagnosis:
    """Diagnose a table under one baseline, with places and closure."""
    baseline = trial.baseline
    found = diagnose(table, baseline)
    return Diagnosis(
        trial,
        found,
        gap_test(table, baseline),
        where(table, baseline),
        closure(table, baseline, found.best),
        noise_factor(table, baseline, found.best.flips),
        prepare(table, baseline).prediction.reshape(6, 3),
    )


@cache
def flight_diagnoses() -> tuple[Diagnosis, ...]:
    """The flight's table under every baseline of `trials`."""
    return tuple(examine(flown(), trial) for trial in trials())


def documents() -> dict[str, Any]:
    """Result of each baseline, by its name."""
    return {found.trial.baseline.name: found.document() for found in flight_diagnoses()}


def evidence_table(found: Diagnosis) -> pd.DataFrame:
    """Sets of families by probability."""
    sets = found.judgement.sets
    return pd.DataFrame(
        {
            "hypothesis": [" + ".join(sorted(families)) or "nothing" for families in sets],
            "log10_probability": [np.log10(max(p, 1e-300)) for p in sets.values()],
        }
    )
