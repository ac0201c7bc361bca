"""The test world: simulated recordings of many craft, gyros and references, with known effects, and what a diagnosis says.

- `families`, `fresh`: effects outside the library, written from the physics of gyros, attitude sensors and telemetry
- `kinds`, `standard`, `motions`, `paths`, `plans`, `trmm`: plans drawn at random, and their noise-free recordings
- `instruments`: plans with several gyros, star trackers or raw sensor tables
- `evidence`: how strongly an effect shows, whatever the stage of the measuring chain it acts at
- `world`, `placing`, `novelty`: what effects do to a plan, their sizes, and what no listed effect explains
- `sources`, `cases`: families, plans and grades by the name of their source; a case by its number
- `timed`: a diagnosis with its time and memory; `answers`, `score`: what an answer is worth, and all together
- `study`, `report`: ``gyrocal study world``; `bench`: ``gyrocal bench``

It is part of a checkout and not of the installed package.
"""
