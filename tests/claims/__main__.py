"""``python -m tests.claims``: show what README, docs and changelog claim wrongly.

``--write`` writes what results say; ``--rerun [STUDY ...]`` compares committed rows with those of the present code instead.
"""

import sys

from tests import ROOT
from tests.claims.check import problems, values_of, write
from tests.claims.rerun import QUICK, SLOW, rerun_problems

if __name__ == "__main__":
    chosen, *studies = sys.argv[1:] or [""]
    if chosen == "--rerun":
        found = [one for study in studies or {**QUICK, **SLOW} for one in rerun_problems(ROOT, study)]
        well = "every case that was run again is what was committed"
    else:
        if chosen == "--write":
            write(ROOT, values_of(ROOT))
        found, well = problems(ROOT), "every claim is what its result says"
    print("\n".join(map(str, found)) or well)
    sys.exit(bool(found))
