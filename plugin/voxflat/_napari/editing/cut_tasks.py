"""The tasks of *Draw cuts* that run in another thread: extract the surface, find cuts, and evaluate them."""

from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.foreground import surface_of
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume
from voxflat.arguments import Progress
from voxflat.maps.flat_map import FlatMap
from voxflat.pipeline.surface import Surface
from voxflat.surfaces.cuts import sketch_error
from voxflat.surfaces.cutting import CutSettings, cut_open
from voxflat.surfaces.standard.sphere import OWN_REGISTRATION, sphere_beside
from voxflat.unique_rows import in_rows

Paths: TypeAlias = dict[str, NDArray[np.int64]]  # cuts by name, as the parameter `cuts` of `Surface.cut` takes them


class Found(NamedTuple):
    """Cuts that were found or read."""

    paths: list[NDArray[np.int64]]  # ids of their vertices in the input
    names: list[str | None]
    left_out: NDArray[np.int64]  # the excluded vertices
    sphere: str | None = None  # on which standard cuts were found: a file, or `OWN_REGISTRATION`


def make_surface(
    source: LayerVolume | LayerMesh, foreground: dict[str, Any], progress: Progress
) -> tuple[Surface, NDArray[np.float64]]:
    """Return the surface on which cuts are drawn, and its mean curvature in 1/mm."""
    whole = surface_of(source, progress, **foreground)
    return whole, whole.mean_curvature(progress=progress)


def find_cuts(whole: Surface, by: str, progress: Progress) -> Found:
    """Return "standard" or "automatic" cuts, or the cuts in a file."""
    cut = whole.cut(by, progress=progress)
    sphere = None if cut.sphere is None else cut.sphere.name
    return Found([line.ids for line in cut.cuts], [line.name for line in cut.cuts], cut.left_out, sphere)


def cuts_of_map(whole: Surface, flat_map: FlatMap) -> Found:
    """Return the cuts of a map, and the vertices of the surface that the map excludes."""
    covered = flat_map.ids[np.unique(flat_map.faces)]
    sphere = OWN_REGISTRATION if flat_map.frame == "standard" and sphere_beside(whole) is None else None
    paths, names = [cut.ids for cut in flat_map.cuts], [cut.name for cut in flat_map.cuts]
    return Found(paths, names, whole.ids[~in_rows(whole.ids, covered)], sphere)


def save_template(whole: Surface, paths: Paths, left_out: NDArray[np.int64], file: Path, progress: Progress) -> Path:
    """Save cuts as a template for all brains, located by the sphere or by the folds of the surface."""
    sphere = sphere_beside(whole) or whole.register(progress=progress)
    cut = _without(whole, left_out).cut(paths, sphere=sphere, relax=False, progress=progress)
    cut.save_template(file, overwrite=True)
    return file


def evaluate_cuts(
    whole: Surface, paths: Paths, left_out: NDArray[np.int64], progress: Progress
) -> tuple[float, list[float]]:
    """Return the mean relative distance error of a coarse preview map, and its increase without each cut."""
    part = _without(whole, left_out)

    def error(cuts: Paths) -> float:
        opened = cut_open(part, CutSettings(cuts=cuts or "automatic", relax=False, progress=progress))
        return sketch_error(opened.surface, None, progress)

    with_all = error(paths)
    return with_all, [error({name: paths[name] for name in paths if name != without}) - with_all for without in paths]


def _without(whole: Surface, left_out: NDArray[np.int64]) -> Surface:
    return whole.drop(left_out) if len(left_out) else whole
