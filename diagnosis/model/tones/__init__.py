"""Tones that all references show and their averages do not."""
