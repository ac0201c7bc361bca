"""Validation of the framework itself: the baseline of recovered parameters, real gyros."""
