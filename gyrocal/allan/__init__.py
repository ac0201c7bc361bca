"""Allan deviation of a gyro's rates and the noise terms of IEEE Std 952 in it, from arrays alone."""

from gyrocal.allan.deviation import Deviation as Deviation
from gyrocal.allan.deviation import overlapping_allan_deviation as overlapping_allan_deviation
from gyrocal.allan.fit import Fit as Fit
from gyrocal.allan.fit import TermEstimate as TermEstimate
from gyrocal.allan.fit import fit_terms as fit_terms
from gyrocal.allan.terms import TERMS as TERMS
from gyrocal.allan.terms import compute_allan_variance as compute_allan_variance
