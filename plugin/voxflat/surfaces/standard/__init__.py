"""Standard maps: the same named cuts and the same orientation for every brain, by its registered sphere."""
