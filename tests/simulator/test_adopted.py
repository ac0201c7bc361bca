import numpy as np
import pytest

from gyrocal import calibrate, load, save
from gyrocal.errors import InputError
from simulator import adopted_scenario, scenario
from simulator.effects import parse
from simulator.simulate import simulate

OVERRIDES = {"gyro.sample_s": 4.0, "reference.every_s": 240.0}
ORBITAL = "bias_orbital:z=0.3,phase_deg=40"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording on file."""
    plan = scenario.override(scenario.load("trmm_series"), OVERRIDES)
    path = tmp_path_factory.mktemp("adopted") / "rec"
    save(simulate(plan, seed=3, effects=[parse(ORBITAL)]), path)
    return path


@pytest.fixture(scope="module")
def recording(folder):
    """As it is on file: writing degrees rounds the last bit."""
    return load(folder)


@pytest.fixture
def written(tmp_path, folder, recording):
    """A function that writes a scenario of the recording with some effects and a covariance."""
    found = calibrate(recording)

    def write(effects=(), covariance=None, **changes):
        settings = [parse(text) for text in effects]
        count = sum(adopted_scenario.REGISTRY[setting.effect].amplitudes(setting).size for setting in settings)
        covariance = np.zeros((count, count)) if covariance is None else np.array(covariance)
        text = adopted_scenario.format_adopted(
            "again", str(folder), adopted_scenario.hash_recording(recording), found.G, found.bias, settings, covariance
        )
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "a.toml").write_text(text)
        return tmp_path / "a.toml"

    return write


def test_what_is_written_is_what_is_read(written, recording):
    loaded = adopted_scenario.load(written([ORBITAL, "noise_excess:x=1.5"], np.diag([4e-4, 1e-4, 0.01])))
    assert [effect.label() for effect in loaded.effects] == ["bias_orbital:z", "noise_excess:x"]
    np.testing.assert_allclose(loaded.amplitudes, [0.3 * np.cos(np.radians(40)), 0.3 * np.sin(np.radians(40)), 1.5])
    np.testing.assert_array_equal(np.diag(loaded.covariance), [4e-4, 1e-4, 0.01])
    np.testing.assert_array_equal(loaded.plan.recording.gyro.rates, recording.gyro.rates)
    np.testing.assert_allclose(loaded.plan.G, calibrate(recording).G, rtol=0, atol=1e-15)


def test_amplitudes_are_drawn_from_their_joint_posterior(written):
    C = np.array([[4e-4, 3e-4], [3e-4, 9e-4]])
    loaded = adopted_scenario.load(written([ORBITAL], C))
    draws = np.array([loaded.draw_amplitudes(np.random.default_rng(k)) for k in range(4000)])
    np.testing.assert_allclose(draws.mean(axis=0), loaded.amplitudes, rtol=0, atol=4 * np.sqrt(np.diag(C) / 4000).max())
    np.testing.assert_allclose(np.cov(draws.T), C, rtol=0.12)
    (setting,) = loaded.replace_amplitudes(draws[0])
    np.testing.assert_allclose(adopted_scenario.REGISTRY["bias_orbital"].amplitudes(setting), draws[0])


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('recording = "', 'recording = "gone', "not a folder"),
        ('sha256 = "', 'sha256 = "0', "not what it was"),
        ("covariance = [[0.0, 0.0], [0.0, 0.0]]", "covariance = [[0.0]]", "must be 2×2"),
        ("covariance = [[0.0, 0.0], [0.0, 0.0]]", "covariance = [[1.0, 2.0], [2.0, 1.0]]", "no negative eigenvalue"),
        ('name = "bias_orbital"\naxis = "z"', 'name = "dss_head"\naxis = "1"', "raw sensor tables"),
    ],
)
def test_faults_are_one_line_that_names_the_file(written, old, new, text):
    path = written([ORBITAL], **{old: new})
    with pytest.raises(InputError, match=text):
        adopted_scenario.load(path)
