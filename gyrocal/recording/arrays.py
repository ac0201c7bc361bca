"""A recording from arrays and tables in memory, and what it looks like on a screen.

Arrays are in radians and seconds, tables in the columns of the files, in degrees; see docs/recording.md.
"""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal.errors import InputError
from gyrocal.recording import format as on_file
from gyrocal.recording.trackers import need_one_sensor

if TYPE_CHECKING:
    import pandas as pd
    import xarray

    from gyrocal.recording.format import Interval, Recording

Array = NDArray[np.float64]

LINES = 15  # of a repr, at most
NORM = 0.01  # a quaternion as far from the unit as this is rounded, one further off is wrong


def from_arrays(
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
    """See `gyrocal.Recording.from_arrays`."""
    tags, raw, when, q = (np.array(values, dtype=np.float64) for values in (t_s, rates, reference_t_s, quaternions))
    if raw.ndim != 2 or len(raw) != tags.size or tags.ndim != 1:
        raise InputError(f"rates must be (n, gyros) for n times, not {raw.shape} for {tags.shape}")
    if q.shape != (when.size, 4):
        raise InputError(f"quaternions must be (m, 4) for m times, not {q.shape} for {when.size}")
    wide = np.eye(3) if G is None else np.array(G, dtype=np.float64)
    if wide.shape != (3, raw.shape[1]):
        raise InputError(f"G must be 3×{raw.shape[1]}, a column for each gyro, not {'×'.join(map(str, wide.shape))}")
    names = on_file.TRIAD if raw.shape[1] == 3 else tuple(str(k + 1) for k in range(raw.shape[1]))
    norm = np.linalg.norm(q, axis=1, keepdims=True)
    bad = np.flatnonzero(~(np.abs(norm[:, 0] - 1) < NORM))
    if bad.size:
        raise InputError(f"quaternion {bad[0]} has norm {norm[bad[0], 0]:.6g}, not 1 ({bad.size} such)")
    if sample_s is None:
        if tags.size < 2:
            raise InputError("give sample_s: one sample does not tell it")
        sample_s = float(np.median(np.diff(tags)))
    spread = np.broadcast_to(np.array(sigma, dtype=np.float64), (when.size, 3)).copy()
    whole = (on_file.Interval("whole", "", float(when[0]), float(when[-1])),) if when.size else ()
    return on_file.Recording(
        title=title,
        epoch=epoch,
        time_scale=time_scale,
        gyro=on_file.GyroStream(tags, raw, sample_s, arw, wide, np.array(bias, dtype=np.float64), names),
        attitudes=on_file.Attitudes(when, q / norm, spread),
        intervals=whole if intervals is None else tuple(intervals),
    )


def from_frame(gyro: pd.DataFrame, attitude: pd.DataFrame, *, arw_deg_per_sqrt_s: float, **options: Any) -> Recording:
    """See `gyrocal.Recording.from_frame`."""
    for name, table, needed in (
        ("gyro", gyro, ("t_s", *on_file.RATE_COLUMNS)),
        ("attitude", attitude, ("t_s", *on_file.QUATERNION_COLUMNS, *on_file.SIGMA_COLUMNS)),
    ):
        missing = [column for column in needed if column not in table.columns]
        if missing:
            raise InputError(f"{name}: column {', '.join(missing)} is missing; found {', '.join(map(str, table.columns))}")
    if "bias_deg_s" in options:
        options["bias"] = np.deg2rad(np.asarray(options.pop("bias_deg_s"), dtype=np.float64))
    return from_arrays(
        gyro["t_s"].to_numpy(),
        np.deg2rad(gyro[list(on_file.RATE_COLUMNS)].to_numpy(dtype=np.float64)),
        attitude["t_s"].to_numpy(),
        attitude[list(on_file.QUATERNION_COLUMNS)].to_numpy(),
        sigma=np.deg2rad(attitude[list(on_file.SIGMA_COLUMNS)].to_numpy(dtype=np.float64)),
        arw=float(np.deg2rad(arw_deg_per_sqrt_s)),
        **options,
    )


def to_xarray(recording: Recording) -> xarray.Dataset:
    """See `gyrocal.Recording.to_xarray`."""
    try:
        import xarray
    except ImportError:
        raise InputError("to_xarray needs xarray: pip install 'gyrocal[xarray]'") from None
    gyro, attitudes = recording.gyro, recording.attitudes
    need_one_sensor(attitudes)
    seconds, deg_s = {"units": "s"}, {"units": "deg/s"}
    return xarray.Dataset(
        {
            "rate_deg_s": (("t_s", "gyro"), gyro.rates_deg_s, deg_s),
            "quaternion": (("reference_t_s", "element"), attitudes.quaternions, {"maps": "inertial to body, scalar last"}),
            "sigma_deg": (("reference_t_s", "body"), attitudes.sigma_deg, {"units": "deg"}),
            "apriori_G": (("body", "gyro"), gyro.apriori_G),
            "apriori_bias_deg_s": ("body", gyro.apriori_bias_deg_s, deg_s),
            "start_s": ("interval", [one.start_s for one in recording.intervals], seconds),
            "stop_s": ("interval", [one.stop_s for one in recording.intervals], seconds),
        },
        {
            "t_s": ("t_s", gyro.t_s, seconds),
            "reference_t_s": ("reference_t_s", attitudes.t_s, seconds),
            "gyro": list("xyz"),
            "body": list("xyz"),
            "element": list(on_file.QUATERNION_COLUMNS),
            "interval": [one.name for one in recording.intervals],
        },
        {
            "title": recording.title,
            "epoch": recording.epoch,
            "time_scale": recording.time_scale,
            "sample_s": gyro.sample_s,
            "arw_deg_per_sqrt_s": gyro.arw_deg_per_sqrt_s,
        },
    )


def facts(recording: Recording) -> list[tuple[str, str]]:
    """What a recording is, a row a quantity."""
    gyro, attitudes = recording.gyro, recording.attitudes
    lengths = [one.stop_s - one.start_s for one in recording.intervals]
    fastest = np.rad2deg(np.nanmax(np.abs(gyro.rates)) if recording.is_array else np.linalg.norm(gyro.rates, axis=1).max())
    sigma = np.rad2deg(np.sqrt(np.mean(np.square(attitudes.sigma), axis=0))) if attitudes.t_s.size else np.empty(0)
    rows = [
        ("title", recording.title),
        ("epoch", f"{recording.epoch} ({recording.time_scale})"),
        ("gyro", f"{gyro.t_s.size} samples of {gyro.sample_s:.6g} s, {gyro.t_s[0]:.6g} to {gyro.t_s[-1]:.6g} s"),
        *([("gyros", ", ".join(gyro.names))] if recording.is_array else []),
        ("fastest rate", f"{fastest:.4g} deg/s"),
        ("angle random walk", f"{np.rad2deg(gyro.arw):.4g} deg/sqrt(s)"),
        ("a-priori bias", f"{', '.join(f'{value:.4g}' for value in np.rad2deg(gyro.apriori_bias))} deg/s"),
        (
            "references",
            f"{attitudes.t_s.size}, sigma {', '.join(f'{value:.3g}' for value in sigma)} deg" if sigma.size else "none",
        ),
        *([("of sensors", ", ".join(one.name for one in attitudes.sensors))] if attitudes.sensors else []),
        ("intervals", f"{len(lengths)} of {min(lengths):.6g} to {max(lengths):.6g} s"),
    ]
    tables = [*recording.tables, *(["sensor tables"] if recording.sensors is not None else [])]
    return rows + ([("tables", ", ".join(tables))] if tables else [])


def text(name: str, rows: list[tuple[str, str]]) -> str:
    """A repr: a line for each fact."""
    width = max(len(label) for label, _ in rows)
    return "\n".join([name, *(f"  {label:<{width}}  {' '.join(value.split())[:100]}" for label, value in rows)][:LINES])


def page(name: str, rows: list[tuple[str, str]]) -> str:
    """The same as a table of HTML."""
    cells = "".join(f"<tr><th>{html.escape(label)}</th><td>{html.escape(value)}</td></tr>" for label, value in rows)
    return f"<table><caption>{html.escape(name)}</caption>{cells}</table>"
