"""Which of several gyros fails: drawn faults of six gyros and of a tetrahedron, with and without reference attitudes.

- `cases` draws a fault of a known signal-to-noise ratio, and asks the diagnosis.
- `report` counts.
"""

from studies.validation.gyro_faults.cases import STUDY
from studies.validation.gyro_faults.report import ENTRY

__all__ = ["ENTRY", "STUDY"]
