"""Optimised plans: limits, slews and attitudes against algebra, sigmas against the calibrator, brute force and Monte Carlo."""

import json
from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pandas as pd
import pytest

from diagnosis.plan.objectives import SigmaObjective
from diagnosis.plan.optimise import exchange_designs, optimise_plan, refine_designs
from diagnosis.plan.slew_design import (
    QUARTER_MODES,
    IntervalDesign,
    SlewLimits,
    build_interval,
    build_slews,
    compute_shortest_slew,
    compute_slew_time,
    compute_sun_margin,
    find_end_quarter,
    read_limits,
)
from gyrocal import InputError, calibrate
from gyrocal.attitude import matrix_from_quaternion
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import SensorsSection, build_profiles, format_scenario, load, override, validate_scenario
from simulator.simulate import compute_noise_free_rates, motion, realise, simulate
from simulator.streams import generator
from simulator.truth.maneuvers import MODE_YAW
from simulator.truth.rotation import build_turn_matrix
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector
from tests import ROOT

RATE, ACCELERATION = np.deg2rad([0.5, 0.02])
LIMITS = SlewLimits(RATE, ACCELERATION, 1000.0)


@pytest.fixture(scope="module")
def small():
    """Two short intervals with a slew each, and three without one that determine the rest."""
    whole = override(load("trmm"), {"gyro.sample_s": 5.0})
    return whole.model_copy(update={"interval": whole.interval[:4]})


@pytest.fixture(scope="module")
def objective(small):
    return SigmaObjective(small, replace(LIMITS, slew_s=400.0))


@pytest.mark.parametrize("angle_deg", [0.5, 5.0, 18.74, 18.76, 90.0, 360.0])
def test_a_slew_takes_the_shortest_time_that_its_limits_allow(angle_deg):
    """Rate and acceleration by differences along the simulator's own profile; one of them is at its limit."""
    design = IntervalDesign(0, 0, (0.0, float(np.deg2rad(angle_deg)), 0.0), (0.0, 1.0))
    slews, _ = build_slews(design, 6000.0, LIMITS)
    slew = slews[0].slew()
    tau = np.linspace(slew.start, slew.stop, 20001)
    rate = slew.rates(tau)
    slope = np.abs(np.gradient(rate, tau)).max()
    assert rate.max() <= RATE * (1 + 1e-9)
    assert slope <= ACCELERATION * (1 + 1e-9)
    assert slope == pytest.approx(ACCELERATION, rel=1e-3)
    assert (rate.max() == pytest.approx(RATE)) == (angle_deg > 18.75)
    assert slew.duration == compute_shortest_slew(np.deg2rad(angle_deg), LIMITS)[0]


def test_limits_and_slew_time_of_trmm_are_those_of_its_slews():
    trmm = load("trmm")
    assert np.rad2deg(read_limits(trmm)) == pytest.approx([0.25, 1.5 * 0.25 / 40])
    assert compute_slew_time(trmm) == pytest.approx(2 * 800 + 2 * 400 + 2 * 31)


def test_the_modes_of_trmm_follow_from_its_slews():
    profiles = build_profiles(load("trmm"))
    assert [find_end_quarter(profile) for profile in profiles] == [0, 2, 2, 2, 2, 0]
    assert [QUARTER_MODES[find_end_quarter(replace(profile, slews=()))] for profile in profiles] == [
        one.mode for one in load("trmm").interval
    ]
    tilted = replace(profiles[0], slews=(replace(profiles[1].slews[0], axis=np.eye(3)[0]),))
    assert find_end_quarter(tilted) is None


@pytest.mark.parametrize(
    "design",
    [
        IntervalDesign(0, 3, (0.4, -0.3, 0.2), (0.3, 0.5)),
        IntervalDesign(2, 2, (0.0, 1.2, 0.5), (0.0, 1.0)),
        IntervalDesign(3, 1, (0.1, 0.0, -0.4), (0.5, 0.1)),
    ],
)
def test_slews_lead_from_the_first_attitude_to_the_last(small, design):
    """The simulated attitudes at both ends, relative to LVLH, which R = C A_li has from the orbit alone."""
    section = build_interval(small.interval[0], design, LIMITS)
    profile = section.build_profile(small.orbit.build_circular_orbit())
    plain = replace(profile, slews=(), yaw=0.0)
    path = motion(small.model_copy(update={"interval": (section,)}))
    ends = matrix_from_quaternion(path.quaternions[[0, -1]])
    lvlh = plain.attitude(np.array([0.0, section.stop_s - section.start_s]))
    yaws = np.array([MODE_YAW[QUARTER_MODES[k]] for k in (design.start, design.end)])
    assert np.allclose(ends @ lvlh.transpose(0, 2, 1), build_turn_matrix(np.eye(3)[2], yaws), atol=1e-9)
    assert find_end_quarter(profile) == design.end


