"""Predict held-out turns: how far a calibration by one part of a recording predicts the turns in the other part.

The intervals are dealt into blocks; a recording of fewer intervals than blocks has each cut at references. The turns of a block
are predicted with the parameters that a calibration finds in all other blocks. A turn leads from one reference to another, a
given time later. Its error is the rotation between the second reference and its prediction from the first one by gyro alone.
So it has the errors of both references in it, whatever the parameters are. Two other sets of parameters predict the same turns:
the a-priori ones, which are the gyro as it is stated, and these with the bias alone estimated.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from gyrocal import attitude
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.davenport import calibrate
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.errors import GyrocalError
from gyrocal.estimation.prediction_consistency import HORIZON_TOLERANCE
from gyrocal.recording import Interval, Recording, find_reference_rows

TURNS_S = (1.0, 10.0, 60.0)
HELD_OUT_BLOCKS = 4  # each is held out once
FEWEST_PIECE_REFERENCES = 3  # references of a piece of an interval
FEWEST_TURNS = 5  # of one length, for a root mean square
USUAL_TURN = 0.0  # stands for the usual time between two references of a piece
PARAMETER_SETS = ("calibrated", "bias_alone", "stated")
EQUAL_ERRORS = 0.05  # relative difference of two errors that counts as none


@dataclass(frozen=True)
class HeldOutTurns:
    """Errors of the predicted turns of one length: root mean squares of the angle, rad."""

    length_s: float  # s from the first to the second reference
    count: int  # number of turns
    # calibrated, bias_alone, stated: error with G and b of the other blocks, with their b alone, and as stated
    calibrated: float
    bias_alone: float
    stated: float
    references: float  # error that the stated sigmas of the two references make

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values, in degrees."""
        errors = {f"{name}_deg": float(np.rad2deg(getattr(self, name))) for name in (*PARAMETER_SETS, "references")}
        return {"turn_s": self.length_s, "count": self.count} | errors


def predict_held_out_turns(
    recording: Recording, lengths_s: Sequence[float] = TURNS_S, **options: Any
) -> tuple[HeldOutTurns, ...]:
    """Predict turns of given lengths, each by a calibration that has not used it.

    Returns one for each length with enough turns; none if too little remains to calibrate by.

    recording: gyro stream and reference attitudes
    lengths_s: of the turns, s; where no references are so far apart, the usual time between two of them
    options: of `gyrocal.calibrate`
    """
    pieces = _cut_intervals(recording)
    blocks = np.array_split(np.arange(len(pieces)), min(HELD_OUT_BLOCKS, len(pieces)))
    all_pieces = _select_pieces(recording, pieces)
    turns: dict[float, list[Array]] = {length: [] for length in (*lengths_s, USUAL_TURN)}
    for block in blocks if len(blocks) > 1 else []:
        other_pieces = [piece for k, piece in enumerate(pieces) if k not in block]
        try:
            parameter_sets = _estimate_parameter_sets(_select_pieces(recording, other_pieces), options)
            paths = [_propagate(all_pieces, parameters, options) for parameters in parameter_sets]
        except (GyrocalError, np.linalg.LinAlgError):  # the remaining blocks do not determine the parameters
            continue
        used = _find_rows(all_pieces, other_pieces)
        for k in block:
            for length, errors in turns.items():
                errors.append(_compare_turns(all_pieces, _find_rows(all_pieces, [pieces[k]]), used, paths, length))
    joined = {length: np.concatenate(errors) for length, errors in turns.items() if errors}
    sufficient = {length: errors for length, errors in joined.items() if len(errors) >= FEWEST_TURNS}
    chosen = [length for length in lengths_s if length in sufficient] or list(sufficient)
    return tuple(_summarise(sufficient[length], length) for length in chosen)


