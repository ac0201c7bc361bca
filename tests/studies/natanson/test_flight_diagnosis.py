"""The flight's table is diagnosed: right names for what is done to it, silence where nothing is, and consistent evidence."""

import numpy as np
import pytest

from gyrocal import GyroParameters, calibrate, residual_table
from simulator.simulate import motion, observe
from simulator.streams import generator
from studies.montecarlo import engine
from studies.montecarlo.study import load_config
from studies.natanson import flight, flight_gap
from studies.natanson.flight_diagnosis import report, table
from studies.natanson.flight_diagnosis.diagnosis import FALSE_ALARM, RATE, diagnose
from studies.report import entry

PRESENT = table.load_present_baseline()
TRIALS = {trial.name: trial for trial in report.list_trial_baselines()}


def table_of(kind, seed):
    return report.simulate_table(kind, PRESENT, generator(7, seed, "table"))


def end_to_end(seed):
    """A table by the simulator and the calibrator themselves, nothing linear about it."""
    scenario = table.load_coarse_trmm()
    truth, initial = flight.read_published_calibration(), flight.read_published_parameters("prelaunch")
    streams = {f"{name}_rng": generator(11, seed, name) for name in ("gyro", "reference")}
    recording = observe(scenario, motion(scenario), G=truth.G, bias=truth.bias, **streams)
    result = calibrate(recording, initial=initial, iterations=1, covariance_model="references only")

    def cells(parameters):
        return residual_table(recording, parameters)[[f"before_{name}_deg" for name in flight.ROTATIONS]].to_numpy()

    published = table.round_to_digits(GyroParameters(result.G, result.bias).vector, table.PUBLISHED_DIGITS)
    before, after = cells(initial), cells(result.parameters)
    # Of no concern here: columns at the coarser steps, with the noise they should have.
    gyro = PRESENT.compute_variances()[1][:, None] * np.array([1.0, 2.0])[:, None, None]
    coarser = before + np.cumsum(generator(11, seed, "steps").normal(size=(2, 6, 3)) * np.sqrt(gyro), axis=0)
    return table.ResidualTable(
        *(table.round_to_digits(values, table.CELL_DEG) for values in (before, after, coarser)), published
    )


def test_the_difference_of_residuals_is_free_of_noise_and_nothing_is_found_where_nothing_is():
    """y − c = Θ(x₀ − x̂) to what print leaves, for tables made without that assumption; y alone misses by the noise."""
    tables = [end_to_end(seed) for seed in range(4)]
    gaps = [table.compute_misfit_p(one, PRESENT) for one in tables]
    motion_chi2 = sum(gap["motion_chi2"] for gap in gaps)
    assert motion_chi2 < 110  # of 72 degrees of freedom at most: Table 3 and the times are exact here
    noise_chi2 = sum(gap["noise_chi2"] for gap in gaps)
    assert abs(noise_chi2 - 168) < 4 * np.sqrt(2 * 168)
    spread = np.concatenate(
        [(one.before - table.compute_motion_numbers(one, PRESENT).prediction).ravel() for one in tables[:2]]
    )
    assert flight.compute_rms(spread) > 0.004  # the noise d is free of
    gaps = [table.compute_misfit_p(table_of("nothing", seed), PRESENT) for seed in range(100)]
    # One false alarm expected; seven or more would come once in 10 000 times.
    assert sum(gap["p_value"] <= FALSE_ALARM for gap in gaps) < 7
    assert np.mean([gap["noise_chi2"] for gap in gaps]) == pytest.approx(42, abs=4 * np.sqrt(84 / 100))
    # Print is covered, and not by far too much: one second-iteration correction is allowed for, and not simulated.
    assert 15 < np.mean([gap["motion_chi2"] for gap in gaps]) < 19


@pytest.mark.parametrize(
    ("kind", "verdict"),
    [
        (report.UNKNOWN, "unknown"),
        *(pytest.param(kind, "named", marks=pytest.mark.long) for kind in ("yaw of 2", "timings")),
    ],
)
def test_what_is_simulated_is_named(kind, verdict):
    found = diagnose(table_of(kind, 3), PRESENT)
    assert found.verdict == verdict
    assert found.causes == tuple(filter(None, [report.CAUSE_BY_KIND[kind]]))


def test_the_present_baseline_is_not_blamed():
    found = report.diagnose_under_baseline(TRIALS[PRESENT.name])
    assert found.causes == ()
    assert found.verdict == "unknown"
    # What is seen is not the noise, and it is not everywhere: the intervals without slews but one are as predicted.
    assert found.gap["noise_p"] > 0.05
    assert found.noise[0] == pytest.approx(1, abs=4 * found.noise[1])
    places = table.locate_misfit(table.read_flight_residual_table(), PRESENT)
    assert (places[places["interval"].isin([1, 5])]["p_holm"] > 0.01).all()
    rms = report.compute_misfit_rms(found)
    assert rms["floor"] == pytest.approx(flight_gap.compute_floor_rms())
    assert rms["floor"] < rms["after"] <= rms["before"] < 0.02


def test_study_runs_by_itself_and_reports(tmp_path, monkeypatch):
    chosen = (TRIALS[PRESENT.name], TRIALS["rate of 4 at +1 RPO"])
    monkeypatch.setattr(report, "list_trial_baselines", lambda: chosen)
    kinds = {kind: report.CAUSE_BY_KIND[kind] for kind in ("nothing", "rate sign", "noise x3")}
    monkeypatch.setattr(report, "CAUSE_BY_KIND", kinds)
    study = report.ENTRY.study
    config = load_config(study, changes={"nothing": 3, "each": 1})
    rows = engine.run(study, config, tmp_path, backend="serial", jobs=1).load()
    made = report.ENTRY.report(config, rows)
    assert all(check.verdict != "fail" for check in made.checks)
    assert made.check("causes with rate of 4 at +1 RPO").value == RATE
    assert made.check("rightly named").value == 2
    entry.write(made, "flight", tmp_path)
    assert "with a wrong name" in (tmp_path / "report.md").read_text()
