"""The gap budget: how far each cause closes the misfit on held-out data, and the remainder.

A part of every interval is held out in turn (`diagnosis.model.folds`). The parameters of M0 and the amplitudes of the causes
come from the rest, with the remainder beside them. The errors of the prediction of the held-out part are whitened by their
covariance under the stated noise, so that all steps of the budget have one measure: their mean square, which is one for a
recording without misfit. The steps are the baseline M0, M0 with the first cause, with the first two, and so on. What is left
above one after the last cause is the remainder.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import scipy.linalg
import scipy.special

from diagnosis.answer import Closure
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.calibration import calibrate_with_columns
from diagnosis.model.folds import PARTS, RECORDING_SPLIT, ConditionedRows, assign_folds, condition_rows
from diagnosis.model.recording_model import RecordingModel
from diagnosis.replication import PartSize, estimate_by_part
from gyrocal.arrays import Array, Mask

DRAWS = 2000  # of the bootstrap over held-out parts
MATERIAL = 1.5  # of the stated sigma, from which an error of a held-out attitude matters to a user
FLOOR = 1.0  # whitened mean square of held-out errors under the stated noise

LEAST_TOTAL_MISFIT = 1e-9
FEWEST_CLUSTERS = 4  # intervals of a recording, over which a bootstrap is made


@dataclass(frozen=True)
class Step:
    """One step of the budget."""

    step: str  # "baseline", the label of a cause, "remainder" or "floor"
    misfit: float  # whitened mean square of the held-out errors once the step is done
    misfit_deg: float  # their RMS, deg
    closed: float | None = None  # share of the misfit between baseline and floor that this step closes
    interval_90: tuple[float, float] | None = None  # its 90 % interval
    probability: float | None = None  # probability, size, sigma, unit: of a cause
    size: float | None = None
    sigma: float | None = None
    unit: str | None = None
    by_part: tuple[PartSize, ...] = ()  # by_part, heterogeneity_p: sizes of a cause by part, see `diagnosis.replication`
    heterogeneity_p: float | None = None
    # spread, ramp: scatter of the sizes by part beyond their sigmas, and the sizes of a line over time at its two ends
    spread: float | None = None
    ramp: tuple[float, float] | None = None
    delta_G: Array | None = None  # delta_G, delta_bias_deg_s: (3, 3) and (3,) change of the calibration by this step
    delta_bias_deg_s: Array | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the step as in the documented format."""
        out = {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}
        out |= {name: list(out[name]) for name in ("interval_90", "ramp") if out[name] is not None}
        return {**out, "by_part": [vars(part).copy() for part in self.by_part]}


@dataclass(frozen=True)
class MisfitSize:
    """Error that a misfit adds to an attitude that is held out and predicted from the rest."""

    added_deg: float  # RMS beside the stated noise
    stated_deg: float  # RMS under the stated noise
    over_s: float  # length of a stretch that is held out, median

    @property
    def material(self) -> bool:
        """Whether the whole error exceeds the stated sigma by a half."""
        return float(np.hypot(self.added_deg, self.stated_deg)) > MATERIAL * self.stated_deg


def measure_misfit_size(budget: Sequence[Step], residuals: pd.DataFrame) -> MisfitSize | None:
    """Measure what the misfit of a budget does to a held-out attitude; None without a budget.

    Parameters
    ----------
    budget : its steps
    residuals : interval and t_s of the observations, a row each
    """
    if not budget or not budget[0].misfit > 0:
        return None
    before = budget[0]
    stated = before.misfit_deg / float(np.sqrt(before.misfit))
    length = residuals.groupby("interval")["t_s"].agg(np.ptp).median() / PARTS
    return MisfitSize(float(np.sqrt(max(before.misfit_deg**2 - stated**2, 0.0))), stated, float(length))


