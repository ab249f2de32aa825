"""Sample the overlays of a hemisphere at the points of its map."""

import os
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io.channels import Channels
from voxflat.io.meshes import read_mesh
from voxflat.io.overlays import read_channels
from voxflat.lab.inputs import Hemisphere
from voxflat.lab.layouts import HEMISPHERES
from voxflat.maps.depth import ON_SURFACE, Depths
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import at_points
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import VolumeSource, source_of
from voxflat.pipeline.standard_map import VERTICES, mesh_file
from voxflat.surfaces.standard.sphere import interpolated, named_space, on_unit_sphere

_ONE = "Pass a file with one map, or draw the series with voxflat image or voxflat movie"
_SERIES = (".dtseries.nii", "_bold.func.gii")  # endings of time series, of which the mean over time is shown
_ON_TEMPLATE = re.compile(r"_space-(fsaverage[56]?)_.*\.(func|shape)\.gii$")  # values at the vertices of a template


def overlay_values(flat_map: FlatMap, hemisphere: Hemisphere) -> dict[str, NDArray[np.number]]:
    """Return the overlays at every point of the map, by name.

    Volumes are sampled in the middle of the cortex if it is known, and values on fsaverage between its vertices.
    """
    surface = flat_map._triangles.on_surface
    in_cortex = flat_map.white_points is not None and flat_map.pial_points is not None
    depths = Depths.of(0.0, 0.5, "equivolume") if in_cortex else ON_SURFACE
    overlays = {}
    for name, path in hemisphere.overlays.items():
        on_template = _ON_TEMPLATE.search(path.name)
        source = source_of(surface, _resampled(path, on_template[1], hemisphere) if on_template else path)
        is_volume = isinstance(source, VolumeSource)
        if len(source.channels) > 1 and path.name.endswith(_SERIES):
            source = source_of(surface, _mean(source.channels))
        if (count := len(source.channels)) > 1:
            raise InputError(f"the overlay {path} has {count} {'frames' if is_volume else 'maps'}. {_ONE}")
        values = source.image(at_points(len(flat_map)), Sampling(depths if is_volume else ON_SURFACE)).data
        if values.ndim > 2:
            raise InputError(f"the overlay {path} has colours or several volumes. Pass one volume of values")
        overlays[name] = values[:, 0]
        if not np.isfinite(overlays[name]).any():
            raise InputError(f"the overlay {path} has no values on the map. Check that it belongs to this subject")
    return overlays


def _mean(series: Channels) -> NDArray[np.float64]:
    """Return the mean over time at each vertex, shape (V,)."""
    total = np.asarray(series.read(0), dtype=np.float64)
    for frame in range(1, len(series)):
        total = total + series.read(frame)
    return total / len(series)


def _resampled(path: Path, mesh: str, hemisphere: Hemisphere) -> NDArray[np.float64]:
    """Return values of a template's vertices at the vertices of the hemisphere, by its registered sphere."""
    own = hemisphere.files.get("sphere")
    if own is None or named_space(own.name) != "fsaverage":
        remedy = "Pass --space native, and check that desc-reg_sphere.surf.gii exists"
        raise InputError(f"the overlay {path} is on {mesh}, but no sphere registers the surface to it. {remedy}")
    series = read_channels(path, VERTICES[mesh])
    values = _mean(series) if path.name.endswith(_SERIES) else np.asarray(series.read(series.find(None)), np.float64)
    template = mesh_file("fsaverage", mesh, HEMISPHERES[hemisphere.hemi][1], "sphere", _subjects_directories(path))
    sphere = read_mesh(own)
    wanted = on_unit_sphere(sphere.points, np.unique(sphere.faces), str(own))
    places = on_unit_sphere(template.points, np.unique(template.faces), mesh)
    return interpolated(places, template.faces, values[:, None], wanted)[0][:, 0]


def _subjects_directories(path: Path) -> list[Path]:
    """Return the directories that may contain fsaverage: that of fMRIPrep, and that of FreeSurfer."""
    folders = [parent / "sourcedata" / "freesurfer" for parent in path.resolve().parents]
    return [*folders, *(Path(os.environ[name]) for name in ("SUBJECTS_DIR",) if name in os.environ)]
