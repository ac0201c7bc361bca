"""Discrepancies that repeat with any period and are on no list: shapes that are no sine, and sines that may not be named.

Their periods are those that `diagnosis.model.periods` has found to explain most as a sine.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.bins import AXES, Family
from diagnosis.model.periods import Found, Period, make_period_columns
from diagnosis.model.recording_model import RecordingModel

Array = NDArray[np.float64]

REPEATED = 4  # best periods at which a swing that is no sine is tried
SHAPE = 3  # its harmonics of any phase
HIGHEST = 7  # its highest harmonic that is locked to the fundamental
DOUBLED = 2  # best periods that may be the second harmonics of others


def list_families(model: RecordingModel, found: Found, listed: Collection[bool]) -> Iterator[Family]:
    """List unlisted rivals that repeat with any period: not as a sine, and as a sine where no listed effect does.

    The k-th harmonic of a shape with jumps falls as 1/k. The second and the third one may have any phase; or those of a square
    wave, sin kθ/k of odd k, or these and those of even k, as in a sawtooth, are locked to the phase θ of the fundamental. That
    has less freedom, so that a weak harmonic tells more. A period whose fundamental is weak is found at its second harmonic.

    Parameters
    ----------
    model : the recording
    found : by the scan
    listed : for which kinds of error, of the references or not, a swing may be named
    """
    for (on_references, axis), periods in found.items():
        what = "references repeat" if on_references else "bias repeats"
        doubled = [replace(one, frequency=0.5 * one.frequency) for one in periods[:DOUBLED]]
        shapes = [*periods[:REPEATED], *doubled]
        options, at = [], []
        for one in shapes:
            orders = one.frequency * np.arange(1.0, HIGHEST + 1)
            several = make_shapes(model, make_period_columns(model, axis, on_references, orders))
            options += several
            at += [replace(one, log_weight=one.log_weight - float(np.log(len(several))))] * len(several)
        yield _build_periodic_family(model, f"{what} with a period, not as a sine", axis, options, at)
        if on_references not in listed:
            options = make_period_columns(model, axis, on_references, np.array([one.frequency for one in periods]))
            yield _build_periodic_family(model, f"{what} with another period", axis, options, periods)


def make_shapes(model: RecordingModel, waves: Sequence[Array]) -> list[Array]:
    """Make shapes that repeat, each as (N, k) columns of which the first two are sine and cosine of the fundamental.

    Parameters
    ----------
    model : the recording
    waves : (N, 2) sine and cosine of each order, the fundamental first
    """
    falling = [wave / order for order, wave in enumerate(waves, 1)]
    X = model.project_out_nuisance(waves[0])
    sine, cosine = np.linalg.lstsq(X, model.y, rcond=None)[0]
    theta = np.arctan2(cosine, sine)
    # sin k(ωt + φ) of sine and cosine of kωt
    locked = [wave @ [np.cos(k * theta), np.sin(k * theta)] for k, wave in enumerate(falling, 1)]
    odd, even = sum(locked[2::2], np.zeros(len(X))), sum(locked[1::2], np.zeros(len(X)))
    return [np.hstack(falling[:SHAPE]), np.column_stack([waves[0], odd]), np.column_stack([waves[0], odd, even])]


def _build_periodic_family(model: RecordingModel, name: str, axis: int, options: list[Array], at: Sequence[Period]) -> Family:
    """With columns of which the first two have unit size together, so that amplitudes at different periods compare."""
    sizes = [float(np.linalg.norm(model.project_out_nuisance(part[:, :2]))) for part in options]
    scaled = [part / max(size, 1e-300) for part, size in zip(options, sizes, strict=True)]
    return Family(name, AXES[axis], scaled, np.exp([one.log_weight for one in at]))
