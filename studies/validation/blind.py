"""Does the diagnosis find what it has not been told? Sealed answers, three processes, one score.

`gyrocal study blind` runs the three steps of `studies.validation.blind_check` in processes of their own: one makes the
recordings and seals the answers, the second diagnoses from the recordings alone, the third opens the answers and counts.
``work/`` in the study's folder holds what they exchange; recordings and single results are deleted in the end, seals, opened
answers and all that was counted are kept. A run that was stopped goes on.

With ``withhold`` above zero each listed effect in turn is put into so many recordings and left out of the library of their
diagnosis: the answer must then be "unknown" or an honest group.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, Self

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydantic import model_validator
from rich.console import Console

from diagnosis.diagnose import diagnose
from gyrocal import InputError
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from simulator.scenario import Scenario
from studies.montecarlo import engine
from studies.montecarlo.manifest import manifest, write_json
from studies.montecarlo.study import Scalar, Streams, Study, StudyConfig, base_scenario, config_sha256, load_config, resolved
from studies.report.console import progress
from studies.report.entry import Entry, Report, show, write
from studies.report.panels import STYLE, save
from studies.report.tables import Table
from studies.validation.blind_check.cases import Range, Spec, draw
from studies.validation.blind_check.score import CLEAR, DETECTABLE, Scores, case_row, scored
from studies.validation.blind_check.steps import DIAGNOSIS_SEED, open_answers

STEPS = (("make", "blind: recordings"), ("diagnose", "blind: diagnoses"), ("score", "blind: scores"))
COLOURS = {"one": "#00798c", "unlisted": "#d1495b"}
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
    known = work / "results"
    resumed = len(list(known.glob("case-*.json"))) if known.exists() else 0
    spec = settings.spec().model_dump_json()
    took = {}
    for step, title in STEPS:
        start = time.monotonic()
        shown = progress(title, settings.cases, console.quiet)
        _step(step, work, jobs or os.cpu_count() or 1, spec if step == "make" else "", shown)
        took[step] = time.monotonic() - start
    rows = pd.DataFrame(json.loads((work / "scores.json").read_text())["rows"])
    table = _kept(folder, work, rows)
    made = report(settings, rows, took)
    if not settings.keep_recordings:
        shutil.rmtree(work)
    write(made, f"Study blind: {SUMMARY}", folder)
    show(made, console)
    wall_s = time.monotonic() - begun
    write_json(folder / "manifest.json", _manifest(settings, folder, wall_s))
    failures = {int(row["case"]): str(row["error"]) for _, row in rows[rows["error"] != ""].iterrows()}
    cpu_s = float(rows.get("runtime_s", pd.Series(dtype=float)).sum())
    return engine.Outcome(folder, table, len(rows), resumed, failures, {}, wall_s, cpu_s)


def _step(step: str, work: Path, jobs: int, given: str, shown: AbstractContextManager[Any]) -> None:
    """One step in a process of its own, which gets the folder and, the first one, the settings."""
    command = [sys.executable, "-m", "studies.validation.blind_check", step, str(work), str(jobs)]
    pipe = subprocess.PIPE
    # A pipe for the errors would fill up with its workers' warnings, and the step would wait for a reader.
    with (
        shown as advance,
        tempfile.TemporaryFile("w+", encoding="utf-8") as errors,
        subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=errors, text=True, encoding="utf-8") as process,
    ):
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(given)
            process.stdin.close()
            done = 0
            for line in process.stdout:
                if line.strip().isdecimal():
                    advance(int(line) - done)
                    done = int(line)
            status = process.wait()
        except KeyboardInterrupt:
            process.terminate()
            raise engine.Interrupted(f"stopped in step '{step}'; the same command goes on in {work.parent}") from None
        errors.seek(0)
        said = errors.read().strip()
    if status:
        raise InputError(f"blind check, step '{step}': {said.splitlines()[-1] if said else f'status {status}'}")


def _kept(folder: Path, work: Path, rows: pd.DataFrame) -> Path:
    """Keep seals, opened answers and rows; returns the rows' file."""
    shutil.copyfile(work / "seals.json", folder / "seals.json")
    open_answers(work)  # once more: what is kept must be what was sealed
    sealed = json.loads((work / "sealed" / "answers.json").read_text())
    opened = {key: {"salt": one["salt"], "answer": one["answer"]} for key, one in sealed.items()}
    (folder / "answers.json").write_text(json.dumps(opened, separators=(",", ":")) + "\n", encoding="utf-8")
    table = folder / "table.parquet"
    rows.drop(columns=[name for name in LISTS if name in rows]).to_parquet(table, index=False)
    return table


def _manifest(settings: BlindConfig, folder: Path, wall_s: float) -> dict[str, Any]:
    about = settings.model_dump(mode="json") | {"cases": settings.cases}
    if not isinstance(settings.scenario, str):
        about["scenario"] = settings.scenario.title
    made = manifest("gyrocal study blind", about, folder, wall_s)
    # As the engine's, so that --rerun knows the study in the folder.
    return made | {"config_sha256": config_sha256(STUDY, resolved(settings)), "chunk": settings.cases, "runs": []}


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
    figures = {"reliability": partial(reliability_figure, made)}
    if len(made.by_snr):
        figures["detection"] = partial(detection_figure, made)
    return Report(tables, figures, findings=tuple(_findings(made, rows)))


