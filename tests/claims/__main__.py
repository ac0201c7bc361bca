"""``python -m tests.claims``: show what README, docs and changelog claim wrongly; with ``--write``, write what results say."""

import sys

from tests import ROOT
from tests.claims.check import problems, values_of, write

if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        write(ROOT, values_of(ROOT))
    found = problems(ROOT)
    print("\n".join(map(str, found)) or "every claim is what its result says")
    sys.exit(bool(found))
