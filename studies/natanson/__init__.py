"""Natanson 1998 compared with the flight: Tables 2 to 5, and the diagnosis of the flight's own residuals.

| question | file |
|---|---|
| Where are the simulated numbers of Tables 2 to 5 computed? | `paper_tables.py` |
| Which form do they have beside the flight's? | `paper_forms.py`; the flight's values are in `flight.py` |
| Where are page, figures and summary made? | `reproduce.py`, with the claims of `claims.py` |
"""
