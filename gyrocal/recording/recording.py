"""A recording in memory: a gyro stream, reference attitudes and calibration intervals that fit together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import InputError
from gyrocal.recording import checks, trackers
from gyrocal.recording.names import TRIAD
from gyrocal.recording.parts import Attitudes, GyroStream, Interval, Orbit
from gyrocal.recording.sensor_tables import SensorTables
from gyrocal.recording.tables import frames

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Recording:
    """Everything the calibrator gets to see."""

    title: str
    epoch: str
    gyro: GyroStream
    attitudes: Attitudes
    intervals: tuple[Interval, ...]
    orbit: Orbit | None = None
    time_scale: str = "UTC"
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    sensors: SensorTables | None = None

    def __post_init__(self) -> None:
        checks.check_gyro(self.gyro)
        checks.check_intervals(self.intervals)
        checks.check_switched_on(self.gyro, self.intervals)
        if self.attitudes.t_s.size or not self.is_array:
            checks.check_attitudes(self.attitudes)
            checks.check_references(self.attitudes.t_s, self.intervals)
            trackers.check(self.attitudes)

    @property
    def is_array(self) -> bool:
        """Whether it has other gyros than x, y and z."""
        return self.gyro.names != TRIAD

    def switched_on(self, interval: int) -> NDArray[np.intp]:
        """Columns of the gyros that were on in an interval, by its number."""
        chosen = self.intervals[interval].gyros
        return np.array([k for k, name in enumerate(self.gyro.names) if chosen is None or name in chosen])

    @classmethod
    def from_arrays(
        cls,
        t_s: ArrayLike,
        rates: ArrayLike,
        reference_t_s: ArrayLike,
        quaternions: ArrayLike,
        *,
        sigma: ArrayLike,
        arw: float,
        sample_s: float | None = None,
        G: ArrayLike | None = None,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        intervals: Sequence[Interval] | None = None,
        title: str = "arrays",
        epoch: str = "2000-01-01T00:00:00",
        time_scale: str = "seconds of the arrays",
    ) -> Recording:
        """A recording of arrays.

        Parameters
        ----------
        t_s, rates : (n,) starts of the samples, s, and (n, k) raw rates of k gyros, rad/s
        reference_t_s, quaternions : (m,) s, and (m, 4) inertial to body, scalar last
        sigma : 1-sigma of the references per body axis, rad; (m, 3), (3,) or one number
        arw : angle random walk, rad/sqrt(s)
        sample_s : s; the median spacing by default
        G : (3, k) a-priori G, needed if k is not 3: the gyros are then named "1", "2", …
        bias : (3,) a-priori b, rad/s
        intervals : one over all references by default
        title, epoch, time_scale : of the recording

        Raises
        ------
        InputError
            Shapes do not fit, or the recording would not be valid.
        """
        from gyrocal.recording.arrays import from_arrays

        return from_arrays(
            t_s,
            rates,
            reference_t_s,
            quaternions,
            sigma=sigma,
            arw=arw,
            sample_s=sample_s,
            G=G,
            bias=bias,
            intervals=intervals,
            title=title,
            epoch=epoch,
            time_scale=time_scale,
        )

    @classmethod
    def from_frame(cls, gyro: pd.DataFrame, attitude: pd.DataFrame, *, arw_deg_per_sqrt_s: float, **options: Any) -> Recording:
        """A recording of two tables with the columns of the files, in degrees.

        Parameters
        ----------
        gyro : t_s, rate_x_deg_s … z
        attitude : t_s, q1 … q4, sigma_x_deg … z
        arw_deg_per_sqrt_s : angle random walk
        options : bias_deg_s, and what else `from_arrays` takes by name

        Raises
        ------
        InputError
            A column is missing, or the recording would not be valid.
        """
        from gyrocal.recording.arrays import from_frame

        return from_frame(gyro, attitude, arw_deg_per_sqrt_s=arw_deg_per_sqrt_s, **options)

    def to_frame(self, table: str = "gyro") -> pd.DataFrame:
        """A table with the columns of the files, in degrees.

        Parameters
        ----------
        table : "gyro", "attitude", or one of the optional tables that the recording has

        Raises
        ------
        InputError
            It has none of that name.
        """
        found = frames(self)
        if table not in found:
            raise InputError(f"{table}: no such table; there are {', '.join(found)}")
        return found[table].copy()

    def to_xarray(self) -> xarray.Dataset:
        """Rates, references and intervals as one labelled data set, in degrees; xarray is an optional extra.

        Raises
        ------
        InputError
            It is not installed.
        """
        from gyrocal.recording import arrays

        return arrays.to_xarray(self)

    def plot_allan(self, ax: Axes | None = None, *, interval: str | None = None) -> Axes:
        """Overlapping Allan deviation of the raw rates about each axis, deg/s, beside the stated angle random walk.

        Parameters
        ----------
        ax : to draw on; one of a new figure by default
        interval : of this interval with whatever moves in it; of the rests by default

        Raises
        ------
        InputError
            There is no rest, no such interval, or too few samples.
        """
        from gyrocal.allan.plot import plot_allan

        return plot_allan(self, ax, interval)

    def __repr__(self) -> str:
        from gyrocal.recording import arrays

        return arrays.text("Recording", arrays.facts(self))

    def _repr_html_(self) -> str:
        from gyrocal.recording import arrays

        return arrays.page("Recording", arrays.facts(self))
