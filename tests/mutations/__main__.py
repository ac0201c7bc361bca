"""Put each fault into a copy of the tree, run the tests, and write which test saw it: build/mutations.

``python -m tests.mutations`` runs all faults; words choose those whose name has one of them, and only their rows are made
anew. With ``--new`` only faults without a row, or with one that says that nothing saw them, are run; with ``--whole`` the whole
suite is asked after the tests that the table names, which takes as long as it takes for each that no test sees.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

from tests import ROOT
from tests.mutations import FAULTS, run

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy is loaded
    os.environ[_name] = "1"

RESULTS = ROOT / "build" / "mutations"
COMMAND = "python -m tests.mutations"


def known() -> dict[str, dict[str, object]]:
    """Rows of earlier runs by name, of faults that are in the table as they were."""
    path = RESULTS / "mutations.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["mutants"] if path.exists() else []
    now = {(fault.name, fault.old, fault.new) for fault in FAULTS}
    return {row["name"]: row for row in rows if (row["name"], row["old"], row["new"]) in now}


def write(rows: dict[str, dict[str, object]]) -> None:
    """Write the rows there are, in the order of the table."""
    ordered = [rows[fault.name] for fault in FAULTS if fault.name in rows]
    RESULTS.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"command": COMMAND, "mutants": ordered}, indent=1, ensure_ascii=False)
    (RESULTS / "mutations.json").write_text(text + "\n", encoding="utf-8")
    alive = [row for row in ordered if not row["killed_by"]]
    lines = [
        "## Small faults and the tests that see them",
        "",
        f"`{COMMAND}`; {len(ordered)} of {len(FAULTS)} faults were run, and {len(alive)} of them seen by no test asked.",
        "Each was alone in a copy of the tree, its compiled code cold; s is the time on a machine that did other work beside.",
        "The commit is that of the sources, with the tests of the day: tests were added for what nothing had seen.",
        "A source may have had another name then.",
        "",
        "| file | fault | seen by | asked | s | commit |",
        "|---|---|---|---|---|---|",
    ]
    for row in ordered:
        seen = f"`{row['killed_by']}`" if row["killed_by"] else "**nothing**"
        lines.append(f"| {row['file']} | {row['breaks']} | {seen} | {row['asked']} | {row['seconds']} | {row['commit']} |")
    left = [fault.name for fault in FAULTS if fault.name not in rows]
    lines += ["", f"Not run yet (`{COMMAND} --new`):", "", *(f"- {name}" for name in left)] if left else []
    (RESULTS / "mutations.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def parsed(arguments: list[str]) -> argparse.Namespace:
    """What is asked for on the command line."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=(__doc__ or "").splitlines()[0])
    parser.add_argument("words", nargs="*", help="choose the faults whose name has one of these; all by default")
    parser.add_argument("--new", action="store_true", help="only faults without a row, or that nothing saw")
    parser.add_argument("--whole", action="store_true", help="ask the whole suite after the tests that the table names")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> int:
    """Run the chosen faults; the number of those that nothing saw."""
    asked_for, rows, commit = parsed(arguments), known(), run.commit()
    words = asked_for.words
    chosen = [fault for fault in FAULTS if not words or any(word in fault.name for word in words)]
    if asked_for.new:
        chosen = [fault for fault in chosen if not rows.get(fault.name, {}).get("killed_by")]
    run.loaded()
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        tree = run.copied(Path(folder))
        for fault in chosen:
            with run.faulty(tree, fault):
                ran, asked = run.tested(tree, fault.tests), "tests of the table"
                if not ran.by and asked_for.whole:
                    first, asked = ran, "whole suite"
                    ran = run.tested(tree, ["tests"])
                    ran = run.Ran(ran.by, first.seconds + ran.seconds)
            row = {"name": fault.name, "file": fault.file, "breaks": fault.breaks, "old": fault.old, "new": fault.new}
            rows[fault.name] = {
                **row,
                "killed_by": ran.by,
                "asked": asked,
                "seconds": round(ran.seconds, 1),
                "commit": commit,
            }
            print(f"{ran.seconds:6.1f} s  {fault.name}: {ran.by or 'SURVIVED'}", flush=True)
            write(rows)
        # A test that fails without the fault as well would have seen nothing.
        seen = sorted({str(rows[fault.name]["killed_by"]) for fault in chosen} - {""})
        wrong = run.tested(tree, [one for one in seen if "::" in one]).by if seen else ""
        if wrong:
            print(f"{wrong} fails without a fault")
    return bool(wrong) or sum(not rows[fault.name]["killed_by"] for fault in chosen)


if __name__ == "__main__":
    sys.exit(min(main(sys.argv[1:]), 1))
