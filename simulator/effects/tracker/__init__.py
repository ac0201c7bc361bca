"""Effects of one of several star trackers, one per file; dropouts are a scenario's, see `simulator.sensors.trackers`."""
