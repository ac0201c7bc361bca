"""The cheapest calibration that is one: a case draws noise, calibrates TRMM's six intervals once, and its row is one line."""

from gyrocal.calibration.increment_packing import compute_packed_shape
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from studies.calibration.shared_truth import NoiseFreeSimulation, build_once, make_noise_generators
from studies.montecarlo import statistics
from studies.montecarlo.study import Streams, Study, StudyConfig
from studies.montecarlo.workspace import get_workspace

SAMPLE_S = 5.0  # so that a case takes a third of a millisecond


class SoakConfig(StudyConfig):
    """What the study runs."""

    overrides: dict[str, bool | int | float | str] = {"gyro.sample_s": SAMPLE_S}  # noqa: RUF012  # pydantic copies it


@build_once
def _prepared(config: SoakConfig, flown: NoiseFreeSimulation) -> tuple[NoiseFreeSimulation, Problem]:
    return flown, Problem.build(flown.plain, prepare_measurements(flown.plain))


def case(config: SoakConfig, number: int, streams: Streams) -> dict[str, object]:
    """Errors of one element of G and of one bias, χ² and NEES of a calibration."""
    flown, problem = _prepared(config, number)
    rates, A = flown.realise(make_noise_generators(streams), out=get_workspace("rates", flown.rates.shape))
    own = problem.replace_case(rates, A, get_workspace("packed", compute_packed_shape(problem.measurements.arcs.pieces)))
    found = own.iterate(flown.initial, 2, "full").check_convergence()
    error = found.x[2] - flown.truth
    return {
        "G_xx": float(error[0]),
        "b_x": float(error[9]),
        "chi2": found.chi2,
        "nees": float(statistics.compute_nees(error[None], found.P[None])[0]),
    }


STUDY = Study("tests.soak.study:STUDY", SoakConfig, case)
