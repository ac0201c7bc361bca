"""Allan deviation of a gyro's rates and the noise terms of IEEE Std 952 in it, from arrays alone."""

from gyrocal.allan.deviation import Deviation, edf, overlapping_allan_deviation, pooled_edf
from gyrocal.allan.fit import Fit, TermEstimate, fit_terms
from gyrocal.allan.terms import TERMS, allan_variance

__all__ = [
    "TERMS",
    "Deviation",
    "Fit",
    "TermEstimate",
    "allan_variance",
    "edf",
    "fit_terms",
    "overlapping_allan_deviation",
    "pooled_edf",
]
