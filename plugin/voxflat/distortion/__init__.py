"""What flattening did to a surface: `figures` of distances and triangles, and `distortion`, all of a map, in tables."""
