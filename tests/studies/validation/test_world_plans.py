import numpy as np
import pytest
import scipy.stats

from gyrocal import calibrate
from gyrocal.recording import load, save
from simulator.truth.integration import integrate
from simulator.truth.rotation import build_turn_matrix, convert_to_matrix, convert_to_quaternion, separation
from studies.validation.world.cases import DESCRIBED
from studies.validation.world.evidence import Change, Evidence, compute_noise_evidence, compute_process_evidence
from studies.validation.world.paths import build_tumbling_rate
from studies.validation.world.plans import MOST_REFERENCES, MOST_SAMPLES, draw_generic_plan
from studies.validation.world.standard import FLIGHT, GRADES, KINDS
from studies.validation.world.trmm import draw_trmm_plan
from studies.validation.world.world import Spec, World
from tests.studies.validation.world_plans import SMALL, small_plan, small_world


def test_a_tumble_is_integrated_to_its_closed_form():
    axis, spin, w = np.array([0.6, 0.0, 0.8]), 0.35, np.array([0.1, -0.2, 0.05])
    t = np.linspace(0, 200, 2001)
    begin = np.array([0.5, 0.5, -0.5, 0.5])
    path = integrate(build_tumbling_rate(axis, spin, w), t, begin)
    size = float(np.linalg.norm(w))
    closed = build_turn_matrix(axis, spin * t) @ build_turn_matrix(w / size, size * t) @ convert_to_matrix(begin)
    assert np.abs(separation(path.quaternions, convert_to_quaternion(closed))).max() < 1e-10


# The plans of the kinds without a law of motion of their own, as they were before there were such laws: number of samples and
# of references, an element of G, and one of the last reference.
BEFORE = {
    "slews_and_rests": (87048, 904, 2.6548951812941276e-05, 0.642121732662482),
    "hand_motion": (45541, 3255, 7.860400959651887e-05, -0.5382954357700546),
    "earth_with_offsets": (76538, 465, 0.0002340382239360577, -0.3030620233392337),
    "bench": (38115, 2011, 2.6548951812941276e-05, 0.7403739007844486),
    "scan": (79375, 294, 2.501914238230981e-05, -0.7157188813192757),
    "tumble": (63163, 513, 0.00011340325104013392, 0.4694992381957016),
    "swaying_craft": (178629, 1642, -8.881938317109206e-05, -0.5278137433613729),
    "slow_drift": (175948, 231, -5.346964727362924e-07, 0.0855270516730535),
    "agile": (41848, 199, 6.538568636102734e-05, 0.6455063567193253),
    "earth_agile": (81248, 845, 0.00019321709216695235, 0.8467691758576346),
}


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.draw is None])
def test_every_kind_of_plan_is_within_its_bounds_and_a_recording(name, tmp_path):
    kind = KINDS[name]
    plan = draw_generic_plan(np.random.default_rng(3), kind, GRADES["ring_laser"], "a plan")
    plain = plan.plain
    assert len(plain.gyro.t_s) <= 1.1 * MOST_SAMPLES
    assert len(plain.attitudes.t_s) <= MOST_REFERENCES + 2 * len(plain.intervals)
    assert any(1 / plain.gyro.sample_s == pytest.approx(hz) for hz in kind.hz)
    assert (plain.orbit is not None) == kind.orbit
    if kind.motion is None:
        counts = len(plain.gyro.t_s), len(plain.attitudes.t_s)
        assert (*counts, plan.G[0, 1], plain.attitudes.quaternions[-1, 0]) == pytest.approx(BEFORE[name], abs=1e-9)
    save(plain, tmp_path / "r")
    again = load(tmp_path / "r")
    assert np.allclose(again.gyro.rates, plain.gyro.rates, rtol=0, atol=1e-12)


def test_samples_are_the_integral_of_the_rate_and_references_lie_on_the_path():
    # Propagating the samples' mean rates from reference to reference must lead where the sixth-order path leads.
    for name in SMALL:
        plan = small_plan(name)
        assert Evidence(plan).model_error < DESCRIBED


def test_recordings_without_effect_are_what_they_say():
    p = []
    for number in range(42):
        name = list(SMALL)[number % 3]
        for attempt in range(20):
            plan = small_plan(name, 100 * number + attempt)
            evidence = Evidence(plan)
            if evidence.model_error < DESCRIBED and evidence.sigmas[:9].max() < 0.03:
                break
        world = World(Spec("known", 8), number, name, SMALL[name][1], plan, evidence)
        p.append(calibrate(world.recording([])).p_value)
    assert scipy.stats.kstest(p, "uniform").pvalue > 0.01
    assert min(p) > 1e-4


def test_the_whitened_residuals_of_the_noise_are_white():
    world = small_world("free")
    white = [world.evidence.whiten_change(world.noise(draw)) for draw in range(30)]
    values = np.concatenate(white)
    assert np.var(values) == pytest.approx(1.0, abs=5 * np.sqrt(2 / values.size))
    lagged = np.concatenate([one[3:] * one[:-3] for one in white])
    assert abs(lagged.mean()) < 5 / np.sqrt(lagged.size)


def test_formal_sigmas_are_those_of_the_calibrator():
    world = small_world("free")
    found = calibrate(world.recording([]))
    formal = np.sqrt(np.diag(found.covariance))
    assert world.evidence.sigmas == pytest.approx(formal, rel=0.02)


def test_what_the_calibration_takes_up_has_no_evidence():
    world = small_world("free")
    constant = Change(
        np.tile([1e-5, -2e-5, 3e-6], (len(world.surroundings.stream.t_s), 1)),
        np.zeros((len(world.surroundings.references.t_s), 3)),
    )
    assert np.linalg.norm(world.evidence.attitude(constant)) < 1e-6 * np.linalg.norm(world.evidence.whiten_change(constant))


def test_a_random_change_has_the_divergence_of_its_covariance():
    rng, n, size = np.random.default_rng(2), 4000, 0.5
    white = [np.sqrt(size) * rng.standard_normal(n) for _ in range(6)]
    assert compute_process_evidence(white) == pytest.approx(np.sqrt(n * (size - np.log1p(size))), rel=0.05)
    shape = np.zeros(n)
    shape[7] = 30.0
    lone = [rng.standard_normal() * shape for _ in range(200)]
    assert compute_process_evidence(lone) == pytest.approx(np.sqrt(900 - np.log1p(900)), rel=0.25)


def test_louder_noise_has_the_divergence_of_two_variances():
    noise = np.random.default_rng(3).standard_normal(5000)
    assert compute_noise_evidence(noise, 1.2 * noise) == pytest.approx(np.sqrt(5000 * (1.44 - 1 - np.log(1.44))))
    assert compute_noise_evidence(noise, noise) == 0


def test_a_plan_like_trmms_is_described_by_the_baseline_and_has_its_activities():
    plan = draw_trmm_plan(np.random.default_rng(4), FLIGHT, "like TRMM")
    assert Evidence(plan).model_error < DESCRIBED
    activities = sorted(interval.activity for interval in plan.plain.intervals)
    assert activities == ["+x forward", "+x to -x yaw", "-x forward", "-x to +x yaw", "-y forward", "inertial hold"]
    assert plan.plain.title == "like TRMM"
