"""Sim-to-real diagnosis: does a recording depart from the baseline simulator, where, by which cause, and how far it shrinks.

The baseline M0 has a constant G and b, white gyro noise of the stated ARW, and white reference errors of the stated sigmas.
Everything rests on one linear model (`diagnosis.model.linear`): what an unmodelled effect adds to the reading of the gyro or
to a reference attitude becomes one more group of columns beside the twelve of the calibration.

The way of a recording through `diagnosis.diagnose`, file by file (steps 4 to 11 are in `explain`):

1. `detectors.samples` and the detector of each symptom beside it: each returns what it finds, and the stream repaired further.
2. `model.prepare`: the calibration under M0 (`model.baseline`) on `model.recording`, which linearises the recording;
   `model.judgement` asks the attitude about lines of the samples and the references' noise, and asks anew, without them, once
   effects were found (`model.at_work`).
   `sinusoids` finds and fits the lines of the samples, the tones of the references and the periods of step 4 alike.
3. `model.symptoms`: which effects claim what the samples show.
4. `model.groups`, with `model.unlisted`, `model.repeating`, `model.processes` and `model.dead_zone`: what could be there, which
   `model.candidates` puts side by side as one linear model; `model.periods` scans the data for swings of any period.
5. `inference.null`: whether there is a gap at all.
6. `inference.search`, on `inference.evidence`: sets of effects and their posterior.
7. `inference.attribution`: what may be named.
8. `inference.amplitudes`: how large the named effects are.
9. `inference.criticism`: whether the identified effects would give innovations like these.
10. `inference.closure`, on the folds of the model: how far the gap shrinks on held-out data.
11. `model.calibration`: G and b with the named effects in the model.
12. `remainder_search`, where listed effects alone do not explain the data: effects in the presence of `model.remainder`, whose
    sizes replicate (`replication`); and the gap budget on held-out data (`budget`).
13. `assemble`: the answer, `result`; `verdict`, from probabilities alone.

Raw sensor tables take the same way from step 4 on, with `model.sensors` as their builder (`sensor_tables`). Thresholds are in
`settings`. What a maneuver plan could show is in `plan`.
"""
