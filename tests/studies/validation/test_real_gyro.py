"""The study of a real gyro: on trials written here with a known delay and truncation, and on the real ones."""

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from gyrocal import InputError
from studies.montecarlo.study import Streams, load_config
from studies.report import entry as report
from studies.validation import broad, real_gyro
from studies.validation.real_gyro import RealConfig
from studies.validation.real_gyro import report as real_report
from tests.studies.validation.test_broad import BIAS, REAL, SAMPLE_S, trial_frame, write

LATE = 2  # samples
STEP = float(np.deg2rad(0.25))  # coarse, so that truncation is a fault of tenths of a degree
PHASES = ((12, 40), (52, 80))


def faulty(seed, late=LATE, step=STEP):
    """A trial whose gyro is late by whole samples, with its readings cut toward zero."""
    frame = trial_frame(PHASES, 92.0, seed=seed)
    names = list(broad.RATE_COLUMNS)
    rates = np.roll(frame[names].to_numpy() + 0.5 * BIAS, late, axis=0)
    frame[names] = np.trunc(rates / step) * step
    return frame


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("trials")
    for number, seed in (("01", 3), ("02", 4)):
        write(faulty(seed), path / f"{number}_synthetic.parquet")
    return path


@pytest.fixture(scope="module")
def rows(folder):
    config = RealConfig(folder=str(folder), units={"T": ("01", "02")}, floor_replays=1)
    with threadpool_limits(1):
        return pd.DataFrame([{"case": 0, "error": "", **row} for row in real_gyro.case(config, 0, Streams(config.entropy, 0))])


def rms(rows, kind, name, column="series_deg2"):
    own = rows[(rows["kind"] == kind) & ((rows["name"] == name) if name else True)]
    return float(np.sqrt(own[column].mean()))


def test_delay_and_truncation_are_found_by_the_other_trials(rows):
    fits = rows[rows["kind"] == "fit"].set_index(["trial", "name"])
    for trial in ("01", "02"):
        assert fits.loc[(trial, "+ time_offset"), "chosen"]
        assert fits.loc[(trial, "+ rate_truncation"), "chosen"]
        last = fits.loc[(trial, "+ stale_samples")]
        assert last["size"] == pytest.approx(LATE * SAMPLE_S, abs=5e-4)


def test_error_on_trials_left_out_shrinks_to_the_floor(rows):
    before, offset, after = (rms(rows, "held", name) for name in ("M0", "+ time_offset", "+ rate_truncation"))
    assert offset < before
    assert after < 0.9 * offset
    assert after < 2.0 * rms(rows, "floor", None)


def test_slow_motion_does_not_tell_a_lag_from_the_delay_there_is(rows):
    """They are the same to first order; the real trials are fast enough to tell."""
    assert rms(rows, "tried", "rate_lag for time_offset") == pytest.approx(rms(rows, "held", "+ stale_samples"), rel=0.1)


def test_without_faults_the_ladder_changes_nothing(tmp_path):
    """Negative control: nothing is chosen, and the error is that of noise from the first rung on."""
    for number, seed in (("01", 3), ("02", 4)):
        write(trial_frame(PHASES, 92.0, seed=seed), tmp_path / f"{number}_clean.parquet")
    config = RealConfig(folder=str(tmp_path), units={"T": ("01", "02")}, floor_replays=1)
    with threadpool_limits(1):
        rows = pd.DataFrame(real_gyro.case(config, 0, Streams(config.entropy, 0)))
    fits = rows[(rows["kind"] == "fit") & (rows["name"] != "M0")]
    assert not fits["chosen"].any()
    assert rms(rows, "held", "M0") == rms(rows, "held", "+ stale_samples")
    assert rms(rows, "held", "M0") < 2.0 * rms(rows, "floor", None)


def test_one_trial_is_parted_by_its_motions(folder):
    config = RealConfig(folder=str(folder), units={"T": ("01",)})
    one = real_gyro.load(config, "01")
    with threadpool_limits(1):
        parted = real_gyro.folds([one], {})
    assert [fold.tested.motions for fold in parted] == [("motion 1",), ("motion 2",)]
    for fold in parted:
        assert fold.tested.motions[0] not in fold.others[0].motions
        assert "rate_truncation" in fold.found.effects


def test_report_is_written_with_licence(rows, tmp_path):
    tone = {"kind": "tone", "unit": "T", "trial": "01", "name": "vibration:x", "frequency": 11.0, "coherence": 0.4, "gain": 0.9}
    made = real_report.report(pd.concat([rows, pd.DataFrame([{**tone, "count": 100.0}])], ignore_index=True))
    assert any("motion of the board" in finding for finding in made.findings)
    report.write(made, "real", tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "CC-BY-4.0" in text
    assert "Laidig" in text
    for name in ("ladder", "series", "zero", "offsets"):
        assert (tmp_path / f"{name}.svg").stat().st_size < 1_000_000


def test_repairs_are_exact():
    rates = np.array([[0.0, 1.0, -2.0]] * 2 + [[3.0, 3.0, 3.0]]) * STEP
    np.testing.assert_allclose(real_gyro.untruncated(rates, STEP)[0] / STEP, [0.0, 1.5, -2.5])
    bad = real_gyro.repeats(rates)
    assert bad.tolist() == [False, True, False]
    np.testing.assert_allclose(real_gyro.filled(rates, bad)[1] / STEP, [1.5, 2.0, 0.5])


def test_absent_trials_are_one_line(tmp_path):
    with pytest.raises(InputError, match="no trial 04 of unit A") as fault:
        load_config(real_gyro.STUDY, None, {"folder": str(tmp_path)})
    assert "\n" not in str(fault.value)


@pytest.mark.skipif(not REAL, reason="the BROAD trials are not beside this checkout; their licence keeps them out of it")
def test_real_gyro_of_one_unit_is_late_and_truncates():
    config = RealConfig(floor_replays=1)
    trials = [real_gyro.load(config, name) for name in ("03", "24")]
    found = real_gyro.Found(("time_offset", "rate_truncation", "stale_samples"), float(np.deg2rad(2000 / 32767)))
    squares = {}
    for name, rung in (("before", ()), ("after", found.effects)):
        fitted = real_gyro.fit([trials[0]], rung, found)
        squares[name] = np.mean([one.squares[1] for one in real_gyro.predicted(trials[1], fitted, rung, found)])
    assert 0.0055 < fitted.offset < 0.0063
    assert np.sqrt(squares["after"]) < 0.4 * np.sqrt(squares["before"])
