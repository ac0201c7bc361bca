"""The study's only case."""

from __future__ import annotations

from typing import Any

from studies.montecarlo.study import Row, Streams, Study, StudyConfig
from studies.validation.sentinel2a.findings import check_rows, drift_rows, left_rows, noise_rows, parameter_rows
from studies.validation.sentinel2a.flown import flown
from studies.validation.sentinel2a.forecast import forecast_rows


class SentinelConfig(StudyConfig):
    """There is one flight, and so one case."""

    cases: int = 1


def case(config: SentinelConfig, number: int, streams: Streams) -> list[Row]:
    """All that is said of the flight, a row a number; the column `kind` says of what kind."""
    data = flown()
    rows: list[dict[str, Any]] = [{"kind": "assumed", "what": text} for text in data.assumed]
    for made in (drift_rows, noise_rows, parameter_rows, left_rows, check_rows, forecast_rows):
        rows += made(data)
    return list(rows)


STUDY = Study("studies.validation.sentinel2a.study:STUDY", SentinelConfig, case)
