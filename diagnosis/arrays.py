"""Types of arrays and what all modules of a diagnosis share; shapes and units are said where one is used."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]

AXES = "xyz"
LEAST_POSITIVE = 1e-300  # beside zero, for p-values and denominators
