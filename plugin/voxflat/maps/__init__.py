"""Flat maps: pixels and what they show, the way back to the surface, textures, and map files.

From below: `colours` and `pictures` know arrays alone; `image_files` and `raster` make pixels and images of
them, `subdivision` and `texture` surfaces with a picture; `surface_texture` and `sampler` say what pixels show; `plane`
is what a map and the page of an atlas share; `flat_map` is the map.
"""
