"""Provide standard maps: the same named cuts and orientation for every brain, based on its registered sphere."""
