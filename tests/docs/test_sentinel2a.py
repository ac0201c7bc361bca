"""The example of Sentinel-2A: conventions by the trackers' own rates, predictions as good as they say, the committed file."""

import runpy

import numpy as np
import pandas as pd
import pytest

from gyrocal import calibrate
from tests import ROOT

FOLDER = ROOT / "docs" / "examples" / "sentinel2a"


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(FOLDER.with_suffix(".py")))


@pytest.fixture(scope="module")
def flight(example):
    return example["import_flight"]()


def test_known_readings_are_predicted_as_well_as_stated(example, flight):
    checked = example["check_predictions"](flight)
    assert checked["rms_in_sigma"].max() < 1.3
    assert checked[checked["from_s"] == 43.0]["rms_in_sigma"].min() > 0.7
    largest = checked[checked["from_s"] > 30].groupby(["tracker", "axis"])["rms_arcsec"].max()
    assert (largest < [1.9, 1.1, 8.2, 1.4, 1.5, 9.1]).all()
    result = calibrate(flight.recording, apriori_covariance=example["build_prior"](flight.recording))
    assert 0.8 < result.chi2 / result.dof < 1.2
    assert "b_x" in " ".join(result.observability.unobservable)


def test_the_committed_prediction_is_that_of_the_example(example, flight):
    table, again = pd.read_csv(FOLDER / "prediction.csv"), example["predict_trackers"](flight)
    assert list(table.columns) == list(again.columns)
    np.testing.assert_allclose(table.to_numpy(), again.to_numpy(), rtol=1e-6, atol=2e-8)
    assert (table["t_s"].iloc[0], table["t_s"].iloc[-1]) == (pytest.approx(65.05, abs=0.05), pytest.approx(97.25, abs=0.1))
