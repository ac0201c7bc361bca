"""The study of a real gyro: on trials written here with a known delay and truncation, and on the real ones."""

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from gyrocal import InputError, calibrate
from studies.montecarlo.study import Streams, load_config
from studies.report import entry
from studies.validation import broad
from studies.validation.real_gyro import STUDY, left_out, prediction, report, study, turns
from studies.validation.real_gyro.trials import RealConfig, load
from tests import SHARED
from tests.studies.validation.test_broad import BIAS, REAL, SAMPLE_S, trial_frame, write

LATE = 2  # samples
STEP = float(np.deg2rad(0.25))  # coarse, so that truncation is a fault of tenths of a degree
PHASES = ((12, 40), (52, 80))
M0, OFFSET, CUT, LAST = (rung.name for rung in prediction.LADDER)


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


def rows_of(folder):
    config = RealConfig(folder=str(folder), units={"T": ("01", "02")}, floor_replays=1)
    with threadpool_limits(1):
        rows = study.case(config, 0, Streams(config.entropy, 0))
    return pd.DataFrame([{"case": 0, "error": "", **row} for row in rows])


@pytest.fixture(scope="module")
def rows(folder):
    return rows_of(folder)


def rms(rows, kind, name, column="series_deg2"):
    own = rows[(rows["kind"] == kind) & ((rows["name"] == name) if name else True)]
    return float(np.sqrt(own[column].mean()))


def test_delay_and_truncation_are_found_by_the_other_trials(rows):
    fits = rows[(rows["kind"] == "fit") & (rows["name"] == LAST)]
    assert set(fits["trial"]) == {"01", "02"}
    assert fits["late"].all()
    assert fits["cut"].all()
    np.testing.assert_allclose(fits["delay_ms"].astype(float), 1e3 * LATE * SAMPLE_S, atol=0.5)
    causes = rows.loc[(rows["kind"] == "diagnosis") & (rows["turn"] == "as recorded"), "causes"]
    assert causes.str.contains("rate_truncation").all()
    again = rows.loc[(rows["kind"] == "diagnosis") & (rows["turn"] == "time offset undone"), "late_probability"]
    assert (again.astype(float) < 0.5).all()


def test_error_on_trials_left_out_shrinks_to_the_floor(rows):
    before, offset, cut, after = (rms(rows, "held", name) for name in (M0, OFFSET, CUT, LAST))
    assert offset < before
    assert cut < 0.9 * offset
    assert after == pytest.approx(cut, rel=0.01)  # none is stale
    assert after < 2.0 * rms(rows, "floor", None)


def test_slow_motion_does_not_tell_a_lag_from_the_delay_there_is(rows):
    """They are the same to first order; the real trials are fast enough to tell."""
    assert rms(rows, "held", prediction.LAGGED) == pytest.approx(rms(rows, "held", LAST), rel=0.1)


def test_without_faults_the_ladder_changes_nothing(tmp_path):
    """Negative control: no delay is found, and the error is that of noise from the first rung on."""
    for number, seed in (("01", 3), ("02", 4)):
        write(trial_frame(PHASES, 92.0, seed=seed), tmp_path / f"{number}_clean.parquet")
    rows = rows_of(tmp_path)
    fits = rows[rows["kind"] == "fit"]
    assert not fits["late"].any()
    assert not fits["cut"].any()
    assert (fits["delay_ms"] == 0).all()
    assert rms(rows, "held", M0) == rms(rows, "held", LAST)
    assert rms(rows, "held", M0) < 2.0 * rms(rows, "floor", None)
    tried = rows[rows["kind"] == "tried"].set_index("name")
    assert set(tried.index) == {"scale_asymmetry", "scale_quadratic", study.FORCE}
    assert (tried["after"] > 0.9 * tried["before"]).all()


def test_one_trial_is_parted_by_its_motions(folder):
    config = RealConfig(folder=str(folder), units={"T": ("01",)})
    with threadpool_limits(1):
        parted = left_out.folds([load(config, "01")], {})
    assert [fold.tested.motions for fold in parted] == [("motion 1",), ("motion 2",)]
    for fold in parted:
        assert fold.tested.motions[0] not in fold.others[0].motions
        assert fold.late
        assert fold.cut


