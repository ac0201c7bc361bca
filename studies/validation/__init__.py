"""Validation of the framework itself: the test world, exams, the baseline of recovered parameters, real gyros."""
