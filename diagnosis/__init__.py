"""Sim-to-real diagnosis: whether, where and why a recording differs from the simulation, and how much of it the causes close.

- The noise of a sample is estimated in `detectors.sample_noise`.
- A cause gets its probability in `posterior`.

The baseline M0 has a constant G and b, white gyro noise of the stated ARW, and white reference errors of the stated sigmas.
All steps use one linear model (`model.linear`). An unmodelled effect adds a group of columns beside the twelve of the
calibration. A column is the error that the effect adds to the gyro's readings or to the reference attitudes.

`diagnose` uses the modules in this order (steps 4 to 9 are in `explain`):

1. `detectors.samples` calls the test of each symptom, one per file.
2. `model.prepare` calibrates under M0 (`model.calibration`) on the linearised recording (`model.recording_model`). It
   classifies the noise of the references, and repeats that without the effects that were identified. `sinusoids` fits the
   lines of the samples and the periods of step 4.
3. `model.symptoms` finds the effects that claim each symptom of the samples.
4. `model.candidates` builds the columns of listed effects, with `model.processes` and `model.periods`, and of alternatives
   outside the library (`model.alternatives`), and joins them to one linear model.
5. `inference.null` tests whether there is a misfit.
6. `inference.joint_search` finds the set of effects and random errors with the highest posterior, by the evidence of sets
   (`inference.search`, `inference.evidence`), and refines its options (`inference.refinement`). Each place of the set holds a
   cause with its alternatives, or a member of the remainder.
7. `inference.amplitudes` estimates the sizes of all members.
8. `budget` measures on held-out data (`model.folds`) how much each cause closes beside the remainder; a cause that closes
   less than nothing belongs to the remainder. `replication` compares sizes between parts of the recording.
9. `model.calibration` estimates G and b with causes and remainder in the model; `remainder` sums up what no cause explains.
10. `assemble` builds the answer (`result`, `answer`), with the verdict from probabilities alone (`verdict`), the tables of
    figures (`detail_tables`) and sentences (`notes`). `adopt` converts it to a scenario.

Raw sensor tables (`sensor_tables`, built by `model.sensors`) use the same steps from 4 on; their answer is `sensor_result`.
General thresholds are in `settings`, others are constants of their module. `plan` predicts what a maneuver plan can show.
"""
