"""Motions that are a law of their own, by name: what a craft or a laboratory does beyond turns, sway and scans."""

from studies.validation.wide.motions import carriers, spacecraft
from studies.validation.wide.motions.base import Law, Lot, Moved

MOTIONS: dict[str, Law] = {law.__name__: law for law in (*spacecraft.LAWS, *carriers.LAWS)}

__all__ = ["MOTIONS", "Law", "Lot", "Moved"]
