"""The recording, the attitudes of both trackers as they are, and what is known of the gyros beforehand.

Known beforehand of ω = G ω_raw + b, with ω_raw the least-squares rate of a regular tetrahedron turned to the trackers by the
import: the turn to `MOUNTING` (the rates hardly vary, so that the import finds it to a few degrees about the mean rate only),
the size of a count to `SCALE`, the tetrahedron's shape to `SHAPE`, and the biases to `BIAS_DEG_H`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal import Recording, attitude
from gyrocal.estimation.predict import prior_covariance
from gyrocal.importing import checked, import_csv, load_mapping
from gyrocal.importing.build import Imported
from gyrocal.importing.sensors import Together, together
from gyrocal.importing.streams import Streams, read_csv, streams

Array = NDArray[np.float64]

FOLDER = Path(__file__).parents[2] / "data" / "sentinel2a"
ATTRIBUTION = "Contains modified Copernicus Sentinel data 2020."
ARCSEC = float(np.rad2deg(1.0) * 3600)
LSB_RAD = 5e-9
MOUNTING, SCALE, SHAPE, BIAS_DEG_H = 0.05, 0.01, 1e-3, 1.0
WINDOW_S = 65.0  # to where there are attitudes


@dataclass(frozen=True)
class Flown:
    """What was imported.

    Attributes
    ----------
    imported : the recording, and what was assumed
    streams : both tables in SI units
    dense : both trackers together at every time of the first, 10 Hz
    """

    imported: Imported
    streams: Streams
    dense: Together

    @property
    def recording(self) -> Recording:
        """The recording."""
        return self.imported.recording

    @property
    def sigma(self) -> dict[str, Array]:
        """(3,) 1-sigma about each tracker's own axes, rad, by name."""
        return dict(self.dense.sigma)

    @property
    def mounting_covariance(self) -> Array:
        """(3, 3) of the mean that the second tracker's mounting is, rad²: of as many independent values as references."""
        (apart,) = self.dense.apart.values()
        return np.asarray(np.cov(apart.T) / self.recording.attitudes.t_s.size)

    def tracker(self, name: str) -> tuple[Array, Array]:
        """Times and attitudes (m, 3, 3) of a tracker's own axes."""
        one = next(sensor for sensor in self.streams.sensors if sensor.name == name)
        return one.t_s, attitude.matrix_from_quaternion(one.q)


@cache
def flown() -> Flown:
    """Import the data."""
    mapping = checked(load_mapping(FOLDER / "mapping.toml"), "mapping.toml")
    files = FOLDER / "imu.csv", FOLDER / "str.csv"
    tables = streams(read_csv(files[0]), read_csv(files[1]), mapping)
    return Flown(import_csv(*files, mapping=mapping), tables, together(tables.sensors, None, mapping.spacing_s or 0.0))


def known(mounting: bool = True, scale: bool = True, bias: bool = True) -> Array:
    """(12, 12) covariance of G and b beforehand; what is not to be fitted is held to a hundredth of a microradian, or deg/h."""
    held = 1e-8
    return prior_covariance(
        SHAPE if mounting and scale and bias else held,
        float(np.deg2rad((BIAS_DEG_H if bias else held) / 3600)),
        MOUNTING if mounting else held,
        SCALE if scale else held,
        np.eye(3),
    )
