"""Files that napari opens and saves: surfaces, values on them, patches, flat maps and atlases."""
