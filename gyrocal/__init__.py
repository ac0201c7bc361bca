"""In-flight gyro calibration: the Davenport scheme in transition-matrix form.

Papers
------
N : G. A. Natanson, "A Transition Matrix Approach to the Davenport Gyro Calibration Scheme", 1998.
R : B. Robertson et al., "On-Orbit Performance of the TRMM Mission Mode", 1999.

Conventions, everywhere in this project
---------------------------------------
Frames
    An attitude matrix A maps inertial components to body components; the LVLH frame has z to nadir, y against the orbit
    normal, x completing it (along the velocity of a circular orbit). x, y, z are also called roll, pitch, yaw.
Quaternions
    Inertial to body, scalar last, A(q) as in Wertz. scipy's `Rotation` is active: A(q) = Rotation.from_quat(q).inv().
Rates
    ω is the body's rate against inertial space in body axes, dA/dt = −[ω×] A, so A(t+Δt) = exp(−[ω×]Δt) A(t).
    Gyro equation, R (7): ω = G ω_raw + b; rows of G are body axes, columns gyros. +x forward flies at ω_y = −1 RPO.
Residual
    exp([θ×]) = A_obs A_propᵀ, N (16), and θ ≈ Θ Δx with Δx = x_adj − x_true: the correction is −Δx.
    N (29) as printed has the opposite sign; the linear form here has that of N (16).
Units
    SI and radians inside; degrees, deg/s and the like only at the edges (files, tables, figures), with the unit in the name.
    ARW is a root PSD: a sample's rate noise is arw / sqrt(sample_s).
Symbols
    G, b (bias), ω (omega), ψ (psi), R, Θ (Theta, the upper three rows of Φ̃), F, W, u, P, C as in N. V is the joint covariance
    of residuals that correlate.
"""

import logging as _logging
from importlib import import_module as _import_module
from importlib.util import find_spec as _find_spec
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

if _TYPE_CHECKING:
    from gyrocal.public import *  # noqa: F403

    __version__: str

_logging.getLogger("gyrocal").addHandler(_logging.NullHandler())  # a library is silent until its user listens


def __getattr__(name: str) -> _Any:
    """Load the public names at the first use of one: numba and scipy take most of a second."""
    if name == "__version__":
        from importlib.metadata import version  # late: it takes as long to load as all else here

        return version("gyrocal")
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module 'gyrocal' has no attribute {name!r}")
    if name != "__all__" and _find_spec(f"gyrocal.{name}") is not None:  # a module of the package is no public name
        return _import_module(f"gyrocal.{name}")
    public = vars(_import_module("gyrocal.public"))
    names = {key: value for key, value in public.items() if not key.startswith("_")}
    names["__all__"] = [*names, "__version__"]
    if name not in names:
        raise AttributeError(f"module 'gyrocal' has no attribute {name!r}")
    globals().update(names)
    return names[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__getattr__("__all__")})
