"""A recording in memory: a gyro stream, reference attitudes and calibration intervals that fit together."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from gyrocal.errors import InputError
from gyrocal.recording import checks
from gyrocal.recording.parts import Attitudes, GyroStream, Interval, Orbit
from gyrocal.recording.sensor_tables import SensorTables
from gyrocal.recording.tables import build_frames

if TYPE_CHECKING:
    import pandas as pd

ROUNDED_NORM = 0.01  # largest deviation of a quaternion's norm from one by rounding; a larger one is an error
MOST_REPR_LINES = 15


@dataclass(frozen=True)
class Recording:
    """All data of a calibration; `without_references` it may have no references, and shows the gyro's noise only."""

    title: str
    epoch: str
    gyro: GyroStream
    attitudes: Attitudes
    intervals: tuple[Interval, ...]
    orbit: Orbit | None = None
    time_scale: str = "UTC"
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    sensors: SensorTables | None = None
    without_references: bool = False

    def __post_init__(self) -> None:
        checks.check_gyro(self.gyro)
        checks.check_intervals(self.intervals)
        if self.attitudes.t_s.size or not self.without_references:
            checks.check_attitudes(self.attitudes)
            checks.check_references(self.attitudes.t_s, self.intervals)

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
        G: ArrayLike = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        bias: ArrayLike = (0.0, 0.0, 0.0),
        intervals: Sequence[Interval] | None = None,
        title: str = "arrays",
        epoch: str = "2000-01-01T00:00:00",
        time_scale: str = "seconds of the arrays",
    ) -> Recording:
        """Build a recording of arrays; an `InputError` if shapes do not fit, or the recording would not be valid.

        Parameters
        ----------
        t_s, rates : (n,) starts of the samples, s, and (n, 3) raw rates, rad/s
        reference_t_s, quaternions : (m,) s, and (m, 4) inertial to body, scalar last
        sigma : 1-sigma of the references per body axis, rad; (m, 3), (3,) or one number
        arw : angle random walk, rad/sqrt(s)
        sample_s : s; the median spacing by default
        G : (3, 3) a-priori G
        bias : (3,) a-priori b, rad/s
        intervals : one over all references by default
        title, epoch, time_scale : of the recording
        """
        tags, raw, when, q = (np.array(values, dtype=np.float64) for values in (t_s, rates, reference_t_s, quaternions))
        if raw.ndim != 2 or len(raw) != tags.size or tags.ndim != 1:
            raise InputError(f"rates must be (n, 3) for n times, not {raw.shape} for {tags.shape}")
        if q.shape != (when.size, 4):
            raise InputError(f"quaternions must be (m, 4) for m times, not {q.shape} for {when.size}")
        norm = np.linalg.norm(q, axis=1, keepdims=True)
        bad = np.flatnonzero(~(np.abs(norm[:, 0] - 1) < ROUNDED_NORM))
        if bad.size:
            raise InputError(f"quaternion {bad[0]} has norm {norm[bad[0], 0]:.6g}, not 1 ({bad.size} such)")
        if sample_s is None:
            if tags.size < 2:
                raise InputError("give sample_s: one sample does not tell it")
            sample_s = float(np.median(np.diff(tags)))
        spread = np.broadcast_to(np.array(sigma, dtype=np.float64), (when.size, 3)).copy()
        whole = (Interval("whole", "", float(when[0]), float(when[-1])),) if when.size else ()
        return cls(
            title=title,
            epoch=epoch,
            time_scale=time_scale,
            gyro=GyroStream(tags, raw, sample_s, arw, np.array(G, dtype=np.float64), np.array(bias, dtype=np.float64)),
            attitudes=Attitudes(when, q / norm, spread),
            intervals=whole if intervals is None else tuple(intervals),
        )

    def to_frame(self, table: str = "gyro") -> pd.DataFrame:
        """Return the table "gyro", "attitude" or another one of the recording, with the columns of the files, in degrees.

        An `InputError` if there is no table of that name.
        """
        frames = build_frames(self.gyro, self.attitudes, self.tables, self.sensors)
        if table not in frames:
            raise InputError(f"{table}: no such table; there are {', '.join(frames)}")
        return frames[table].copy()

    def _list_facts(self) -> list[tuple[str, str]]:
        """List the facts of a recording, a row for each quantity."""
        gyro, attitudes = self.gyro, self.attitudes
        lengths = [interval.stop_s - interval.start_s for interval in self.intervals]
        fastest = np.rad2deg(np.linalg.norm(gyro.rates, axis=1).max())
        sigma = np.rad2deg(np.sqrt(np.mean(np.square(attitudes.sigma), axis=0))) if attitudes.t_s.size else np.empty(0)
        sigma_text = f", sigma {', '.join(f'{value:.3g}' for value in sigma)} deg"
        rows = [
            ("title", self.title),
            ("epoch", f"{self.epoch} ({self.time_scale})"),
            ("gyro", f"{gyro.t_s.size} samples of {gyro.sample_s:.6g} s, {gyro.t_s[0]:.6g} to {gyro.t_s[-1]:.6g} s"),
            ("fastest rate", f"{fastest:.4g} deg/s"),
            ("angle random walk", f"{np.rad2deg(gyro.arw):.4g} deg/sqrt(s)"),
            ("a-priori bias", f"{', '.join(f'{value:.4g}' for value in np.rad2deg(gyro.apriori_bias))} deg/s"),
            ("references", f"{attitudes.t_s.size}{sigma_text}" if sigma.size else "none"),
            ("intervals", f"{len(lengths)} of {min(lengths):.6g} to {max(lengths):.6g} s"),
        ]
        tables = [*self.tables, *(["sensor tables"] if self.sensors is not None else [])]
        return rows + ([("tables", ", ".join(tables))] if tables else [])

    def __repr__(self) -> str:
        return format_text("Recording", self._list_facts())

    def _repr_html_(self) -> str:
        return format_html("Recording", self._list_facts())


def format_text(name: str, rows: list[tuple[str, str]]) -> str:
    """Format facts as a repr with a line for each, at most `MOST_REPR_LINES`."""
    width = max(len(label) for label, _ in rows)
    return "\n".join(
        [name, *(f"  {label:<{width}}  {' '.join(value.split())[:100]}" for label, value in rows)][:MOST_REPR_LINES]
    )


def format_html(name: str, rows: list[tuple[str, str]]) -> str:
    """Format facts as a table of HTML."""
    cells = "".join(f"<tr><th>{html.escape(label)}</th><td>{html.escape(value)}</td></tr>" for label, value in rows)
    return f"<table><caption>{html.escape(name)}</caption>{cells}</table>"
