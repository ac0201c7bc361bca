"""Sizes of effects that are not linear in the rate, where they are a good part of it."""

import numpy as np

from diagnosis.inference.amplitudes import fit
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates

QUADRATIC = EFFECTS["scale_quadratic"]
DEG = np.deg2rad(1.0)


def turning(size_ppm, seed):
    """A body that turns at up to 20 deg/s about each axis, seen by a y gyro whose scale factor grows with the rate."""
    t_s = 0.1 * np.arange(12_000)
    rates = np.zeros((t_s.size, 3))
    for axis in range(3):
        fast = np.random.default_rng([axis, 4]).uniform(-20, 20, 15)
        rates[:, axis] = DEG * np.interp(t_s % 80, [0, 20, 30, 60, 70], [0, 0, 1, 1, 0]) * fast[(t_s // 80).astype(int)]
    made = of_rates(rates, 40, 0.1, 2e-6, 1e-3, seed)
    error = 1e-6 * size_ppm * np.rad2deg(np.abs(rates[:, 1])) * rates[:, 1]
    made.gyro.rates[:, 1] += error
    return prepare(made).model


def test_the_size_is_that_of_the_rate_without_the_effect():
    """Of two percent of the fastest turns: at the rates of M0 the column alone is off by about that much of itself."""
    size = -1000.0
    linear = build_linear_model(turning(size, 1), [QUADRATIC], rivals=False)
    entry = linear.candidates[linear.find("scale_quadratic:y")]
    member = SelectedCandidate(linear.find("scale_quadratic:y"), 0, int(np.argmin(np.abs(np.log(entry.scales / abs(size))))))
    found = fit(linear, [member])[0]
    assert abs(found.size - size) < 3.5 * found.sigma
    plain = float(linear.X[:, 0] @ linear.y / (linear.X[:, 0] @ linear.X[:, 0]))
    assert abs(plain - size) > 4 * found.sigma
