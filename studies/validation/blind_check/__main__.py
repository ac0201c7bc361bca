"""One step of the blind check as a process: ``python -m studies.validation.blind_check make|diagnose|score FOLDER [JOBS]``.

`make` reads its settings (`Spec` as JSON) from standard input. Progress goes to standard error. An error is one line on
standard output, for whoever started the step, and an exit status that is not 0.
"""

import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from gyrocal.errors import GyrocalError
from studies.report.console import progress
from studies.validation.blind_check.cases import Spec
from studies.validation.blind_check.steps import diagnose_all, make, score

SHOWN = {"make": "blind: recordings", "diagnose": "blind: diagnoses", "score": "blind: scores"}


def main(arguments: list[str]) -> int:
    """Run a step; returns the exit status."""
    step, folder = arguments[0], Path(arguments[1])
    jobs = int(arguments[2]) if len(arguments) > 2 else 1

    def shown(study: str, total: int) -> AbstractContextManager[Any]:
        return progress(SHOWN[step], total)

    try:
        if step == "make":
            make(folder, Spec.model_validate_json(sys.stdin.read()), jobs, shown)
        elif step == "diagnose":
            diagnose_all(folder, jobs, shown)
        elif step == "score":
            score(folder, jobs, shown)
        else:
            print(f"{step}: no such step; there are {', '.join(SHOWN)}")
            return 2
    except GyrocalError as error:
        print(" ".join(str(error).split()))
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
