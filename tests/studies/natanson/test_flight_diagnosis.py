"""The flight's table is diagnosed: right names for what is done to it, silence where nothing is, and honest evidence."""

import json

import numpy as np
import pytest
from scipy.special import logsumexp

from gyrocal import GyroParameters, InputError, calibrate, residual_table
from simulator.simulate import motion, observe
from simulator.streams import generator
from studies.montecarlo import engine
from studies.montecarlo.study import load_config
from studies.natanson import flight, flight_gap
from studies.natanson import flight_diagnosis as fd
from studies.natanson.flight_diagnosis import baselines, draws, families, numbers, simulated_tables, table, timings

PRESENT = fd.present()
TRIALS = {trial.baseline.name: trial for trial in fd.trials()}


def table_of(kind, seed):
    return fd.simulated(kind, PRESENT, generator(7, seed, "table"))


def end_to_end(seed):
    """A table by the simulator and the calibrator themselves, nothing linear about it."""
    scenario = fd.trmm()
    truth, initial = flight.calibration(), flight.parameters("prelaunch")
    streams = {f"{name}_rng": generator(11, seed, name) for name in ("gyro", "reference")}
    recording = observe(scenario, motion(scenario), G=truth.G, bias=truth.bias, **streams)
    result = calibrate(recording, initial=initial, iterations=1, covariance_model="references only")

    def cells(parameters):
        return residual_table(recording, parameters)[[f"before_{name}_deg" for name in flight.ROTATIONS]].to_numpy()

    published = table.rounded(GyroParameters(result.G, result.bias).vector, table.PUBLISHED_DIGITS)
    before, after = cells(initial), cells(result.parameters)
    # Of no concern here: columns at the coarser steps, with the noise they should have.
    gyro = PRESENT.variances()[1][:, None] * np.array([1.0, 2.0])[:, None, None]
    coarser = before + np.cumsum(generator(11, seed, "steps").normal(size=(2, 6, 3)) * np.sqrt(gyro), axis=0)
    return fd.Table(*(table.rounded(values, table.CELL_DEG) for values in (before, after, coarser)), published)


def test_difference_of_the_residuals_is_free_of_noise():
    """y − c = Θ(x₀ − x̂) to what print leaves, for tables made without that assumption; y alone misses by the noise."""
    gaps = [fd.gap_test(end_to_end(seed), PRESENT) for seed in range(4)]
    motion_chi2 = sum(gap["motion_chi2"] for gap in gaps)
    assert motion_chi2 < 110  # of 72 degrees of freedom at most: Table 3 and the times are exact here
    noise_chi2 = sum(gap["noise_chi2"] for gap in gaps)
    assert abs(noise_chi2 - 168) < 4 * np.sqrt(2 * 168)
    spread = np.concatenate([(t.before.ravel() - fd.prepare(t, PRESENT).prediction) for t in (end_to_end(0), end_to_end(1))])
    assert flight.rms(spread) > 0.004  # the noise d is free of


def test_predictions_are_those_of_the_flight_gap():
    prediction = fd.prepare(fd.flown(), PRESENT).prediction.reshape(6, 3)
    np.testing.assert_allclose(prediction, flight_gap.predict(PRESENT.scenario), atol=3e-4)
    other = fd.prepare(fd.flown(), PRESENT, flips=(1, 3)).prediction.reshape(6, 3)
    reversed_ = flight_gap.with_minus_y_rate(flight_gap.with_yaw_directions(PRESENT.scenario, -1, -1), 1)
    np.testing.assert_allclose(other, flight_gap.predict(reversed_), atol=3e-4)


@pytest.mark.parametrize(("k", "sign"), [(1, 1), (5, -1), (3, -1), (4, 1)])
def test_interpolation_is_the_simulator(k, sign):
    u = np.random.default_rng(k).random((25, len(timings.NODES[k])))
    theta, Theta = table.outcomes([timings.TIMINGS[k].section(row, sign) for row in timings.TIMINGS[k].values(u)])
    found = timings.surrogate(k, sign)(u)
    assert np.ptp(theta, axis=0).max() > 0.03  # timings matter
    np.testing.assert_allclose(found[:, :3], theta, atol=3e-4)
    np.testing.assert_allclose(found[:, 3:], Theta.reshape(-1, 36), atol=0.01 * np.abs(Theta).max())