def test_report_is_written_with_licence(rows, tmp_path):
    made = report.report(rows)
    assert made.check("trials with a gyro that is surely late").verdict == "pass"
    assert made.check("error over its series, share of the gap closed").verdict == "pass"
    assert made.check("zero bin over its neighbours, smallest").verdict == "pass"
    entry.write(made, "real", tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "CC-BY-4.0" in text
    assert "Laidig" in text
    for name in ("ladder", "series", "delays"):
        assert (tmp_path / f"{name}.svg").stat().st_size < 1_000_000


def test_cut_readings_are_put_in_the_middle_of_what_they_stand_for(folder):
    one = load(RealConfig(folder=str(folder), units={"T": ("01",)}), "01")
    frame = trial_frame(PHASES, 92.0, noise=False, seed=3)
    truth = np.roll(frame[list(broad.RATE_COLUMNS)].to_numpy() + 0.5 * BIAS, LATE, axis=0)
    fast = np.abs(truth) > 4 * STEP

    def short(rates):
        return np.mean((truth - rates)[fast] * np.sign(truth[fast]))

    assert short(one.trial.rates) == pytest.approx(0.5 * STEP, rel=0.05)
    assert abs(short(one.repaired(cut=True, bridged=False))) < 0.02 * STEP


def test_fit_is_that_of_the_calibrator(folder):
    """Another implementation: batch estimation by Davenport's iteration, of one trial as it is on file."""
    one = load(RealConfig(folder=str(folder), units={"T": ("01",)}), "01")
    found = prediction.fitted([one], prediction.LADDER[0])
    other = calibrate(prediction.undone(one, prediction.LADDER[0], 0.0))
    sigma = np.sqrt(np.diag(other.covariance))
    away = np.concatenate([(found.G - other.parameters.G).ravel(), found.bias - other.parameters.bias]) / sigma
    assert np.abs(away).max() < 0.3


def test_remaining_turns_are_read_as_white_and_walk():
    """Mean squares that are exactly 3 (2 s² + w² T) give s and w."""
    white, walk = 0.08, 0.1
    lags = np.array(turns.LAGS_S)
    squares = 3 * (2 * white**2 + walk**2 * lags)
    base = {"unit": "T", "trial": "01"}
    made = [
        {
            "kind": "turns",
            **base,
            "name": name,
            "lag_s": lag,
            "count": 10.0,
            "series_deg2": both * square,
            "along_deg2": square / 3,
        }
        for lag, square in zip(lags, squares, strict=True)
        for name, both in (("slower", 0.5), ("faster", 1.5))
    ]
    trial = {"kind": "trial", **base, "rate_deg_s": 1.0, "stated_sigma_deg": 1.0, "stated_arw_deg_per_sqrt_s": 1.0}
    (row,) = turns.remaining(pd.DataFrame([*made, trial])).to_dict("records")
    assert row["white_deg"] == pytest.approx(white)
    assert row["walk_deg_per_sqrt_s"] == pytest.approx(walk)
    assert row["faster_over_slower"] == pytest.approx(np.sqrt(3))
    assert row["share_along_turn"] == pytest.approx(1 / 3)


def test_repeats_are_bridged(tmp_path):
    frame = trial_frame(PHASES, 92.0, seed=3)
    names = list(broad.RATE_COLUMNS)
    rates = frame[names].to_numpy().copy()
    repeated = 5000 + 7 * np.arange(40)
    stale = rates.copy()
    stale[repeated] = rates[repeated - 1]
    write(frame.assign(**dict(zip(names, stale.T, strict=True))), tmp_path / "01_stale.parquet")
    one = load(RealConfig(folder=str(tmp_path), units={"T": ("01",)}), "01")
    assert np.flatnonzero(one.stale).tolist() == repeated.tolist()
    bridged = one.repaired(cut=False, bridged=True)
    np.testing.assert_array_equal(np.delete(bridged, repeated, axis=0), np.delete(rates, repeated, axis=0))
    middle = 0.5 * (rates[repeated - 1] + rates[repeated + 1])
    off_line, off_bridge = (np.sqrt(np.mean((values - rates[repeated]) ** 2)) for values in (middle, bridged[repeated]))
    assert off_bridge <= off_line  # the line through the neighbours, or what follows the motion better


def test_absent_trials_are_one_line(tmp_path):
    with pytest.raises(InputError, match="no trial 04 of unit A") as fault:
        load_config(STUDY, None, {"folder": str(tmp_path)})
    assert "\n" not in str(fault.value)


def test_trials_elsewhere_need_none_at_the_usual_place(folder, monkeypatch):
    monkeypatch.setattr(RealConfig.model_fields["folder"], "default", str(folder / "nowhere"))
    RealConfig.model_rebuild(force=True)
    try:
        config = load_config(STUDY, None, {"folder": str(folder), "units": {"T": ["01", "02"]}})
    finally:
        monkeypatch.undo()
        RealConfig.model_rebuild(force=True)
    assert config.points() == ["T"]


@pytest.mark.skipif(not REAL, reason="the BROAD trials are not beside this checkout; their licence keeps them out of it")
def test_real_gyro_of_one_unit_is_late_and_its_samples_need_repair():
    config = RealConfig(folder=str(SHARED / "real" / "broad"), floor_replays=1)
    trials = [load(config, name) for name in ("03", "24")]
    squares = {}
    for rung in prediction.LADDER:
        found = prediction.fitted([trials[0]], rung)
        squares[rung.name] = np.mean([one.squares[1] for one in prediction.predicted(trials[1], found, rung)])
    assert 0.0055 < found.delay < 0.0063
    assert np.sqrt(squares[OFFSET]) < 0.6 * np.sqrt(squares[M0])
    assert np.sqrt(squares[LAST]) < 0.7 * np.sqrt(squares[CUT])
    assert np.sqrt(squares[LAST]) < 0.4 * np.sqrt(squares[M0])
