"""Propose an effect outside the library: the remainder as a smooth function of one regressor.

The error about each body axis is a function f(r) of a regressor r (`simulator.effects.regressors`). It is an addition to the
readings, a share of the own rate, or an error of the references. f is linear between a few knots. Its values there have
the prior covariance

    τ² (4 (u − ½)(u′ − ½) + ν m² (3M − m)/6),    m = min(u, u′),  M = max(u, u′)

with u the place between the outer knots, 0 to 1. The second term is that of an integrated Wiener process, whose posterior mean
is the smoothing spline with a penalty on f″² (Wahba, Spline Models for Observational Data, 1990, section 1.5). Axes, τ and ν
are those of the largest evidence

    log E = ½ Σ_j (τ² c_j²/(1 + τ² w_j) − log(1 + τ² w_j))

with w and c the eigenvalues of the products of the whitened columns in units of the prior, and the observations along them.

Nested cross-validation guards against the freedom of the choice. An eighth of each interval is held out at a time
(`diagnosis.model.folds`). Regressor, axes, penalty and values come from the rest, with the remainder in its noise, and predict
that part. The remainder is estimated beside the best shape of the whole recording, since it else absorbs the function. A draft
is accepted if the 90 % interval of the share of the misfit that the predictions close lies above zero, and if its evidence
exceeds that of a larger remainder in its place, all regressors counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.budget import collect_held_out, convert, list_parts, whiten_prediction
from diagnosis.model.folds import SETTINGS as FOLDS
from diagnosis.model.folds import condition_rows, reverse_whitening
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.remainder import add_remainder, build_processes, estimate_remainder
from diagnosis.remainder_search import BesideRemainder
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator.effects.regressors import Regressor, list_regressors, tabulate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AXES_TRIED = tuple(axes for count in (1, 2, 3) for axes in combinations(range(3), count))
DRAFT_UNITS = {"gyro": ("deg/h", np.deg2rad(1.0) / 3600), "scale": ("ppm", 1e-6), "reference": ("deg", np.deg2rad(1.0))}


@dataclass(frozen=True)
class DraftSettings:
    """Settings of a draft."""

    knots: int = 12  # of a function
    ends: tuple[float, float] = (0.001, 0.999)  # quantiles of the regressor at the outer knots
    # signal-to-noise ratios of the whole function, from which τ follows
    snr: tuple[float, ...] = tuple(np.geomspace(2.0, 300.0, 10).tolist())
    bends: tuple[float, ...] = (1.0, 30.0, 1000.0, 30000.0)  # ν
    evidence: float = 6.0  # least log of the odds against a larger remainder; fewer than one in 400 by chance
    tied: float = 5.0  # log evidence within which two regressors are not distinguished


SETTINGS = DraftSettings()


@dataclass(frozen=True)
class Shape:
    """Functions of one regressor about all axes.

    Attributes
    ----------
    kind : "gyro" for an addition to the readings, "scale" for a share of the own rate, "reference" for an error of these
    regressor : what they follow
    knots : (k,) in its unit
    weights : (k,) time that each knot stands for, which makes a mean over the recording
    columns : (N, 3k) observations of unit values at the knots, axis by axis, not whitened
    """

    kind: str
    regressor: Regressor
    knots: Array
    weights: Array
    columns: Array

    @property
    def name(self) -> str:
        """Name of the effect."""
        return f"draft_{'' if self.kind == 'gyro' else self.kind + '_'}{self.regressor.name}"


@dataclass(frozen=True)
class Choice:
    """Functions of one shape at the largest evidence.

    Attributes
    ----------
    shape : number of the shape
    log_evidence : mean over axes, τ and ν, relative to no function
    values : (3k,) posterior mean
    root : (3k, q) root of the prior covariance
    """

    shape: int
    log_evidence: float
    values: Array
    root: Array


@dataclass(frozen=True)
class Draft:
    """A proposed effect.

    Attributes
    ----------
    name : of the effect
    kind, regressor : see `Shape`
    knots : (k,) in the unit of the regressor
    values, sigmas : (k, 3) about each body axis in `unit`
    unit : deg/h, ppm of the rate, or deg
    sigma : of a common factor of all values
    closed, interval_90 : share of the held-out misfit of M0 that it closes beyond the identified effects, 90 % interval
    tied : names of other drafts that the recording does not distinguish from it
    """

    name: str
    kind: str
    regressor: Regressor
    knots: Array
    values: Array
    sigmas: Array
    unit: str
    sigma: float
    closed: float
    interval_90: tuple[float, float]
    tied: tuple[str, ...] = ()


def suggest_draft(stated: RecordingModel, beside: BesideRemainder) -> Draft | None:
    """Propose a function of one regressor for the remainder.

    Parameters
    ----------
    stated : the recording with the stated noise
    beside : the remainder, and the effects identified beside it, which are taken out

    Returns
    -------
    None where no function of a regressor predicts held-out data better
    """
    shift = sum((one.shift for one in beside.fitted), np.zeros(stated.size))  # what the effects add beside their columns
    left = stated.zeta - reverse_whitening(beside.model, beside.model.undo_mounting_whitening(shift))
    stated, noisy = replace(stated, zeta=left), replace(beside.model, zeta=left)
    shapes = list(build_shapes(stated))
    if not shapes:
        return None
    causes = np.hstack([np.zeros((stated.size, 0)), *(one.columns * one.prior_sigma for one in beside.fitted)])
    free = np.linalg.qr(noisy.project_out_nuisance(causes))[0]
    whitened = noisy.whiten(np.hstack([one.columns for one in shapes]))
    ranked = rank_shapes(
        shapes, _remove_directions(free, noisy.project_out_nuisance(whitened)), _remove_directions(free, noisy.y)
    )
    known, processes = convert(noisy, stated, causes), build_processes(stated)
    without = estimate_remainder(stated, processes, known)
    best = shapes[ranked[0].shape]
    remainder = estimate_remainder(stated, processes, np.hstack([known, stated.whiten(best.columns) @ ranked[0].root]), without)
    log_odds = remainder.log_likelihood - without.log_likelihood - float(np.log(len(shapes)))
    if log_odds < SETTINGS.evidence:
        return None
    final = add_remainder(stated, remainder)
    closed, interval = collect_held_out(stated, _predict_parts(stated, final, shapes, known)).closed(1, 2)
    if not interval[0] > 0:
        return None
    free = np.linalg.qr(final.project_out_nuisance(convert(stated, final, known)))[0]
    X, y = _remove_directions(free, final.whiten_and_project(best.columns)), _remove_directions(free, final.y)
    tied = [shapes[one.shape].name for one in ranked[1:] if one.log_evidence > ranked[0].log_evidence - SETTINGS.tied]
    return replace(_fit_draft(best, X, y, closed, interval), tied=tuple(tied))


def _remove_directions(basis: Array, columns: Array) -> Array:
    """Take the directions of an orthonormal basis out of columns."""
    return np.asarray(columns - basis @ (basis.T @ columns))


# ---- shapes --------------------------------------------------------------------------------------------------------------


def build_shapes(model: RecordingModel) -> Iterator[Shape]:
    """Build the functions of each regressor that changes in a recording."""
    stream, references = model.stream, model.references
    for one in list_regressors(stream).values():
        values = one.compute()
        knots = place_knots(values, stream.duration_s)
        if knots is None:
            continue
        hats = tabulate(values, knots, np.eye(SETTINGS.knots))
        weights = hats.T @ stream.duration_s
        yield Shape("gyro", one, knots, weights, model.reading(_expand_axes(hats)))
        if not one.name.startswith(("rate_", "speed", "acceleration_")):
            scaled = _expand_axes(hats) * stream.rates[:, :, None]
            yield Shape("scale", one, knots, weights, model.reading(scaled))
    for one in list_regressors(references).values():
        values = one.compute()
        knots = place_knots(values, np.ones(values.size))
        if knots is not None:
            hats = tabulate(values, knots, np.eye(SETTINGS.knots))
            yield Shape("reference", one, knots, hats.sum(axis=0), model.observe_reference_error(_expand_axes(hats)))


def place_knots(values: Array, weights: Array) -> Array | None:
    """Place knots (k,) half evenly and half by quantiles of values (n,) with weights (n,); None for constant values."""
    order = np.argsort(values)
    mass = np.cumsum(weights[order])
    quantiles = np.interp(np.linspace(*SETTINGS.ends, SETTINGS.knots), (mass - 0.5 * weights[order]) / mass[-1], values[order])
    even = np.linspace(quantiles[0], quantiles[-1], SETTINGS.knots)
    changes = np.isfinite(quantiles).all() and even[-1] - even[0] > 1e-9 * np.abs(even).max()
    return np.asarray(0.5 * (quantiles + even)) if changes else None


def _expand_axes(hats: Array) -> Array:
    """Put functions (n, k) on each axis by itself, (n, 3, 3k)."""
    out = np.zeros((len(hats), 3, 3 * hats.shape[1]))
    for axis in range(3):
        out[:, axis, axis * hats.shape[1] : (axis + 1) * hats.shape[1]] = hats
    return out


# ---- choice --------------------------------------------------------------------------------------------------------------


def rank_shapes(shapes: Sequence[Shape], X: Array, y: Array) -> list[Choice]:
    """Rank the shapes by their evidence, from whitened columns (N, p) of all of them and observations (N,)."""
    starts = np.cumsum([0, *(one.columns.shape[1] for one in shapes)])
    own = [X[:, a:b] for a, b in pairwise(starts)]
    found = [fit_shape(k, one.knots, own[k].T @ own[k], own[k].T @ y) for k, one in enumerate(shapes)]
    return sorted(found, key=lambda one: -one.log_evidence)


def fit_shape(number: int, knots: Array, gram: Array, along: Array) -> Choice:
    """Fit the functions of one shape from the products of its columns (3k, 3k) and with the observations (3k,)."""
    k, best, evidences, kept = knots.size, -np.inf, [], None
    for bend in SETTINGS.bends:
        root = _build_prior_root(knots, bend)
        for axes in AXES_TRIED:
            R = np.zeros((3 * k, root.shape[1] * len(axes)))
            for place, axis in enumerate(axes):
                R[axis * k : (axis + 1) * k, place * root.shape[1] : (place + 1) * root.shape[1]] = root
            w, V = np.linalg.eigh(R.T @ gram @ R)
            w, c = np.maximum(w, 0.0), V.T @ (R.T @ along)
            if w[-1] <= 0:
                continue
            scales = (np.square(SETTINGS.snr) / w[-1])[:, None]
            each = 0.5 * (scales * c**2 / (1 + scales * w) - np.log1p(scales * w)).sum(axis=1)
            evidences.append(each)
            if each.max() > best:
                best, tau2 = float(each.max()), float(scales[each.argmax(), 0])
                kept = (tau2 * R @ (V @ (c / (1 + tau2 * w))), np.sqrt(tau2) * R)
    if kept is None:
        return Choice(number, -np.inf, np.zeros(3 * k), np.zeros((3 * k, 0)))
    total = np.concatenate(evidences)
    return Choice(number, float(logsumexp(total) - np.log(total.size)), *kept)


def _build_prior_root(knots: Array, bend: float) -> Array:
    """(k, k) root of the prior covariance at τ = 1, see the module."""
    u = (knots - knots[0]) / (knots[-1] - knots[0])
    low, high = np.minimum.outer(u, u), np.maximum.outer(u, u)
    values, vectors = np.linalg.eigh(4 * np.outer(u - 0.5, u - 0.5) + bend * low**2 * (3 * high - low) / 6)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


# ---- held-out data -------------------------------------------------------------------------------------------------------


def _predict_parts(
    stated: RecordingModel, noisy: RecordingModel, shapes: Sequence[Shape], causes: Array
) -> Iterator[tuple[Mask, Array, Array]]:
    """Choose a shape without each part of the intervals, and predict that part by M0, with the effects, and with the shape.

    Effects that are identified beside the remainder are nuisance parameters. Their columns `causes` (N, q) are whitened by the
    stated noise, in units of priors.
    """
    known = causes / (FOLDS.broad * PLAUSIBLE_RANGE[-1])  # which `condition_rows` multiplies by
    causes = convert(stated, noisy, known)
    whitened = noisy.whiten(np.hstack([one.columns for one in shapes]))
    for out in list_parts(stated):
        learnt = condition_rows(noisy, whitened, out, causes)
        choice = rank_shapes(shapes, learnt.train_X, learnt.train_y)[0]
        told = condition_rows(stated, stated.whiten(shapes[choice.shape].columns), out, known)
        alone = condition_rows(stated, np.zeros((stated.size, 0)), out)
        change = told.error_X @ choice.values if choice.log_evidence > 0 else np.zeros(told.error_y.size)
        errors = np.column_stack([alone.error_y, told.error_y, told.error_y - change])
        yield out, errors, np.column_stack([whiten_prediction(alone, errors[:, :1]), whiten_prediction(told, errors[:, 1:])])


# ---- the draft -----------------------------------------------------------------------------------------------------------


def _fit_draft(shape: Shape, X: Array, y: Array, closed: float, interval_90: tuple[float, float]) -> Draft:
    """Fit the values of the chosen shape to all data (N, 3k) and (N,), and take out what G and b take up."""
    found = fit_shape(0, shape.knots, X.T @ X, X.T @ y)
    seen = X @ found.root
    covariance = found.root @ np.linalg.solve(np.eye(seen.shape[1]) + seen.T @ seen, found.root.T)
    unit, scale = DRAFT_UNITS[shape.kind]
    centred = build_centering(shape)
    values = centred @ found.values.reshape(3, -1).T / scale
    own = covariance.reshape(3, shape.knots.size, 3, shape.knots.size)
    variances = np.column_stack([np.diag(centred @ own[axis, :, axis] @ centred.T) for axis in range(3)])
    sigmas = np.sqrt(np.maximum(variances, 0.0)) / scale
    sigma = 1 / max(float(np.linalg.norm(X @ found.values)), 1e-300)
    return Draft(shape.name, shape.kind, shape.regressor, shape.knots, values, sigmas, unit, sigma, closed, interval_90)


def build_centering(shape: Shape) -> Array:
    """Build the (k, k) matrix that takes out of values their mean over the recording, and of a rate the linear part.

    Both belong to G and b.
    """
    linear = shape.kind == "gyro" and shape.regressor.name.startswith("rate_")
    basis = np.vander(shape.knots, 2)[:, 0 if linear else 1 :]
    root = np.sqrt(shape.weights)[:, None]
    return np.asarray(np.eye(shape.knots.size) - basis @ np.linalg.pinv(root * basis) * root.T)


def render_draft(draft: Draft) -> str:
    """Render the effect file of a draft, which `--effects` loads."""
    low, high = draft.interval_90
    on_references = draft.kind == "reference"
    seen = "references" if on_references else "stream"
    method, what = ("reference_columns", "the references") if on_references else ("columns", "the readings")
    of = {"gyro": "error of the readings", "scale": "error of the scale factors", "reference": "error of the references"}
    shown = " * stream.rates" if draft.kind == "scale" else ""
    factor = {"gyro": "DEG_H", "scale": "PPM", "reference": "DEG"}[draft.kind]
    rows = "\n".join(
        f"    ({_format_numbers([knot])}, {_format_numbers(value)}, {_format_numbers(sigma)}),"
        for knot, value, sigma in zip(draft.knots, draft.values, draft.sigmas, strict=True)
    )
    return f'''"""Draft of an effect outside the library: the {of[draft.kind]} follows {draft.regressor.words}.

