"""Tones that the references show and their averages do not.

Candidates are seen in averages of neighbouring references, in which a tone of a few references' period is lost, and the gyro's
own samples may hide it in the motion. So the innovations of all references (`diagnosis.model.misfit`) are searched for one.

What follows the motion swings as the body does: a tone is one only if it keeps its χ² beside what the products of the rates,
their sizes and their changes explain. Its rivals are a wave about no single axis, and one whose amplitude is another in each
part of the recording.
"""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp

from diagnosis.model.recording import RecordingModel
from diagnosis.model.tones.fit import Fit
from diagnosis.model.tones.peak import strongest
from diagnosis.model.tones.tone import BIAS, PICKUP, REFERENCE, UNLISTED, Array, Tone, Way

OWN = 0.5  # share of its χ² that a tone must keep beside what follows the motion


def fast_tone(model: RecordingModel, rates: Array, p_least: float, unlisted: float) -> Tone | None:
    """The strongest tone of all references that is too fast for their averages; None without one.

    Parameters
    ----------
    model : of the recording, about its calibration under M0
    rates : (samples, 3) repaired raw rates, rad/s
    p_least : p-value below which a tone is one
    unlisted : prior probability that it is on no list
    """
    found = None if model.recording.attitudes.sensor is not None else strongest(model, p_least)
    if found is None:
        return None
    fit = Fit.of(model)
    centre = fit.centred(found)
    axis, _ = fit.strongest(centre)
    (frequency,) = fit.coherent(np.array([centre]), axis, found.step_hz)
    if fit.strongest(frequency)[1] < OWN:
        return None
    ways = [*fit.listed(float(frequency), centre, axis, found.step_hz, rates), *fit.rivals(float(frequency), axis)]
    shares = {REFERENCE: (1 - unlisted) / 3, BIAS: (1 - unlisted) / 3, PICKUP: (1 - unlisted) / 3, UNLISTED: unlisted}
    log = np.array([way.log_weight + np.log(shares[way.kind]) for way in ways])
    probability = np.exp(log - logsumexp(log))
    together: dict[tuple[str, int], tuple[Way, float]] = {}
    for k in np.argsort(-probability):
        key = ways[k].kind, ways[k].axis
        first, share = together.get(key, (ways[k], 0.0))
        together[key] = (first, share + float(probability[k]))
    return Tone(tuple(sorted(together.values(), key=lambda one: -one[1])), found.p_value)
