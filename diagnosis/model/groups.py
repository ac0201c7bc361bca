"""Candidates before their place in the linear model is known, and the model's candidates that are made of them.

An effect says itself which columns or which covariance it has, which options are worth trying and how plausible it is
(`simulator.effects.base.Effect`). An unlisted rival is a discrepancy that is on no list, with amplitudes of any size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.linear import EVERY, Candidate, Option, Parameters, exactly, first_amplitude, scales_of, spaced
from diagnosis.model.linear import SETTINGS as LINEAR
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Effect, Trial

Array = NDArray[np.float64]

AXES = "xyz"


@dataclass(frozen=True)
class Group:
    """A candidate before its place in the model is known.

    Attributes
    ----------
    effect, axis, listed, unit, process, positive, log_odds, read, size_sigma, shifted, scanned, roughness : as in `Candidate`
    columns : per option (N, k) whitened columns
    parameters : per option
    weights : (o,) prior share of each option
    limits : plausible range of the size
    weight : prior of its effect beside that of the others
    scales : as in `Candidate`; by default those within the limits that the columns can show
    loudest : largest signal-to-noise ratio of interest, where the scales are those by default
    """

    effect: str
    axis: str | None
    listed: bool
    columns: Sequence[Array]
    parameters: Sequence[Parameters]
    weights: Array
    limits: tuple[float, float]
    unit: str
    process: bool = False
    positive: bool = False
    weight: float = 1.0
    log_odds: float = 0.0
    read: Callable[[Array], tuple[float, Parameters]] = first_amplitude
    size_sigma: Callable[[float], float] = exactly
    shifted: bool = False
    scales: Array | None = None
    scanned: bool = False
    loudest: float = LINEAR.visible[1]
    roughness: float = 0.0


def group_of(
    effect: Effect, axis: str | None, columns: Sequence[Array], trials: Sequence[Trial], process: bool = False
) -> Group:
    """Build the group of a listed effect by its columns at each set of parameters."""
    return Group(
        effect=effect.name,
        axis=axis,
        listed=True,
        columns=columns,
        parameters=[dict(trial.parameters) for trial in trials],
        weights=np.array([trial.weight for trial in trials]),
        limits=effect.prior,
        unit=effect.unit,
        process=process,
        positive=effect.sign == "positive",
        weight=effect.weight,
        read=effect.from_amplitudes,
    )


def build_rival(
    name: str, axis: str | None, columns: Sequence[Array], process: bool = False, weights: Array | None = None
) -> Group:
    """Build a discrepancy that is on no list, with options of equal prior unless a scan for periods gives their weights."""
    count, scanned = len(columns), weights is not None
    shares = np.full(count, 1 / max(count, 1)) if weights is None else weights
    return Group(name, axis, False, columns, [{}] * count, shares, (0.0, np.inf), "", process, scanned=scanned)


def placed(
    groups: Sequence[Group],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    size: int = 0,
    visible: tuple[float, float] = LINEAR.visible,
) -> tuple[tuple[Candidate, ...], Array]:
    """Place the columns (N, p) of all groups side by side, and list their candidates; see `list_candidates`."""
    candidates, columns = list_candidates(groups, projected, settings, visible), [np.empty((size, 0))]
    parts = [part for group in groups for part in group.columns]
    return candidates, np.hstack(parts or columns)


def list_candidates(
    groups: Sequence[Group],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    visible: tuple[float, float] = LINEAR.visible,
) -> tuple[Candidate, ...]:
    """List the candidates of groups whose columns lie side by side, with their scales and priors.

    Each effect has the same prior, shared by its axes, and so has each rival; what could not be seen is left out.

    Parameters
    ----------
    groups : the candidates
    projected : takes the nuisance parameters out of columns
    settings : priors
    visible : signal-to-noise ratios of interest
    """
    names = {group.effect for group in groups if group.listed}
    rivals = {group.effect for group in groups if not group.listed}
    share = settings.unlisted_share if rivals and names else float(bool(rivals))
    axes = {name: sum(group.effect == name for group in groups) for name in names | rivals}
    candidates, stop = [], 0
    for group in groups:
        stops = stop + np.cumsum([part.shape[1] for part in group.columns], dtype=int)
        stop = int(stops[-1]) if stops.size else stop
        norms = [np.linalg.norm(projected(part), axis=0) for part in group.columns]
        largest = max((float(norm.max()) for norm in norms if norm.size), default=0.0)
        shown = visible[0], max(visible[1], group.loudest)
        scales = scales_of(largest, group.limits, shown) if group.scales is None else group.scales
        # What a size of a random process shows differs between its options, each of which has scales of its own.
        windows = [_window(norm, group.limits, shown) for norm in norms] if group.process and group.scales is None else []
        if windows and scales.size:
            scales = spaced(min(low for low, high in windows if low < high), max(high for low, high in windows if low < high))
        if not scales.size:
            continue
        family = (1 - share) / len(names) if group.listed else share / len(rivals)
        options = []
        windows = windows or [EVERY] * len(norms)
        for end, norm, weight, parameters, window in zip(
            stops.tolist(), norms, group.weights, group.parameters, windows, strict=True
        ):
            if not window[0] < window[1] or (group.scales is None and not norm.size):  # nothing of it can be seen here
                continue
            options.append(Option(end - norm.size, norm.size, float(np.log(weight)), parameters, window))
        prior = float(np.log(group.weight * family / axes[group.effect]))
        candidates.append(
            Candidate(
                group.effect, group.axis, group.listed, prior, tuple(options), scales, group.unit, group.process,
                group.positive, group.log_odds, group.read, group.size_sigma, group.shifted, group.scanned, group.roughness,
            )
        )  # fmt: skip
    return tuple(candidates)


def _window(norms: Array, limits: tuple[float, float], visible: tuple[float, float]) -> tuple[float, float]:
    """Range of the scales that an option can show; no range where nothing of it can be seen."""
    largest = float(norms.max(initial=0.0))
    return (max(limits[0], visible[0] / largest), min(limits[1], visible[1] / largest)) if largest > 0 else (np.inf, 0.0)
