"""Sentinel-2A in flight: 97 s of four fibre-optic gyros and two star trackers, by the general import.

Contains modified Copernicus Sentinel data 2020. The data and the mapping that they are imported by are in
``studies/data/sentinel2a``; nothing here reads them in a way of its own. The trackers' attitudes end at 65 s, the gyros go on.

- `flown` imports, and says what was known of the gyros beforehand.
- `findings` asks what the first 65 s tell: drift with parameters fitted to other thirds, noise, what is left, and what cannot
  be told at a rate that is nearly constant. It carries the trackers' attitudes on to 97 s.
"""

from studies.validation.sentinel2a.study import ENTRY, STUDY

__all__ = ["ENTRY", "STUDY"]
