"""Does the diagnosis find what it has not been told? Sealed answers, three processes, one score.

`gyrocal study blind` runs the three steps of `studies.validation.blind_check` in processes of their own: one makes the
recordings and seals the answers, the second diagnoses from the recordings alone, the third opens the answers and counts.
``work/`` in the study's folder holds what they exchange, and each step's study; it is deleted in the end, while seals, opened
answers and all that was counted are kept. A run that was stopped goes on.

With ``withhold`` above zero each listed effect in turn is put into so many recordings and left out of the library of their
diagnosis: the answer must then be "unknown" or a group of alternatives.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from pydantic import model_validator
from rich.console import Console

from diagnosis.diagnose import diagnose
from gyrocal import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.scenario import Scenario
from studies.montecarlo import engine
from studies.montecarlo.files import write_parquet, write_text
from studies.montecarlo.manifest import MANIFEST, write_manifest
from studies.montecarlo.study import Scalar, Streams, Study, StudyConfig, base_scenario, load_config
from studies.report.checks import Check
from studies.report.entry import Entry, Report, show, write
from studies.report.panels import GREY, RED, TEAL, Draw, Line, curves, noted, sheet
from studies.report.tables import Table
from studies.validation.blind_check.cases import Range, Spec, draw
from studies.validation.blind_check.score import CLEAR, DETECTABLE, Scores, case_row, scored
from studies.validation.blind_check.steps import DIAGNOSIS_SEED, open_answers

COLOURS = {"one": TEAL, "unlisted": RED}
CASES = 300
LISTS = ("statements", "size_sigmas")  # columns that hold lists


class BlindConfig(StudyConfig):
    """What is drawn, see `studies.validation.blind_check.cases.Spec`.

    Attributes
    ----------
    snr, pair_snr, unlisted_snr, withheld_snr : ranges of the evidence signal-to-noise ratio
    mix : cases with no effect, one, two and an unlisted one in a block
    temperature_share : of the recordings that have a gyro temperature without needing one
    withhold : cases of each effect that its diagnosis cannot name; zero for the blind check itself
    keep_recordings : do not delete recordings and single results in the end
    """

    cases: int = CASES
    scenario: str | Scenario = "trmm_series"
    overrides: dict[str, Scalar] = {  # noqa: RUF012  # pydantic copies it
        "gyro.arw_deg_per_sqrt_s": 1.5e-4,
        "reference.sigma_deg.0": 0.005,
        "reference.sigma_deg.1": 0.005,
        "reference.sigma_deg.2": 0.008,
    }
    mix: tuple[int, int, int, int] = (6, 13, 5, 6)
    snr: Range = (4.0, 40.0)
    pair_snr: Range = (8.0, 40.0)
    unlisted_snr: Range = (4.0, 40.0)
    withheld_snr: Range = (12.0, 30.0)
    temperature_share: float = 0.4
    withhold: int = 0
    keep_recordings: bool = False

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.dispersions:
            raise ValueError("plans are drawn by the blind check itself; use overrides")
        needed = self.withhold * len(EFFECTS)
        if self.withhold and self.cases == CASES:
            self.__dict__["cases"] = needed  # it is frozen for everybody else
        if self.withhold and self.cases != needed:
            raise ValueError(f"withholding {len(EFFECTS)} effects {self.withhold} times makes {needed} cases, not {self.cases}")
        return self

    def spec(self) -> Spec:
        """What the first step draws by."""
        return Spec(
            entropy=self.entropy,
            cases=self.cases,
            base=base_scenario(self),
            mix=self.mix,
            snr=self.snr,
            pair_snr=self.pair_snr,
            unlisted_snr=self.unlisted_snr,
            withheld_snr=self.withheld_snr,
            temperature_share=self.temperature_share,
            withhold=self.withhold,
        )


def recording(config: BlindConfig, number: int, streams: Streams) -> Recording:
    """The recording of one case."""
    return draw(config.spec(), number).recording()


def case(config: BlindConfig, number: int, streams: Streams) -> dict[str, Any]:
    """One case in one process, to look into it (``--rerun``); what counts is `run`."""
    drawn = draw(config.spec(), number)
    found = diagnose(drawn.recording(), seed=DIAGNOSIS_SEED, library=drawn.nameable).to_json()
    row = case_row(drawn.answer, {"diagnosis": found, "error": ""})
    return {key: value for key, value in row.items() if key not in ("case", "error", *LISTS)}


STUDY = Study("studies.validation.blind:STUDY", BlindConfig, case, recording)


def run(
    folder: Path,
    changes: Mapping[str, Any],
    console: Console,
    config: Path | None = None,
    jobs: int | None = None,
) -> engine.Outcome:
    """Run the three steps one after the other, and write and show the report.

    Parameters
    ----------
    folder : of the study
    changes, config : settings, as for any study
    console : for the report
    jobs : worker processes of each step
    """
    begun = time.monotonic()
    settings: BlindConfig = load_config(STUDY, config, changes)
    work = folder / "work"
    work.mkdir(parents=True, exist_ok=True)
    took = {}
    for step in ("make", "diagnose", "score"):
        start = time.monotonic()
        _step(step, work, jobs or os.cpu_count() or 1, settings.spec().model_dump_json() if step == "make" else "")
        took[step] = time.monotonic() - start
    rows = pd.DataFrame(json.loads((work / "scores.json").read_text())["rows"])
    table = _kept(folder, work, rows)
    made = report(settings, rows, took)
    write(made, f"Study blind: {SUMMARY}", folder)
    show(made, console)
    # The manifest is that of the diagnoses' study, whose answers and scores are here too.
    about = json.loads((work / "results" / MANIFEST).read_text())
    about |= engine.about(STUDY, settings) | {"wall_s": round(time.monotonic() - begun, 3)}
    write_manifest(folder, about)
    if not settings.keep_recordings:
        shutil.rmtree(work)
    failures = {int(case): error for case, error in about["failures"].items()}
    resumed, cpu_s = about["runs"][-1]["resumed"], about["cpu_s"]
    return engine.Outcome(folder, table, len(rows), resumed, failures, about["warnings"], about["wall_s"], cpu_s, about)


def _step(step: str, work: Path, jobs: int, given: str = "") -> None:
    """One step in a process of its own, which gets the folder and, the first one, the settings."""
    command = [sys.executable, "-m", "studies.validation.blind_check", step, str(work), str(jobs)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8") as process:
        try:
            said, _ = process.communicate(given)
        except KeyboardInterrupt:
            process.terminate()
            raise engine.Interrupted(f"stopped in step '{step}'; the same command goes on in {work.parent}") from None
    if process.returncode:
        raise InputError(f"blind check, step '{step}': {said.strip() or f'status {process.returncode}'}")


def _kept(folder: Path, work: Path, rows: pd.DataFrame) -> Path:
    """Keep seals, opened answers and rows; returns the rows' file."""
    write_text(folder / "seals.json", (work / "seals.json").read_text())
    open_answers(work)  # once more: what is kept must be what was sealed
    sealed = json.loads((work / "sealed" / "answers.json").read_text())
    opened = {key: {"salt": one["salt"], "answer": one["answer"]} for key, one in sealed.items()}
    write_text(folder / "answers.json", json.dumps(opened, separators=(",", ":")) + "\n")
    table = folder / "table.parquet"
    write_parquet(table, rows.drop(columns=[name for name in LISTS if name in rows]))
    return table


