"""Motions that are a law of their own: what a craft or a laboratory does beyond turns, sway and scans."""
