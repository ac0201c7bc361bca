"""One step of the blind check as a process: ``python -m studies.validation.blind_check make|diagnose|score FOLDER [JOBS]``.

`make` reads its settings (`Spec` as JSON) from standard input. Progress is a number a line on standard output; an error is one
line on standard error and exit status 2.
"""

import sys
from pathlib import Path

from gyrocal.errors import GyrocalError
from studies.validation.blind_check.cases import Spec
from studies.validation.blind_check.steps import diagnose_all, make, score


def main(arguments: list[str]) -> int:
    """Run a step; returns the exit status."""
    step, folder = arguments[0], Path(arguments[1])
    jobs = int(arguments[2]) if len(arguments) > 2 else 1

    def told(done: int) -> None:
        print(done, flush=True)

    try:
        if step == "make":
            make(folder, Spec.model_validate_json(sys.stdin.read()), jobs, told)
        elif step == "diagnose":
            diagnose_all(folder, jobs, told)
        elif step == "score":
            score(folder, jobs, told)
        else:
            print(f"{step}: no such step; there are make, diagnose, score", file=sys.stderr)
            return 2
    except GyrocalError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
