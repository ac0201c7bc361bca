"""The wide world: recordings of craft, gyros and references unlike TRMM's, with effects that the diagnosis has never seen.

- `families`: unlisted effects, written from the physics of gyros, attitude sensors and telemetry alone
- `kinds`, `paths`, `plans`: motions, gyros and references drawn at random, and their noise-free recordings
- `evidence`: how strongly an effect shows, whatever the stage of the measuring chain it acts at
- `world`, `placing`, `novelty`: what effects do to a plan, their sizes, and what of an unlisted one no listed one explains
- `split`: which families, plans and grades set thresholds and which score, never both (``split.json``)
- `cases`: a case by its number; `diagnosing`: the only module here that asks the diagnosis
- `study`: ``gyrocal study wide``
"""
