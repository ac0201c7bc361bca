"""Stretches of a recording without a rate or an attitude, which effects find for themselves and which are taken out of it.

A gyro that stops, references that freeze or that show something else for a moment: no error model describes such stretches, and
each of them spoils all tests that follow. They are found from samples and references as recorded, before anything else. Without
them the intervals are cut at lost samples, and lost references are missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal.recording import Attitudes, Interval, Recording, find_reference_rows
from simulator.effects.base import Effect, Fault, Surroundings
from simulator.effects.innovations import compute_innovations
from simulator.effects.recording_view import extract_surroundings

Mask = NDArray[np.bool_]

FEWEST = 2  # references of an interval that can be propagated
ZERO = 8.0  # sigmas of a level, within which one gyro that stops there may have a dead zone as well
ALONG = 0.98  # cosine, which a random direction exceeds in one of a hundred
MOST_LOST = 0.5  # share of the references, above which they are not taken for exceptions


def find_faults(recording: Recording, effects: Sequence[Effect]) -> tuple[Fault, ...]:
    """Find the faults of a recording."""
    able = [effect for effect in effects if effect.implements("find_faults")]
    if not able or not recording.attitudes.t_s.size:
        return ()
    found: list[Fault] = []
    for effect in able:
        # A fault that was found is out of the way of those that are looked for after it.
        left = remove_faults(recording, found)
        around = extract_surroundings(left, left.gyro.apriori_G, left.gyro.apriori_bias, 0)
        if effect.missing(around) is None:
            faults = [
                fault for fault in effect.find_faults(around) if _is_exception(fault) and not _is_along_rate(fault, around)
            ]
            found += [_expand_fault(fault, left, recording) for fault in faults]
    return tuple(found)


def _is_along_rate(fault: Fault, around: Surroundings) -> bool:
    """Tell whether all references of a fault are off along the change of the rate, as late time tags make them in a slew."""
    if not fault.references.any():
        return False
    seen = compute_innovations(around)
    begins = fault.references[seen.second] & ~fault.references[seen.first]
    if not begins.any():
        return False
    at = np.searchsorted(around.stream.t_s, around.references.t_s).clip(0, around.stream.t_s.size - 1)
    change = around.stream.rates[at[seen.second[begins]]] - around.stream.rates[at[seen.first[begins]]]
    off = seen.values[begins]
    along = np.abs(np.sum(off * change, axis=1))
    return bool((along > ALONG * np.linalg.norm(off, axis=1) * np.linalg.norm(change, axis=1)).all())


def _is_exception(fault: Fault) -> bool:
    """Whether most of the recording is left, and no dead zone of one gyro looks the same."""
    level = fault.detection
    if level.axis is not None and abs(level.size) <= ZERO * level.sigma:
        return False
    return bool(fault.references.mean() < MOST_LOST and fault.samples.mean() < MOST_LOST)


def _expand_fault(fault: Fault, part: Recording, whole: Recording) -> Fault:
    """A fault with the references of the whole recording in place of those of a part."""
    lost = np.isin(whole.attitudes.t_s, part.attitudes.t_s[fault.references])
    return replace(fault, references=lost)


def remove_faults(recording: Recording, faults: Sequence[Fault]) -> Recording:
    """Take lost samples and references out of a recording; as it is where nothing is left of it without them."""
    if not faults:
        return recording
    lost_samples = np.any([fault.samples for fault in faults], axis=0)
    lost_references = np.any([fault.references for fault in faults], axis=0)
    kept = _keep_references(recording.attitudes, ~lost_references)
    pieces = _cut_intervals(recording, kept.t_s, recording.gyro.t_s[lost_samples])
    if not pieces:
        return recording
    inside = np.zeros(kept.t_s.size, dtype=bool)
    for piece in pieces:
        inside[find_reference_rows(kept.t_s, piece)] = True
    return replace(recording, attitudes=_keep_references(kept, inside), intervals=pieces)


def _keep_references(attitudes: Attitudes, kept: Mask) -> Attitudes:
    return attitudes.select_rows(kept)


def _cut_intervals(recording: Recording, reference_s: NDArray[np.float64], lost_s: NDArray[np.float64]) -> tuple[Interval, ...]:
    """The parts of the intervals between lost samples that have references enough."""
    out = []
    for interval in recording.intervals:
        times = reference_s[find_reference_rows(reference_s, interval)]
        part = np.searchsorted(lost_s, times)
        numbers = np.unique(part)
        for number in numbers:
            chosen = times[part == number]
            if chosen.size < FEWEST:
                continue
            if numbers.size == 1:
                out.append(interval)
            else:
                name, start, stop = f"{interval.name}/{number}", float(chosen[0]), float(chosen[-1])
                out.append(replace(interval, name=name, start_s=start, stop_s=stop))
    return tuple(out)