def report(config: BlindConfig, rows: pd.DataFrame, took: Mapping[str, float] | None = None) -> Report:
    """Criteria, rates, and where the mistakes are."""
    made = scored(rows)
    mistakes = made.confusion[made.confusion["truth"] != made.confusion["said"]]
    most = mistakes.sort_values("cases", ascending=False, ignore_index=True).head(25)
    tables = {
        "criteria": Table("Criteria", made.criteria),
        "rates": Table("Rates with Wilson's 95 % intervals", made.table),
        "by_snr": Table("Over the signal-to-noise ratio", made.by_snr),
        "reliability": Table("Stated probability against frequency", made.reliability),
        "by_effect": Table("By effect", made.by_effect),
        "confusion": Table("What was in, what was said", made.confusion, shown=most),
        "run_time": Table("Run time", run_time(rows, took or {})),
    }
    figures = {"reliability": reliability_figure(made)}
    if len(made.by_snr):
        figures["detection"] = detection_figure(made)
    return Report(tables, figures, _checks(made, rows))


def run_time(rows: pd.DataFrame, took: Mapping[str, float]) -> pd.DataFrame:
    """Seconds of a diagnosis, and of each step by the clock."""
    seconds = rows["runtime_s"].dropna() if "runtime_s" in rows else pd.Series(dtype=float)
    out = [{"what": f"{step}, wall", "seconds": value} for step, value in took.items()]
    if len(seconds):
        for name, value in (("median", seconds.median()), ("95 %", seconds.quantile(0.95)), ("largest", seconds.max())):
            out.append({"what": f"a diagnosis, {name}", "seconds": float(value)})
    return pd.DataFrame(out, columns=["what", "seconds"])


