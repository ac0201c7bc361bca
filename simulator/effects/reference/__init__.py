"""Effects on the reference attitudes, one per file."""
