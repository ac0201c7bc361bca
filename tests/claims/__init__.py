"""What README, docs and changelog claim is bound to committed results: ``python -m tests.claims [--write]``.

A number that comes from a result has a marker behind it, ``46<!--=mission_loop-->``; its name stands in `tests.claims.registry`
and says which result it is read from. A table that is made of results stands between ``<!--begin NAME-->`` and ``<!--end-->``.
``--write`` brings both up to date. ``--rerun [STUDY]`` runs chosen cases of committed studies again. The test fails if

- a number or a table is not what the result says,
- a case of a committed study that is run again does not give the committed rows (`tests.claims.rerun`),
- a number that looks like a result's has no marker, and is not in ``stated.toml``, which says where else it comes from,
- a page speaks of sealed answers beside anything but an exam.
"""
