"""Geodesic distances: sources, rows of distances in memory or in a store on disk, and paths."""
