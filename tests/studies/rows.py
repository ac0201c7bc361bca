"""Rows of a small study, for the tests of its report."""

from pathlib import Path

import pandas as pd

from studies.montecarlo.engine import run
from studies.montecarlo.study import Study, StudyConfig


def run_study(study: Study, config: StudyConfig, folder: Path) -> pd.DataFrame:
    """Run a study in this process; no case may fail."""
    table = run(study, config, folder, backend="serial").load()
    assert (table["error"] == "").all()
    return table
