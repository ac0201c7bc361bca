import numpy as np
import pytest

from gyrocal.errors import InputError
from gyrocal.sensors.series import SensorSeries
from tests.gyrocal.estimation.flights import DirectionSensor

MODEL = DirectionSensor((np.eye(3),), "tracker")


def series(**changes):
    values = {"t": np.array([0.0, 1.0, 3.0]), "y": np.zeros((3, 3)), "sigma": np.full((3, 3), 1e-3)} | changes
    return SensorSeries(MODEL, values["t"], values["y"], values["sigma"])


def changed(base, index, value):
    out = np.array(base, dtype=float)
    out[index] = value
    return out


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"t": np.arange(4.0)}, r"measurements must be \(4, 3\), not \(3, 3\)"),
        ({"t": np.array([0.0, 2.0, 2.0])}, "row 2: times must ascend, 2 s follows 2 s"),
        ({"sigma": changed(np.ones((3, 3)), (2, 0), 0.0)}, "row 2: sigma must be positive"),
        ({"y": changed(np.zeros((3, 3)), (0, 1), np.inf)}, "row 0: a measurement is not finite"),
    ],
)
def test_what_cannot_be_used_is_one_clear_line(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        series(**changes)
    assert str(caught.value).startswith("tracker: ")
