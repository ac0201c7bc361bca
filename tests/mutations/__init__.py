"""Small faults put into the core one at a time, and the tests that see each: ``python -m tests.mutations``."""

from tests.mutations import calibrator, diagnosing, reading, simulating, studying

# The layers from the top: what is compiled of those below a faulty one stays good.
FAULTS = [*studying.FAULTS, *diagnosing.FAULTS, *simulating.FAULTS, *reading.FAULTS, *calibrator.FAULTS]