@dataclass(frozen=True)
class HeldOut:
    """Held-out errors of a sequence of explanations."""

    squares: Array  # (parts, steps) sums of whitened squares in each held-out part
    squares_deg2: Array  # (parts, steps) sums of squares, deg²
    dof: Array  # (parts,) held-out values
    interval: tuple[str, ...]  # (parts,) name of the interval of each

    @property
    def misfit(self) -> Array:
        """(steps,) whitened mean square."""
        return np.asarray(self.squares.sum(axis=0) / self.dof.sum())

    @property
    def misfit_deg(self) -> Array:
        """(steps,) RMS, deg."""
        return np.asarray(np.sqrt(self.squares_deg2.sum(axis=0) / self.dof.sum()))

    def closed(self, before: int, after: int, seed: int = 0) -> tuple[float, tuple[float, float]]:
        """Compute the share of the baseline's misfit that the steps between two close, and its 90 % interval.

        The interval is that of a bootstrap over the intervals of the recording, since parts of one share errors of G and random
        processes; over all parts where there are fewer than `FEWEST_CLUSTERS`. The percentiles of few values are expanded by
        Student's distribution (Hesterberg, American Statistician 69, 2015, section 5).
        """
        rng = np.random.default_rng(seed)
        _, cluster = np.unique(self.interval, return_inverse=True)
        if cluster.max() + 1 < FEWEST_CLUSTERS:
            cluster = np.arange(len(self.dof))
        count = int(cluster.max()) + 1
        misfits, closed_misfits = (
            np.bincount(cluster, values, count)
            for values in (self.squares[:, 0] - FLOOR * self.dof, self.squares[:, before] - self.squares[:, after])
        )
        picks = rng.integers(0, count, (DRAWS, count))
        total = max(float(misfits.sum()), LEAST_TOTAL_MISFIT)
        drawn_misfits = misfits[picks].sum(axis=1)
        shares = closed_misfits[picks].sum(axis=1) / np.where(
            np.abs(drawn_misfits) > LEAST_TOTAL_MISFIT, drawn_misfits, LEAST_TOTAL_MISFIT
        )
        tail = (
            float(scipy.special.ndtr(scipy.special.stdtrit(count - 1, 0.05) * np.sqrt(count / (count - 1))))
            if count > 1
            else 0.0
        )
        low, high = np.quantile(shares[drawn_misfits > 0], [tail, 1 - tail]) if (drawn_misfits > 0).any() else (-np.inf, np.inf)
        return float(closed_misfits.sum()) / total, (float(low), float(high))


def predict_held_out(
    model: RecordingModel,
    effects: Sequence[FittedEffect],
    unnamed: Sequence[FittedEffect] = (),
    sets: Sequence[Sequence[int]] | None = None,
) -> HeldOut:
    """Predict every held-out part by M0 alone, with the first effect, with the first two, and so on.

    Parameters
    ----------
    model : the recording
    effects : in the order of the budget
    unnamed : members of the remainder, which are in the model of the training data and predict nothing
    sets : places of the effects that are in the model at each step instead
    """
    sets = [range(count) for count in range(len(effects) + 1)] if sets is None else sets
    no_columns = np.zeros((model.size, 0))
    W = np.hstack([no_columns, *(fitted.columns * fitted.prior_sigma for fitted in effects)])
    remainder = np.hstack([no_columns, *(fitted.columns * fitted.prior_sigma for fitted in unnamed)])
    shifts = np.column_stack(
        [no_columns, *(fitted.shift for fitted in effects), sum((fitted.shift for fitted in unnamed), np.zeros(model.size))]
    )
    owner = np.repeat(np.arange(len(effects)), [effect.columns.shape[1] for effect in effects])
    return collect_held_out(
        model, _predict_parts(model, W, remainder, shifts, [np.isin(owner, chosen) for chosen in sets], sets)
    )


def _predict_parts(
    model: RecordingModel,
    W: Array,
    remainder: Array,
    shifts: Array,
    columns_in: Sequence[Mask],
    shifts_in: Sequence[Sequence[int]],
) -> Iterator[tuple[Mask, Array, Array]]:
    """Predict each part from columns of the effects, of the remainder, and shifts, one for each effect and one for the rest.

    At each step the chosen columns and shifts of the effects are in the model.
    """
    places = np.cumsum([0, W.shape[1], remainder.shape[1], shifts.shape[1]])
    columns = np.hstack([W, remainder, shifts])
    for out in list_parts(model):
        fold = condition_rows(model, columns, out)
        remainder_places = np.arange(places[1], places[2])
        errors = []
        for columns_of_step, shifts_of_step in zip(columns_in, shifts_in, strict=True):
            chosen = np.flatnonzero(columns_of_step)
            chosen_shifts = places[2] + np.array(shifts_of_step, dtype=int)
            A = fold.train_X[:, np.append(chosen, remainder_places)]
            y = fold.train_y - fold.train_X[:, np.append(chosen_shifts, places[3] - 1)].sum(axis=1)
            a = np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ y)[: chosen.size]
            errors.append(fold.error_y - fold.error_X[:, chosen] @ a - fold.error_X[:, chosen_shifts].sum(axis=1))
        e = np.column_stack(errors)
        yield out, e, whiten_prediction(fold, e)


def list_parts(model: RecordingModel) -> Iterator[Mask]:
    """List the rows (N,) of each part that is held out."""
    fold = np.repeat(assign_folds(model), 3)
    yield from (fold == number for number in np.unique(fold) if (fold != number).any())


