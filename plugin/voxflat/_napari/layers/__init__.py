"""What napari's layers hold, as volumes, meshes and places in mm."""
