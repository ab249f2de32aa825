"""Find the axes of microscopy stacks, and open volumes and maps where the stacks lie."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from napari import Viewer
from napari.layers import Image, Labels, Layer, Surface
from numpy.typing import NDArray

from voxflat._napari.layers.volumes import finest
from voxflat._napari.layers.world import WORLD, LayerPlace, from_ras, unit_of
from voxflat._napari.viewer_state import ViewerState
from voxflat.errors import InputError
from voxflat.io.formats.tiff import TIFF_ENDINGS
from voxflat.io.grid import scaled

_NEAR = 0.01  # voxels


def world_of(viewer: Viewer, layer: Layer) -> str:
    """Return the world axes of a layer: those that were chosen, or those of its source; microscopes have z, y, x."""
    is_tissue = unit_of(layer) != "mm" or layer.ndim > 3 or _is_stack(viewer, layer)
    usual = str(layer.metadata.get(WORLD, "SAR" if is_tissue else "RAS"))
    return ViewerState.of(viewer).world_of(layer) or usual


def _is_stack(viewer: Viewer, layer: Layer) -> bool:
    """Return whether a volume without a unit of length is read from a TIFF file, or lies on one, as its labels do."""
    if isinstance(layer, Surface) or str(layer.units[-1]) != "pixel":
        return False
    alike = [one for one in viewer.layers if isinstance(one, Image | Labels) and _size(one) == _size(layer)]
    return any(str(one.source.path).lower().endswith(TIFF_ENDINGS) for one in alike)


def _size(layer: Image | Labels) -> tuple[int, ...]:
    return tuple(finest(layer).shape)


@dataclass(frozen=True, eq=False)
class Stack:
    """An open layer with other world axes than x, y, z."""

    layer: Layer
    place: LayerPlace

    @property
    def world(self) -> str:
        return self.place.origin["world_axes"]

    def affine(self, affine: NDArray[np.float64], unit: str) -> NDArray[np.float64]:
        """Return an affine to RAS+ as an affine to the world of the layer, in the unit of the layer."""
        in_place = scaled(affine, unit, self.place.unit)
        corners = from_ras(np.vstack([in_place[:3, 3], in_place[:3, :3].T + in_place[:3, 3]]), self.world)
        matrix = np.eye(4)
        matrix[:3, 3] = corners[0]
        matrix[:3, :3] = (corners[1:] - corners[0]).T
        return matrix


def stack_of(
    viewer: Viewer | None, shape: tuple[int, ...], affine: NDArray[np.float64], unit: str = "mm"
) -> Stack | None:
    """Return the open stack that has the same voxels as a volume, given its affine to RAS+, or None."""
    for layer in [] if viewer is None else viewer.layers:
        if not isinstance(layer, Image | Labels) or layer.ndim < 3 or "voxflat" in layer.metadata:
            continue
        world = world_of(viewer, layer)
        with suppress(InputError):  # the layer has no place in space
            place = LayerPlace.of(layer, world, layer.ndim - 3)
            size = finest(layer).shape[layer.ndim - 3 : layer.ndim]
            if world != "RAS" and _is_same(size, place.affine, shape[:3], scaled(affine, unit, place.unit)):
                return Stack(layer, place)
    return None


def viewer_order(affine: NDArray[np.float64]) -> list[int]:
    """Return the voxel axes that are closest to the three axes of the viewer."""
    along = np.abs(affine[:3, :3]) / np.linalg.norm(affine[:3, :3], axis=0)
    order = [-1, -1, -1]
    for row, column in sorted(np.ndindex(3, 3), key=lambda cell: -along[cell]):
        if order[row] < 0 and column not in order:
            order[row] = column
    return order


def _is_same(
    size: tuple[int, ...], to_ras: NDArray[np.float64], shape: tuple[int, ...], affine: NDArray[np.float64]
) -> bool:
    """Return whether two grids have the same voxels, possibly along other axes."""
    step = np.linalg.inv(to_ras) @ affine
    last = np.array(shape) - 1
    ends = np.sort(step[:3] @ np.array([[0, 0, 0, 1], [*last, 1]]).T, axis=1)
    off_axis = (step[:3, :3] - np.round(step[:3, :3])) * np.maximum(last, 1)
    is_corner = np.allclose(ends, np.column_stack([np.zeros(3), np.array(size) - 1]), rtol=0, atol=_NEAR)
    return is_corner and np.allclose(off_axis, 0, rtol=0, atol=_NEAR)
