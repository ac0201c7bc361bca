"""A recording linearised about the calibration beside its likeliest effect, where that under M0 is too far off.

What M0 cannot explain goes into its G and b as far as it will. A gyro that hides degrees of motion turns its axes by degrees,
and half the square of that times the angle of a slew is more than a reference's sigma: the model is not linear there
any more, and no effect would explain what is left. The single effect of the list that explains most tells the calibration
beside it. Linearised about that, all are compared anew (Gauss–Newton, with the effect in the model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from diagnosis.inference.amplitudes import amplitudes
from diagnosis.inference.search import Search
from diagnosis.model.calibration import calibrated
from diagnosis.model.candidates import linear_model
from diagnosis.model.dead_zone import dead_zone_groups
from diagnosis.model.prepare import Prepared
from diagnosis.model.true_path import SMALL
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Effect

ROUNDS = 2


def beside_the_likeliest(prepared: Prepared, effects: Sequence[Effect], settings: DiagnosisSettings) -> Prepared:
    """The same, its model linearised about the calibration beside the effect that explains most, where that matters."""
    sigma = float(prepared.model.recording.attitudes.sigma.min())
    for _ in range(ROUNDS):
        model = prepared.model
        if not model.bent:
            break
        linear = linear_model(model, effects, dead_zone_groups(prepared, effects), settings, rivals=False, scan=False)
        best = max(Search(linear, settings).singles(), key=lambda one: one.log_evidence)
        change, _ = calibrated(model, amplitudes(linear, best.members))
        if 0.5 * float(np.abs(change[:9]).max()) ** 2 < SMALL * sigma:
            break
        prepared = replace(prepared, model=prepared.linearise(model.G + change[:9].reshape(3, 3), model.bias + change[9:]))
    return prepared
