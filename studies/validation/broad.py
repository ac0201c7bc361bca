"""A trial of BROAD, a MEMS gyro with an optical reference orientation, as a recording; see docs/validation.md.

The body frame is the sensor's. The inertial frame is replaced by the East-North-Up frame of the cameras, which turns with the
Earth: up to 0.0042 deg/s, which a bias absorbs only while the attitude is constant. Rates and attitudes keep the file's values
and time tags; errors that a diagnosis may look for are not corrected.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from numpy.typing import NDArray

from gyrocal import Attitudes, GyroStream, InputError, Interval, Recording
from gyrocal.arrays import Array, Mask
from gyrocal.importing.alignment import refine
from gyrocal.importing.estimates import ALLAN_S, compute_turns, count_walk_degrees, estimate_walk_at_rest
from gyrocal.importing.motion import build_motion
from gyrocal.importing.reference_sigma import ReferenceSigma, fit_reference_sigma
from gyrocal.mask_runs import find_mask_runs

IMU_RATE_COLUMNS = ("imu_gyr_x", "imu_gyr_y", "imu_gyr_z")
FORCE_COLUMNS = ("imu_acc_x", "imu_acc_y", "imu_acc_z")
OPTICAL_QUATERNION_COLUMNS = ("opt_quat_x", "opt_quat_y", "opt_quat_z", "opt_quat_w")  # scalar last, as everywhere here
MOVEMENT_COLUMN = "movement"
RATE_KEY = b"sampling_rate_hz"

BROAD_ATTRIBUTION = (
    'Data: D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A Benchmark for Robust Inertial Orientation Estimation", '
    "Data 6(7):72, 2021, doi:10.3390/data6070072; recorded by Kai Brands, converted by Daniel Laidig. "
    "Licence CC-BY-4.0; changed: raw gyro, specific force and a choice of the optical orientations in another format."
)
ASSUMED_EPOCH = "2000-01-01T00:00:00"  # the trials carry no date
TIME_SCALE = "seconds of the trial"
BROAD_NORM_TOLERANCE = 1e-3

REST_MARGIN_S = 2.0  # how far into the rests an interval reaches, or a third of the rest if that is less
LONG_S = 60.0  # a motion longer than this is cut
PIECE_S = 30.0  # into pieces of at most so long
STILL_S = 1.0  # rest counts as such so far from any movement
SHORTEST_REST_S = 3.0
OFFSET_STEP_S = 0.03  # between the orientations whose rates show a time offset
FEWEST_INCREMENTS = 12  # for a separate sigma at rest, or in motion


@dataclass(frozen=True)
class Trial:
    """The contents of a trial's file."""

    name: str  # the file's
    sample_s: float  # s between samples; sample k is tagged k sample_s
    rates: Array  # (n, 3) raw gyro, rad/s
    force: Array  # (n, 3) specific force by the accelerometer, m/s²
    quaternions: Array  # (n, 4) ENU to sensor frame, scalar last; NaN where not tracked
    moving: Mask  # (n,) inside a motion phase

    @property
    def t_s(self) -> Array:
        """(n,) time tags, s."""
        return np.arange(len(self.rates), dtype=np.float64) * self.sample_s

    @property
    def tracked(self) -> Mask:
        """(n,) whether there is an optical orientation."""
        return np.asarray(np.isfinite(self.quaternions).all(axis=1))

    @property
    def phases(self) -> list[tuple[int, int]]:
        """First and one past the last sample of each motion phase."""
        return find_mask_runs(self.moving)

    @cached_property
    def still(self) -> Mask:
        """(n,) at rest, and `STILL_S` from any movement."""
        margin = self.samples(STILL_S)
        still = np.ones(len(self.moving), dtype=bool)
        for first, stop in self.phases:
            still[max(first - margin, 0) : stop + margin] = False
        return still

    @property
    def rests(self) -> list[tuple[int, int]]:
        """First and one past the last sample of each rest."""
        return find_mask_runs(self.still)

    def samples(self, duration_s: float) -> int:
        """Return the number of samples in so many seconds, at least one."""
        return max(round(duration_s / self.sample_s), 1)


