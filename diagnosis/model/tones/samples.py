r"""Whether the samples show a tone that the references ascribe to a reading.

With S the samples' Fourier coefficient under a window at the tone's frequency, a that of the tone itself, and P the mean
power of n coefficients around,

    log LR = (n + 1) [log(1 + |S|²/(n P)) − log(1 + |S − a|²/(n v))] − log(v/P),    v = P + 2 |a|²/χ²,

for the tone in the readings against none: P has the scatter of n coefficients, and a that of the χ² that the references give
it. A body that moves at that frequency has a large S of any phase, which speaks for neither.
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from diagnosis.model.tones.tone import Array, Way
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices

BESIDE = np.arange(3, 15)  # coefficients to either side of a tone, in units of the frequency resolution


def sample_log_ratio(recording: Recording, rates: Array, way: Way, chi2: float) -> float:
    """log of the likelihood of the samples with a tone in the readings, over that without, see the module.

    Parameters
    ----------
    recording : whose intervals the samples are of
    rates : (samples, 3) raw rates, rad/s
    way : of the tone
    chi2 : that it explains of the references
    """
    total, sample_s = 0.0, recording.gyro.sample_s
    wave = way.in_samples(recording)
    for part in interval_slices(recording):
        count = part.stop - part.start
        whole = BESIDE / (count * sample_s)
        if way.frequency_hz <= whole[-1] or way.frequency_hz + whole[-1] >= 0.5 / sample_s:
            continue
        turned = np.exp(-2j * np.pi * way.frequency_hz * sample_s * np.arange(count)) * np.hanning(count)
        x = rates[part, way.axis]
        spectrum, a = scipy.fft.fft(turned * (x - x.mean())), np.sum(turned * wave[part])
        S, n = spectrum[0], 2 * BESIDE.size
        P = float(np.mean(np.abs(spectrum[np.concatenate([BESIDE, -BESIDE])]) ** 2))
        if not P > 0:
            continue
        v = P + 2 * abs(a) ** 2 / max(chi2, 2.0)
        total += (n + 1) * float(np.log1p(abs(S) ** 2 / (n * P)) - np.log1p(abs(S - a) ** 2 / (n * v)))
        total -= float(np.log(v / P))
    return total
