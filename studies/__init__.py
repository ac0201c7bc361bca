"""Parameterised studies, the flight's published values, the paper's tables and the command line."""