def _cut_intervals(recording: Recording) -> list[Interval]:
    """Cut the intervals into pieces if they are fewer than the blocks; no two pieces share a reference."""
    parts = -(-HELD_OUT_BLOCKS // len(recording.intervals))
    t_s = recording.attitudes.t_s
    out = []
    for interval in sorted(recording.intervals, key=lambda interval: interval.start_s):
        rows = find_reference_rows(t_s, interval)
        for k, piece in enumerate(np.array_split(rows, max(min(parts, rows.size // FEWEST_PIECE_REFERENCES), 1))):
            out.append(
                replace(interval, name=f"{interval.name} {k}", start_s=float(t_s[piece[0]]), stop_s=float(t_s[piece[-1]]))
            )
    return out


def _find_rows(recording: Recording, pieces: Sequence[Interval]) -> Indices:
    return np.unique(np.concatenate([find_reference_rows(recording.attitudes.t_s, piece) for piece in pieces]))


def _select_pieces(recording: Recording, pieces: Sequence[Interval]) -> Recording:
    """Select the recording with these intervals and their references alone."""
    references = recording.attitudes.select_rows(_find_rows(recording, pieces))
    return replace(recording, attitudes=references, intervals=tuple(pieces), tables={}, sensors=None)


def _estimate_parameter_sets(training: Recording, options: dict[str, Any]) -> tuple[GyroParameters, ...]:
    """Estimate parameters by the other blocks, by these with the bias alone, and take the stated ones."""
    bias_alone = options | {"solve_for": "bias", "parametrisation": "gain", "apriori_covariance": None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the calibration of the whole recording has them too
        calibrated = [calibrate(training, **option_set).parameters for option_set in (options, bias_alone)]
    return (*calibrated, GyroParameters(training.gyro.apriori_G, training.gyro.apriori_bias))


class _GyroPath(NamedTuple):
    """Attitudes propagated by gyro from one reference to others."""

    start: Indices  # (m,) row of the reference that each starts from
    row: Indices  # (m,) row of the reference at its time
    A: Array  # (m, 3, 3)


def _propagate(recording: Recording, parameters: GyroParameters, options: dict[str, Any]) -> _GyroPath:
    """Propagate the attitude from the first reference of each interval to the others."""
    sampling = {name: options[name] for name in ("step_s", "resampling", "max_gap_s") if name in options}
    prepared = prepare_measurements(recording, **sampling)
    theta = Problem.build(recording, prepared).state(parameters).theta
    observed = attitude.matrix_from_quaternion(recording.attitudes.quaternions[prepared.row])
    return _GyroPath(prepared.start, prepared.row, attitude.rotation_matrix(-theta) @ observed)


def _compare_turns(
    recording: Recording,
    rows: Indices,
    used: Indices,
    paths: Sequence[_GyroPath],
    length_s: float,
) -> Array:
    """Compare turns of a length between references that are not used, in the piece of these rows, with their prediction.

    Returns (n, 5) of each turn its length, s, the errors with each of the `PARAMETER_SETS` and the sigma of the references'
    own, rad.
    """
    attitudes = recording.attitudes
    t_s = attitudes.t_s[rows]
    turn_s = float(np.median(np.diff(t_s))) if length_s == USUAL_TURN and rows.size > 1 else length_s
    next_row = np.minimum(np.searchsorted(t_s, t_s + turn_s), rows.size - 1)
    previous_row = np.maximum(next_row - 1, 0)
    nearest = np.where(t_s + turn_s - t_s[previous_row] < t_s[next_row] - t_s - turn_s, previous_row, next_row)
    is_compared = (nearest > np.arange(rows.size)) & (np.abs(t_s[nearest] - t_s - turn_s) <= HORIZON_TOLERANCE * turn_s)
    is_compared &= ~np.isin(rows, used) & ~np.isin(rows[nearest], used)
    first, second = np.flatnonzero(is_compared), nearest[is_compared]
    A = attitude.matrix_from_quaternion(attitudes.quaternions[rows])
    errors = []
    for path in paths:
        in_piece = path.start == rows[0]
        A_gyro = A.copy()
        A_gyro[np.searchsorted(rows, path.row[in_piece])] = path.A[in_piece]
        predicted = A_gyro[second] @ A_gyro[first].transpose(0, 2, 1) @ A[first]
        errors.append(np.linalg.norm(attitude.residual(A[second], predicted), axis=1))
    variance = np.square(attitudes.sigma[rows]).sum(axis=1)
    return np.stack([t_s[second] - t_s[first], *errors, np.sqrt(variance[first] + variance[second])], axis=1)


def _summarise(turns: Array, length_s: float) -> HeldOutTurns:
    """Summarise turns (n, 5) by root mean squares."""
    usual = float(np.median(turns[:, 0])) if length_s == USUAL_TURN else length_s
    return HeldOutTurns(usual, len(turns), *np.sqrt(np.mean(np.square(turns[:, 1:5]), axis=0)).tolist())


def describe_held_out_turns(turns: Sequence[HeldOutTurns]) -> str:
    """Describe in one line how well held-out turns are predicted, beside the two other sets of parameters."""
    if not turns:
        return "Held-out prediction: none; it needs references in at least two blocks that share none."
    last_turns = turns[-1]
    lengths = ", ".join(f"{turn.length_s:.3g}" for turn in turns)
    errors = {
        name: ", ".join(f"{np.rad2deg(getattr(item, name)):.2g}" for item in turns) for name in (*PARAMETER_SETS, "references")
    }
    return (
        f"Held-out prediction: turns of {lengths} s to {errors['calibrated']} deg RMS; by the bias alone "
        f"{errors['bias_alone']}, by the gyro as stated {errors['stated']}; references' noise {errors['references']}. "
        f"The calibration is {_rank(last_turns.calibrated, last_turns.bias_alone)} the bias alone "
        f"and {_rank(last_turns.calibrated, last_turns.stated)} the gyro as stated."
    )


def _rank(error: float, reference_error: float) -> str:
    if error < (1 - EQUAL_ERRORS) * reference_error:
        return "better than"
    return "worse than" if error > (1 + EQUAL_ERRORS) * reference_error else "as good as"
