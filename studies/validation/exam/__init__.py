"""First-sight exams of the diagnosis, each a folder ``NNN`` whose order of commits shows that it was one.

1. Families of effects and plans are written after the diagnosis is frozen, without sight of it (``families.py``, ``plans.py``).
2. ``gyrocal exam seal NNN`` draws the cases and writes ``seal.json``: seeds, number of cases, the SHA-256 of the generator and
   of the keys, which are what is in each recording. It is committed without keys.
3. ``gyrocal exam run NNN`` diagnoses every recording once, from a clean checkout of that commit or a later one, and writes
   ``keys.json``, ``answers.json``, which names the commit, and ``score.json``. They are committed whatever they say.
4. ``gyrocal exam verify NNN`` checks all of it against the history of the repository.

Afterwards the families are a source of the test world (`studies.validation.world.sources`) like any other.
"""
