import numpy as np
import pandas as pd
import pytest

from studies.calibration import summaries


def test_orders_and_crossings_of_known_curves():
    x = np.array([0.5, 1.0, 2.0, 4.0])
    assert summaries.fit_log_slope(x, 3 * x**1.7) == pytest.approx(1.7)
    assert summaries.find_level_crossing(x, 3 * x**2, 3 * 1.3**2) == pytest.approx(1.3)
    assert summaries.find_level_crossing(x, x, 4.0) == 4.0
    assert np.isnan(summaries.find_level_crossing(x, x, 5.0))
    assert np.isnan(summaries.find_level_crossing(x, x, 0.1))
    assert np.isnan(summaries.fit_log_slope([1.0], [2.0]))


def test_the_flight_beside_simulated_values():
    values = pd.Series(np.arange(101.0))
    assert summaries.summarise_with_flight(values, 25.0)["flight_percentile"] == pytest.approx(100 * 25 / 101)
    found = summaries.summarise_with_flight(values, np.nan)
    assert [found[name] for name in ("p05", "median", "p95")] == [5.0, 50.0, 95.0]
    assert np.isnan(found["flight_percentile"])
