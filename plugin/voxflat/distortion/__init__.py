"""Distortion of a flattened surface: `figures` for distances and triangles, and `distortion` for their tables."""
