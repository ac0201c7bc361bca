"""The true motion: orbit, maneuvers, and the integration of the attitude."""