def test_common_timings_are_those_of_the_scenario():
    timing = flight_gap.timing_of(PRESENT.scenario)
    bounds = timings.COMMON
    u = np.array([[timing.delay_s / 300, np.log(0.25 / 0.15) / np.log(4), (0.1 - 0.02) / 0.48, 0.6]])
    assert bounds["stay_s"] == (3000.0, 4000.0)
    good, points = timings.common_points(u)
    assert good.all()
    for k, point in points.items():
        section = timings.TIMINGS[k].section(timings.TIMINGS[k].values(point)[0], table.sign_of(PRESENT.scenario.interval[k]))
        for made, wanted in zip(section.slew, PRESENT.scenario.interval[k].slew, strict=True):
            assert made.start_s == pytest.approx(wanted.start_s, abs=1e-6)
            assert made.duration_s == pytest.approx(wanted.duration_s)
            assert made.angle_deg == wanted.angle_deg


def test_evidence_is_the_integral_over_the_prior():
    """Against the plain mean over every point of the prior, all eighteen numbers correlated."""
    case = fd.prepare(table_of("nothing", 1), PRESENT)
    drawn = draws.own_draws(case, 1)
    sampled = families.evidence(case, draws.residuals_of(case, drawn), drawn.log_weight)
    _, values = timings.cloud(1, 1)
    d = np.tile(case.d, (len(values), 1))
    d[:, 3:6] = case.target[3:6] - timings.shifted(values, case.shift)
    direct = logsumexp(numbers.log_normal(d, case.covariance)) - np.log(len(d))
    assert sampled == pytest.approx(direct, abs=0.15)
    # A timing that changes nothing costs evidence: the assumed ones are right here.
    assert sampled < families.evidence(case, case.d[None]) - 1


def test_evidence_of_two_intervals_is_the_double_integral():
    case = fd.prepare(table_of("nothing", 2), PRESENT)
    both = draws.joined([draws.own_draws(case, 1), draws.own_draws(case, 5)])
    sampled = families.evidence(case, draws.residuals_of(case, both), both.log_weight)
    # Directly: points of either cloud that matter at all, every pair of them.
    keep = {}
    for k, sign in ((1, 1), (5, -1)):
        predictions = timings.shifted(timings.cloud(k, sign)[1], case.shift)
        rows = slice(3 * k, 3 * k + 3)
        near = numbers.log_normal(case.target[rows] - predictions, 2 * case.covariance[rows, rows])
        keep[k] = predictions[near > near.max() - 12]
    first, second = (np.arange(len(keep[k])) for k in (1, 5))
    pairs = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
    d = np.tile(case.d, (len(pairs), 1))
    d[:, 3:6] = case.target[3:6] - keep[1][pairs[:, 0]]
    d[:, 15:18] = case.target[15:18] - keep[5][pairs[:, 1]]
    direct = logsumexp(numbers.log_normal(d, case.covariance)) - np.log(timings.CLOUD[1] * timings.CLOUD[5])
    assert sampled == pytest.approx(direct, abs=0.3)


def test_nothing_is_found_where_nothing_is():
    gaps = [fd.gap_test(table_of("nothing", seed), PRESENT) for seed in range(100)]
    # One false alarm expected; seven or more would come once in 10 000 times.
    assert sum(gap["p_value"] <= fd.FALSE_ALARM for gap in gaps) < 7
    assert np.mean([gap["noise_chi2"] for gap in gaps]) == pytest.approx(42, abs=4 * np.sqrt(84 / 100))
    # Print is covered, and not by far too much: one second-iteration correction is allowed for, and not simulated.
    assert 15 < np.mean([gap["motion_chi2"] for gap in gaps]) < 19


@pytest.mark.parametrize("kind", ["yaw of 2", "rate sign", "one timing", "noise /3", "unknown", "yaw of 2, four timings"])
def test_what_is_simulated_is_named(kind):
    truth = fd.KINDS[kind]
    found = fd.diagnose(table_of(kind, 3), PRESENT)
    if truth == {fd.UNKNOWN}:
        assert found.verdict == "unknown"
        assert found.causes == ()
    else:
        assert found.verdict == "named"
        assert set(found.causes) == truth
    assert sum(found.sets.values()) == pytest.approx(1)


@pytest.mark.parametrize("name", ["rate of 4 at +1 RPO", "slews centred and smooth", "noise three times"])
def test_what_was_done_to_the_baseline_is_named(name):
    trial = TRIALS[name]
    found = fd.diagnose(fd.flown(), trial.baseline)
    assert set(found.causes) == trial.done
    assert found.best.flips == trial.flips