MET = "Whether a criterion is met; its rate, with Wilson's 95 % interval, is in the first table."


def _checks(made: Scores, rows: pd.DataFrame) -> tuple[Check, ...]:
    named = made.rows[(made.rows["kind"] == "one") & made.rows["exact"].astype(bool)]
    ratio = (named["G_error"] / named["baseline_G_error"]).median() if len(named) else np.nan
    return (
        *(Check(row["criterion"], row["met"], "yes", meaning=MET) for _, row in made.criteria.iterrows()),
        Check("diagnoses that failed and are not counted", float((rows["error"] != "").sum()), (0.0, 0.0)),
        Check("error of G over that of the baseline, single cause named rightly, median", ratio),
    )


def detection_figure(made: Scores) -> Draw:
    """How often an effect is noticed and put right, over its signal-to-noise ratio."""
    parts = []
    for kind, title, at in (("one", "single listed effects", DETECTABLE), ("unlisted", "unlisted effects", CLEAR)):
        found = made.by_snr[made.by_snr["kind"] == kind]
        if found.empty:
            continue
        lines = [
            Line(rates["snr"], rates["value"], str(what), COLOURS[kind], style, rates["low"], rates["high"], bars=True)
            for style, (what, rates) in zip(("o-", "s--"), found.groupby("what", sort=False), strict=False)
        ]
        axes: dict[str, Any] = {"x": "evidence signal-to-noise ratio", "y": "share of the cases, 95 % interval", "log": "x"}
        axes |= {"ticks": [4, 8, 12, 20, 40], "at": [at], "legend": "lower right"}
        all_of_them = Line(axes["ticks"], np.ones(5), "", GREY, ":")
        parts.append(curves([all_of_them, *lines], title=title, **axes))
    return sheet(*parts, size=(9.0, 3.4), sharey=True)


def reliability_figure(made: Scores) -> Draw:
    """Stated probability of a cause against how often it was there, with the number of statements."""
    table = made.reliability
    points = Line(table["stated"], table["frequency"], "", COLOURS["one"], "o", table["low"], table["high"], bars=True)
    panel = curves([Line([0, 1], [0, 1], "", GREY, "-"), points])

    def draw(on: Axes) -> None:
        panel.draw(on)
        for count, x, y in table[["of", "stated", "frequency"]].to_numpy(float):
            noted(on, f"{count:.0f}", x, y, (4, -10))

    x, y = "stated probability, mean of a bin", "share that was there, 95 % interval"
    return sheet(replace(panel, draw=draw, x=x, y=y), size=(4.2, 3.8))


SUMMARY = "is the diagnosis right about recordings whose answers are sealed"
ENTRY = Entry(STUDY, SUMMARY, report)