def run_time(rows: pd.DataFrame, took: Mapping[str, float]) -> pd.DataFrame:
    """Seconds of a diagnosis, and of each step by the clock."""
    seconds = rows["runtime_s"].dropna() if "runtime_s" in rows else pd.Series(dtype=float)
    out = [{"what": f"{step}, wall", "seconds": value} for step, value in took.items()]
    if len(seconds):
        for name, value in (("median", seconds.median()), ("95 %", seconds.quantile(0.95)), ("largest", seconds.max())):
            out.append({"what": f"a diagnosis, {name}", "seconds": float(value)})
    return pd.DataFrame(out, columns=["what", "seconds"])


def _percent(rate: Mapping[Any, Any]) -> str:
    low, high = 100 * rate["low"], 100 * rate["high"]
    return f"{100 * rate['value']:.1f} % ({rate['hits']:.0f} of {rate['of']:.0f}, {low:.1f} to {high:.1f} %)"


def _findings(made: Scores, rows: pd.DataFrame) -> list[str]:
    out = []
    for _, row in made.criteria.iterrows():
        verdict = "met" if row["met"] == "yes" else "not met"
        out.append(f"{row['criterion']}: {_percent(row.to_dict())}; asked {row['asked']}: {verdict}.")
    failed = int((rows["error"] != "").sum())
    if failed:
        out.append(f"{failed} of {len(rows)} diagnoses failed and are not counted.")
    rates = made.table.set_index("what")
    for name in ("single, seen in the samples: cause exact or in group", "wrong, of all named"):
        if rates.loc[name, "of"]:
            out.append(f"{name}: {_percent(rates.loc[name].to_dict())}.")
    named = made.rows[(made.rows["kind"] == "one") & made.rows["exact"].astype(bool)]
    if len(named):
        ratio = (named["G_error"] / named["baseline_G_error"]).median()
        out.append(f"With a single cause named rightly, the error of G is {ratio:.2g} times that of the baseline (median).")
    return out


def detection_figure(made: Scores, path: Path) -> Path:
    """How often an effect is noticed and put right, over its signal-to-noise ratio."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 3.4), layout="constrained")
        for axes, kind, title in zip(
            drawing.subplots(1, 2, sharey=True), ("one", "unlisted"), ("single listed effects", "unlisted effects"), strict=True
        ):
            part = made.by_snr[made.by_snr["kind"] == kind]
            for style, (what, rates) in zip(("o-", "s--"), part.groupby("what", sort=False), strict=False):
                _with_bars(axes, rates["snr"], rates, style, COLOURS[kind], str(what))
            axes.axvline(DETECTABLE if kind == "one" else CLEAR, color="0.6", linewidth=0.8, linestyle=":")
            axes.set_xscale("log")
            axes.set_xticks([4, 8, 12, 20, 40], ["4", "8", "12", "20", "40"])
            axes.minorticks_off()
            axes.set_xlabel("evidence signal-to-noise ratio")
            axes.set_title(title, loc="left", fontsize=9)
            axes.set_ylim(-0.03, 1.03)
            if len(part):
                axes.legend(loc="lower right", fontsize=8)
        drawing.axes[0].set_ylabel("share of the cases, 95 % interval")
        return save(drawing, path)


def reliability_figure(made: Scores, path: Path) -> Path:
    """Stated probability of a cause against how often it was there."""
    with mpl.rc_context(STYLE):
        drawing = Figure(figsize=(4.2, 3.8), layout="constrained")
        axes = drawing.add_subplot()
        axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
        table = made.reliability
        if len(table):
            _with_bars(axes, table["stated"], table.rename(columns={"frequency": "value"}), "o", COLOURS["one"], "causes")
            for _, row in table.iterrows():
                axes.annotate(
                    f"{row['of']:.0f}", (row["stated"], row["frequency"]), (4, -10), textcoords="offset points", fontsize=7
                )
        axes.set_xlabel("stated probability, mean of a bin")
        axes.set_ylabel("share that was there, 95 % interval")
        axes.set_xlim(-0.02, 1.02)
        axes.set_ylim(-0.02, 1.02)
        return save(drawing, path)


def _with_bars(axes: Axes, x: pd.Series, rates: pd.DataFrame, style: str, colour: str, name: str) -> None:
    value = rates["value"].to_numpy(float)
    bars = np.abs(np.vstack([value - rates["low"].to_numpy(float), rates["high"].to_numpy(float) - value]))
    axes.errorbar(x.to_numpy(float), value, bars, fmt=style, color=colour, markersize=4, linewidth=1.2, capsize=2, label=name)


SUMMARY = "is the diagnosis right about recordings whose answers are sealed"
ENTRY = Entry(STUDY, SUMMARY, report)
