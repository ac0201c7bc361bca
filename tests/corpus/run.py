"""Run a bad input in this process and say how it ended.

"traceback" is any exception but an exit; "several lines" is more than one line on standard error; "slow" is over 30 s of
processor time. A calibration that is answered is right if every parameter is within six sigmas of the truth, "told" if what
is printed says that residuals do not fit or what is not observable, and else "silent": the worst outcome.
"""

import json
import os
import shutil
import signal
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from studies.cli.main import main
from tests.corpus.cases import FREE, JUDGED, REFUSED, Bad

LIMIT_S = 30
SIGMAS = 6.0
TOLD = ("do not trust the sigmas", "smaller than the stated noise", "Not determined by the data", "No degrees of freedom")
GOOD = ("refused", "right", "told", "answered")


class Slow(BaseException):
    """The limit is over."""


@dataclass(frozen=True)
class Outcome:
    """How a bad input ended, in a word, and what was said."""

    word: str
    said: str


@contextmanager
def limited() -> Iterator[None]:
    """Raise `Slow` after the limit: of this process's own time, since others may be at work; and after ten times that."""

    def over(number: int, frame: object) -> None:
        raise Slow

    before = {number: signal.signal(number, over) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
    signal.setitimer(signal.ITIMER_REAL, 10 * LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def run(bad: Bad, recording: Path, truth: np.ndarray[Any, Any], work: Path) -> Outcome:
    """Run one input in a folder of its own, which is removed again.

    Parameters
    ----------
    bad : the input
    recording : a good recording
    truth : (12,) its G, row by row, and b in deg/s; of several gyros (4 gyros,), of each its row of K and its c in deg/s
    work : an empty folder
    """
    here = work / "case"
    here.mkdir()
    shutil.copytree(recording, here / "REC")
    before = Path.cwd()
    try:
        bad.damage(here)
        os.chdir(here)
        arguments = [one.replace("TMP", str(here)) for one in bad.arguments]
        return _judged(bad, arguments, truth)
    finally:
        os.chdir(before)
        shutil.rmtree(here, ignore_errors=True)


def _judged(bad: Bad, arguments: list[str], truth: np.ndarray[Any, Any]) -> Outcome:
    if bad.expected == JUDGED:
        arguments = [*arguments, "--json", "result.json"]
    try:
        with limited(), warnings.catch_warnings():
            warnings.simplefilter("default")
            result = CliRunner().invoke(main, arguments)
    except Slow:
        return Outcome("slow", f"over {LIMIT_S} s")
    if isinstance(result.exception, Slow):
        return Outcome("slow", f"over {LIMIT_S} s")
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        last = "".join(traceback.format_exception(result.exception)).strip().splitlines()
        return Outcome("traceback", f"{last[-1]} {last[-3] if len(last) > 2 else ''}")
    lines = result.stderr.splitlines()
    said = " | ".join(lines)
    if len(lines) > 1:
        return Outcome("several lines", said)
    if result.exit_code == 2:
        return Outcome("refused", said) if len(lines) == 1 else Outcome("no word", result.stdout[:200])
    if result.exit_code:
        return Outcome(f"status {result.exit_code}", said)
    if bad.expected == REFUSED:
        return Outcome("accepted", said)
    if bad.expected == FREE:
        return Outcome("answered", said)
    found = json.loads(Path("result.json").read_text())
    values, sigmas = _answer(found)
    if values.shape == sigmas.shape and (np.abs(values - truth) <= SIGMAS * sigmas).all():
        return Outcome("right", said)
    told = any(text in result.stdout for text in TOLD)
    return Outcome("told" if told else "silent", said or f"off by {np.nanmax(np.abs(values - truth)):.1e}")


def _answer(found: dict[str, Any]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """What a calibration says, in the order of the truth, and its sigmas."""
    if "K" in found:
        values = np.column_stack([found["K"], found["c_deg_s"]]).ravel()
        return values, np.sqrt(np.diag(np.array(found["covariance"], dtype=float)))
    values = np.array([*np.ravel(found["G"]), *found["bias_deg_s"]], dtype=float)
    return values, np.array([row["sigma"] for row in found["estimates"]], dtype=float)