On data that neither chose the regressor nor fitted the table it closes {100 * draft.closed:.0f} % of the misfit
(90 % interval {100 * low:.0f} to {100 * high:.0f} %). Size 1 is the function found, with a sigma of
{draft.sigma:.2g}. It is linear between the knots and constant beyond them. Its mean, and what G takes up, are left out.
Drafts that the recording does not distinguish from it: {", ".join(draft.tied) or "none"}.
"""

import numpy as np

from simulator.effects import Effect
from simulator.effects.common import {factor}
from simulator.effects.regressors import compute_regressor, list_regressors, tabulate

REGRESSOR = "{draft.regressor.name}"  # {draft.regressor.words}
TABLE = np.array([  # regressor ({draft.regressor.unit}), error about x, y, z and its sigmas ({draft.unit})
{rows}
])  # fmt: skip


class Draft(Effect):
    """See the module."""

    def {method}(self, {seen}, axis, parameters):
        """Error of {what} at size 1, one column."""
        found = tabulate(compute_regressor({seen}, REGRESSOR), TABLE[:, 0], TABLE[:, 1:4])
        return (found * {factor}{shown})[:, :, None]

    def missing(self, around):
        """It needs its regressor."""
        return None if REGRESSOR in list_regressors(around.{seen}) else f"the recording has no {{REGRESSOR}}"


EFFECT = Draft(
    name="{draft.name}",
    summary="{of[draft.kind]} follows {draft.regressor.words}, as drafted",
    unit="of the draft",
    stage="{"reference" if on_references else "rate"}",
    prior=(0.1, 10.0),
    axes=(),
    drawn=False,
)
'''


def summarise_draft(draft: Draft) -> str:
    """Summarise a draft in one sentence."""
    low, high = draft.interval_90
    return (
        f"{draft.name} follows {draft.regressor.words} and closes {100 * draft.closed:.0f} % of the held-out misfit "
        f"(90 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    )


def _format_numbers(values: Sequence[float] | Array) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
