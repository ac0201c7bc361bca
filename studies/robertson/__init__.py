"""Reproduction of R: the Mission Mode loop simulated through the flight's first five months, and the flight's values.

| question | file |
|---|---|
| Where is R Table 3 computed as in R, on board minus ground batch? | `ladder.py`, from the nominal to the flight |
| Where is it computed against the simulated truth, with Tables 1 and 2? | `performance.py` |
| Where are the flight's values? | `published_tables.py` |
| Where are page, figures and summary made? | `reproduce.py`, `figures.py`, `claims.py` |
"""
