"""Rows on one trial by itself: the file, its diagnosis, what its samples show, and whether the cameras see its tones."""

from __future__ import annotations

import numpy as np

from diagnosis.result import Diagnosis
from gyrocal import attitude
from simulator.effects.gyro import vibration
from studies.montecarlo.manifest import digest
from studies.validation import broad
from studies.validation.real_gyro.fitting import fit, rms
from studies.validation.real_gyro.ladder import LADDER, LATE, Found, repeats
from studies.validation.real_gyro.left_out import timing_probability
from studies.validation.real_gyro.trials import Loaded, RealConfig, Row

SHOWN_BINS = 4  # counts on either side of zero
SWEEP = 4  # samples before and after one, for the rate to have swept through
SWEPT = 6  # counts in that time
TONE_BLOCK_S = 1.0


def file_row(config: RealConfig, one: Loaded) -> Row:
    """The trial itself: its file's digest, noise and mean rate."""
    moving = one.trial.rates[one.trial.moving]
    return {
        "kind": "trial",
        "trial": one.number,
        "name": one.trial.name,
        "text": digest(config.files(one.number)[0].read_bytes()),
        "samples": float(len(one.trial.rates)),
        "arw": float(np.rad2deg(one.recording.gyro.arw)),
        "sigma": float(np.rad2deg(rms(one.recording.attitudes.sigma))),
        "rate": float(np.rad2deg(np.sqrt(np.square(moving).sum(axis=1).mean()))),
    }


def diagnosis_rows(one: Loaded, found: Diagnosis, turn: int) -> list[Row]:
    """The verdict, then a row for each cause."""
    base = {"trial": one.number, "turn": float(turn)}
    best = found.details.explanations
    rows: list[Row] = [
        {
            "kind": "diagnosis",
            **base,
            "text": found.verdict,
            "p_value": found.p_value,
            "unknown": found.unknown_probability,
            "timing": timing_probability(found),
            "name": str(best["effects"].iloc[0]) if len(best) else "",
            "probability": float(best["probability"].iloc[0]) if len(best) else 0.0,
        }
    ]
    for cause in found.causes:
        parameters = ", ".join(f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in cause.parameters.items())
        rows.append(
            {
                "kind": "cause",
                **base,
                "name": cause.label,
                "text": "/".join(cause.group),
                "size": cause.size,
                "size_sigma": cause.sigma,
                "size_unit": cause.unit,
                "parameters": parameters,
                "probability": cause.probability,
            }
        )
    return rows


def own_rows(one: Loaded, found: Found) -> list[Row]:
    """The time offset fitted to the trial alone, with what its own diagnosis found undone, to compare within the unit."""
    rung = tuple(effect for effect in LADDER if effect == LATE or effect in found.effects)
    fitted = fit([one], rung, found)
    return [{"kind": "own", "trial": one.number, "size": fitted.offset, "size_sigma": fitted.offset_sigma}]


def zero_rows(one: Loaded, found: Found) -> list[Row]:
    """Counts of the readings next to zero while the rate sweeps through it, all axes together."""
    if found.step <= 0:
        return []
    counts = np.rint(one.trial.rates / found.step)
    sweeping = np.abs(np.roll(counts, -SWEEP, axis=0) - np.roll(counts, SWEEP, axis=0)) > SWEPT
    sweeping &= one.trial.moving[:, None]
    return [
        {"kind": "zero", "trial": one.number, "bin": float(k), "count": float(np.count_nonzero(sweeping & (counts == k)))}
        for k in range(-SHOWN_BINS, SHOWN_BINS + 1)
    ]


def repeat_rows(one: Loaded) -> list[Row]:
    """Repeats on all axes, those that chance makes of how often each axis repeats around there, and the runs of two or more."""
    rates = one.trial.rates
    equal = np.zeros(rates.shape)
    equal[1:] = rates[1:] == rates[:-1]
    together = repeats(rates)
    width = one.trial.samples(0.5)
    kernel = np.ones(width) / width
    # Without those where all repeat at once: they are what is asked about.
    single = np.where(together[:, None], 0.0, equal)
    around = np.column_stack([np.convolve(single[:, k], kernel, mode="same") for k in range(3)])
    lengths = np.array([stop - first for first, stop in broad.runs(together)])
    return [
        {
            "kind": "repeats",
            "trial": one.number,
            "count": float(together.sum()),
            "expected": float(np.prod(around, axis=1).sum()),
            "moving_count": float(np.count_nonzero(together & one.trial.moving)),
            "moving_expected": float(np.prod(around, axis=1)[one.trial.moving].sum()),
            "long_runs": float(np.count_nonzero(lengths >= 2)),
            "size": float(lengths[lengths >= 2].mean()) if (lengths >= 2).any() else 0.0,
        }
    ]


def tone_rows(one: Loaded, found: Diagnosis) -> list[Row]:
    """Whether the cameras see a tone that the gyro sees: coherence of both at rest, and how much of it the cameras see."""
    rows: list[Row] = []
    block = one.trial.samples(TONE_BLOCK_S)
    t = one.trial.t_s
    A = attitude.matrix_from_quaternion(np.where(one.trial.tracked[:, None], one.trial.quaternions, [0.0, 0.0, 0.0, 1.0]))
    # A_{k+1} = exp(−[ω×]Δt) A_k
    optical = attitude.residual(A[:-1], A[1:]) / one.trial.sample_s
    good = one.trial.tracked[:-1] & one.trial.tracked[1:] & ~one.trial.moving[:-1]
    for cause in found.causes:
        if cause.effect != vibration.EFFECT.name or cause.axis is None:
            continue
        axis, f = "xyz".index(cause.axis), float(cause.parameters["apparent_hz"])
        window = np.hanning(block) * np.exp(-2j * np.pi * f * t[:block])
        pairs = [
            (window @ one.trial.rates[k : k + block, axis], window @ optical[k : k + block, axis])
            for first, stop in broad.runs(good)
            for k in range(first, stop - block, block)
        ]
        if len(pairs) < 4:
            continue
        g, o = np.array(pairs).T
        power = float(np.sum(np.abs(g) ** 2) * np.sum(np.abs(o) ** 2))
        rows.append(
            {
                "kind": "tone",
                "trial": one.number,
                "name": cause.label,
                "frequency": f,
                "coherence": float(np.abs(np.vdot(o, g)) ** 2 / power),
                "gain": float(np.vdot(g, o).real / np.sum(np.abs(g) ** 2)),
                "count": float(len(pairs)),
            }
        )
    return rows
