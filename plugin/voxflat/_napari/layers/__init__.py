"""Convert napari layers to volumes, meshes and points in mm."""
