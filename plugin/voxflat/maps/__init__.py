"""Flat maps: pixels and the data that they show, lookups on the surface, textures, and map files.

From bottom to top: `colours` and `pictures` work on arrays; `image_files` and `raster` make pixels and images,
`subdivision` and `textured` make surfaces with a picture; `surface_points` holds the geometry, `sampling` interpolates
voxels, and `sources` computes the values of pixels; `plane` is shared by maps and pages of atlases; `flat_map` is the
map.
"""
