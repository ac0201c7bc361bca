"""ψ of N (11) over the angle turned in a step: the integral, its linear form, and what the paper prints for η."""

from pathlib import Path

import numpy as np
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

from gyrocal import psi_matrix
from studies.report.panels import BLUE, ORANGE, RED, TEAL, Line, draw_panels, make_curves, save

angles = np.logspace(-3, 0.5, 30)  # rad in one step of one second
axis = np.array([2.0, -1.0, 2.0]) / 3


def integral(angle):
    """∫₀¹ exp(−[ω×]τ) dτ."""
    return quad_vec(lambda tau: Rotation.from_rotvec(-angle * tau * axis).as_matrix(), 0.0, 1.0, epsabs=1e-14)[0]


truth = np.array([integral(angle) for angle in angles])
full, linear = (np.array([psi_matrix(angle * axis, 1.0, form) for angle in angles]) for form in ("full", "linear"))
off = {name: np.abs(one - truth).max(axis=(1, 2)) for name, one in (("full", full), ("linear", linear))}
mended, printed = 0.5 * (1 - np.sin(angles) / angles) / angles**2, 0.5 * (1 - np.sin(angles)) / angles**2

errors = [Line(angles, off["linear"], "linear ψ", ORANGE), Line(angles, np.fmax(off["full"], 1e-17), "full ψ", BLUE, "^-")]
eta = [Line(angles, printed, "as printed", RED), Line(angles, mended, "with ν(φ) = sin φ/φ", TEAL, "^-")]
axes = {"x": "angle in a step φ, rad", "log": "xy"}
figure = draw_panels(
    make_curves(errors, title="Error of ψ, per second", y="largest element", legend="upper left", **axes),
    make_curves(eta, title="η of N (11)", y="η", legend="upper right", **axes),
    size=(7.5, 3.0),
)
print(f"η at {angles[0]:.0e} rad: {mended[0]:.4f}, as printed {printed[0]:.0f}")
save(figure, Path("psi_of_a_step.svg"))
