"""Figures: `flat_map`, `scatter`, `heat_map(s)`, `spectrum`, `patch_3d`, ... of maps; `atlas_page`, ... of atlases.

Those in space return a picture, which `save_picture` writes, drawn by PyVista; `movie` pictures one after the other,
which `save_movie` writes. The others return a
`matplotlib.figure.Figure`, to be changed, or written by `save`; none touches pyplot, so they work without a screen, in
threads, and beside the user's own figures.
"""

from voxflat.figures.atlases import atlas_heat_map, atlas_page
from voxflat.figures.files import save, save_movie, save_picture
from voxflat.figures.flat_maps import flat_map
from voxflat.figures.maps import heat_map, heat_maps, scatter, spectrum
from voxflat.figures.movies import Movie, movie
from voxflat.figures.overlays import Overlay
from voxflat.figures.space import atlas_3d, patch_3d
from voxflat.figures.worst import worst_places, worst_places_3d

__all__ = [
    "Movie",
    "Overlay",
    "atlas_3d",
    "atlas_heat_map",
    "atlas_page",
    "flat_map",
    "heat_map",
    "heat_maps",
    "movie",
    "patch_3d",
    "save",
    "save_movie",
    "save_picture",
    "scatter",
    "spectrum",
    "worst_places",
    "worst_places_3d",
]
