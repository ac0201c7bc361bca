"""The study's case: everything that is said of one sensor unit."""

from __future__ import annotations

import numpy as np

from diagnosis.diagnose import diagnose
from studies.montecarlo.study import Streams, Study
from studies.validation.real_gyro.fitting import Fitted
from studies.validation.real_gyro.floor import floor_rows
from studies.validation.real_gyro.held_rows import fold_rows, increment_rows
from studies.validation.real_gyro.ladder import delayed
from studies.validation.real_gyro.left_out import Fold, folds, found_by
from studies.validation.real_gyro.own_rows import diagnosis_rows, file_row, own_rows, repeat_rows, tone_rows, zero_rows
from studies.validation.real_gyro.trials import RealConfig, Row, load


def case(config: RealConfig, number: int, streams: Streams) -> list[Row]:
    """All that is said of one unit, a row a number; the column `kind` says of what kind."""
    unit = config.points()[number]
    trials = [load(config, name) for name in config.units[unit]]
    diagnoses = {one.number: diagnose(one.recording, seed=config.entropy) for one in trials}
    rows: list[Row] = []
    for one in trials:
        rows.append(file_row(config, one))
        rows += diagnosis_rows(one, diagnoses[one.number], 1)
        found = found_by([diagnoses[one.number]])
        rows += [*zero_rows(one, found), *repeat_rows(one), *tone_rows(one, diagnoses[one.number])]
        rows += own_rows(one, found)
    parted = folds(trials, diagnoses)
    last: dict[str, list[tuple[Fold, Fitted]]] = {}
    for fold in parted:
        rows += fold_rows(fold, last)
    for name, done in last.items():
        one = next(trial for trial in trials if trial.number == name)
        offset = float(np.mean([fitted.offset for _, fitted in done]))
        again = delayed(one.recording, offset, lag=False)
        rows += diagnosis_rows(one, diagnose(again, seed=config.entropy), 2)
        for fold, fitted in done:
            rows += increment_rows(fold, fitted)
    rows += floor_rows(config, trials, parted, last)
    return [{"unit": unit, **row} for row in rows]


STUDY = Study("studies.validation.real_gyro:STUDY", RealConfig, case)