@dataclass(frozen=True)
class ImportedTrial:
    """A recording with its estimated noise."""

    recording: Recording
    sigma_rest: Array  # sigma_rest, sigma_motion: (3,) reference 1-sigma per body axis, rad
    sigma_motion: Array
    arw: Array  # (3,) angle random walk per axis, rad/sqrt(s)
    still: Mask  # (references,) whether each was taken at rest

    def summary(self) -> pd.DataFrame:
        """Summarise the import, a row for each quantity, in degrees."""

        def vector(values: Array, digits: int) -> str:
            return ", ".join(f"{value:.{digits}f}" for value in np.rad2deg(values))

        gyro, lengths = self.recording.gyro, [interval.stop_s - interval.start_s for interval in self.recording.intervals]
        rows = [
            ("gyro samples", f"{gyro.t_s.size} at {1 / gyro.sample_s:.2f} Hz"),
            ("intervals", f"{len(lengths)} of {min(lengths):.1f} to {max(lengths):.1f} s"),
            ("reference attitudes", f"{np.count_nonzero(~self.still)} in motion, {np.count_nonzero(self.still)} at rest"),
            ("their sigma at rest x, y, z", f"{vector(self.sigma_rest, 4)} deg"),
            ("their sigma in motion x, y, z", f"{vector(self.sigma_motion, 4)} deg"),
            ("angle random walk x, y, z", f"{vector(self.arw, 5)} deg/sqrt(s)"),
            ("bias from the first rest x, y, z", f"{vector(gyro.apriori_bias, 4)} deg/s"),
        ]
        return pd.DataFrame(rows, columns=["what", "value"])


