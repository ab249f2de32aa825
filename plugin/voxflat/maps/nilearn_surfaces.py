"""Both hemispheres as objects of nilearn: the function `to_nilearn`."""

from typing import TYPE_CHECKING, Any, overload

from voxflat.arguments import checked_instance
from voxflat.errors import InputError
from voxflat.io.files import require
from voxflat.maps.flat_map import FlatMap

if TYPE_CHECKING:
    from nilearn.surface import PolyMesh, SurfaceImage

_STRUCTURES = {"left": "CortexLeft", "right": "CortexRight"}


@overload
def to_nilearn(left: FlatMap | None, right: FlatMap | None = None, image: None = None) -> "PolyMesh": ...


@overload
def to_nilearn(left: FlatMap | None, right: FlatMap | None, image: "SurfaceImage") -> "SurfaceImage": ...


def to_nilearn(left: FlatMap | None, right: FlatMap | None = None, image: Any = None) -> Any:
    """Convert the maps of both hemispheres to a nilearn ``PolyMesh``, or show a ``SurfaceImage`` on them.

    The flat meshes have the vertices of the flattened meshes, in the same order. Values do not change, so the plotting
    functions, ``SurfaceMasker`` and ``SurfaceLabelsMasker`` of nilearn return the same numbers as on the folded
    surface. For the reverse, pass the data of a flat image to ``SurfaceImage`` with the folded mesh.

    Parameters
    ----------
    left, right : FlatMap or None
        Maps of meshes. Pass None for a hemisphere that is not shown.
    image : nilearn.surface.SurfaceImage, optional
        Values at the vertices of the meshes, such as a statistic, a time series or an atlas.

    Returns
    -------
    nilearn.surface.PolyMesh or nilearn.surface.SurfaceImage
        The flat meshes, with coordinates (u, v, 0) in mm, or the values of `image` on them. Vertices excluded from a
        map lie at the origin and do not belong to any triangle.

    Raises
    ------
    InputError
        If a map was made from a volume or belongs to the other hemisphere, or the image does not fit the maps.

    See Also
    --------
    FlatMap.to_nilearn : Convert a single map.

    Examples
    --------
    >>> voxflat.to_nilearn(voxflat.samples.hill().flatten()).parts["left"].n_vertices
    441
    """
    meshes, nilearn = {}, require("nilearn.surface")
    for side, flat_map in (("left", left), ("right", right)):
        if flat_map is None:
            continue
        checked_instance(flat_map, FlatMap, side, "a flat map")
        if flat_map.is_voxels:
            raise InputError(f"{side} is the map of a volume, which has no vertices. Flatten the mesh of a hemisphere")
        if flat_map.origin.structure not in (None, _STRUCTURES[side]):
            raise InputError(f"{side} is the map of {flat_map.origin.structure}. Pass left, right in this order")
        meshes[side] = flat_map.to_nilearn()
    if not meshes:
        raise InputError("no map is given. Pass the map of at least one hemisphere")
    mesh = nilearn.PolyMesh(**meshes)
    if image is None:
        return mesh
    parts = getattr(getattr(image, "data", None), "parts", None)
    if not isinstance(parts, dict):
        raise InputError(f"image is {type(image).__name__}. Pass a nilearn SurfaceImage")
    for side, part in mesh.parts.items():
        if side not in parts:
            raise InputError(f"image has no values for the {side} hemisphere. Leave out its map")
        if len(parts[side]) != part.n_vertices:
            problem = f"image has {len(parts[side])} values for the {side} hemisphere, but its mesh has"
            raise InputError(f"{problem} {part.n_vertices} vertices. Pass values of the mesh that was flattened")
    return nilearn.SurfaceImage(mesh, nilearn.PolyData(**{side: parts[side] for side in meshes}))
