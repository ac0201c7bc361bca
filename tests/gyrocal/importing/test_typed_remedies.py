"""What a refusal prints is typed: the import then succeeds, and its calibration agrees with the truth."""

import re

import numpy as np
import pytest

import gyrocal
from studies.validation import mems_log
from tests.gyrocal.importing.mems import largest_error

MOST_SIGMA = 5.0  # of twelve parameters
RATES = ["gx", "gy", "gz"]
WORDS = {
    "--time": "t:s",
    "--gyro": "gx,gy,gz:deg/s",
    "--quat": "qw,qx,qy,qz:body-to-inertial",
}


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
    "time unit": (scale_rates, 1.0, {"--time": "t:ms"}, r"times in (\S+), not ms", lambda match: {"--time": f"t:{match[1]}"}),
    "signs": (turn_axes, np.diag([1, -1, -1]), {}, r"the gyro's axes as (\S+)", replace_axes),
    "order": (turn_axes, np.eye(3)[[1, 0, 2]], {}, r"the gyro's axes as (\S+)", replace_axes),
    "mounting": (turn_axes, TURN, {}, r"(--mounting estimate)", take_options),
    "skew": (turn_axes, SKEW, {}, r"(--axes) '([^']+)'", lambda match: {match[1]: match[2]}),
    "direction": (scale_rates, 1.0, {"--quat": "qw,qx,qy,qz:inertial-to-body"}, r"\((body-to-inertial)\)",
                  lambda match: {"--quat": f"qw,qx,qy,qz:{match[1]}"}),
    "factor": (scale_rates, 0.7, {}, r"the rates times (\S+) \((--rate-factor)\)", take_factor),
    "factor by itself": (scale_rates, 0.7, {}, r"(--align auto)", take_options),
    "late": (shift_attitudes, 3.7, {}, r"(--align auto)", take_options),
    "apart": (shift_attitudes, 4000.0, {}, r"(--align auto)", take_options),
    "dated": (shift_attitudes, 1.7e9, {}, r"(--attitude-offset \S+);", take_options),
    "clock": (stretch_gyro_clock, 1.02, {}, r"time tags times (\S+) \((--time-factor)\)", take_factor),
    "tags alike": (lose_digits, 1e3, {}, r"(--rate) HZ", lambda match: {match[1]: "100"}),
    "tags of a register": (lose_digits, 1e3, {"--rate": "100", "--gyro": "gx,gy,gz:counts"}, r"(--lsb) '\S+ deg/s'",
                           lambda match: {match[1]: "1 deg/s"}),
    "wrap": (accumulate, 77.0, {"--gyro": "gx,gy,gz:deg"}, r"jumps by (\S+); .* (--wrap) VALUE",
             lambda match: {match[2]: "77"}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_remedy_that_is_typed_mends_its_case(run_cli, log, tmp_path, name):
    spoil, value, typed, words, read = CASES[name]
    start = log.gyro["timestamp_ms"].iloc[0]
    tables = (one.assign(t=(one["timestamp_ms"] - start) / 1000) for one in (log.gyro, log.attitude))
    for table, file in zip(spoil(*tables, value), ("g.csv", "a.csv"), strict=True):
        table.to_csv(tmp_path / file, index=False)
    files = [str(tmp_path / file) for file in ("g.csv", "a.csv", "out")]

    def run(options):
        return run_cli("import", "csv", *files, *(word for pair in options.items() for word in pair))

    options = WORDS | typed
    refused = run(options)
    assert refused.exit_code == 2, refused.stdout
    match = re.search(words, refused.stderr)
    assert match, refused.stderr
    done = run(options | read(match))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "out")
    if name in (
        "unit",
        "time unit",
        "direction",
        "wrap",
        "dated",
        "tags alike",
        "tags of a register",
        "late",
        "apart",
        "clock",
    ):
        assert largest_error(recording, log) < MOST_SIGMA
        return
    # The gyro's errors are those of the spoilt axes: the calibrated rates are those of the body.
    result = gyrocal.calibrate(recording)
    true = log.gyro[RATES].to_numpy() @ log.G.T + np.rad2deg(log.bias)
    raw = np.rad2deg(recording.gyro.rates)
    found = raw @ result.parameters.G.T + np.rad2deg(result.parameters.bias)
    assert np.abs(found - true).max() < 0.3
