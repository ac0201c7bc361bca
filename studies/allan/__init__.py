"""Allan deviation of the noise of a recording, with the terms of IEEE Std 952 in it."""
