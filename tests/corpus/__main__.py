"""Run all bad inputs and write how they ended: outcomes.csv with a row each, outcomes.md with a row for each family."""

import json
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd
from click.testing import CliRunner

from studies.cli.main import main
from studies.montecarlo.files import write_csv, write_text
from studies.report import tables as render
from tests.corpus import headers, several, tables, words
from tests.corpus.cases import Bad
from tests.corpus.run import GOOD, run

FAMILIES = (
    headers.recordings,
    headers.scenario_files,
    tables.values,
    tables.rows,
    tables.text_files,
    tables.files,
    words.options,
    words.numbers,
    words.effects,
    words.small_files,
    words.outputs,
    words.imports,
    several.trackers,
    several.gyros,
    several.following,
    several.conditions,
    several.exports,
)


def everything() -> Iterator[Bad]:
    """All bad inputs."""
    return chain.from_iterable(family() for family in FAMILIES)


def good(work: Path, scenario: str) -> tuple[Path, "np.ndarray"]:
    """A good recording, small enough to be read a thousand times, and its truth."""
    truth, folder = work / "truth.json", work / scenario
    options = ["--set", "gyro.sample_s=5.0", "--seed", "1", "--truth", str(truth)]
    assert CliRunner().invoke(main, ["simulate", scenario, str(folder), *options]).exit_code == 0
    document = json.loads(truth.read_text())
    if "gyros" in document:
        array = document["gyros"]
        return folder, np.column_stack([array["K"], array["c_deg_s"]]).ravel()
    return folder, np.array([*np.ravel(document["G"]), *document["bias_deg_s"]])


def outcomes(inputs: list[Bad]) -> pd.DataFrame:
    """A row for each input."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        made = {scenario: good(Path(name), scenario) for scenario in dict.fromkeys(bad.scenario for bad in inputs)}
        for number, bad in enumerate(inputs):
            begun = time.monotonic()
            found = run(bad, *made[bad.scenario], Path(name))
            took = time.monotonic() - begun
            if found.word not in GOOD or "-v" in sys.argv:
                print(f"{number} {bad.family}: {bad.name}: {found.word}: {found.said[:300]}", flush=True)
            said = found.said.replace(name, "…")
            rows.append(
                {
                    "family": bad.family,
                    "input": bad.name,
                    "expected": bad.expected,
                    "outcome": found.word,
                    "said": said,
                    "s": took,
                }
            )
    return pd.DataFrame(rows)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each family: how many ended in which way."""
    counted = pd.crosstab(pd.Categorical(rows["family"], rows["family"].unique()), rows["outcome"]).rename_axis("family")
    ordered = [*GOOD, *sorted(set(counted.columns) - set(GOOD))]
    table = counted.reindex(columns=ordered, fill_value=0)
    table.insert(0, "inputs", table.sum(axis=1))
    table.index = table.index.astype(str).rename("family")
    table.loc["all"] = table.sum()
    return table.rename_axis(None, axis=1).reset_index()


if __name__ == "__main__":
    chosen = [bad for bad in everything() if not sys.argv[1:] or any(word in bad.family for word in sys.argv[1:])]
    print(len(chosen), "inputs", flush=True)
    rows = outcomes(chosen)
    table = summary(rows)
    print(table.to_string())
    if not sys.argv[1:]:
        folder = Path("build/corpus")
        write_csv(folder / "outcomes.csv", rows.drop(columns="s"))
        note = "`python -m tests.corpus`; a row for each input is in outcomes.csv."
        write_text(folder / "outcomes.md", render.format_markdown("How bad inputs end", table, note))
