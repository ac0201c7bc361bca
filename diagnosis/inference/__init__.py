"""Inference on a linear model: candidates, evidence, search, attribution, amplitudes, closure."""
