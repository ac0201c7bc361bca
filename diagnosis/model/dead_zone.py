"""The candidate "small rates read zero" of a recording: what the samples show of it, and the columns of what it hides.

The samples say where a slow reading is zero and how likely that is without a dead zone (`diagnosis.detectors.dead_zone_rests`);
that enters as the candidate's likelihood. In the attitude a rate is missing in those runs. The reading does not show that rate,
so it needs a number of its own in each run, and its evidence counts all of them: a drift, a step or an asymmetry, which need
one number, win over it wherever both explain the data. The rate that is missing is one that this axis usually has, which is the
scale of the amplitudes; a run in which the attitude denies such a rate speaks against the zone.

With m missing of the reading ω = G (ω_raw + m e) + b, and its column is along G e of the true G. M0 has to explain what is
missing, and its G is off; the product of m and of what that lacks is not linear in them (`estimate_input_axis`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.dead_zone_rests import MOST_PARTS, DeadZoneEvidence, estimate_half_width
from diagnosis.model.calibration import calibrate_beside
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linear import Parameters
from diagnosis.model.prepare import PreparedRecording
from diagnosis.model.processes import MOST_COLUMNS, SEEN
from diagnosis.model.recording_model import RecordingModel
from gyrocal.mask_runs import find_mask_runs
from simulator.effects.base import Effect
from simulator.effects.common import markov

Array = NDArray[np.float64]

AXES = "xyz"

# size of the motion inside the zone beside the rates that are missing, in usual rates
UNSEEN = (0.05, 0.15, 0.5)
MEMORY = 10.0  # time constant of that motion in cells, beside none: a body at rest drifts
ROUNDING = 1e-9  # of the variance of a motion, below which there is none
DIFFERENCE = 0.4  # usual size of the differences between runs beside what they have in common
SCALES = (0.003, 10.0)  # of the amplitudes, in usual rates
MOST_ODDS = 4.0  # that rests may give it: their model of the motion is a rough one, and the attitude must show it
MOST_PASSED = 25.0  # the same of passes through the zone
TRIALS = 3  # gyros
# Of the power of what a zone hides: a motion has a course of its own in each passage, and these have a level and a slope.
ROUGHNESS = 0.02
CALIBRATED = 3  # times that the input axis is found anew, with what is missing along the last one
FELT = 0.5  # sigmas that a usual rate must move the residuals by for what it hides to be a column of its own
LEAST_ODDS = -10.0  # that they may hold against it


def estimate_input_axis(model: RecordingModel, one: DeadZoneEvidence) -> Array:
    """(3,) change of the calibrated rate with that of the gyro, G e, as what the zone leaves of the readings tells it.

    M0 has to explain the missing rates with its G, which may be several percent off, and a rate that is missing acts along the
    true one. It is found as the calibration beside any rate that the zone may hide.
    """
    toward, usual = model.G[:, one.axis], float(np.rad2deg(one.usual))
    for _ in range(CALIBRATED):
        hidden = model.whiten(observe_missing_rates(model, one, toward))
        (beside,) = build_unseen_motion(model, one, toward)
        change, _ = calibrate_beside(model, [(hidden, usual), (beside, usual)])
        toward = model.G[:, one.axis] + change[:9].reshape(3, 3)[:, one.axis]
    return toward


def observe_missing_rates(model: RecordingModel, one: DeadZoneEvidence, toward: Array) -> Array:
    """Observations of a missing rate, deg/s: in all runs alike, and its difference in each; (N, shapes + runs).

    `toward` is the gyro's `estimate_input_axis`.
    """
    step = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    part = one.part[step]
    numbers = np.unique(part[(part >= 0) & (part < MOST_PARTS)])
    low = np.deg2rad(1.0) * np.column_stack([part >= 0, *(DIFFERENCE * (part == number) for number in numbers)])
    return model.observe_rate_error(toward[:, None] * low[:, None, :])


def bridge_passes(model: RecordingModel, one: DeadZoneEvidence, toward: Array) -> Array:
    """(N, 1) observations of the rate that a zone hides on a straight course between its edges, rad/s.

    The readings beside a run show the edges at which the motion entered and left. At an end of an interval it may be anywhere
    in the zone, in the middle on average.
    """
    gyro, course = model.recording.gyro, np.zeros(one.part.size)
    signs = np.sign(gyro.rates[:, one.axis])
    follows = np.append(False, np.diff(gyro.t_s) < 1.5 * gyro.sample_s)
    for low, high in find_mask_runs(one.part >= 0):
        enter = signs[low - 1] if follows[low] else 0.0
        leave = signs[high] if high < course.size and follows[high] else 0.0
        course[low:high] = one.alive * np.linspace(enter, leave, high - low)
    step = np.searchsorted(gyro.t_s, model.t_s, side="right") - 1
    return model.observe_rate_error(toward[:, None] * course[step][:, None, None])


def build_unseen_motion(
    model: RecordingModel,
    one: DeadZoneEvidence,
    toward: Array,
    sizes: Sequence[float] = UNSEEN[-1:],
    memories: Sequence[float] = (0.0,),
) -> list[Array]:
    """(N, r) whitened observations of a random rate, deg/s, in the slow part of each cell: a level, and a slope over it.

    A body that turns about other axes meanwhile turns the blind one with it: what is missing at the beginning of a passage has
    another direction than at its end. There are as many as sizes, times memories.
    """
    level, slope = map(model.whiten, _observe_cells(model, one, toward))
    run_s = model.cells.run_s
    parts: dict[float, tuple[Array, Array, Array]] = {}
    for memory in memories:
        columns = np.hstack([level, slope])
        if memory and run_s.size > 1:
            spread = markov(run_s, memory * float(np.median(np.diff(run_s)))) + ROUNDING * np.eye(run_s.size)
            columns[:, : run_s.size] = level @ np.linalg.cholesky(spread)
        columns = columns[:, np.any(columns != 0, axis=0)]
        parts[memory] = columns, *np.linalg.eigh(columns.T @ model.project_out_nuisance(columns))
    return [_select_seen(*parts[memory], size, one.usual) for size in sizes for memory in memories]


def _select_seen(columns: Array, powers: Array, turned: Array, size: float, usual: float) -> Array:
    """The directions (N, r) of columns of unit size that are seen at a size, by their powers (k,) and themselves (k, k)."""
    faint = min(SEEN * powers.max(initial=0.0), (FELT / (size * usual)) ** 2)
    seen = np.flatnonzero(powers > faint)[::-1][:MOST_COLUMNS]
    return np.asarray(columns @ turned[:, seen]) * np.deg2rad(size)


def _observe_cells(model: RecordingModel, one: DeadZoneEvidence, toward: Array) -> tuple[Array, Array]:
    """(N, c) observations of a missing rate in the slow part of each cell: a level, and a slope over it."""
    step = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    silent = one.part[step] >= 0
    level = silent.astype(float)
    low, high = model.cells.first, model.cells.last
    before = np.append(0, np.cumsum(silent))
    count = before[high] - before[low]
    place = np.repeat(np.arange(low.size), high - low)
    along = (before[:-1] - before[low][place] + 0.5) / np.maximum(count[place], 1)  # of the slow part of the cell
    return _integrate_cells(model, toward, level), _integrate_cells(model, toward, level * (2 * along - 1))


def _integrate_cells(model: RecordingModel, toward: Array, weights: Array) -> Array:
    """(N, c) observations of a reading that is too low by `weights` (n,) in the steps of one cell."""
    turned = (model.to_inertial @ toward) * (model.dt * weights)[:, None]
    total = np.vstack([np.zeros(3), np.cumsum(turned, axis=0)])
    out, low, high = np.zeros((model.size, model.cells.first.size)), model.cells.first, model.cells.last
    for number, block in enumerate(model.blocks):
        inside = np.flatnonzero(model.cells.interval == number)
        done = np.clip(block.steps.start + block.ends[:, None], low[inside], high[inside])
        added = block.average_references(np.moveaxis(total[done] - total[low[inside]], 2, 1))
        out[np.ix_(np.arange(block.rows.start, block.rows.stop), inside)] = added.reshape(-1, inside.size)
    return out


def bound_p_of_passes(dead: Sequence[DeadZoneEvidence]) -> float:
    """Bound on the p-value under M0 of what passes through a zone show, 1/(odds) averaged over all tried half widths."""
    return float(np.exp(-max((one.log_odds - np.log(TRIALS) for one in dead if one.passed), default=0.0)).clip(0.0, 1.0))


def list_dead_zone_groups(prepared: PreparedRecording, effects: Sequence[Effect]) -> Iterator[CandidateColumns]:
    """A candidate for each gyro that may have a dead zone, if an effect claims that symptom."""
    effect = next((one for one in effects if one.symptom == "dead_zone"), None)
    if effect is None:
        return
    # Each gyro could have had one beforehand, also those that show none.
    weight = effect.weight * len(prepared.dead) / len(AXES)
    for one in prepared.dead:
        yield replace(_group(prepared.model, one, effect), weight=weight)


def _group(model: RecordingModel, one: DeadZoneEvidence, effect: Effect) -> CandidateColumns:
    usual = float(np.rad2deg(one.usual))
    toward = estimate_input_axis(model, one)
    rates = model.whiten(observe_missing_rates(model, one, toward))
    course = [model.whiten(bridge_passes(model, one, toward))] if one.passed else []
    unseen = build_unseen_motion(model, one, toward, UNSEEN, (0.0, MEMORY))
    moving = [np.hstack([rates, part]) for part in unseen]
    count = rates.shape[1]

    def read(amplitudes: Array) -> tuple[float, Parameters]:
        return estimate_half_width(one, amplitudes[0] + DIFFERENCE * amplitudes[1:count])[0], {}

    return CandidateColumns(
        effect=effect.name,
        axis=AXES[one.axis],
        listed=True,
        columns=[np.hstack([part, *course]) for part in (rates, *moving)],
        parameters=[{} for _ in (rates, *moving)],
        weights=np.array([0.5, *(0.5 / len(moving) for _ in moving)]),
        limits=(max(effect.prior[0], SCALES[0] * usual), min(effect.prior[1], SCALES[1] * usual)),
        unit=effect.unit,
        log_odds=float(np.clip(one.log_odds, LEAST_ODDS, MOST_PASSED if one.passed else MOST_ODDS)),
        read=read,
        size_sigma=lambda size: estimate_half_width(one, np.array([size]))[1],
        roughness=ROUGHNESS,
        shifted=one.passed,
        loudest=np.inf,  # each of hundreds of amplitudes is that large, and a smaller scale would hold all of them back
    )
