"""Geodesic distances: sources, distance rows in memory or in a store on disk, and paths."""
