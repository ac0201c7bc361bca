"""A real gyro: what M0 lacks on recorded trials, and how far the error of predictions shrinks on trials that found nothing.

The trials are those of BROAD (`studies.validation.broad`, docs/broad.md), a case a sensor unit; units share nothing. Every
trial is diagnosed by itself against M0 with that sensor's noise. Then each is left out in turn (of a unit with one trial each
motion):

- G, a common b and, if half of the others' diagnoses find the gyro late, its delay are fitted to the others, side by side in
  one linear model (`prediction`). Of the trial left out only the gyro is used: the mean of its first rest is taken from its
  rates, and its samples are repaired as their own tests say.
- Its attitude is propagated from the first reference of every interval, with one more thing undone at each rung of the ladder,
  and compared with the references: at the end of the interval, and the mean square over all of them. Rests are not scored.
- The *floor* is what the whole procedure leaves on simulated trials: M0 with the effects found, on the recorded motion.

Then the tags are set right by the delay so found, and the diagnosis asked again what remains; and further effects are tried in
the linear model of the whole unit, with whole trials held out. `study` makes the rows, `report` what is said of them.
"""

from studies.validation.real_gyro.report import ENTRY
from studies.validation.real_gyro.study import STUDY

__all__ = ["ENTRY", "STUDY"]
