"""A long study that is killed at random moments: ``python -m tests.soak`` writes build/soak."""