def test_the_sun_margin_is_that_of_the_simulated_attitudes(small):
    """Attitudes at the tags of raw sensors, which go on during slews, every 2 s."""
    design = IntervalDesign(0, 0, (1.2, 0.0, 0.0), (0.0, 1.0))
    section = build_interval(small.interval[1], design, LIMITS)
    profile = section.build_profile(small.orbit.build_circular_orbit())
    path = motion(small.model_copy(update={"interval": (section,), "sensors": SensorsSection(every_s=2.0)}))
    tau = path.sensor_t_s - section.start_s
    sun = compute_sun_vector(compute_julian_date(small.epoch) + path.sensor_t_s / DAY)
    for axis in (0, 2):
        angles = np.arccos(np.sum(matrix_from_quaternion(path.sensor_quaternions)[:, axis] * sun, axis=1))
        moving = (tau >= profile.slews[0].start) & (tau <= profile.slews[-1].stop)
        margin = compute_sun_margin(profile, small.epoch, (tuple(np.eye(3)[axis]), 0.3))
        assert margin == pytest.approx(angles[moving].min() - 0.3, abs=0.5 * 10 * (RATE + 0.002))


def test_information_adds_to_the_covariance_that_the_calibrator_states(small, objective):
    """The calibrator takes samples half as long, and the plausible ranges as its prior."""
    designs = [
        IntervalDesign(0, 0),
        IntervalDesign(0, 2, (0.0, 0.0, float(np.pi))),
        IntervalDesign(2, 2),
        IntervalDesign(2, 2, (0.0, 0.0, float(-np.pi / 2)), (0.0, 0.9)),
    ]
    sections = [build_interval(one, design, LIMITS) for one, design in zip(small.interval, designs, strict=True)]
    recording = simulate(small.model_copy(update={"interval": tuple(sections)}), noise=False)
    stated = calibrate(recording, apriori_covariance=np.diag(objective.plausible**2)).sigma
    total = sum(objective.measure(k, one).information for k, one in enumerate(designs))
    found = objective.compute_sigmas(total) * objective.plausible
    assert found == pytest.approx(stated, rel=3e-3)


def test_the_search_reaches_the_best_of_all_combinations(small, objective):
    """Brute force: all pairs of slews on a grid of axes and angles in the two short intervals, with the others as they are."""
    grid = [IntervalDesign(0, 0)] + [
        IntervalDesign(0, 0, (angle * x, angle * y, angle * z), (0.0, 1.0))
        for angle in np.deg2rad([20.0, 45.0])
        for x, y, z in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1))
    ]
    still = IntervalDesign(0, 0)
    value = {}
    for a, b in product(range(len(grid)), repeat=2):
        plan = [still, grid[a], still, grid[b]]
        fits = all(objective.measure(k, one).is_allowed for k, one in enumerate(plan))
        if fits and objective.compute_slew_time(plan) <= objective.limits.slew_s:
            value[a, b] = float(objective.compute_values(plan).max())
    assert len(value) > 15
    designs = refine_designs(objective, exchange_designs(objective, [still] * 4))
    assert objective.compute_values(designs).max() <= min(value.values()) + 1e-6
    assert objective.compute_slew_time(designs) <= objective.limits.slew_s
    assert all(one.end == other.start for one, other in pairwise(designs))


def test_an_optimised_plan_is_within_its_limits_and_its_file_is_the_plan(small, tmp_path, monkeypatch):
    """The slews of the scenario refined; the sigmas are those of the file's own scenario."""
    monkeypatch.setattr("diagnosis.plan.optimise.exchange_designs", lambda objective, designs: designs)
    limits = replace(LIMITS, slew_s=1000.0)
    found = optimise_plan(small, limits)
    (tmp_path / "better.toml").write_text(format_scenario(found.scenario))
    read = load(tmp_path / "better.toml")
    assert read == found.scenario
    assert found.slew_s == pytest.approx(compute_slew_time(read))
    assert found.slew_s <= 1000.0
    rate, acceleration = read_limits(read)
    assert rate <= RATE * (1 + 1e-9)
    assert acceleration <= ACCELERATION * (1 + 1e-9)
    assert found.sigma == pytest.approx(calibrate(simulate(read, noise=False)).sigma)
    assert found.worst_ratio < 1.01  # in about half the slew time, some sigmas cannot be smaller than those of orbit rates
    ends = [find_end_quarter(profile) for profile in build_profiles(read)]
    starts = [QUARTER_MODES.index(one.mode) for one in read.interval]
    assert starts[1:] == ends[:-1]
    assert (starts[0], ends[-1]) == (0, 2)


