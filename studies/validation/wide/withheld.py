"""``gyrocal study withheld``: is an effect *unknown* where the list lacks it and all of its family?

A case is drawn as those of the wide check with one listed effect, but its diagnosis can name no effect of that family: those
whose names begin with the same word, as all swings and walks of a bias do, and those that are kin of one of them. What the
others explain but for 3 sigma is no case. The families take turns, so that each has as many cases as any other, and *unknown*
is the right answer. The threshold of the conformal sets is the one that every diagnosis uses: it was set with the whole list.
"""

from __future__ import annotations

import json
import time
from typing import Any

import pandas as pd

from diagnosis.settings import DEFAULT
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from studies.montecarlo.study import Streams, Study
from studies.report.checks import Check, at_least, at_most
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.validation.blind_check.score import label
from studies.validation.wide import score
from studies.validation.wide.cases import NOVEL, Drawn, by_lot, world_of
from studies.validation.wide.diagnosing import diagnosed
from studies.validation.wide.novelty import novelty
from studies.validation.wide.placing import placed
from studies.validation.wide.split import PartName
from studies.validation.wide.study import OUTCOMES, WideConfig, answered, described
from studies.validation.wide.world import World

SUMMARY = "is an effect unknown where the list lacks it and its whole family"
COVERED, WRONG = 0.85, 0.05  # asked for


class WithheldConfig(WideConfig):
    """As of the wide check, of the part that scores."""

    cases: int = 100
    part: PartName = "scored"


def families() -> tuple[tuple[str, ...], ...]:
    """The listed effects by family, see the module, in the order of the registry."""
    out: list[set[str]] = []
    for name, effect in EFFECTS.items():
        alike = [
            one
            for one in out
            if any(_first(other) == _first(name) or (effect.kin and EFFECTS[other].kin == effect.kin) for other in one)
        ]
        out = [one for one in out if one not in alike] + [set().union({name}, *alike)]
    return tuple(sorted((tuple(sorted(one)) for one in out), key=str))


def _first(name: str) -> str:
    return name.split("_")[0]


def draw(config: WithheldConfig, number: int) -> tuple[Drawn, tuple[str, ...]]:
    """A case, and the family that its diagnosis lacks.

    Raises
    ------
    InputError
        No effect of any family can show in its plan and be told from those of the others.
    """
    world = world_of(config.spec(), number)
    every = families()
    turn = number % len(every)
    for family in every[turn:] + every[:turn]:
        found = _of_family(world, family)
        if found is not None:
            return found, family
    raise InputError(f"case {number}: no effect that can show in its plan differs from those of the other families")


def _of_family(world: World, family: tuple[str, ...]) -> Drawn | None:
    others = [effect for name, effect in EFFECTS.items() if name not in family]
    for name in by_lot(world, family):
        for one, snr in placed(world, EFFECTS[name]):
            novel = novelty(world, one, others)
            if novel > NOVEL:
                return Drawn("unlisted", world, (one,), (snr,), (snr,), novel)
    return None


def recording(config: WithheldConfig, number: int, streams: Streams) -> Recording:
    """The recording of one case."""
    return draw(config, number)[0].recording()


def case(config: WithheldConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Draw a case, and diagnose its recording with a list that lacks the family."""
    begun = time.process_time()
    drawn, family = draw(config, number)
    made = drawn.recording()
    drawn_at = time.process_time()
    found = diagnosed(made, [name for name in EFFECTS if name not in family])
    row = described(drawn, number) | answered(drawn, number, found) | {"family": _title(family)}
    return row | {"make_s": drawn_at - begun, "diagnose_s": time.process_time() - drawn_at}


def _title(family: tuple[str, ...]) -> str:
    return " ".join(sorted({_first(name) for name in family}))


def report(config: WithheldConfig, rows: pd.DataFrame) -> Report:
    """Rates, sets and misses, by family."""
    sets = score.set_coverage(rows, DEFAULT.conformal).iloc[0]
    rates = score.rates(rows)
    table = rates[rates["cases"] > 0].reset_index(drop=True)
    wrong = table.set_index("what")["share"]["unlisted and detected: a confident wrong name"]
    by_family = []
    for name, own in rows.groupby("family", sort=True):
        line = score.set_coverage(own, DEFAULT.conformal).iloc[0]
        counted = {one: int((own["outcome"] == one).sum()) for one in OUTCOMES if one not in ("right", "alarm")}
        by_family.append({"family": name, "cases": len(own), **counted, "sets that hold unknown": line["share"]})
    missed = rows[rows["outcome"] != "unknown"]
    shown = ["case", "family", "effects", "plan", "grade", "snr", "attitude_snr", "novelty", "outcome", "said", "probability"]
    truths = missed.assign(effects=[_named(text) for text in missed["truth"]])
    checks = (
        Check("90 % conformal sets that hold unknown", float(sets["share"]), at_least(COVERED), meaning=score.WITHIN),
        Check("detected: a confident wrong name", float(wrong), at_most(WRONG), meaning=score.WITHIN),
    )
    tables = {
        "rates": Table("Rates, with 95 % binomial intervals", table),
        "sets": Table("Conformal sets of explanations", score.set_coverage(rows, DEFAULT.conformal)),
        "families": Table("Outcomes by the family that the list lacked", pd.DataFrame(by_family)),
        "misses": Table("Those that are not unknown, case by case", truths[shown]),
    }
    return Report(tables, checks=checks)


def _named(truth: str) -> str:
    return " + ".join(label(one["effect"], one["axis"]) for one in json.loads(truth))


STUDY = Study("studies.validation.wide.withheld:STUDY", WithheldConfig, case, recording)
ENTRY = Entry(STUDY, SUMMARY, report)
