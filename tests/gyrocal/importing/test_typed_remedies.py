"""What a refusal prints is typed: the import then succeeds, and its calibration agrees with the truth."""

import re

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from tests.gyrocal.importing import mems_log
from tests.gyrocal.importing.mems import largest_error

MOST_SIGMA = 5.0  # of twelve parameters
RATES = ["gx", "gy", "gz"]
WORDS = {"--time": "t:s", "--gyro": "gx,gy,gz:deg/s", "--quat": "qw,qx,qy,qz:body-to-inertial"}


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(41), seconds=40.0)


def scale_rates(gyro, attitude, factor):
    return gyro.assign(**{name: factor * gyro[name] for name in RATES}), attitude


def turn_axes(gyro, attitude, rows):
    return gyro.assign(**dict(zip(RATES, np.asarray(rows) @ gyro[RATES].to_numpy().T, strict=True))), attitude


def shift_attitudes(gyro, attitude, by_s):
    return gyro, attitude.assign(t=attitude.t + by_s)


def stretch_gyro_clock(gyro, attitude, factor):
    return gyro.assign(t=factor * gyro.t), attitude


def lose_digits(gyro, attitude, step_s):
    return gyro.assign(t=step_s * np.floor(gyro.t / step_s + 1e-9)), attitude


def accumulate(gyro, attitude, wrap):
    angle = np.cumsum(0.01 * gyro[RATES].to_numpy(), axis=0) - 0.01 * gyro[RATES].to_numpy()
    return gyro.assign(**dict(zip(RATES, (angle % wrap).T, strict=True))), attitude


def replace_unit(match):
    return {"--gyro": f"gx,gy,gz:{match[1]}"}


def replace_axes(match):
    return {"--gyro": re.sub("([xyz])", r"g\1", match[1].rstrip(";")) + ":deg/s"}


def take_options(match):
    return dict(pair.rsplit(" ", 1) for pair in match.groups() if pair)


def take_factor(match):
    return {match[2]: match[1]}


TURN = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
SKEW = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1]]) / np.sqrt(3)
CASES = {
    # The fault, options as first typed, the words of the refusal, and how they are typed.
    "unit": (scale_rates, 1.0, {"--gyro": "gx,gy,gz:rad/s"}, r"the gyro in (\S+), not rad/s", replace_unit),
    "order and signs": (turn_axes, np.diag([1, -1, 1])[[1, 0, 2]], {}, r"the gyro's axes as (\S+)", replace_axes),
    "mounting": (turn_axes, TURN, {}, r"(--mounting estimate)", take_options),
    "skew": (turn_axes, SKEW, {}, r"(--axes) '([^']+)'", lambda match: {match[1]: match[2]}),
    "direction": (scale_rates, 1.0, {"--quat": "qw,qx,qy,qz:inertial-to-body"}, r"\((body-to-inertial)\)",
                  lambda match: {"--quat": f"qw,qx,qy,qz:{match[1]}"}),
    "factor": (scale_rates, 0.7, {}, r"the rates times (\S+) \((--rate-factor)\)", take_factor),
    "late": (shift_attitudes, 3.7, {}, r"(--align auto)", take_options),
    "dated": (shift_attitudes, 1.7e9, {}, r"(--attitude-offset \S+);", take_options),
    "clock": (stretch_gyro_clock, 1.02, {}, r"time tags times (\S+) \((--time-factor)\)", take_factor),
    "tags alike": (lose_digits, 1e3, {}, r"(--rate) HZ", lambda match: {match[1]: "100"}),
    "wrap": (accumulate, 77.0, {"--gyro": "gx,gy,gz:deg"}, r"jumps by \S+; .* (--wrap \S+)", take_options),
}  # fmt: skip


def count_seconds(table, log):
    return table.assign(t=(table["timestamp_ms"] - log.gyro["timestamp_ms"].iloc[0]) / 1000)


def write_tables(folder, gyro, attitude):
    gyro.to_csv(folder / "g.csv", index=False)
    attitude.to_csv(folder / "a.csv", index=False)
    return lambda options: (*(str(folder / name) for name in ("g.csv", "a.csv", "out")), *sum(options.items(), ()))


