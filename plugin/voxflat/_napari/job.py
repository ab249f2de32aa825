"""A flattening job: its parameters, and the steps from volumes and meshes to layers."""

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat._napari.layers.foreground import surface_of
from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.sampled import Overlay, Shown
from voxflat._napari.layers.seed import Seed
from voxflat._napari.layers.volumes import LayerVolume, TimeAxis
from voxflat._napari.results.flat_layers import FlatLayers, MovieMaps, SingleFrame
from voxflat._napari.results.maps import map_layers, page_layers
from voxflat._napari.results.session import Session
from voxflat.arguments import Progress
from voxflat.errors import Cancelled, InputError
from voxflat.evaluation.given_map import load
from voxflat.maps.flat_map import FlatMap
from voxflat.methods import METHODS, Method
from voxflat.pipeline.series import flatten_series
from voxflat.surfaces.standard.sphere import OWN_REGISTRATION


@dataclass(frozen=True, eq=False)
class Frames:
    """All frames of a movie."""

    volumes: tuple[LayerVolume, ...]
    reference: int  # the frame that is flattened
    time: TimeAxis


@dataclass(frozen=True, eq=False)
class Job:
    """The parameters of a flattening, with the defaults of `Surface`; it stores no layers, so any thread can run it."""

    surface: LayerVolume | LayerMesh
    method: str = "voxflat"
    label: int | None = None
    threshold: float | None = None
    rim: str | None = None  # the kind of rim, a key of `RIMS`
    keep: LayerVolume | NDArray[Any] | None = None  # a mask of the same shape for a volume
    seed_point: Seed | None = None
    radius: float | None = None
    polygon: NDArray[np.float64] | None = None  # (k, 3), RAS+ mm: corners, which are moved to the nearest vertices
    pial: LayerMesh | None = None
    flat: LayerMesh | None = None  # the flat map of another tool, which is shown instead of making a map
    options: Mapping[str, Any] = field(default_factory=dict)  # options of the method and of `Surface.flatten`
    pixel_size: float | None = None  # mm
    shown: Shown | None = None
    values: Overlay | None = None  # the values at the vertices of the mesh
    start: FlatMap | None = None  # the map to start from
    frames: Frames | None = None  # to flatten all frames of a movie
    frame: SingleFrame | None = None  # to flatten one of them
    form: Mapping[str, Any] | None = None  # the settings of the form, for the description of the map

    def run(self, progress: Progress) -> FlatLayers:
        _tell(progress, "reading the layer")
        if self.frames is not None:
            return self._flatten_all(self.frames, progress)
        flat_map = self._flatten(progress)
        flat_map = Session.made_from(self.surface.origin, self.form).put(flat_map)
        _draw(progress, "map")
        layers = map_layers(flat_map, self.surface.origin["layer"], self.shown, self.values, self.pixel_size)
        return replace(layers, frame=self.frame)

    def _flatten(self, progress: Progress) -> FlatMap:
        pial = None if self.pial is None else self.pial.read()
        if self.flat is not None:
            whole = surface_of(self.surface, progress, pial=pial)
            return load(self.flat.read(), surface=whole, progress=progress)._measured(progress)
        foreground: dict[str, Any] = {"label": self.label, "threshold": self.threshold, "rim": self.rim, "pial": pial}
        part = surface_of(self.surface, progress, **foreground)
        method, drop, how = self.split()
        if how.get("sphere") == OWN_REGISTRATION:
            how["sphere"] = part.register(progress=progress)
        corners = None
        if self.polygon is not None:
            _, nearest = scipy.spatial.cKDTree(part.points).query(self.polygon)
            corners = part.ids[nearest]
        if self.keep is not None:
            part = part.keep(self.keep.read() if isinstance(self.keep, LayerVolume) else self.keep)
        if drop is not None:
            part = part.drop(drop)
        if self.seed_point is not None and self.radius is not None:
            part = part.disk(self.seed_point, self.radius, progress=progress)
        if corners is not None:
            part = part.polygon(corners, progress=progress)
        return part.flatten(method, **how, progress=progress)

    def _flatten_all(self, frames: Frames, progress: Progress) -> FlatLayers:
        """Flatten all frames of a movie with one map."""
        surfaces = []
        for number, volume in enumerate(frames.volumes):
            try:
                surfaces.append(surface_of(volume, progress, label=self.label, threshold=self.threshold))
            except InputError as error:
                raise InputError(f"frame {number}: {error}") from error
        method, _, how = self.split()
        series = flatten_series(surfaces, method, reference=frames.reference, **how, progress=progress)
        flat_map = series.flat_map
        flat_map = Session.made_from(self.surface.origin, self.form, time=frames.time.record()).put(flat_map)
        _draw(progress, "map")
        layers = map_layers(flat_map, self.surface.origin["layer"], pixel_size=self.pixel_size)
        movie = MovieMaps(replace(series, flat_map=flat_map), frames.time)
        return replace(layers, shown=self.shown, movie=movie)

    def split(self) -> tuple[Method, NDArray[Any] | None, dict[str, Any]]:
        """Split the options into the method, the excluded vertices, and keyword arguments of `Surface.flatten`."""
        kind = METHODS[self.method]
        own = {name: value for name, value in self.options.items() if name in kind.__dataclass_fields__}
        how = {name: value for name, value in self.options.items() if name not in own}
        if self.start is not None:
            own["start"] = self.start
        is_aligned = self.start is None or self.start.frame == "standard"
        if self.frames is not None or not is_aligned:  # movies have no sphere; the position of a start is kept
            how.pop("sphere", None)
        return kind(**own), how.pop("drop", None), how


@dataclass(frozen=True, eq=False)
class PatchesJob:
    """The parameters of a job that flattens a surface in patches, like `Job`."""

    surface: LayerVolume | LayerMesh
    limit: dict[str, Any]  # one of max_angle, bound and count, as in `Surface.patches`
    label: int | None = None
    threshold: float | None = None
    rim: str | None = None
    glue: float | None = None  # the bound on C; None if patches are not glued
    pixel_size: float | None = None  # mm
    shown: Shown | None = None
    form: Mapping[str, Any] | None = None  # the settings of the form, as in `Job`

    def run(self, progress: Progress) -> FlatLayers:
        _tell(progress, "reading the layer")
        foreground: dict[str, Any] = {"label": self.label, "threshold": self.threshold, "rim": self.rim}
        whole = surface_of(self.surface, progress, **foreground)
        atlas = Session.made_from(self.surface.origin, self.form).put(whole.patches(**self.limit, progress=progress))
        glued = None if self.glue is None else atlas.glue(self.glue, progress=progress)
        _draw(progress, "page")
        return page_layers(atlas if glued is None else glued, self.shown, self.pixel_size)


def _draw(progress: Progress, what: str) -> None:
    """Report the drawing stage, and import the modules that the dock needs, so that the window is not blocked later."""
    _tell(progress, f"drawing the {what}")
    importlib.import_module("voxflat.figures")


def _tell(progress: Progress, stage: str) -> None:
    if progress(stage, 0, 1) is False:
        raise Cancelled(f"cancelled while {stage}")
