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

    reproduction: Results
    studies: Path  # folder of the studies' results

    def __getitem__(self, path: str) -> Any:
        """Return a number of the summary; `KeyError` if it is missing or None."""
        value = self.reproduction.summary[path]
        if value is None:
            raise KeyError(path)
        return value

    def say(self, text: str, **further: Any) -> str:
        """Fill the fields of a sentence with numbers of the summary, or with further ones."""
        return fill(text, self, **further)  # type: ignore[arg-type]

    def table(self, name: str) -> pd.DataFrame:
        """Return a table of the reproduction."""
        return self.reproduction.tables[name]

    def study(self, name: str, table: str) -> pd.DataFrame:
        """Read a table of a study."""
        path = self.studies / name / f"{table}.csv"
        if not path.is_file():
            raise KeyError(path)
        return pd.read_csv(path)


class _PathFormatter(Formatter):
    """Formats "{path:.4f}" by the value of a path, which may contain any characters."""

    def get_field(self, field_name: str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> tuple[Any, str]:
        return kwargs[field_name], field_name

    def format_field(self, value: Any, format_spec: str) -> Any:
        return NO_VALUE if value is None else super().format_field(value, format_spec)


def fill(text: str, values: Mapping[str, Any], **further: Any) -> str:
    """Fill the fields of a sentence, which name paths of a summary or further values, with their numbers."""
    return _PathFormatter().vformat(text, (), ChainMap(further, values))  # type: ignore[arg-type]


Judge = Callable[[PaperResults], tuple[Verdict, str]]


@dataclass(frozen=True)
class Claim:
    """A claim of a paper."""

    where: str  # its place in the paper
    text: str  # of the claim
    judge: Judge  # returns verdict and finding, in a sentence


@dataclass(frozen=True)
class JudgedClaim:
    """A claim with its verdict."""

    claim: Claim
    verdict: Verdict
    finding: str  # a sentence


def judge_claims(claims: Sequence[Claim], results: PaperResults) -> list[JudgedClaim]:
    """Judge every claim; open if a run does not have the results that it needs."""
    judged = []
    for claim in claims:
        try:
            verdict, text = claim.judge(results)
        except (KeyError, IndexError):
            verdict, text = "open", NOT_SIMULATED
        judged.append(JudgedClaim(claim, verdict, text))
    return judged


def make_judge(
    text: str, condition: Callable[[PaperResults], bool], then: Verdict = "agrees", otherwise: Verdict = "open"
) -> Judge:
    """Make a judge with a constant sentence, whose verdict depends on a condition."""
    return lambda results: (then if condition(results) else otherwise, results.say(text))
