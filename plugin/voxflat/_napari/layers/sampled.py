"""The values that a flat map shows, from a volume sampled at the surface or from the vertices of a mesh."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
from napari.layers import Labels, Layer, Surface
from napari.utils.colormaps import DirectLabelColormap
from numpy.typing import NDArray

from voxflat._napari.layers.meshes import LayerMesh
from voxflat._napari.layers.volumes import LayerVolume, finest
from voxflat._napari.layers.world import unit_ratio
from voxflat.atlases.atlas import Atlas
from voxflat.demo import DEPTH
from voxflat.io.partners import check_side
from voxflat.maps.plane import Planar
from voxflat.maps.raster import FlatImage

_OTHER = "Show a layer of the map's hemisphere"
_WHITE = ("white", "smoothwm")  # parts of the names of surfaces with grey matter outside
_HEAD = 60.0  # mm; the shortest side of a volume that contains a hemisphere
_FINE = 2.0  # mm; the size of the largest voxels that resolve the cortex


@dataclass(frozen=True, eq=False)
class Sampled:
    """A volume to show on the map."""

    volume: LayerVolume
    depth: float = 0.0  # mm outside the surface
    kind: str = "image"  # or "labels", the type of the layer
    display: Mapping[str, Any] = field(default_factory=dict)  # keywords that make the map look like the layer
    fraction: float | None = None  # fraction of the cortical thickness, used instead of the depth

    @property
    def name(self) -> str:
        return self.volume.origin["layer"]

    @property
    def where(self) -> str:
        """The depth, such as "1.5 mm outside"; empty at the surface."""
        if self.fraction is not None:
            return f"at {self.fraction:g} of the cortex"
        side, unit = "outside" if self.depth > 0 else "inside", self.volume.place.unit
        return f"{abs(self.depth):g} {unit} {side}" if self.depth else ""

    @property
    def meaning(self) -> str:
        place = self.where if self.fraction is not None else f"{self.where or 'at'} the surface"
        return f"the values of '{self.name}', sampled {place}"

    def image(self, flat_map: Planar | Atlas, pixel_size: float | None) -> FlatImage:
        """Draw the values on a map, as `FlatMap.image` does."""
        place: dict[str, Any] = {"depth": self.depth} if self.fraction is None else {"fraction": self.fraction}
        interpolation = "nearest" if self.kind == "labels" else "linear"
        return flat_map.image(self.volume.lazily(), pixel_size, interpolation=interpolation, **place)


@dataclass(frozen=True, eq=False)
class Overlay:
    """Values at the vertices of a mesh to show on the map."""

    name: str
    values: NDArray[Any]
    display: Mapping[str, Any] = field(default_factory=dict)  # as in `Sampled`
    path: Path | None = None
    structure: str | None = None
    kind: str = "image"  # or "labels", as in a `.label.gii` file
    where: ClassVar[str] = ""  # as in `Sampled`

    @property
    def meaning(self) -> str:
        return f"the values of '{self.name}'"

    def image(self, flat_map: Planar | Atlas, pixel_size: float | None) -> FlatImage:
        """Draw the values on a map, as `FlatMap.image` does."""
        of_map = flat_map if isinstance(flat_map, Atlas) else flat_map._triangles.on_surface
        check_side(f"Layer '{self.name}'", self.structure, of_map.origin.structure, _OTHER, "the map")
        return flat_map.image(self.values, pixel_size)


Shown: TypeAlias = Sampled | Overlay


def shown(
    layer: Layer, world: str, depth: float = 0.0, *, fraction: float | None = None, step: tuple[int, ...] = ()
) -> Shown:
    """Read the values and the display of a layer; `step` is an index along its leading axes. May raise InputError."""
    if isinstance(layer, Surface):
        return overlay(layer, LayerMesh.of(layer, world))
    volume = LayerVolume.of(layer, world, step)
    if isinstance(layer, Labels):
        return Sampled(volume, depth, "labels", {"colormap": layer.colormap}, fraction)
    return Sampled(volume, depth, display={} if layer.rgb else _display(layer), fraction=fraction)


def usual_depth(layer: Layer | None) -> float:
    """Return the default sampling depth, in mm: that of the demo if values lie outside white matter, otherwise 0."""
    if layer is None or layer.ndim != 3:
        return 0.0
    if isinstance(layer, Surface):
        return DEPTH if any(word in layer.name for word in _WHITE) else 0.0
    sides = np.abs(np.diff(layer.extent.world, axis=0)[0]) * unit_ratio(layer.units, ["mm"] * 3)
    spacing = sides / np.maximum(np.asarray(finest(layer).shape[:3]) - 1, 1)
    return DEPTH if sides.min() >= _HEAD and spacing.max() <= _FINE else 0.0


def overlay(layer: Surface, mesh: LayerMesh) -> Overlay:
    """Read the values of a Surface layer with the given mesh, and their display."""
    path = Path(layer.source.path) if layer.source.path else None
    if "labels" in layer.metadata and layer.vertex_colors is not None:
        keys, first = np.unique(np.asarray(mesh.values).astype(np.int64), return_index=True)
        colours = dict(zip(keys.tolist(), np.asarray(layer.vertex_colors)[first], strict=True))
        display = {"colormap": DirectLabelColormap(color_dict={None: "transparent", **colours})}
        return Overlay(layer.name, mesh.values, display, path, mesh.structure, "labels")
    return Overlay(layer.name, mesh.values, _display(layer), path, mesh.structure)


def _display(layer: Layer) -> dict[str, Any]:
    display = {"colormap": layer.colormap, "gamma": layer.gamma}
    if layer.contrast_limits != layer.contrast_limits_range:  # the user has set the limits
        display["contrast_limits"] = layer.contrast_limits
    return display
