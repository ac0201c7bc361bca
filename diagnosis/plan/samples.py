"""Effects seen in the samples: their smallest visible sizes follow from the thresholds of the stream and noise tests.

Those are in `diagnosis.detectors.samples` and `diagnosis.detectors.reference_noise`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.stats

from diagnosis.detectors import clipping, outliers, reference_noise, sample_noise
from diagnosis.detectors import report as stream_report
from diagnosis.detectors import samples as stream
from diagnosis.detectors import spectral_lines as tones
from diagnosis.model.candidates import AXES
from diagnosis.model.recording import Model
from diagnosis.plan.result import POWER, Visible
from diagnosis.plan.visibility import row_of
from simulator.effects import EFFECTS
from simulator.scenario import Scenario, profiles


def quiet_samples(scenario: Scenario) -> tuple[int, int]:
    """Gyro samples outside slews and transitions and clear of their edges: in all, and in the longest stretch."""
    total, longest = 0, 0
    for profile in profiles(scenario):
        edges = [0.0, *(t for span in sorted(profile.moving) for t in span), profile.stop_s - profile.start_s]
        counts = [
            int((b - a) / scenario.gyro.sample_s) - 2 * sample_noise.HALF for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
        total += sum(max(count, 0) for count in counts)
        longest = max([longest, *counts])
    return total, longest


def samples_seen(scenario: Scenario, model: Model, names: Sequence[str], snr: float) -> list[Visible]:
    """Smallest visible sizes of those of some effects that show in the samples; snr is what the others need."""
    wanted = {
        "noise_excess": lambda: _noise_factor(scenario),
        "rate_quantization": lambda: _lattice(scenario, model, "rate_quantization"),
        "rate_truncation": lambda: _lattice(scenario, model, "rate_truncation"),
        "rate_deadzone": lambda: _dead_zones(model, snr),
        "rate_saturation": lambda: _saturation(model),
        "vibration": lambda: _vibration(scenario),
        "spikes": lambda: _spikes(scenario),
        "stale_samples": lambda: _stale(model),
        "reference_noise_excess": lambda: _reference_factor(scenario),
    }
    return [row for name in names if name in wanted for row in wanted[name]()]


def _sample_sigma(scenario: Scenario) -> float:
    """Noise of a sample, deg/s."""
    return scenario.gyro.arw_deg_per_sqrt_s / float(np.sqrt(scenario.gyro.sample_s))


def _noise_factor(scenario: Scenario) -> list[Visible]:
    """Second differences: z = (f² − 1)/rel must pass the point of `EVENT_P` with scatter f² rel."""
    effect, n = EFFECTS["noise_excess"], quiet_samples(scenario)[0]
    if n < 200 or scenario.gyro.arw_deg_per_sqrt_s == 0:
        return [row_of(effect, "not identifiable", np.inf, "needs 200 quiet samples of a gyro with stated noise", "samples")]
    relative = np.sqrt(2 / n * reference_noise.CORRELATED)
    level, spread = scipy.stats.norm.isf(stream_report.EVENT_P / 2) * relative, scipy.stats.norm.ppf(POWER) * relative
    size = float(np.sqrt((1 + level) / (1 - spread))) if spread < 1 else np.inf
    low = float(np.sqrt(max(1 - level, 0.0) / (1 + spread)))
    return [row_of(effect, "visible", size, f"any one axis; or a factor below {low:.3f}", "samples")]


def _lattice(scenario: Scenario, model: Model, name: str) -> list[Visible]:
    """A step that at most 0.7 of the values are distinct on, and above the share of the noise that counts."""
    sigma = _sample_sigma(scenario)
    rng = np.random.default_rng(0)
    raw = np.rad2deg(model.recording.gyro.rates)
    x = raw + sigma * rng.standard_normal(raw.shape)
    out = []
    for axis in range(3):
        steps = np.geomspace(1e-9, 1.0, 37)
        few = [np.unique(np.round(x[:, axis] / step)).size <= 0.7 * len(x) for step in steps]
        step = float(steps[int(np.argmax(few))]) if any(few) else np.inf
        size = max(step, stream.COARSE * sigma)
        out.append(row_of(EFFECTS[name], "visible", size, "exact: readings are multiples of it", "samples", AXES[axis]))
    return out


def _dead_zones(model: Model, snr: float) -> list[Visible]:
    """A zone whose missing rates have the signal-to-noise ratio that other effects need."""
    effect = EFFECTS["rate_deadzone"]
    zones = np.geomspace(*effect.prior, 41)
    out = []
    for axis in range(3):
        inside = np.abs(model.raw[:, axis, None]) < np.deg2rad(zones)
        low = np.zeros((*model.raw.shape, zones.size))
        low[:, axis] = np.where(inside, -model.raw[:, axis, None], 0.0)
        norms = np.linalg.norm(model.prepared(model.reading(low)), axis=0)
        seen = np.flatnonzero(norms >= snr)
        if seen.size:
            text = "from about here on by the missing rates"
            out.append(row_of(effect, "visible", float(zones[seen[0]]), text, "attitude", AXES[axis]))
        else:
            out.append(row_of(effect, "implausible", np.inf, "no missing rate shows in the attitude", "attitude", AXES[axis]))
    return out


def _saturation(model: Model) -> list[Visible]:
    """Limits that at least five samples exceed."""
    out = []
    for axis in range(3):
        largest = np.sort(np.abs(model.recording.gyro.rates[:, axis]))[-clipping.FEWEST_CLIPPED]
        limit = float(np.rad2deg(largest))
        out.append(row_of(EFFECTS["rate_saturation"], "visible", limit, "limits up to this are seen", "samples", AXES[axis]))
    return out


def _vibration(scenario: Scenario) -> list[Visible]:
    """Power of a tone in the longest quiet stretch under a Hann window, of noise bandwidth 3/2.

    2 × power over noise is χ² with 2 degrees of freedom and noncentrality A² n/(3 σ²); it must pass 2 ln(tried/`LINE_P`).
    """
    effect, n, sigma = EFFECTS["vibration"], quiet_samples(scenario)[1], _sample_sigma(scenario)
    if n < 256 or sigma == 0:
        return [row_of(effect, "not identifiable", np.inf, "needs 256 quiet samples in a row, and noise", "samples")]
    needed = noncentrality(2 * np.log(n / 2 / tones.LINE_P), 2)
    size = float(sigma * np.sqrt(3 * needed / n))
    text = f"above {tones.LOWEST_LINE:g} Hz; up to 1.2 times that between frequency bins"
    return [row_of(effect, "visible", size, text, "samples")]


def noncentrality(point: float, degrees: int) -> float:
    """Of a χ² that passes a point with probability 0.9."""
    low, high = 0.0, 10 * point + 100
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if scipy.stats.ncx2.sf(point, degrees, middle) < POWER else (low, middle)
    return high


def _spikes(scenario: Scenario) -> list[Visible]:
    """Two outliers beyond `OUTLIER` sigmas of a reading less a median of seven, among exponential ones."""
    effect, n, sigma = EFFECTS["spikes"], quiet_samples(scenario)[0], _sample_sigma(scenario)
    fraction = next(float(one.default or 0.0) for one in effect.parameters if one.name == "fraction")
    # P(no more than one of a Poisson number) = 0.1 at 3.89.
    needed, limit = 3.89, outliers.OUTLIER * sigma * np.sqrt(1 + np.pi / 14)
    if 3 * n * fraction <= needed:
        return [row_of(effect, "implausible", np.inf, f"too few samples for a share of {fraction:g}", "samples")]
    size = float(limit / np.log(3 * n * fraction / needed))
    return [row_of(effect, "visible", size, f"share {fraction:g} on all axes; two beyond {limit:.2g} suffice", "samples")]


def _stale(model: Model) -> list[Visible]:
    """Three exact repeats are enough; P(Poisson ≥ 3) = 0.9 at 5.32."""
    share = 5.32 / model.recording.gyro.t_s.size
    return [row_of(EFFECTS["stale_samples"], "visible", 1.0, f"any run length, from a share of {share:.2g} on", "samples")]


def _reference_factor(scenario: Scenario) -> list[Visible]:
    """χ² of three axes' mean square second differences; one axis with a factor f has z = (f² − 1) v/rel."""
    effect = EFFECTS["reference_noise_excess"]
    every = scenario.reference.every_s
    count = 0
    if scenario.reference.at == "series" and every is not None:
        count = sum(max(int((one.stop_s - one.start_s) / every) - 1, 0) for one in scenario.interval)
    if every is None or count < reference_noise.FEWEST:
        text = "needs a longer series of references"
        return [row_of(effect, "not identifiable", np.inf, text, "samples")]
    needed = float(np.sqrt(noncentrality(scipy.stats.chi2.isf(reference_noise.LEVEL, 3), 3)))
    relative = np.sqrt(2 * reference_noise.CORRELATED * reference_noise.TRIMMING / count)
    out = []
    for axis, sigma in enumerate(scenario.reference.sigma_deg):
        walk = 2 * scenario.gyro.arw_deg_per_sqrt_s**2 * every
        factor = float(np.sqrt(1 + needed * relative * (6 * sigma**2 + walk) / (6 * sigma**2)))
        out.append(row_of(effect, "visible", factor, "", "samples", AXES[axis]))
    return out
