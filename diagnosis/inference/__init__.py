"""Inference on a linear model: candidates, evidence, search, amplitudes, closure."""
