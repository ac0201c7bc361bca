"""Natanson 1998 compared with the flight: Tables 2 to 5, and the diagnosis of the flight's own residuals."""
