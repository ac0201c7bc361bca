"""Effects of the gyro, its timing and its telemetry, one per file."""
