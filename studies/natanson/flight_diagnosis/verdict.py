"""The verdict: what the weights of the hypotheses say together."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import logsumexp

from studies.natanson.flight_diagnosis.families import FAMILIES, UNKNOWN, Families, Hypothesis, hypotheses
from studies.natanson.flight_diagnosis.gap import gap_test
from studies.natanson.flight_diagnosis.table import Baseline, Table

SURE = 0.95
FALSE_ALARM = 0.01


@dataclass(frozen=True)
class Judgement:
    """What the hypotheses' weights say.

    Attributes
    ----------
    verdict : "none", "named", "group" or "unknown"
    causes : families at work
    group : sets of families that hold `SURE` of the probability together, the likeliest first
    sets : probability of each set of families, the likeliest first
    includes : probability that a family is at work; of "unknown", that something remains beside what is named
    best : likeliest hypothesis of the likeliest set
    p_value : of there being a gap
    """

    verdict: str
    causes: tuple[str, ...]
    group: tuple[Families, ...]
    sets: dict[Families, float]
    includes: dict[str, float]
    best: Hypothesis
    p_value: float
    weighed: tuple[Hypothesis, ...] = field(repr=False, default=())

    def unknown_deg(self) -> tuple[float, float]:
        """Size of what is unknown, mean and sigma over the hypotheses that hold one, deg; zeros without."""
        holding = [h for h in self.weighed if UNKNOWN in h.families]
        if not holding:
            return 0.0, 0.0
        weight = np.exp(np.array([h.log_weight for h in holding]) - logsumexp([h.log_weight for h in holding]))
        size = np.sqrt([h.extra.max() for h in holding])
        mean = float(weight @ size)
        return mean, float(np.sqrt(weight @ (size - mean) ** 2))

    def members(self) -> dict[str, float]:
        """Probability of each interval's slew reversed or timing other than assumed, over all hypotheses."""
        total = logsumexp([h.log_weight for h in self.weighed])
        out: dict[str, float] = {}
        for h in self.weighed:
            share = float(np.exp(h.log_weight - total))
            places = [f"reversed in {k + 1}" for k in h.flips]
            places += ["timings common to all"] if isinstance(h.timed, str) else [f"timing of {k + 1}" for k in h.timed]
            for place in places:
                out[place] = out.get(place, 0.0) + share
        return out


def judge(weighed: Sequence[Hypothesis], p_value: float) -> Judgement:
    """The verdict: no gap at `FALSE_ALARM`; or the causes that reach `SURE`, with or without an unknown beside them."""
    total = logsumexp([h.log_weight for h in weighed])
    found: dict[Families, float] = {}
    for h in weighed:
        found[h.families] = found.get(h.families, 0.0) + float(np.exp(h.log_weight - total))
    sets = dict(sorted(found.items(), key=lambda item: -item[1]))
    includes = {name: sum(p for families, p in sets.items() if name in families) for name in FAMILIES}
    likeliest = next(iter(sets))
    best = max((h for h in weighed if h.families == likeliest), key=lambda h: h.log_weight)
    causes = tuple(name for name in FAMILIES if name != UNKNOWN and includes[name] >= SURE)
    group, reached = [], 0.0
    for families, p in sets.items():
        if reached >= SURE:
            break
        group.append(families)
        reached += p
    if p_value > FALSE_ALARM:
        verdict, causes, group = "none", (), []
    elif causes:
        verdict = "named"
    else:
        verdict = "unknown" if likeliest == frozenset({UNKNOWN}) and includes[UNKNOWN] >= SURE else "group"
    return Judgement(verdict, causes, tuple(group), sets, includes, best, p_value, tuple(weighed))


def diagnose(table: Table, baseline: Baseline) -> Judgement:
    """The verdict on a table under a baseline; without a gap no hypotheses are weighed."""
    p_value = gap_test(table, baseline)["p_value"]
    if p_value > FALSE_ALARM:
        nothing = Hypothesis(frozenset(), "baseline", 0.0)
        return Judgement("none", (), (), {frozenset(): 1.0}, dict.fromkeys(FAMILIES, 0.0), nothing, p_value)
    return judge(hypotheses(table, baseline), p_value)
