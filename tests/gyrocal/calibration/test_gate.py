"""What may be linearised, what counts as found, and the parameters that are solved for."""

import numpy as np
import pytest

from gyrocal import NAMES, InputError, select
from gyrocal.calibration.gate import LargeResidualError, check_residual_size
from gyrocal.calibration.observability import evaluate_observability
from tests.builders import TRUTH


def test_residuals_up_to_thirty_degrees_pass():
    theta = np.deg2rad([[1.0, 2.0, 3.0], [29.9, 0.0, 0.0], [0.0, 17.0, -17.0]])
    check_residual_size(theta)
    with pytest.raises(LargeResidualError, match=r"30\.1 deg") as caught:
        check_residual_size(np.vstack([theta, np.deg2rad([[0.0, 0.0, -30.1]])]))
    assert caught.value.output == 3
    with pytest.raises(LargeResidualError) as caught:
        check_residual_size(np.array([[0.1, 0.0, 0.0], [0.0, np.nan, 0.0]]))
    assert (caught.value.output, caught.value.angle) == (1, np.inf)


def test_found_is_what_the_data_say_better_than_the_plausible_range():
    """A singular value is the plausible range over the sigma of the data alone."""
    sigma, plausible = np.array([0.5, 0.99, 1.01]), np.array([1e-2, 1e-2, 1e-5])
    judged = evaluate_observability(np.diag(1 / (sigma * plausible)), plausible, ("G_xx", "G_yy", "b_x"))
    np.testing.assert_allclose(judged.singular_values, 1 / sigma, rtol=1e-12)
    assert judged.unobservable == ("1 b_x",)
    assert evaluate_observability(np.diag(1 / (0.9 * sigma * plausible)), plausible, ("G_xx", "G_yy", "b_x")).unobservable == ()


def test_table_has_the_flights_calibrated_values():
    # N Table 3 at 0.5 s and R eq. (9) are the same calibration.
    table = TRUTH.table()
    np.testing.assert_allclose(table["scale_factor"], [1.00044, 1.00053, 1.00088], atol=5e-6)
    np.testing.assert_allclose(table["misalignment_x_deg"], [0, 0.044, 0.054], atol=5.1e-4)
    np.testing.assert_allclose(table["misalignment_y_deg"], [-0.058, 0, 0.096], atol=5.1e-4)
    np.testing.assert_allclose(table["misalignment_z_deg"], [0.039, -0.124, 0], atol=5.1e-4)
    np.testing.assert_allclose(table["bias_deg_s"], [-1.55e-4, 1.98e-4, 0.78e-4], atol=5.1e-7)


@pytest.mark.parametrize(
    ("text", "count"), [("all", 12), ("bias", 3), ("scale,bias", 6), ("all,-misalignment", 6), ("gyro_y", 4), ("G_xy,b_z", 2)]
)
def test_subsets(text, count):
    names = select(text)
    assert len(names) == count
    assert list(names) == [name for name in NAMES if name in names]


def test_unknown_or_empty_subset_is_refused():
    for bad in ("G_xw", "bias,-bias"):
        with pytest.raises(InputError):
            select(bad)
