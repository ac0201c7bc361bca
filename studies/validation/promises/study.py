"""Does every covariance and interval that the library states hold, over four plans and four grades of noise?

Each case flies one plan with one grade (`studies.validation.promises.plans`) through calibrator, trackers, four gyros, batch,
filter, smoother, alignment, prediction and the next recording (`studies.validation.promises.cases`); every so many cases a
diagnosis is made as well (`studies.validation.promises.diagnosing`), which takes as long as twenty of the others.
"""

from pydantic import Field, model_validator

from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.validation.promises import cases, diagnosing
from studies.validation.promises.cases import Row


class PromisesConfig(StudyConfig):
    """What the study runs; its plans and grades are its own.

    Attributes
    ----------
    diagnosed_every : a diagnosis in each case that this divides
    """

    cases: int = 1600
    diagnosed_every: int = Field(default=32, ge=1)

    @model_validator(mode="after")
    def _of_its_own(self) -> "PromisesConfig":
        if self.overrides or self.dispersions:
            raise ValueError("plans and grades are the study's own; overrides and dispersions have no effect")
        return self


def case(config: PromisesConfig, number: int, streams: Streams) -> list[Row]:
    """A row for each promise."""
    rows = cases.rows(number, streams)
    turn, rest = divmod(number, config.diagnosed_every)
    return rows if rest else [*rows, *diagnosing.rows(config.entropy, turn)]


STUDY = Study("studies.validation.promises.study:STUDY", PromisesConfig, case)
