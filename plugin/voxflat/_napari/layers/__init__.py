"""Conversion of napari's layers to volumes, meshes and points in mm."""
