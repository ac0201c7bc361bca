"""The only step of the wide check that asks the diagnosis, which sees a recording and nothing else."""

from collections.abc import Sequence
from typing import Any

from gyrocal.recording import Recording
from studies.montecarlo.files import plain

SEED = 0  # the diagnosis' own draws must not depend on the cases'


def diagnosed(recording: Recording, library: Sequence[str] | None = None) -> dict[str, Any]:
    """The diagnosis as JSON, without the findings of single windows, which may be hundreds; it may name those in a library."""
    from diagnosis.diagnose import diagnose  # late: drawing a case must not depend on it

    found = diagnose(recording, library=library, seed=SEED).to_json()
    return {key: plain(value) for key, value in found.items() if key != "where"}