@pytest.mark.parametrize("name", CASES)
def test_a_remedy_that_is_typed_mends_its_case(run_cli, log, tmp_path, name):
    spoil, value, typed, words, read = CASES[name]
    build_words = write_tables(tmp_path, *spoil(count_seconds(log.gyro, log), count_seconds(log.attitude, log), value))
    options = WORDS | typed
    refused = run_cli("import", "csv", *build_words(options))
    assert refused.exit_code == 2, refused.stdout
    match = re.search(words, refused.stderr)
    assert match, refused.stderr
    done = run_cli("import", "csv", *build_words(options | read(match)))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "out")
    if spoil not in (turn_axes, scale_rates) or np.array_equal(value, 1.0):
        assert largest_error(recording, log) < MOST_SIGMA
        return
    # The gyro's errors are those of the spoilt axes: the calibrated rates are those of the body.
    result = gyrocal.calibrate(recording)
    true = log.gyro[RATES].to_numpy() @ log.G.T + np.rad2deg(log.bias)
    found = np.rad2deg(recording.gyro.rates @ result.parameters.G.T + result.parameters.bias)
    assert np.abs(found - true).max() < 0.3


def test_smooth_references_are_refused_until_their_sigma_is_stated(run_cli, log, tmp_path):
    rates = np.deg2rad(log.gyro[RATES].to_numpy()) @ log.G.T + log.bias
    bodies = Rotation.from_matrix(mems_log._integrate_attitudes(rates, np.eye(3))[:: mems_log.SAMPLES_PER_ATTITUDE])
    attitude = log.attitude.assign(**dict(zip(("qx", "qy", "qz", "qw"), bodies.as_quat().T, strict=True)))
    build_words = write_tables(tmp_path, count_seconds(log.gyro, log), count_seconds(attitude, log))
    refused = run_cli("import", "csv", *build_words(WORDS))
    assert refused.exit_code == 2
    match = re.search(r"as smoothed ones do.* (--sigma) DEG", refused.stderr)
    done = run_cli("import", "csv", *build_words(WORDS | {match[1]: "0.05"}))
    assert done.exit_code == 0, done.stderr
    assert largest_error(gyrocal.load(tmp_path / "out"), log) < 1


def test_references_far_apart_give_the_bias_that_those_near_each_other_give(run_cli, tmp_path):
    log = mems_log.log(np.random.default_rng(42), seconds=90.0)
    build_words = write_tables(tmp_path, count_seconds(log.gyro, log), count_seconds(log.attitude[::45], log))
    done = run_cli("import", "csv", *build_words(WORDS | {"--sigma": str(mems_log.REFERENCE_SIGMA_DEG)}))
    assert done.exit_code == 0, done.stderr
    assert largest_error(gyrocal.load(tmp_path / "out"), log) < MOST_SIGMA


def turn_steadily(K, rate_deg_s, sigma_deg):
    """Tables of a body at a constant rate: gyros along the rows of K, and attitudes."""
    rng, t = np.random.default_rng(4), np.arange(0, 60, 0.25)
    errors = np.deg2rad(sigma_deg) * rng.normal(size=(t.size, 3))
    body = Rotation.from_rotvec(np.deg2rad(t[:, None] * rate_deg_s)) * Rotation.from_rotvec(errors)
    rates = rate_deg_s @ K.T + 1e-5 * rng.normal(size=(t.size, 3))
    quaternions = dict(zip(("qx", "qy", "qz", "qw"), body.as_quat().T, strict=True))
    return pd.DataFrame({"t": t} | dict(zip(RATES, rates.T, strict=True))), pd.DataFrame({"t": t} | quaternions)


def test_skew_gyros_at_a_constant_rate_are_said_by_import_and_calibration(run_cli, tmp_path):
    rate = np.array([0.06, -0.02, 0.01])
    words = ("import", "csv", *write_tables(tmp_path, *turn_steadily(SKEW, rate, 0.0005))(WORDS), "--force")
    taken = run_cli(*words)
    assert taken.exit_code == 0, taken.output
    said = re.search(r"implausible: (the mean rate is .*)", taken.output).group(1)
    by_gyro, by_attitudes = (float(one) for one in re.findall(r"([\d.]+) (?:± [\d.e-]+ )?deg/s by the", said))
    assert by_gyro == pytest.approx(np.linalg.norm(SKEW @ rate), rel=1e-3)
    assert by_attitudes == pytest.approx(np.linalg.norm(rate), rel=0.02)
    assert said in run_cli("calibrate", str(tmp_path / "out")).output
    mended = run_cli(*words, "--axes", ";".join(",".join(map(str, row)) for row in SKEW))
    assert mended.exit_code == 0, mended.output
    assert "implausible" not in mended.output
    assert np.abs(np.rad2deg(gyrocal.load(tmp_path / "out").gyro.apriori_bias)).max() < 1e-3