def read(path: Path) -> Trial:
    """Read a trial; an `InputError` in one line if the file is not one."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; a BROAD trial is one Parquet file")
    try:
        table = pq.read_table(path)
        metadata = table.schema.metadata or {}
        frame = table.to_pandas()
    except Exception as fault:  # pyarrow raises many types for a damaged file
        raise InputError(f"{path}: cannot be read as Parquet: {' '.join(str(fault).split())}") from None
    required = (*IMU_RATE_COLUMNS, *FORCE_COLUMNS, *OPTICAL_QUATERNION_COLUMNS, MOVEMENT_COLUMN)
    missing = [name for name in required if name not in frame.columns]
    if missing:
        raise InputError(f"{path}: not a BROAD trial: column {', '.join(missing)} is missing")
    for name in required:
        as_bool, as_number = pd.api.types.is_bool_dtype(frame[name]), pd.api.types.is_numeric_dtype(frame[name])
        if as_bool != (name == MOVEMENT_COLUMN) or not as_number:  # bool counts as numeric
            raise InputError(f"{path}: column {name} holds {frame[name].dtype}")
    try:
        rate_hz = float(metadata[RATE_KEY])
    except (KeyError, ValueError):
        raise InputError(f"{path}: no number under {RATE_KEY.decode()} in the Parquet schema's metadata") from None
    if not 1 <= rate_hz <= 1e5:
        raise InputError(f"{path}: a sampling rate of {rate_hz:g} Hz cannot be meant")
    rates, force, quaternions = (
        np.ascontiguousarray(frame[list(names)].to_numpy(dtype=np.float64))
        for names in (IMU_RATE_COLUMNS, FORCE_COLUMNS, OPTICAL_QUATERNION_COLUMNS)
    )
    for quantity, values in (("gyro rate", rates), ("acceleration", force)):
        invalid = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if invalid.size:
            raise InputError(f"{path}: {quantity} in row {invalid[0]} is not a finite number ({invalid.size} such)")
    norm = np.linalg.norm(quaternions, axis=1)
    not_unit = np.flatnonzero(np.abs(norm - 1) > BROAD_NORM_TOLERANCE)  # False where not tracked
    if not_unit.size:
        k = not_unit[0]
        raise InputError(f"{path}: opt_quat in row {k} has norm {norm[k]:.6g}, not 1 ({not_unit.size} such)")
    # opt_quat takes sensor vectors to ENU: as_matrix() of it is A transposed, and A(q) is that for the same q.
    return Trial(path.stem, 1 / rate_hz, rates, force, quaternions / norm[:, None], frame[MOVEMENT_COLUMN].to_numpy(dtype=bool))


class TrialInterval(NamedTuple):
    """An interval of a trial, by its first and last sample."""

    name: str
    activity: str
    first: int
    last: int


def cut_trial(trial: Trial, intervals: str | float = "motion") -> list[TrialInterval]:
    """Cut a trial into intervals.

    Parameters
    ----------
    trial : the trial
    intervals : "motion", from the rest before each motion phase into the rest after it, a phase longer than `LONG_S` in
        touching pieces of at most `PIECE_S` and then with the rests as separate intervals; "whole", one interval over all; or
        a length in s, touching intervals of at most this length over rest and motion
    """
    tracked = np.flatnonzero(trial.tracked)
    if tracked.size == 0:
        raise InputError(f"{trial.name}: the optical orientation is nowhere tracked")
    first, last = int(tracked[0]), int(tracked[-1])
    if intervals == "whole":
        return [TrialInterval("whole", "whole trial", first, last)]
    if intervals == "motion":
        return _cut_around_motion(trial, first, last)
    if isinstance(intervals, str) or not (10 * trial.sample_s < intervals < np.inf):
        raise InputError(f"intervals: motion, whole, or a length of more than {10 * trial.sample_s:g} s, not {intervals}")
    parts = divide_evenly(first, last, trial.samples(intervals))
    return [TrialInterval(f"part {k}", "part", *part) for k, part in enumerate(parts, 1)]


def _cut_around_motion(trial: Trial, first: int, last: int) -> list[TrialInterval]:
    """Cut around each motion phase between two tracked samples.

    Each piece reaches into the rests by a margin. A phase longer than `LONG_S` is cut, and its rests are pieces of their own.
    """
    phases = [(a, b) for a, b in trial.phases if a > first and b < last]
    if not phases:
        raise InputError(f"{trial.name}: no motion phase with rest before and after it; choose other intervals")
    stops = [first, *(b for _, b in phases)]
    starts = [*(a for a, _ in phases), last]
    margin = [min(trial.samples(REST_MARGIN_S), (start - stop) // 3) for stop, start in zip(stops, starts, strict=True)]
    out: list[TrialInterval] = []
    for k, (a, b) in enumerate(phases):
        name, low, high = f"motion {k + 1}", a - margin[k], b + margin[k + 1]
        if (high - low) * trial.sample_s <= LONG_S:
            out.append(TrialInterval(name, "rest, motion, rest", low, high))
            continue
        if not out or out[-1].last <= stops[k]:  # otherwise the rest after the previous motion is this one
            out.append(TrialInterval(f"rest before {name}", "rest", stops[k], low))
        parts = divide_evenly(low, high, trial.samples(PIECE_S))
        out += [TrialInterval(f"{name} part {i}", "part of a long motion", *part) for i, part in enumerate(parts, 1)]
        end = starts[k + 1] - (0 if k + 1 == len(phases) else margin[k + 1])  # up to the margin of the next motion
        out.append(TrialInterval(f"rest after {name}", "rest", high, end))
    return out


def describe_time_offset(trial: Trial, attitude_offset_s: float = 0.0) -> tuple[str, ...]:
    """Describe the time offset of gyro and orientations by their rates; empty if no motion shows one."""
    rows = np.flatnonzero(trial.tracked)[:: trial.samples(OFFSET_STEP_S)]
    t_s = trial.t_s[rows] + attitude_offset_s
    windows = build_motion(trial.t_s, trial.rates, trial.sample_s, t_s, trial.quaternions[rows])
    alignment = None if windows is None else refine(windows, reverse=False, with_clock=False)
    return () if alignment is None else (alignment.describe_offset(),)


def divide_evenly(first: int, last: int, longest: int) -> list[tuple[int, int]]:
    """Divide first … last into equal touching pieces, none longer than `longest`."""
    count = max(-(-(last - first) // longest), 1)
    return [(int(a), int(b)) for a, b in pairwise(np.linspace(first, last, count + 1).round())]


def select_reference_samples(trial: Trial, cut: tuple[int, int], spacing_s: float) -> NDArray[np.intp]:
    """Select evenly spaced samples of an interval, or the nearest tracked ones at most half a step away."""
    first, last = cut
    count = max(round((last - first) * trial.sample_s / spacing_s), 1)
    targets = np.linspace(first, last, count + 1)
    tracked = np.flatnonzero(trial.tracked[first : last + 1]) + first
    if tracked.size == 0:
        return tracked
    nearest = tracked[[int(np.argmin(np.abs(tracked - target))) for target in targets]]
    is_close = np.abs(nearest - targets) <= 0.5 * (last - first) / count
    return np.unique(nearest[is_close])


def build_recording(
    trial: Trial, intervals: str | float = "motion", spacing_s: float = 1.0, attitude_offset_s: float = 0.0
) -> ImportedTrial:
    """Build a recording from a trial.

    Raises `InputError` if the trial has no rest, no motion or too few tracked orientations for the request.

    Parameters
    ----------
    trial : the trial
    intervals : see `cut_trial`
    spacing_s : s between the reference attitudes of an interval
    attitude_offset_s : by which the orientations are too early, s; the trial has no date, so the gyro's tags move back instead
    """
    if not trial.sample_s <= spacing_s < np.inf:
        raise InputError(f"the spacing of the references must be at least a sample, {trial.sample_s:g} s, not {spacing_s:g}")
    at_rest = [trial.rates[first:stop] for first, stop in trial.rests]
    arw = estimate_walk_at_rest(at_rest, trial.sample_s)
    if arw is None:
        raise InputError(f"{trial.name}: no rest of {3 * ALLAN_S:g} s to take the gyro noise from")
    long_rests = [rates for rates in at_rest if len(rates) * trial.sample_s >= SHORTEST_REST_S]
    if not long_rests:
        raise InputError(f"{trial.name}: no rest of {SHORTEST_REST_S:g} s to take the bias from")
    if not abs(attitude_offset_s) < trial.t_s[-1]:
        raise InputError(f"--attitude-offset {attitude_offset_s:g}: give s, less than the {trial.t_s[-1]:.6g} s of the trial")
    interval_rows = [
        (name, activity, select_reference_samples(trial, (first, last), spacing_s))
        for name, activity, first, last in cut_trial(trial, intervals)
    ]
    interval_rows = [(name, activity, rows) for name, activity, rows in interval_rows if rows.size >= 2]
    if not interval_rows:
        raise InputError(f"{trial.name}: no interval has two tracked orientations")
    gyro = GyroStream(
        t_s=trial.t_s - attitude_offset_s,
        rates=trial.rates,
        sample_s=trial.sample_s,
        arw=float(np.sqrt(np.mean(np.square(arw)))),
        apriori_bias=-long_rests[0].mean(axis=0),  # b of ω = G ω_raw + b with G = I
        arw_estimated=True,
        arw_degrees=count_walk_degrees(at_rest, trial.sample_s),
    )
    used = np.unique(np.concatenate([rows for _, _, rows in interval_rows]))
    still = trial.still[used]
    rest, motion = _estimate_reference_sigma(trial, gyro, spacing_s)
    sigma = np.where(still[:, None], rest.sigma, motion.sigma)
    columns = ["t_s", *(f"specific_force_{axis}_m_s2" for axis in "xyz")]
    recording = Recording(
        title=f"BROAD {trial.name} (CC-BY-4.0, doi:10.3390/data6070072)",
        epoch=ASSUMED_EPOCH,
        time_scale=TIME_SCALE,
        gyro=gyro,
        attitudes=Attitudes(trial.t_s[used], trial.quaternions[used], sigma, True, None, min(rest.degrees, motion.degrees)),
        intervals=tuple(
            Interval(name, activity, float(trial.t_s[rows[0]]), float(trial.t_s[rows[-1]]))
            for name, activity, rows in interval_rows
        ),
        tables={"housekeeping": pd.DataFrame(np.column_stack([gyro.t_s, trial.force]), columns=columns)},
    )
    return ImportedTrial(recording, rest.sigma, motion.sigma, arw, np.asarray(still))


def _estimate_reference_sigma(trial: Trial, gyro: GyroStream, spacing_s: float) -> tuple[ReferenceSigma, ReferenceSigma]:
    """Estimate the reference sigma at rest and in motion, from turns between references over the whole trial.

    If the gyro's noise hides that of the references over the spacing, the spacing is halved until it does not.
    """
    tracked = np.flatnonzero(trial.tracked)
    while spacing_s >= trial.sample_s:
        rows = select_reference_samples(trial, (int(tracked[0]), int(tracked[-1])), spacing_s)
        pairs = [(int(a), int(b)) for a, b in pairwise(rows) if (b - a) * trial.sample_s < 1.5 * spacing_s]
        if len(pairs) < FEWEST_INCREMENTS:
            raise InputError(f"{trial.name}: {len(pairs)} turns between tracked orientations {spacing_s:g} s apart are too few")
        turns = compute_turns(gyro, trial.t_s, trial.quaternions, pairs)
        at_rest = np.array([bool(trial.still[a : b + 1].all()) for a, b in pairs])
        estimates = []
        for mask in (at_rest, ~at_rest):
            selection = mask if np.count_nonzero(mask) >= FEWEST_INCREMENTS else np.ones_like(mask)
            estimates.append(fit_reference_sigma(turns.select(selection), gyro.arw, gyro.arw_degrees))
        if all(sigma.sigma.any() for sigma in estimates):
            return estimates[0], estimates[1]
        spacing_s /= 2
    raise InputError(f"{trial.name}: the references scatter less than the gyro over any time, so that they have no sigma")