def test_the_present_baseline_is_not_blamed():
    found = fd.examine(fd.flown(), TRIALS[PRESENT.name])
    assert found.judgement.causes == ()
    assert found.judgement.verdict == "unknown"
    # What is seen is not the noise, and it is not everywhere: the intervals without slews but one are as predicted.
    assert found.gap["noise_p"] > 0.05
    assert found.noise[0] == pytest.approx(1, abs=4 * found.noise[1])
    calm = found.where[found.where["interval"].isin([1, 5])]
    assert (calm["p_holm"] > 0.01).all()
    assert found.closure.rms_deg["floor"] == pytest.approx(flight_gap.floor_rms())
    assert found.closure.rms_deg["floor"] < found.closure.rms_deg["after"] <= found.closure.rms_deg["before"] < 0.02


def test_a_reversed_yaw_is_closed_to_the_present_gap():
    found = fd.examine(fd.flown(), TRIALS["yaw of 2 reversed"])
    present = fd.prepare(fd.flown(), PRESENT)
    rms = flight.rms(fd.flown().before.ravel() - present.prediction)
    assert found.closure.rms_deg["before"] > 4 * rms
    assert found.closure.rms_deg["after"] == pytest.approx(rms)
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    assert document["verdict"] == "named"
    assert document["causes"][0]["parameters"]["intervals"] == [2]
    assert {place["interval"] for place in document["where"][:2]} == {"m2"}


def test_the_sign_that_table_4_doubts_is_a_slip():
    """N Table 2, calibrated, 2 s, interval 3, yaw: −0.042 printed, +0.042 by its table of means."""
    rows = fd.by_step().set_index(["step_s", "interval", "axis"])
    printed = rows.loc[(2.0, 3, "yaw")]
    assert abs(printed["gap_deg"]) > 20 * printed["sigma_deg"]
    other = printed["gap_deg"] + 2 * printed["after_deg"]
    assert other == pytest.approx(rows.loc[(0.5, 3, "yaw"), "gap_deg"], abs=3 * printed["sigma_deg"])


def test_holm():
    # Sorted 0.01, 0.03, 0.04: 3·0.01, 2·0.03, and no smaller than the one before.
    np.testing.assert_allclose(fd.holm(np.array([0.04, 0.01, 0.03])), [0.06, 0.03, 0.06])


def test_judgement_needs_a_sure_cause():
    def weighed(*probabilities):
        families = [frozenset({fd.YAW}), frozenset({fd.TIMING}), frozenset({fd.YAW, fd.UNKNOWN})]
        return [fd.Hypothesis(f, "", np.log(p)) for f, p in zip(families, probabilities, strict=True)]

    assert fd.judge(weighed(0.90, 0.02, 0.08), 1e-6).causes == (fd.YAW,)
    split = fd.judge(weighed(0.60, 0.35, 0.05), 1e-6)
    assert split.verdict == "group"
    assert split.group == (frozenset({fd.YAW}), frozenset({fd.TIMING}))
    assert fd.judge(weighed(0.98, 0.01, 0.01), 0.5).verdict == "none"


def test_study_runs_by_itself_and_reports(tmp_path, monkeypatch):
    monkeypatch.setattr(baselines, "trials", lambda: [TRIALS[PRESENT.name], TRIALS["rate of 4 at +1 RPO"]])
    monkeypatch.setattr(simulated_tables, "KINDS", {kind: fd.KINDS[kind] for kind in ("nothing", "rate sign", "noise x3")})
    fd.flight_diagnoses.cache_clear()
    config = load_config(fd.STUDY, changes={"nothing": 3, "each": 1})
    results = fd.run(tmp_path, config)
    fd.flight_diagnoses.cache_clear()
    assert json.loads((tmp_path / "diagnosis.json").read_text()) == json.loads(json.dumps(results))
    assert results["rate of 4 at +1 RPO"]["causes"][0]["effect"] == fd.RATE
    assert {path.name for path in tmp_path.glob("*.svg")} >= {"flight_table.svg", "flight_evidence.svg"}
    assert "wrong name" in (tmp_path / "report.md").read_text()
    again = engine.rerun(fd.STUDY, config, 4, tmp_path)
    assert again.rows["kind"].iloc[0] == config.points()[4]
    assert again.same


def test_settings_that_make_no_tables_are_refused():
    with pytest.raises(InputError, match="the grid has 255 points, one a case; change them by nothing and each"):
        load_config(fd.STUDY, changes={"cases": 3})
    with pytest.raises(InputError, match="belongs to the scenario"):
        load_config(fd.STUDY, changes={"scenario": "trmm_series"})
