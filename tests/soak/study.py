"""The cheapest calibration that is one: a case draws noise, calibrates TRMM's six intervals once, and its row is one line."""

from gyrocal.calibration.packing import packed_shape
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import measurements
from studies.calibration.prepared import Flown, noise_of, shared
from studies.montecarlo import statistics
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.montecarlo.workspace import workspace

SAMPLE_S = 5.0  # so that a case takes a third of a millisecond


class SoakConfig(StudyConfig):
    """What the study runs."""

    overrides: dict[str, bool | int | float | str] = {"gyro.sample_s": SAMPLE_S}  # noqa: RUF012  # pydantic copies it


@shared
def _prepared(config: SoakConfig, flown: Flown) -> tuple[Flown, Problem]:
    return flown, Problem.of(flown.plain, measurements(flown.plain))


def case(config: SoakConfig, number: int, streams: Streams) -> dict[str, object]:
    """Errors of one element of G and of one bias, χ² and NEES of a calibration."""
    flown, problem = _prepared(config, number)
    rates, A = flown.realise(noise_of(streams), out=workspace("rates", flown.rates.shape))
    own = problem.with_case(rates, A, workspace("packed", packed_shape(problem.measurements.arcs.pieces)))
    found = own.iterate(flown.initial, 2, "full").checked()
    error = found.x[2] - flown.truth
    return {
        "G_xx": float(error[0]),
        "b_x": float(error[9]),
        "chi2": found.chi2,
        "nees": float(statistics.nees(error[None], found.P[None])[0]),
    }


STUDY = Study("tests.soak.study:STUDY", SoakConfig, case)
