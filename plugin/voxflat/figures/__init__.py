"""Figures of flat maps (`flat_map`, `scatter`, `heat_map`, `patch_3d`, ...) and of atlases (`atlas_page`, ...).

Most functions return a `matplotlib.figure.Figure`, which can be changed, and which `save` writes. They do not use
pyplot, so they work without a screen, in threads, and alongside the user's own figures. The 3-D functions draw with
PyVista and return an image, which `save_picture` writes. `movie` returns a sequence of images, which `save_movie`
writes.
"""

from voxflat.figures.atlases import atlas_heat_map, atlas_page
from voxflat.figures.distortion import heat_map, heat_maps, scatter, spectrum
from voxflat.figures.files import save, save_movie, save_picture
from voxflat.figures.flat_maps import flat_map
from voxflat.figures.movies import Movie, movie
from voxflat.figures.overlays import Overlay
from voxflat.figures.profiles import profile
from voxflat.figures.views_3d import atlas_3d, patch_3d
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
    "profile",
    "save",
    "save_movie",
    "save_picture",
    "scatter",
    "spectrum",
    "worst_places",
    "worst_places_3d",
]


def __dir__() -> list[str]:
    return sorted(__all__)
