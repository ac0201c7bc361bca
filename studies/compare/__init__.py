"""Comparison of a recording with scenarios: its percentiles among their simulations, and the shrinkage of the gap."""
