import numpy as np
import pytest

from gyrocal import NAMES, InputError, select
from tests.builders import TRUTH


def test_table_has_the_flights_calibrated_values():
    # N Table 3 at 0.5 s and R eq. (9) are the same calibration.
    table = TRUTH.table()
    np.testing.assert_allclose(table["scale_factor"], [1.00044, 1.00053, 1.00088], atol=5e-6)
    np.testing.assert_allclose(table["misalignment_x_deg"], [0, 0.044, 0.054], atol=5.1e-4)
    np.testing.assert_allclose(table["misalignment_y_deg"], [-0.058, 0, 0.096], atol=5.1e-4)
    np.testing.assert_allclose(table["misalignment_z_deg"], [0.039, -0.124, 0], atol=5.1e-4)
    np.testing.assert_allclose(table["bias_deg_s"], [-1.55e-4, 1.98e-4, 0.78e-4], atol=5.1e-7)


def test_raw_inverts_rates():
    raw = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_allclose(TRUTH.raw(TRUTH.rates(raw)), raw, atol=1e-14)


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
