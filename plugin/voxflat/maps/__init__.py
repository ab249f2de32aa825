"""Flat maps: pixels and what they show, the way back to the surface, textures, and map files."""