def test_what_cannot_be_planned_is_refused_in_one_line(small):
    with pytest.raises(InputError, match="no interval has room"):
        optimise_plan(small, replace(LIMITS, slew_s=10.0))
    with pytest.raises(InputError, match="three gyros"):
        optimise_plan(load("trmm_tetrahedron"), LIMITS)
    with pytest.raises(InputError, match="no reference attitudes"):
        optimise_plan(override(small, {"reference.at": "none"}), LIMITS)


def test_the_plan_of_the_gallery_has_the_sigmas_of_trmm_in_less_than_half_the_slew_time():
    """All twelve, with the limits that docs/plan.md states; and the errors of simulated calibrations have these sigmas.

    Errors of the whitened parameters over 12 × CASES draws: their mean square has a relative standard error of √(2/(12 CASES)).
    """
    trmm, plan = (override(load(name), {"gyro.sample_s": 5.0}) for name in ("trmm", ROOT / "docs/examples/half_the_slews.toml"))
    assert compute_slew_time(plan) < 0.5 * compute_slew_time(trmm)
    rate, acceleration = np.rad2deg(read_limits(plan))
    assert rate <= 0.6 * (1 + 1e-9)
    assert acceleration <= 0.03 * (1 + 1e-9)
    stated = calibrate(simulate(plan, noise=False))
    assert (stated.sigma <= 1.01 * calibrate(simulate(trmm, noise=False)).sigma).all()
    path, cases = motion(plan), 60
    rates = compute_noise_free_rates(plan, path)
    recording = simulate(plan, noise=False)
    problem = Problem.build(recording, prepare_measurements(recording))
    start = np.append(np.ravel(plan.gyro.apriori_G), np.deg2rad(plan.gyro.apriori_bias_deg_s))
    truth = np.append(np.ravel(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s))
    errors = []
    for case in range(cases):
        streams = generator(7, case, "gyro_noise"), generator(7, case, "reference_noise")
        drawn, quaternions = realise(plan, path, rates, *streams)
        found = problem.replace_case(drawn, matrix_from_quaternion(quaternions)).iterate(start, 3, look_back=False)
        errors.append(found.x[-1] - truth)
    root = np.linalg.cholesky(stated.covariance / np.outer(stated.sigma, stated.sigma))
    white = np.linalg.solve(root, (np.array(errors) / stated.sigma).T)
    assert np.mean(white**2) == pytest.approx(1.0, abs=3.5 * np.sqrt(2 / white.size))


def test_the_committed_study_is_that_of_the_plan_on_file_and_docs_state_its_numbers():
    folder, page = ROOT / "results/optimised_plan", (ROOT / "docs/plan.md").read_text()
    config = json.loads((folder / "manifest.json").read_text())["config"]
    assert ROOT / config["scenario"] == ROOT / "docs/examples/half_the_slews.toml"
    recorded = validate_scenario(json.loads((folder / "manifest.json").read_text())["scenario"], "manifest")
    assert recorded == override(load(ROOT / config["scenario"]), config["overrides"])
    checks = pd.read_csv(folder / "checks.csv", index_col="check")
    assert (checks["verdict"] == "pass").all()
    nees = [float(checks.loc[f"mean NEES, {name} prior", "value"]) for name in ("with", "without")]
    assert f"is {nees[0]:.3f} with and {nees[1]:.3f} without the" in page.replace("\n", " ")


def test_mean_rates_over_samples_bias_the_plan_by_the_square_of_the_sample():
    """Noise-free, and converged: the errors over sigma that docs/plan.md states."""
    errors = []
    for sample_s in (2.0, 1.0, 0.5):
        scenario = override(load(ROOT / "docs/examples/half_the_slews.toml"), {"gyro.sample_s": sample_s})
        found = calibrate(simulate(scenario, noise=False))
        errors.append((found.G[0, 0] - scenario.gyro.true_G[0][0]) / found.sigma[0])
    assert errors == pytest.approx([0.034, 0.0085, 0.0021], rel=0.05)
