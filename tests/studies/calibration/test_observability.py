"""Which maneuvers are needed: subsets against what theory and calibration say of them."""

import numpy as np
import pytest

from gyrocal import calibrate
from simulator.simulate import motion, observe
from studies.calibration.maneuvers_needed import (
    SIGMAS,
    STUDY,
    find_minimal_subsets,
    select_intervals,
)
from studies.montecarlo.study import load_base_scenario, load_config
from studies.report.units import PPM_DEG_H
from tests.studies.rows import run_study

CONFIG = load_config(STUDY, changes={"overrides.gyro.sample_s": 5.0, "series_s": 120.0})


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return run_study(STUDY, CONFIG, tmp_path_factory.mktemp("maneuvers"))


@pytest.fixture(scope="module")
def recording():
    scenario = load_base_scenario(CONFIG)
    return observe(scenario, motion(scenario), gyro_rng=None, reference_rng=None)


def test_fewer_than_four_ends_never_suffice_and_more_never_tell_less(rows):
    # R: three equations an interval, so at least four intervals for twelve parameters.
    ends = rows[rows["references"] == "ends"]
    free = 12 - 3 * ends["size"]
    assert (ends["lost"] >= free.clip(lower=0)).all()
    assert (ends.loc[ends["size"] < 4, "lost"] > 0).all()
    assert find_minimal_subsets(ends)["size"].min() == 4
    assert (ends.loc[ends["size"] == 6, "lost"] == 0).all()
    wide = rows.pivot_table(index="maneuvers", columns="references", values="information_bits")
    assert (wide["series"] > wide["ends"]).all()
    ends = rows[rows["references"] == "ends"]
    bits = {frozenset(text.split("+")): value for text, value in zip(ends["maneuvers"], ends["information_bits"], strict=True)}
    assert all(value > bits[own - {name}] for own, value in bits.items() for name in own if len(own) > 1)
    row = rows[(rows["references"] == "series") & (rows["maneuvers"] == "m1")].iloc[0]
    assert "1 G_yy + 0.0657 deg/s b_y" in row["combinations"]


@pytest.mark.parametrize("maneuvers", ["m1+m2+m4+m6", "m1+m3+m5+m6"])
def test_calibrate_agrees(rows, recording, maneuvers):
    row = rows[(rows["references"] == "ends") & (rows["maneuvers"] == maneuvers)].iloc[0]
    chosen = [int(name[1]) - 1 for name in maneuvers.split("+")]
    if row["lost"]:
        assert len(calibrate(select_intervals(recording, chosen)).observability.unobservable) == row["lost"]
    else:
        result = calibrate(select_intervals(recording, chosen))
        # The plausible range as a prior makes the study's sigmas smaller by (σ/range)²/2 at most.
        own = row[SIGMAS].to_numpy(float)
        assert (own <= result.sigma * PPM_DEG_H * (1 + 1e-6)).all()
        np.testing.assert_allclose(own, result.sigma * PPM_DEG_H, rtol=0.03)
        # calibrate judges at the a-priori parameters.
        assert row["condition"] == pytest.approx(result.observability.condition, rel=0.02)
