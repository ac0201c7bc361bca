"""Gyro parameters: G and b, or bias, scale factor and two misalignments per gyro.

R (7): ω = G ω_raw + b, rows of G are body axes, columns gyros. The per-gyro form is that of N Table 3: the scale factor of
gyro i is G[i, i], its misalignment relative to body axis j is G[i, j] in radians, its bias b[i]. The two forms are one-to-one.
That gyro i owns row i holds to first order only; what a gyro itself does is in `gyrocal.calibration.gyro_space`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


AXIS_NAMES = ("x", "y", "z")
NAMES = tuple(f"G_{i}{j}" for i in AXIS_NAMES for j in AXIS_NAMES) + tuple(f"b_{i}" for i in AXIS_NAMES)
SCALE_FACTORS = tuple(f"G_{i}{i}" for i in AXIS_NAMES)
MISALIGNMENT_NAMES = tuple(f"G_{i}{j}" for i in AXIS_NAMES for j in AXIS_NAMES if i != j)
BIAS_NAMES = tuple(f"b_{i}" for i in AXIS_NAMES)


def list_parameter_groups(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """List names of groups of the twelve parameters: nine of a matrix by rows, then three biases."""
    return {
        "all": names,
        "bias": names[9:],
        "scale": names[:9:4],
        "misalignment": tuple(name for k, name in enumerate(names[:9]) if k % 4),
        **{f"gyro_{axis}": (*names[3 * i : 3 * i + 3], names[9 + i]) for i, axis in enumerate(AXIS_NAMES)},
    }


@dataclass(frozen=True)
class GyroParameters:
    """Calibration of a three-axis gyro, ω = G ω_raw + b.

    Attributes
    ----------
    G : (3, 3) dimensionless
    bias : (3,) b, rad/s
    """

    G: Array
    bias: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "G", np.array(self.G, dtype=float))
        object.__setattr__(self, "bias", np.array(self.bias, dtype=float))
        if self.G.shape != (3, 3) or self.bias.shape != (3,):
            raise InputError(f"G must be 3×3 and the bias of length 3, not {self.G.shape} and {self.bias.shape}")
        if not (np.isfinite(self.G).all() and np.isfinite(self.bias).all()):
            raise InputError("G and the bias must be finite")

    @classmethod
    def from_vector(cls, x: Array) -> GyroParameters:
        """Make parameters from a vector (12,) in the order of `NAMES`."""
        return cls(np.reshape(x[:9], (3, 3)), np.asarray(x[9:]))

    @property
    def vector(self) -> Array:
        """(12,) in the order of `NAMES`; G dimensionless, b in rad/s."""
        return np.concatenate([self.G.ravel(), self.bias])

    @property
    def bias_deg_s(self) -> Array:
        """(3,) b, deg/s."""
        return np.asarray(np.rad2deg(self.bias))

    @property
    def scale_factor(self) -> Array:
        """(3,) scale factor of each gyro, the diagonal of G."""
        return np.diag(self.G).copy()

    @property
    def misalignment(self) -> Array:
        """(3, 3) rad, [i, j] of gyro i relative to body axis j, zero on the diagonal."""
        return np.asarray(self.G - np.diag(np.diag(self.G)))

    def table(self) -> pd.DataFrame:
        """Tabulate the parameters in the form of N Table 3: a row a gyro; degrees and deg/s."""
        import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

        misalignment = np.rad2deg(self.misalignment)
        return pd.DataFrame(
            {
                "gyro": AXIS_NAMES,
                "bias_deg_s": np.rad2deg(self.bias),
                "scale_factor": self.scale_factor,
                **{f"misalignment_{j}_deg": misalignment[:, k] for k, j in enumerate(AXIS_NAMES)},
            }
        )


def select(names: str | Iterable[str], known: tuple[str, ...] = NAMES) -> tuple[str, ...]:
    """List the parameters to solve for, in the order of `known`.

    Parameters
    ----------
    names : names or groups ("all", "bias", "scale", "misalignment", "gyro_x", "gyro_y", "gyro_z"), as a sequence or
        separated by commas; a leading "-" removes a name or group: "all,-misalignment" is all but the misalignments
    known : the twelve names of the parametrisation

    Raises
    ------
    InputError
        A name is unknown, or no parameter is left.
    """
    parts = [part.strip() for part in names.split(",")] if isinstance(names, str) else list(names)
    groups = list_parameter_groups(known)
    chosen: set[str] = set()
    for part in parts:
        key = part.removeprefix("-")
        members = set(groups.get(key, (key,)))
        if not members <= set(known):
            raise InputError(f"unknown parameter {key!r}; known: {', '.join((*groups, *known))}")
        chosen = chosen - members if part.startswith("-") else chosen | members
    if not chosen:
        raise InputError("no parameter is left to solve for")
    return tuple(name for name in known if name in chosen)
