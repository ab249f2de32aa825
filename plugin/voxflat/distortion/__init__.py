"""Distortion of a flattened surface: `figures` of distances and triangles, and `distortion`, all of them in tables."""
