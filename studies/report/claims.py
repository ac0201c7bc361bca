"""Claims of a paper, each with a verdict: it agrees, the paper slips, the reading is ours, or the question is open.

The paper slips only where a printed equation, sign or digit contradicts the paper's own numbers.

A verdict and the sentence beside it are computed from the results; only the claim is typed, with its place in the paper.
"""

from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import Any, Literal

import pandas as pd

from studies.report.committed_results import Results
from studies.report.tables import NO_VALUE

Verdict = Literal["agrees", "the paper slips", "our reading", "open"]
NOT_SIMULATED = "This run did not simulate what the verdict needs."


@dataclass(frozen=True)
class PaperResults:
    """What a paper's reproduction found."""

    results: Results  # of the reproduction
    studies: Path  # folder of the studies' results

    def __getitem__(self, path: str) -> Any:
        """A number of the summary; `KeyError` if it is not there, or none."""
        value = self.results.summary[path]
        if value is None:
            raise KeyError(path)
        return value

    def say(self, text: str, **more: Any) -> str:
        """A sentence with numbers of the summary, or further ones, in its fields."""
        return fill(text, self, **more)  # type: ignore[arg-type]

    def table(self, name: str) -> pd.DataFrame:
        """A table of the reproduction."""
        return self.results.tables[name]

    def study(self, name: str, table: str) -> pd.DataFrame:
        """A table of a study."""
        path = self.studies / name / f"{table}.csv"
        if not path.is_file():
            raise KeyError(path)
        return pd.read_csv(path)


class _PathFormatter(Formatter):
    """Formats "{path:.4f}" by the value of a path, whatever signs it has."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> tuple[Any, str]:
        return kwargs[field_name], field_name

    def format_field(self, value: Any, format_spec: str) -> Any:
        return NO_VALUE if value is None else super().format_field(value, format_spec)


def fill(text: str, values: Mapping[str, Any], **more: Any) -> str:
    """A sentence with the numbers that its fields name: paths of a summary, or names of further values."""
    return _PathFormatter().vformat(text, (), ChainMap(more, values))  # type: ignore[arg-type]


Judge = Callable[[PaperResults], tuple[Verdict, str]]


@dataclass(frozen=True)
class Claim:
    """A claim of a paper."""

    where: str  # its place in the paper
    text: str  # what the paper says
    judge: Judge  # verdict and what was found, in a sentence


@dataclass(frozen=True)
class JudgedClaim:
    """A claim with its verdict."""

    claim: Claim
    verdict: Verdict
    found: str


def judge_claims(claims: Sequence[Claim], found: PaperResults) -> list[JudgedClaim]:
    """Every claim with its verdict; open where a run has not what it takes."""
    out = []
    for claim in claims:
        try:
            verdict, text = claim.judge(found)
        except (KeyError, IndexError):
            verdict, text = "open", NOT_SIMULATED
        out.append(JudgedClaim(claim, verdict, text))
    return out


def make_judge(
    text: str, condition: Callable[[PaperResults], bool], then: Verdict = "agrees", otherwise: Verdict = "open"
) -> Judge:
    """Make a judge with that sentence, and one verdict where the condition holds and another where it does not."""
    return lambda found: (then if condition(found) else otherwise, found.say(text))
