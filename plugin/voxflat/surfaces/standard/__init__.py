"""Provide standard maps: the same named cuts and orientation for every brain, by its registered sphere."""
