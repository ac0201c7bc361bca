"""Least times of candidates that take turns."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Candidate:
    """Something to be timed."""

    call: Callable[[], Any]  # the work, prepared so that nothing else is timed
    rounds: int  # how many rounds to take part in, spread evenly over all; a slow candidate takes part in few


def interleaved(candidates: Mapping[str, Candidate]) -> dict[str, float]:
    """Least time of each, ms.

    A turn is a call that is not timed, then one that is: so each finds its own data in the caches, whoever came before it and
    whether or not that one read the same. A candidate with a single round is called once.
    """
    total = max(candidate.rounds for candidate in candidates.values())
    least = dict.fromkeys(candidates, float("inf"))
    for turn in range(total):
        for name, candidate in candidates.items():
            if turn * candidate.rounds // total == (turn + 1) * candidate.rounds // total:
                continue  # its next turn is a later one
            if candidate.rounds > 1:
                candidate.call()
            start = time.perf_counter()
            candidate.call()
            least[name] = min(least[name], time.perf_counter() - start)
    return {name: 1e3 * value for name, value in least.items()}
