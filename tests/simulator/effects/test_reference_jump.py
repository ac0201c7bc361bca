"""Reference attitudes that jump by a constant rotation: innovations that show it, and what a diagnosis says of it."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from diagnosis.diagnose import diagnose
from simulator.effects import EFFECTS, parse
from simulator.effects.recording_view import smooth_rates
from simulator.effects.reference.reference_jump import compute_reference_innovations, find_edges
from simulator.simulate import build_surroundings, motion
from simulator.truth.rotation import separation
from tests.simulator.effects.test_clock import RIVALS, agile

JUMP = "reference_jump=0.1,e_x_deg=1,e_y_deg=2,e_z_deg=-2,begin_s=500,end_s=560"


def seen(scenario, *texts, seed=2):
    """A recording, and what it offers at its a-priori calibration."""
    recording = simulator.simulate(scenario, seed=seed, effects=[parse(text) for text in texts])
    gyro = recording.gyro
    rates = smooth_rates(recording, gyro.apriori_G, gyro.apriori_bias)
    return recording, build_surroundings(recording, replace(motion(scenario), rates=rates))


def test_a_jump_turns_the_reference_about_all_axes_while_it_lasts():
    """exp([e×]) A with e = 0.1 deg · (1, 2, −2)/3 from 500 to 560 s."""
    plain = simulator.simulate(agile(), noise=False)
    shown = simulator.simulate(agile(), noise=False, effects=[parse(JUMP)])
    e = np.rad2deg(separation(plain.attitudes.quaternions, shown.attitudes.quaternions))
    inside = (plain.attitudes.t_s >= 500) & (plain.attitudes.t_s < 560)
    np.testing.assert_allclose(e[inside], np.tile([0.1 / 3, 0.2 / 3, -0.2 / 3], (30, 1)), atol=1e-9)
    np.testing.assert_allclose(e[~inside], 0, atol=1e-9)
    np.testing.assert_array_equal(plain.gyro.rates, shown.gyro.rates)


@pytest.mark.parametrize("scenario", ["agile", "trmm_series"])
def test_innovations_have_their_noise_without_a_calibration_before(scenario):
    """Those of 420 s, in which the body turns by half a turn, as well; their scatter to five sigma of a variance."""
    _, around = seen(agile() if scenario == "agile" else simulator.load(scenario))
    found = compute_reference_innovations(around)
    z = found.values / found.sigma
    assert len(z) > 300
    assert np.std(z) == pytest.approx(1.0, abs=5 / np.sqrt(2 * z.size))
    assert not find_edges(found, around).size


def test_innovations_show_the_begin_and_the_end_of_a_jump():
    """With the sign of e at its begin and the other one, turned on by the body, at its end."""
    _, around = seen(agile(), JUMP)
    found = compute_reference_innovations(around)
    edges = find_edges(found, around)
    np.testing.assert_allclose(around.references.t_s[found.second[edges]], [500, 560])
    e = np.deg2rad(0.1) * np.array([1, 2, -2]) / 3
    np.testing.assert_allclose(found.values[edges[0]], e, atol=5 * found.sigma.max())
    np.testing.assert_allclose(np.linalg.norm(found.values[edges[1]]), np.linalg.norm(e), atol=5 * found.sigma.max())
    windows = {(one.parameters["begin_s"], one.parameters["end_s"]) for one in EFFECTS["reference_jump"].trials(around)}
    assert windows == {(499.0, 1e12), (559.0, 1e12), (499.0, 559.0)}


def test_a_diagnosis_names_a_jump_and_nothing_else():
    found = diagnose(seen(agile(), JUMP)[0], library=RIVALS)
    (cause,) = found.causes
    assert cause.group == ("reference_jump",)
    assert cause.size == pytest.approx(0.1, abs=0.01)
    assert [cause.parameters[name] for name in ("e_x_deg", "e_y_deg", "e_z_deg")] == pytest.approx(
        [0.033, 0.067, -0.067], abs=0.01
    )
    assert (cause.parameters["begin_s"], cause.parameters["end_s"]) == (499.0, 559.0)
