"""The blind check: recordings with effects drawn at random, answers sealed, a diagnosis that sees the recordings alone.

Three steps (`steps`), each fit to run in a process of its own (`python -m studies.validation.blind_check`):

1. `make` draws the cases (`cases`, `plans`, `unlisted`), writes recordings and seals the answers (`seal`). The truth is the
   full simulation, whose motion comes from its own integrator; the diagnosis' linear model only says how strong an effect is.
2. `diagnose_all` reads recordings and nothing else.
3. `score` opens the answers, checks every seal first, and counts (`score`).
"""
