"""Known vulnerabilities of the pinned packages: ``make audit``, by pip-audit, which asks the package registry.

Where the registry cannot be reached, or does not know of vulnerabilities, nothing is checked and one line says so: that
is no clean bill. A vulnerability that is found ends with status 1.
"""

import json
import subprocess
import sys
from typing import Any

from tests import ROOT

COMMAND = ("-m", "pip_audit", "--requirement", "constraints.txt", "--no-deps", "--disable-pip", "--format", "json")


def judged(packages: list[dict[str, Any]]) -> tuple[str, int]:
    """What is said of the packages that pip-audit lists, and the exit status."""
    asked = [one for one in packages if "skip_reason" not in one]
    if not asked:
        return "audit: skipped: the registry says nothing of vulnerabilities; nothing was checked", 0
    found = [
        f"{one['name']} {one['version']}: {', '.join(each['id'] for each in one['vulns'])}" for one in asked if one["vulns"]
    ]
    rest = f"; {len(packages) - len(asked)} could not be checked" if len(asked) < len(packages) else ""
    if not found:
        return f"audit: no known vulnerability in {len(asked)} pinned packages{rest}", 0
    return "\n".join([f"audit: {len(found)} of {len(asked)} pinned packages have known vulnerabilities{rest}", *found]), 1


def main() -> int:
    """Ask, and say what came back; the exit status."""
    ran = subprocess.run([sys.executable, *COMMAND], cwd=ROOT, capture_output=True, text=True)
    try:
        said, status = judged(json.loads(ran.stdout)["dependencies"])
    except (ValueError, KeyError):
        last = (ran.stderr.strip().splitlines() or ["no answer"])[-1]
        said, status = f"audit: skipped: the registry cannot be asked ({last[:200]}); nothing was checked", 0
    print(said)
    return status


if __name__ == "__main__":
    sys.exit(main())