def whiten_prediction(conditioned: ConditionedRows, errors: Array) -> Array:
    """Whiten errors (s, k) of a prediction by their covariance."""
    factor = np.linalg.cholesky(conditioned.covariance)
    return np.asarray(scipy.linalg.solve_triangular(factor, errors, lower=True, check_finite=False))


def collect_held_out(model: RecordingModel, predicted: Iterable[tuple[Mask, Array, Array]]) -> HeldOut:
    """Collect errors (s, steps) of predicted rows (N,), rad, and the same whitened, interval by interval."""
    squares, degrees, dof, names = [], [], [], []
    for out, errors, white in predicted:
        owner = np.repeat(model.observation_block, 3)[out]
        for number in np.unique(owner):
            mine = owner == number
            squares.append((white[mine] ** 2).sum(axis=0))
            degrees.append((np.rad2deg(errors[mine]) ** 2).sum(axis=0))
            dof.append(float(mine.sum()))
            names.append(model.recording.intervals[model.blocks[number].interval].name)
    return HeldOut(np.array(squares), np.array(degrees), np.array(dof), tuple(names))


def is_surely_closing(model: RecordingModel, effects: Sequence[FittedEffect], unnamed: Sequence[FittedEffect], k: int) -> bool:
    """Check whether the 90 % interval of the share that the k-th effect closes beside all others is above zero."""
    others = [place for place in range(len(effects)) if place != k]
    prediction = predict_held_out(model, effects, unnamed, [(), others, range(len(effects))])
    return prediction.closed(1, 2)[1][0] > 0


def summarise_closure(prediction: HeldOut) -> Closure:
    """Summarise how far all causes together close the misfit."""
    last = prediction.squares.shape[1] - 1
    closed, interval = prediction.closed(0, last)
    names = list(dict.fromkeys(prediction.interval))
    rows = [(name, np.array([interval_name == name for interval_name in prediction.interval])) for name in names]
    table = pd.DataFrame(
        {
            "interval": names,
            "before": [prediction.squares[mine, 0].sum() / prediction.dof[mine].sum() for _, mine in rows],
            "after": [prediction.squares[mine, last].sum() / prediction.dof[mine].sum() for _, mine in rows],
            "floor": [FLOOR] * len(names),
            "dof": [prediction.dof[mine].sum() for _, mine in rows],
        }
    )
    before, after = float(prediction.misfit[0]), float(prediction.misfit[last])
    return Closure("held-out whitened mean square", RECORDING_SPLIT, before, after, FLOOR, closed, interval, table)


def measure_causes(
    model: RecordingModel,
    effects: Sequence[FittedEffect],
    unnamed: Sequence[FittedEffect],
    probabilities: Sequence[float],
) -> tuple[HeldOut, tuple[Step, ...]]:
    """Measure causes on held-out data and by part.

    Parameters
    ----------
    model, effects, unnamed : as for `predict_held_out`
    probabilities : of each effect
    """
    prediction = predict_held_out(model, effects, unnamed)
    misfit, degrees = prediction.misfit, prediction.misfit_deg
    remainder = [(fitted.columns, fitted.prior_sigma) for fitted in unnamed]
    changes = [
        calibrate_with_columns(model, [*remainder, *((effect.columns, effect.prior_sigma) for effect in effects[:count])])[0]
        for count in range(len(effects) + 1)
    ]
    steps = [Step("baseline", float(misfit[0]), float(degrees[0]))]
    for k, (fitted, probability) in enumerate(zip(effects, probabilities, strict=True)):
        sizes = estimate_by_part(model, effects, unnamed, k)
        closed, interval = prediction.closed(k, k + 1)
        delta = changes[k + 1] - changes[k]
        steps.append(
            Step(
                fitted.label, float(misfit[k + 1]), float(degrees[k + 1]), closed, interval, probability, sizes.mean,
                max(sizes.sigma, fitted.sigma), fitted.unit, sizes.parts, sizes.heterogeneity_p, sizes.spread, sizes.ramp,
                delta[:9].reshape(3, 3), np.rad2deg(delta[9:]),
            )
        )  # fmt: skip
    unexplained = 1.0 - prediction.closed(0, len(effects))[0]
    low, high = prediction.closed(0, len(effects))[1]
    steps.append(Step("remainder", float(misfit[-1]), float(degrees[-1]), unexplained, (1 - high, 1 - low)))
    expected = float(degrees[-1] / np.sqrt(max(misfit[-1], FLOOR)))
    steps.append(Step("floor", FLOOR, expected))
    return prediction, tuple(steps)
