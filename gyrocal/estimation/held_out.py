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
from typing import Any

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
        """Plain values, in degrees."""
        errors = {f"{name}_deg": float(np.rad2deg(getattr(self, name))) for name in (*PARAMETER_SETS, "references")}
        return {"turn_s": self.length_s, "count": self.count} | errors


def predict_held_out_turns(
    recording: Recording, lengths_s: Sequence[float] = TURNS_S, **options: Any
) -> tuple[HeldOutTurns, ...]:
    """Predict turns of given lengths, each by a calibration that has not used it.

    Returns one for each length of which there are enough turns; none where too little is left to hold out.

    recording: gyro stream and reference attitudes
    lengths_s: of the turns, s; where no references are so far apart, the usual time between two of them
    options: of `gyrocal.calibrate`
    """
    pieces = _cut_intervals(recording)
    blocks = np.array_split(np.arange(len(pieces)), min(HELD_OUT_BLOCKS, len(pieces)))
    whole = _select_pieces(recording, pieces)
    turns: dict[float, list[Array]] = {length: [] for length in (*lengths_s, USUAL_TURN)}
    for block in blocks if len(blocks) > 1 else []:
        others = [piece for k, piece in enumerate(pieces) if k not in block]
        try:
            sets = _calibrate_without(_select_pieces(recording, others), options)
            paths = [_propagate(whole, parameters, options) for parameters in sets]
        except (GyrocalError, np.linalg.LinAlgError):  # what is left determines nothing
            continue
        used = _find_rows(whole, others)
        for k in block:
            for length, errors in turns.items():
                errors.append(_compare_turns(whole, _find_rows(whole, [pieces[k]]), used, paths, length))
    together = {length: np.concatenate(errors) for length, errors in turns.items() if errors}
    enough = {length: errors for length, errors in together.items() if len(errors) >= FEWEST_TURNS}
    chosen = [length for length in lengths_s if length in enough] or list(enough)
    return tuple(_summarise(enough[length], length) for length in chosen)


def _cut_intervals(recording: Recording) -> list[Interval]:
    """The intervals, or pieces of them where they are fewer than the blocks; no two pieces share a reference."""
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
    """The recording with these intervals and their references alone."""
    kept = recording.attitudes.select_rows(_find_rows(recording, pieces))
    return replace(recording, attitudes=kept, intervals=tuple(pieces), tables={}, sensors=None)


def _calibrate_without(others: Recording, options: dict[str, Any]) -> tuple[GyroParameters, ...]:
    """Parameters by the other blocks, by these with the bias alone, and as stated."""
    bias_alone = options | {"solve_for": "bias", "parametrisation": "gain", "apriori_covariance": None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the calibration of the whole recording has them too
        calibrated = [calibrate(others, **option_set).parameters for option_set in (options, bias_alone)]
    return (*calibrated, GyroParameters(others.gyro.apriori_G, others.gyro.apriori_bias))


def _propagate(recording: Recording, parameters: GyroParameters, options: dict[str, Any]) -> tuple[Indices, Indices, Array]:
    """Rows from which and to which each reference is propagated by gyro, and the attitudes there, (m, 3, 3)."""
    sampling = {name: options[name] for name in ("step_s", "resampling", "max_gap_s") if name in options}
    prepared = prepare_measurements(recording, **sampling)
    theta = Problem.build(recording, prepared).state(parameters).theta
    observed = attitude.matrix_from_quaternion(recording.attitudes.quaternions[prepared.row])
    return prepared.start, prepared.row, attitude.rotation_matrix(-theta) @ observed


def _compare_turns(
    recording: Recording,
    rows: Indices,
    used: Indices,
    paths: Sequence[tuple[Indices, Indices, Array]],
    length_s: float,
) -> Array:
    """Turns of a length in the piece of these rows, of references that are not used.

    Returns (n, 5) of each turn its length, s, the errors with each of the `PARAMETER_SETS` and the sigma of the references'
    own, rad.
    """
    attitudes = recording.attitudes
    t_s = attitudes.t_s[rows]
    wanted = float(np.median(np.diff(t_s))) if length_s == USUAL_TURN and rows.size > 1 else length_s
    after = np.minimum(np.searchsorted(t_s, t_s + wanted), rows.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(t_s + wanted - t_s[before] < t_s[after] - t_s - wanted, before, after)
    near = (nearest > np.arange(rows.size)) & (np.abs(t_s[nearest] - t_s - wanted) <= HORIZON_TOLERANCE * wanted)
    near &= ~np.isin(rows, used) & ~np.isin(rows[nearest], used)
    first, second = np.flatnonzero(near), nearest[near]
    A = attitude.matrix_from_quaternion(attitudes.quaternions[rows])
    errors = []
    for start, row, propagated in paths:
        is_inside = start == rows[0]
        P = A.copy()
        P[np.searchsorted(rows, row[is_inside])] = propagated[is_inside]
        predicted = P[second] @ P[first].transpose(0, 2, 1) @ A[first]
        errors.append(np.linalg.norm(attitude.residual(A[second], predicted), axis=1))
    variance = np.square(attitudes.sigma[rows]).sum(axis=1)
    return np.stack([t_s[second] - t_s[first], *errors, np.sqrt(variance[first] + variance[second])], axis=1)


def _summarise(turns: Array, length_s: float) -> HeldOutTurns:
    """Root mean squares of turns (n, 5)."""
    usual = float(np.median(turns[:, 0])) if length_s == USUAL_TURN else length_s
    return HeldOutTurns(usual, len(turns), *np.sqrt(np.mean(np.square(turns[:, 1:5]), axis=0)).tolist())


def describe_held_out_turns(turns: Sequence[HeldOutTurns]) -> str:
    """Say in one line how well held-out turns are predicted, beside the two other sets of parameters."""
    if not turns:
        return "Held-out prediction: none; it needs references in at least two blocks that share none."
    last = turns[-1]
    lengths = ", ".join(f"{turn.length_s:.3g}" for turn in turns)
    errors = {
        name: ", ".join(f"{np.rad2deg(getattr(item, name)):.2g}" for item in turns) for name in (*PARAMETER_SETS, "references")
    }
    return (
        f"Held-out prediction: turns of {lengths} s to {errors['calibrated']} deg RMS; by the bias alone "
        f"{errors['bias_alone']}, by the gyro as stated {errors['stated']}; references' noise {errors['references']}. "
        f"The calibration is {_rank(last.calibrated, last.bias_alone)} the bias alone "
        f"and {_rank(last.calibrated, last.stated)} the gyro as stated."
    )


def _rank(error: float, reference_error: float) -> str:
    if error < (1 - EQUAL_ERRORS) * reference_error:
        return "better than"
    return "worse than" if error > (1 + EQUAL_ERRORS) * reference_error else "as good as"
