"""The linear model of raw sensor tables.

Each arc is fitted by itself, and what its thousands of measurements say of the effects is in the products of all columns with
one another and with the residuals z. From their Gram matrix with the nuisance parameters projected out, Q diag(λ) Qᵀ, the rows
diag(√λ) Qᵀ have the same products, so that each arc is a hundred rows of the model. The rows of all arcs stand one below the
other: an arc held out is a choice of rows, and a sensor that sits differently each day has columns for each arc by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.linalg
from scipy.special import chdtrc

from diagnosis.arrays import LEAST_POSITIVE
from diagnosis.model.candidates import place_candidates
from diagnosis.model.linear import CandidateColumns, Fold, LinearModel, build_rival
from diagnosis.model.sensors.arcs import FittedArc
from diagnosis.model.sensors.columns import HeldAmplitudes, build_groups
from diagnosis.settings import DiagnosisSettings
from gyrocal.arrays import Array, Indices
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect

FOLDS = 6  # of the arcs
MONTH = 30 * 86400.0  # s, unit of a drift
# signal-to-noise ratios: of thousands of measurements, about amplitudes that were found
VISIBLE = (1.0, 10000.0)
RANK = 1e-13  # relative eigenvalue of a Gram matrix, below which there is only rounding
SEEN = 1e-9  # relative singular value of all columns, below which one adds nothing to the others

TABLE_SPLIT = "days left out, a sixth of the arcs at a time"


@dataclass(frozen=True)
class Tables:
    """All arcs, in a few rows each."""

    # candidates with their columns (N, k) in sigmas, the nuisance parameters projected out
    groups: tuple[CandidateColumns, ...]
    y: Array  # (N,) residuals, the same way
    owner: Indices  # (N,) number of the arc of each row
    names: tuple[str, ...]  # names, t_s, dof: of each arc its interval, its middle, and its degrees of freedom
    t_s: Array
    dof: tuple[int, ...]


def build_tables(
    fits: Sequence[FittedArc], effects: Sequence[SensorEffect], about: Mapping[str, HeldAmplitudes] | None = None
) -> Tables:
    """Build columns and residuals of fitted arcs; effects that wander have their columns in any case.

    The amplitudes `about`, by label, were taken off the measurements before the arcs were fitted, and the errors are linearised
    about them; the residuals get their linear part back.
    """
    held = about or {}
    present = [effect for effect in SENSOR_EFFECTS.values() if effect in effects or effect.wanders]
    rows, dof = [], []
    for fitted in fits:
        groups = build_groups(fitted, present, held)
        gram, degrees = fitted.gram(np.hstack([part for group in groups for part in group.columns]))
        rows.append(_factor_gram(gram))
        dof.append(degrees)
    stacked = np.vstack(rows)
    amplitudes, placed_groups, start = np.zeros(stacked.shape[1] - 1), [], 0
    for group in groups:
        label = group.effect if group.axis is None else f"{group.effect}:{group.axis}"
        stops = start + np.cumsum([part.shape[1] for part in group.columns])
        if label in held:  # the first option is the one held
            amplitudes[start : stops[0]] = held[label].amplitudes
        columns = np.split(stacked[:, start : stops[-1]], stops[:-1] - start, axis=1)
        placed_groups.append(replace(group, columns=columns))
        start = int(stops[-1])
    return Tables(
        groups=tuple(placed_groups),
        y=stacked[:, -1] + stacked[:, :-1] @ amplitudes,
        owner=np.repeat(np.arange(len(rows)), [len(part) for part in rows]),
        names=tuple(fitted.arc.name for fitted in fits),
        t_s=np.array([float(fitted.path.t.mean()) for fitted in fits]),
        dof=tuple(dof),
    )


def _factor_gram(gram: Array) -> Array:
    """Factor a Gram matrix into rows (r, p) with these products; the columns are scaled to one length for the decomposition."""
    norms = np.sqrt(np.maximum(np.diag(gram), 0.0))
    unit = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    values, vectors = np.linalg.eigh(gram * np.outer(unit, unit))
    kept = values > RANK * values[-1]
    return np.asarray(np.sqrt(values[kept])[:, None] * vectors[:, kept].T * norms)


def build_sensor_model(tables: Tables, effects: Sequence[SensorEffect], settings: DiagnosisSettings) -> LinearModel:
    """Build the linear model, with the effects that may be named and all unlisted rivals as candidates."""
    groups = [group for group in tables.groups if not group.listed or SENSOR_EFFECTS[group.effect] in effects]
    candidates, W = place_candidates(
        [*groups, *_list_wander_groups(tables)], lambda columns: columns, settings, visible=VISIBLE
    )
    return LinearModel(
        y=tables.y,
        X=W,
        W=W,
        candidates=candidates,
        dof=sum(tables.dof),
        projected=lambda values: values,
        most_effects=settings.largest_sensor_set,
        split=TABLE_SPLIT,
        folds=partial(_build_arc_folds, tables),
    )


def _list_wander_groups(tables: Tables) -> Iterator[CandidateColumns]:
    """List rivals of sensors that are mounted differently each day, or drift through the months."""
    for group in tables.groups:
        if not group.listed or not SENSOR_EFFECTS[group.effect].wanders:
            continue
        sensor, (columns,) = SENSOR_EFFECTS[group.effect].sensor(group.axis), group.columns
        days = np.hstack([np.where(tables.owner[:, None] == k, columns, 0.0) for k in range(len(tables.names))])
        # The search looks at the first columns first. The prior of the amplitudes is the same for any rotation of them.
        _, turn = np.linalg.eigh(days.T @ days)
        months = (tables.t_s - tables.t_s.mean()) / MONTH
        yield build_rival(f"{sensor} sits differently each day", None, [days @ turn[:, ::-1]])
        yield build_rival(f"{sensor} drifts", None, [months[tables.owner][:, None] * columns])


def _build_arc_folds(tables: Tables, W: Array) -> Iterator[Fold]:
    """Build folds of a sixth of the arcs; each arc keeps its epoch attitude and bias, which no explanation may use."""
    for number in range(FOLDS):
        out = tables.owner % FOLDS == number
        if not out.any() or out.all():
            continue
        yield Fold(
            train_y=tables.y[~out],
            train_X=W[~out],
            left_y=tables.y[out],
            left_X=W[out],
            owner=np.array(tables.names)[tables.owner[out]],
            dof={tables.names[k]: float(tables.dof[k]) for k in np.unique(tables.owner[out])},
        )


@dataclass(frozen=True)
class Noise:
    """Noise of the sensors, from what all columns together, of effects and of rivals, leave."""

    factor: float = 1.0  # how many times it is what is stated; 1 unless it is surely more
    p_value: float = 1.0  # that noise as stated leaves that much; 1 if the factor is 1


def estimate_sensor_noise(model: LinearModel, settings: DiagnosisSettings) -> Noise:
    """Test by χ² whether the sensors' noise exceeds the stated one, after a fit of all columns together."""
    norms = np.linalg.norm(model.X, axis=0)
    inverse_norms = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    (triangle,) = scipy.linalg.qr(np.column_stack([model.X * inverse_norms, model.y]), mode="r", check_finite=False)
    A, b = triangle[:, :-1], triangle[:, -1]
    amplitudes, _, rank, _ = np.linalg.lstsq(A, b, rcond=SEEN)
    chi2, dof = float(np.sum((b - A @ amplitudes) ** 2)), model.dof - int(rank)
    p = max(float(chdtrc(dof, chi2)), LEAST_POSITIVE) if dof > 0 else 1.0
    return Noise(float(np.sqrt(chi2 / dof)), p) if p < settings.chi2_sensors else Noise()


def rescale_noise(model: LinearModel, factor: float) -> LinearModel:
    """Rescale a model to units of a larger noise, or chance would pass for evidence; candidates and their scales stay."""

    def folds(W: Array) -> Iterator[Fold]:
        for fold in model.folds(W):
            yield replace(fold, train_y=fold.train_y / factor, left_y=fold.left_y / factor)

    if factor == 1.0:
        return model
    return replace(model, y=model.y / factor, X=model.X / factor, W=model.W[:, :] / factor, folds=folds)
