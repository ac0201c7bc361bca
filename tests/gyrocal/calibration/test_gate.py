"""What may be linearised, and what counts as found: both thresholds by themselves, at numbers beside them."""

import numpy as np
import pytest

from gyrocal.calibration.gate import LargeResidualError, check
from gyrocal.calibration.observability import evaluate_observability

NAMES = ("G_xx", "G_yy", "b_x")


def test_residuals_up_to_thirty_degrees_pass():
    theta = np.deg2rad([[1.0, 2.0, 3.0], [29.9, 0.0, 0.0], [0.0, 17.0, -17.0]])
    check(theta)
    with pytest.raises(LargeResidualError, match=r"30\.1 deg") as caught:
        check(np.vstack([theta, np.deg2rad([[0.0, 0.0, -30.1]])]))
    assert caught.value.output == 3
    with pytest.raises(LargeResidualError) as caught:
        check(np.array([[0.1, 0.0, 0.0], [0.0, np.nan, 0.0]]))
    assert (caught.value.output, caught.value.angle) == (1, np.inf)


def test_found_is_what_the_data_say_better_than_the_plausible_range():
    """A singular value is the plausible range over the sigma of the data alone."""
    sigma, plausible = np.array([0.5, 0.99, 1.01]), np.array([1e-2, 1e-2, 1e-5])
    judged = evaluate_observability(np.diag(1 / (sigma * plausible)), plausible, NAMES)
    np.testing.assert_allclose(judged.singular_values, 1 / sigma, rtol=1e-12)
    assert judged.unobservable == ("1 b_x",)
    assert evaluate_observability(np.diag(1 / (0.9 * sigma * plausible)), plausible, NAMES).unobservable == ()
