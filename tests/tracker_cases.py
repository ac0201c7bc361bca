"""Small recordings with two star trackers."""

import numpy as np

import simulator

# A quarter of the references, and steps at which a slew is still followed to a fifth of the noise.
AGILE = simulator.override(simulator.load("agile_trackers"), {"gyro.sample_s": 1.0, "reference.every_s": 150.0})
TURNED_DEG = (0.01, -0.02, 0.03)
ESTIMATED = simulator.override(
    AGILE, {"reference.tracker.1.estimated": True, "reference.tracker.1.misalignment_deg": list(TURNED_DEG)}
)
TETRAHEDRON = {
    "axes": [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]],
    "scale_ppm": [900.0, -600.0, 300.0, -1200.0],
    "bias_deg_s": [1.2e-4, -0.8e-4, 2.0e-4, -1.5e-4],
}


def truth(scenario):
    """(12,) G and b, rad/s."""
    return np.concatenate([np.ravel(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s)])
