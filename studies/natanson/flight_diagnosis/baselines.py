"""The flight's table under the present baseline and under deliberately wrong ones."""

from dataclasses import replace
from functools import cache

from simulator.scenario import Scenario
from studies.natanson import flight
from studies.natanson.flight_diagnosis.builder import NOISE, RATE, TIMING, YAW
from studies.natanson.flight_diagnosis.diagnosis import TableDiagnosis, diagnose
from studies.natanson.flight_diagnosis.table import Baseline, load_present_baseline, read_flight_residual_table, reverse_slews
from studies.natanson.flight_diagnosis.timings import RAMPS, replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS

CENTRED_RATE_DEG_S, CENTRED_STAY_S = 0.2, 3600.0  # peak rate, and time between the slews of interval 4


@cache
def list_trial_baselines() -> tuple[Baseline, ...]:
    """The present baseline first, then the deliberately wrong ones."""
    right = load_present_baseline()

    def wrong(name: str, effect: str, *flips: int) -> Baseline:
        sections = tuple(reverse_slews(s) if k in flips else s for k, s in enumerate(right.scenario.interval))
        return Baseline(name, right.scenario.model_copy(update={"interval": sections}), done=frozenset({effect}))

    return (
        right,
        wrong("yaw of 2 reversed", YAW, 1),
        wrong("yaw of 6 reversed", YAW, 5),
        wrong("both yaws reversed", YAW, 1, 5),
        wrong("rate of 4 at +1 RPO", RATE, MINUS_Y),
        Baseline("slews centred and smooth", centre_slews(right.scenario), done=frozenset({TIMING})),
        replace(right, name="noise three times", noise_factor=3.0, done=frozenset({NOISE})),
        replace(right, name="noise a third", noise_factor=1 / 3, done=frozenset({NOISE})),
    )


def centre_slews(scenario: Scenario) -> Scenario:
    """Slews in the middle of their intervals and nothing but ramps, as slow as the rate of the assumed ones peaks."""
    sections = list(scenario.interval)
    for k in (*YAW_INTERVALS, MINUS_Y):
        section, stay = sections[k], CENTRED_STAY_S if k == MINUS_Y else 0.0
        length = section.stop_s - section.start_s
        duration = min(abs(section.slew[0].angle_deg) / CENTRED_RATE_DEG_S, 0.95 * length)
        sections[k] = replace_slew_timings(section, 0.5 * (length - duration - stay), duration, RAMPS[1], stay)
    return scenario.model_copy(update={"interval": tuple(sections)})


@cache
def diagnose_under_baseline(trial: Baseline) -> TableDiagnosis:
    """Diagnose the flight's table under one baseline."""
    return diagnose(read_flight_residual_table(), trial)


def compute_misfit_rms(found: TableDiagnosis) -> dict[str, float]:
    """RMS of flown minus predicted, before and after the explanation, and of the flight's residuals after calibration."""
    left = read_flight_residual_table().after.ravel()
    values = {"before": found.before + left, "after": found.after + left, "floor": left}
    return {name: float(flight.compute_rms(value)) for name, value in values.items()}
