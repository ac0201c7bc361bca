"""Allan deviation of a gyro's rates and the noise terms of IEEE Std 952 in it, from arrays alone."""

from gyrocal.allan.deviation import Deviation, overlapping_allan_deviation
from gyrocal.allan.fit import Fit, TermEstimate, fit_terms
from gyrocal.allan.terms import TERMS, compute_allan_variance

__all__ = [
    "TERMS",
    "Deviation",
    "Fit",
    "TermEstimate",
    "compute_allan_variance",
    "fit_terms",
    "overlapping_allan_deviation",
]
