"""Does every covariance and interval that the library states hold, over four plans and four grades of noise?

Each case flies one plan with one grade (`studies.validation.promises.plans`) through calibrator, trackers, four gyros, batch,
filter, smoother, alignment, prediction and the next recording (`studies.validation.promises.cases`). What a diagnosis states is
checked in the test world (`studies.validation.world`).
"""

from pydantic import model_validator

from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.validation.promises import cases
from studies.validation.promises.cases import Row


class PromisesConfig(StudyConfig):
    """What the study runs; its plans and grades are its own."""

    cases: int = 1600

    @model_validator(mode="after")
    def _of_its_own(self) -> "PromisesConfig":
        if self.overrides or self.dispersions:
            raise ValueError("plans and grades are the study's own; overrides and dispersions have no effect")
        return self


def case(config: PromisesConfig, number: int, streams: Streams) -> list[Row]:
    """A row for each promise."""
    return cases.rows(number, streams)


STUDY = Study("studies.validation.promises.study:STUDY", PromisesConfig, case)
