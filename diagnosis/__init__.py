"""Sim-to-real diagnosis: whether, where and why a recording differs from the simulation, and how far the causes close that.

The baseline M0 has a constant G and b, white gyro noise of the stated ARW, and white reference errors of the stated sigmas.
Everything rests on one linear model (`diagnosis.model.linear`). An unmodelled effect adds a group of columns beside the twelve
of the calibration. Its column is what the effect adds to the gyro's readings or to a reference attitude.

`diagnosis.diagnose` uses the modules in this order (steps 4 to 12 are in `explain`):

1. `detectors.samples` calls the test of each symptom. A test returns its findings and the repaired stream.
2. `model.prepare` calibrates under M0 (`model.baseline`) on the linearised recording (`model.recording_model`).
   `model.noise_classification` classifies the noise of the references, and repeats that without the effects that were
   identified (`model.known_effects`). `sinusoids` fits the lines of the samples and the periods of step 4.
3. `model.symptoms` computes the posterior of each symptom.
4. `model.groups` builds the columns of listed effects, with `model.processes`, `model.periods` and
   `model.rounded_covariates`, and of alternatives outside the library (`model.deterministic_alternatives`,
   `model.periodic_alternatives`). `model.candidates` joins them to one linear model.
5. `inference.null` tests whether there is a misfit.
6. `inference.search` computes the posterior of sets of effects from `inference.evidence`.
7. `inference.attribution` selects the causes that are reported.
8. `inference.amplitudes` estimates their sizes.
9. `inference.criticism` tests whether the explanation would give innovations like the observed ones.
10. `inference.closure` measures on held-out data (`model.folds`) how far the causes close the misfit.
11. `model.calibration` estimates G and b with the causes in the model.
12. `remainder_search` identifies effects in the presence of a remainder (`model.remainder`) where listed effects alone do not
    explain the data. `replication` compares their sizes between parts of the recording, and `budget` gives the gap budget.
13. `assemble` builds the answer (`result`), with the verdict from probabilities alone (`verdict`).

Raw sensor tables (`sensor_tables`, built by `model.sensors`) use the same steps from 4 on. General thresholds are in
`settings`, others are constants of their module. `plan` predicts what a maneuver plan can show.
"""
