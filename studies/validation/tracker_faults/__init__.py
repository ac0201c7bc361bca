"""Which of two star trackers errs, and by what: drawn effects of one of them over several plans, and none.

- `cases` draws an effect of a known signal-to-noise ratio, and asks the diagnosis.
- `report` counts.
"""

from studies.validation.tracker_faults.cases import STUDY
from studies.validation.tracker_faults.report import ENTRY

__all__ = ["ENTRY", "STUDY"]
