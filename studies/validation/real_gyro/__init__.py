"""A real gyro: what M0 lacks on recorded trials, and how far the error of predictions shrinks on trials that found nothing.

The trials are those of BROAD (`studies.validation.broad`, docs/broad.md), a case a sensor unit; units share nothing. Every
trial is diagnosed by itself against M0 with that sensor's noise. Then each is left out in turn (of a unit with one trial each
motion):

- The effects are *chosen* by the diagnoses of the others: those named by at least half of them (`left_out`). Their sizes, G
  and a common b are fitted to the others by least squares with M0's noise (`fitting`). Of the trial left out only the gyro is
  used: the mean of its first rest is taken from its rates, and samples are repaired one by one (`ladder`).
- Its attitude is propagated from the first reference of every interval, with one more effect at each rung of the ladder, and
  compared with the references: at the end of the interval, and the mean square over all of them. Rests are not scored.
- The *floor* is what the whole procedure leaves on simulated trials: M0 with the effects found, on the recorded motion.

Then the tags are set right by the time offset so found, and the diagnosis asked again what remains. `study` makes the rows
(`own_rows`, `held_rows`, `floor`), `report` the tables, figures and sentences.
"""

from studies.validation.real_gyro.fitting import Fitted, Prediction, fit, predicted
from studies.validation.real_gyro.ladder import LADDER, Found, delayed, filled, repaired, repeats, rungs, untruncated
from studies.validation.real_gyro.left_out import Fold, folds, found_by
from studies.validation.real_gyro.report import ENTRY
from studies.validation.real_gyro.study import STUDY, case
from studies.validation.real_gyro.trials import Loaded, RealConfig, load

__all__ = [
    "ENTRY",
    "LADDER",
    "STUDY",
    "Fitted",
    "Fold",
    "Found",
    "Loaded",
    "Prediction",
    "RealConfig",
    "case",
    "delayed",
    "filled",
    "fit",
    "folds",
    "found_by",
    "load",
    "predicted",
    "repaired",
    "repeats",
    "rungs",
    "untruncated",
]
