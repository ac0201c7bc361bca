"""Even time tags for samples that a host has tagged in batches, in whole seconds, on arrival or with jitter.

A gyro samples at an even rate. Its tag is t_k = a + h k + e_k of the sample number k, the spacing h and an error e_k.
A robust straight line through the tags against the number gives h and a, and its values replace the tags.

Which line depends on the error:

- Samples that share a tag have the tag of the first of them, or the current whole second: e_k <= 0, and zero for the first
  sample of each group. The line goes through the first samples.
- A burst of samples is tagged on arrival. All of its samples have waited for the last one, which has the smallest e_k: the line
  goes through the last samples.
- A single sample that is tagged late by a host has e_k >= 0 with a tail to one side. Its lower envelope is the line with the
  smallest delay. An exponential delay has a skewness of 2, half a normal one of 1.0, a symmetric one of 0. Above 0.8 the 5 %
  quantile is taken, which for an exponential delay lies 0.05 of the mean delay above the envelope. Below, it is the median.

A step up of the tags against the number by a sample or more is loss: the number goes on by as many. After a gap of more than
`LONGEST_COUNTED` samples the line begins anew with the same spacing, since a logger that starts again does so at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrocal.arrays import Array, Indices

FEWEST_TAGS = 20  # with fewer a line is no better than the tags
FEWEST_ANCHORS = 6
UNEVEN_SAMPLE = 0.25  # of a sample: a spacing farther from a whole number of samples is uneven
MOST_UNEVEN_SHARE = 0.01  # of the spacings: up to it the tags are even
SHORT_SPACING = 0.25  # of a sample: rows nearer to each other are of one batch
BATCH_SHARE = 0.2  # of the spacings that are this short: above it the rows come in batches
LONGEST_COUNTED = 20  # samples of a gap over which the sample number goes on
LEAST_STEP = 0.6  # of a sample: a step up that is a lost one
MOST_STEP_ANCHORS = 60  # on either side of a step
WALK_LAG, WALK_GROWTH = 4, 1.5  # errors of tags do not grow with the lag; those of a random walk double over four samples
ONE_SIDED_SKEWNESS = 0.8  # of the errors of tags: above it they are delays
ENVELOPE_QUANTILE = 0.05
LARGEST_DRIFT = 0.05  # of the rate between two blocks: no clock changes by more
LEAST_FOLLOWED = 0.75  # share of the rows on a line that then holds for the others too
BLOCK_ANCHORS = 50  # in a block whose median shows a drift of the clock from a line


@dataclass(frozen=True)
class EvenTimes:
    """Even times of some rows."""

    t_s: Array  # (n,) s
    sample_s: float  # spacing, s
    errors: str  # deviation of the tags from the times, in words
    drift_s: float  # largest deviation of the times from one straight line, s, as the clock drifts; zero without a drift


def is_uneven(t_s: Array) -> bool:
    """Whether more than one percent of the spacings of tags are no whole number of samples."""
    if t_s.size < FEWEST_TAGS:
        return False
    spacing = np.diff(t_s)
    usual = float(np.median(spacing))
    if usual <= 0:
        return True
    ratio = spacing / usual
    # A real gap may have any length, but more than a percent of the spacings are no gaps.
    is_off = (np.abs(ratio - np.maximum(np.round(ratio), 1.0)) > UNEVEN_SAMPLE) | (ratio > LONGEST_COUNTED)
    return bool(np.mean(is_off) > MOST_UNEVEN_SHARE)


def fit_even_times(t_s: Array, number: Array | None = None, sample_s: float | None = None) -> EvenTimes | None:
    """Fit even times to tags (n,), s, of rows in the order of sampling; None if the tags do not follow the sample number.

    number: (n,) sample numbers; with None the rows are numbered, and steps of the tags count as lost samples
    sample_s: spacing of the samples if it is known
    """
    is_numbered = number is not None
    k = np.arange(t_s.size, dtype=np.float64) if number is None else number.astype(np.float64)
    if t_s.size < FEWEST_TAGS:
        return None
    h = sample_s or estimate_spacing(t_s, k)
    if not h > 0:
        return None
    rows, errors = _choose_anchors(t_s, h * np.append(np.diff(k), 1.0))
    if rows.size < FEWEST_ANCHORS and sample_s is None:
        return None
    if rows.size == 1:  # all rows have one tag
        return EvenTimes(t_s[0] + h * (k - k[0]), float(h), errors, 0.0)
    if _grows_with_lag(t_s[rows] - h * k[rows], h):
        return None
    part = np.zeros(rows.size, dtype=np.intp)  # stretches with an intercept of their own
    for _ in range(3):
        if not is_numbered:
            k, part = _count_lost_samples(t_s, k, h, rows, part)
        if sample_s is None:
            h = _estimate_anchor_spacing(t_s[rows], k[rows], part, h)
    residual = t_s[rows] - h * k[rows]
    stretches, index = np.unique(part, return_inverse=True)
    medians = np.array([np.median(residual[part == stretch]) for stretch in stretches])
    centred = residual - medians[index] if part.any() else residual
    centred = centred - np.median(centred)
    late = errors == "" and _estimate_skewness(centred) > ONE_SIDED_SKEWNESS
    if not errors:
        errors = f"have {'late arrival' if late else 'jitter'} of {np.std(centred) / h:.2g} samples (RMS)"
    # The anchor of a row is the next one in bursts, whose anchors are last, and otherwise the one before.
    is_burst = errors.startswith("come in bursts")
    anchor = np.searchsorted(rows, np.arange(t_s.size), side="left" if is_burst else "right") - (not is_burst)
    part_of_row = part[np.clip(anchor, 0, rows.size - 1)]
    line, drift = np.zeros(t_s.size), 0.0
    for stretch in stretches:
        inside = part == stretch
        least = max(UNEVEN_SAMPLE * h, 5 * _estimate_noise(residual))
        knots = _fit_offset(k[rows[inside]], residual[inside], ENVELOPE_QUANTILE if late else 0.5, least)
        leaps = np.flatnonzero(np.abs(np.diff(knots[1])) > LARGEST_DRIFT * h * np.diff(knots[0])) + 1
        if leaps.size:
            return _fit_without_backlog(t_s, k, knots, leaps, sample_s)
        line[part_of_row == stretch] = np.interp(k[part_of_row == stretch], *knots)
        drift = max(drift, float(np.ptp(knots[1])))
    even = h * k + line
    return None if (np.diff(even) < 0.5 * h).any() else EvenTimes(even, float(h), errors, drift)


def _fit_without_backlog(
    t_s: Array, k: Array, knots: tuple[Array, Array], leaps: Indices, sample_s: float | None
) -> EvenTimes | None:
    """Fit even times by the longest stretch between leaps: the others are a backlog, or the clock was set."""
    first, stop = max(pairwise([0, *leaps, knots[0].size]), key=lambda ends: ends[1] - ends[0])
    follows = (k >= knots[0][first]) & (k <= knots[0][stop - 1])
    fit = fit_even_times(t_s[follows], k[follows], sample_s) if follows.mean() >= LEAST_FOLLOWED else None
    if fit is None:
        return None
    k_inside = np.clip(k, *k[follows][[0, -1]])
    even = np.interp(k_inside, k[follows], fit.t_s) + (k - k_inside) * fit.sample_s
    stray = f"run off the line by {np.abs(t_s - even).max():.3g} s in up to {100 * (1 - follows.mean()):.0f} % of the rows"
    return EvenTimes(even, fit.sample_s, f"{fit.errors}, and {stray}", fit.drift_s)


def estimate_spacing(t_s: Array, k: Array) -> float:
    """Estimate the spacing, s, by the median over a quarter of the rows, which a few gaps do not change."""
    lag = max(t_s.size // 4, 1)
    return float(np.median((t_s[lag:] - t_s[:-lag]) / (k[lag:] - k[:-lag])))


def _choose_anchors(t_s: Array, expected: Array) -> tuple[Indices, str]:
    """Choose the rows whose tags have the least error, and describe the others; all rows, and "", if there are no batches."""
    spacing = np.diff(t_s)
    short = spacing < SHORT_SPACING * expected[:-1]
    # Tags of a batch are in order; tags that go back have single errors of a sample and more.
    if short.mean() <= BATCH_SHARE or np.mean(spacing < 0) > MOST_UNEVEN_SHARE:
        return np.arange(t_s.size), ""
    first = np.concatenate([[0], np.flatnonzero(~short) + 1])
    size = t_s.size / first.size
    if np.mean(spacing[short] == 0) > 0.5:
        # The log may begin within a group, whose first sample then is not the group's.
        return (first[1:] if first.size > FEWEST_ANCHORS else first), f"come in groups of about {size:.3g} rows with one tag"
    return np.append(first[1:] - 1, t_s.size - 1), f"come in bursts of about {size:.3g} rows tagged on arrival"


def _count_lost_samples(t_s: Array, k: Array, h: float, rows: Indices, part: Indices) -> tuple[Array, Indices]:
    """Increase the sample numbers (n,) by lost samples, and number the stretches of anchors between longer gaps."""
    residual = t_s[rows] - h * k[rows]
    # The difference of two medians of `width` tags has a sigma of 1.25 sqrt(2 / width) times that of a tag; five of them are
    # less than the least step where there are enough tags for it.
    sigma = 5 * 1.25 * np.sqrt(2.0) * _estimate_noise(residual)
    width = int(min(max(np.ceil((sigma / (LEAST_STEP * h)) ** 2), 3), MOST_STEP_ANCHORS, rows.size // 2))
    least = max(LEAST_STEP * h, sigma / np.sqrt(width))
    padded = np.pad(residual, (width - 1, width - 1), mode="edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
    # Entry j: step from the anchors up to j to those after it.
    step = medians[width : width + rows.size - 1] - medians[: rows.size - 1]
    jump = np.diff(residual)
    k, part = k.copy(), part.copy()
    shift = np.zeros(t_s.size)
    candidates = np.flatnonzero((step > least) & (jump > 0.5 * least))
    last = -width
    for j in candidates.tolist():
        group = candidates[(candidates >= j) & (candidates < j + width)]
        if j - last < width:
            continue
        j = int(group[np.argmax(jump[group])])
        lost = round(float(step[j]) / h)
        if lost >= 1:
            begins = int(rows[j] + 1 + np.argmax(np.diff(t_s[rows[j] : rows[j + 1] + 1])))  # after the longest spacing
            shift[begins:] += lost
            if lost > LONGEST_COUNTED:
                part[j + 1 :] += 1
        last = j
    return k + shift, part


def _estimate_anchor_spacing(t_s: Array, k: Array, part: Indices, usual: float) -> float:
    """Estimate the spacing by the median slope between anchors half a stretch apart (Theil and Sen, on separate pairs)."""
    slopes = []
    for stretch in np.unique(part):
        inside = part == stretch
        lag = int(inside.sum()) // 2
        if lag >= FEWEST_ANCHORS // 2:
            slopes.append((t_s[inside][lag:] - t_s[inside][:-lag]) / (k[inside][lag:] - k[inside][:-lag]))
    return float(np.median(np.concatenate(slopes))) if slopes else usual


def _estimate_noise(residual: Array) -> float:
    """Estimate the robust sigma of one tag by the differences of neighbours, s."""
    steps = np.diff(residual)
    return 1.4826 * float(np.median(np.abs(steps - np.median(steps)))) / np.sqrt(2.0)


def _grows_with_lag(residual: Array, h: float) -> bool:
    """Whether the residuals of the tags are a random walk, as for rows that are not evenly sampled."""

    def compute_spread(lag: int) -> float:
        steps = residual[lag:] - residual[:-lag]
        return float(np.median(np.abs(steps - np.median(steps))))

    return residual.size > 2 * WALK_LAG and compute_spread(WALK_LAG) > WALK_GROWTH * max(compute_spread(1), 0.1 * h)


def _estimate_skewness(values: Array) -> float:
    """Estimate the skewness of values (n,); zero without a spread."""
    centred = values - values.mean()
    spread = float(np.sqrt(np.mean(centred**2)))
    return float(np.mean(centred**3)) / spread**3 if spread > 0 else 0.0


def _fit_offset(k: Array, residual: Array, quantile: float, least: float) -> tuple[Array, Array]:
    """Fit sample numbers and offsets of the line: one offset, or one for each block if the clock drifts by more than least."""
    single = np.array([np.quantile(residual, quantile)])
    blocks = min(k.size // BLOCK_ANCHORS, 200)
    if blocks < 2:
        return k[:1], single
    parts = list(zip(np.array_split(k, blocks), np.array_split(residual, blocks), strict=True))
    offsets = np.array([np.quantile(values, quantile) for _, values in parts])
    if np.ptp(offsets) <= 2 * least:
        return k[:1], single
    return np.array([numbers.mean() for numbers, _ in parts]), offsets
