"""The Monte Carlo engine: studies, cases, storage, backends, dispersions, statistics."""
