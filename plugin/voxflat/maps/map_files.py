"""Files of flat maps, and maps as meshes with the vertex numbers of the surface."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, is_whole, log, shown
from voxflat.distortion.bands import HUMAN
from voxflat.distortion.distortion import Distortion
from voxflat.distortion.figures import undefined_as_nan
from voxflat.errors import InputError
from voxflat.io import files
from voxflat.io.descriptions import check_distortion
from voxflat.io.meshes import Mesh
from voxflat.io.origin import take_origin
from voxflat.io.provenance import Record, as_text
from voxflat.io.readers import read_arrays
from voxflat.io.reading import record_file
from voxflat.surfaces.cut_sides import one_point_a_vertex, triangles_of
from voxflat.surfaces.cuts import Cut

_FORMAT, _SERIES_FORMAT = 5, "series 1"
_BY_USER = ("given", "automatic", "start", "charts", None)  # who chose cuts that are not of a template
_REQUIRED = ("uv", "ids", "faces", "torn", "sources", "eigenvalues")
_OF_SURFACE = ("points", "normals")

_LAYOUT = {  # types and axes of the arrays in a file, in the form that `check_shapes` expects
    "uv": ("f8", "points 2"),
    **dict.fromkeys(("points", "normals", "white_points", "pial_points"), ("f8", "points 3")),
    **dict.fromkeys(
        ("curvature", "sulcal_depth", "spread", "distortion_per_point", "distortion_areal"), ("f8", "points")
    ),
    "faces": ("u4", "faces 3"),
    **dict.fromkeys(("torn", "distortion_is_flipped"), ("?", "faces")),
    "sources": ("i8", "sources"),
    "eigenvalues": ("f8", "?"),
    "rows": ("f4", "sources ?"),
    "bridges": ("i8", "? 3"),
    "distortion_scatter": ("f8", "? 2"),
    **dict.fromkeys(("series_points", "series_normals"), ("f8", "frames points 3")),
    "series_gaps": ("f8", "frames"),
    "series_folded": ("i8", "frames"),
}


def write_map(path: Path, arrays: dict[str, Any], description: Record) -> None:
    """Write the arrays and the description of a map or a series to an archive (completely or not at all)."""
    text = as_text({"format": _SERIES_FORMAT if "series" in description else _FORMAT, **description})
    with files.atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, metadata=np.array(text), **arrays)


def read_map(path: str | os.PathLike[str], *, series: bool = False) -> dict[str, Any]:
    """Read the fields of a `FlatMap`, and the arrays of a series; a damaged file raises an `InputError`."""
    with files.naming(path, files.AGAIN):
        files.check_regular(checked_path(path))
    with files.holding(path, "a series" if series else "a flat map"):
        arrays = read_arrays(path)
        metadata = files.from_json(str(arrays.pop("metadata")))
        form = metadata.pop("format")
        if isinstance(form, str) != series:
            one = "Use `voxflat image`, or read them with voxflat.load_series"
            told = "a single map. Read it with voxflat.load" if series else f"maps of several frames. {one}"
            raise InputError(f"{path} holds {told}")
        files.check_format(path, form, _SERIES_FORMAT if series else _FORMAT, "Flatten the surface again")
        record_file(path)
        has_surface = metadata["distortion"] is not None or "points" in arrays
        required = {name: arrays[name] for name in (*_REQUIRED, *(_OF_SURFACE if has_surface else ()))}
        uv, ids = required["uv"], required["ids"]  # a file without these fields failed before
        layout = {**_LAYOUT, "ids": ("i8", "points 3" if metadata.get("kind") == "voxels" else "points")}
        with files.naming(path, files.AGAIN):
            files.check_shapes(arrays, layout)
            files.check_range(arrays, {"faces": len(uv), "sources": len(uv)})
            files.check_places({name: required[name] for name in ("uv", "points") if name in required})
            origin = take_origin(metadata, ids)
            if has_surface:
                check_distortion(metadata["distortion"])
            if has_surface and metadata["distortion"]["triangles"] is None and "distortion_areal" in arrays:
                raise InputError(f"its key 'triangles' is null, but it has the array distortion_areal. {files.AGAIN}")
            arrays = files.in_types(arrays, layout)
        figures = metadata.pop("distortion")
        of_surface = {"distortion": _distortion(figures, arrays)} if has_surface else dict.fromkeys(_OF_SURFACE)
        if series:
            _check_series(arrays, metadata)
        return {
            "distortion": None,
            **of_surface,
            "origin": origin,
            "cuts_by": metadata.get("cuts_by"),
            "cuts": _take_cuts(metadata),
            "method": metadata.pop("method", "unknown"),
            "seed": metadata.pop("seed", 0),
            "warnings": tuple(metadata.pop("warnings", ())),
            **{name: metadata.pop(name, None) for name in ("frame", "period")},
            "store": Path(metadata.pop("store")) if "store" in metadata else None,
            "record": metadata.pop("provenance", {}),
            "details": metadata,
            **arrays,
        }


def _distortion(figures: dict[str, Any], arrays: dict[str, Any]) -> Distortion:
    """Take the distortion out of the metadata and the arrays of a file."""
    more = {name: figures.pop(name) for name in ("triangles", "reference", "topology", "voxel_size")}
    triangles, more["bands"] = more.pop("triangles"), tuple(figures.pop("bands", HUMAN))
    if triangles is not None:
        triangles = undefined_as_nan(triangles)
        triangles |= {name: arrays.pop(f"distortion_{name}") for name in ("areal", "is_flipped")}
    distances = undefined_as_nan(figures)
    distances |= {name: arrays.pop(f"distortion_{name}") for name in ("per_point", "scatter")}
    return Distortion._of(distances, triangles, **more)


def _take_cuts(metadata: dict[str, Any]) -> tuple[Cut, ...]:
    """Take the cuts out of the metadata of a file; lengths of given cuts are not known."""
    paths = metadata.pop("cuts", None) or []
    names = metadata.pop("cut_names", None) or [None] * len(paths)  # old files have no names
    reason = "given" if metadata.pop("cuts_by", None) in _BY_USER else "template"
    user_cuts = [Cut(np.asarray(path, np.int64), None, reason, name) for path, name in zip(paths, names, strict=True)]
    automatic = metadata.pop("automatic_cuts", None) or []
    return (*user_cuts, *(Cut(np.asarray(cut["ids"], np.int64), cut["length"], cut["reason"]) for cut in automatic))


def _check_series(arrays: dict[str, Any], metadata: dict[str, Any]) -> None:
    """Check that a file of a series is complete."""
    reference, count = metadata["series"]["reference"], len(arrays["series_points"])
    for name in (name for name in _LAYOUT if name.startswith("series_")):
        arrays[name]  # a file without this array fails here
    files.check_places({"series_points": arrays["series_points"]})
    if not is_whole(reference) or not 0 <= reference < count:
        raise InputError(f"its reference frame is {shown(reference)}, but it has {count} frames. {files.AGAIN}")
    if not np.array_equal(arrays["series_points"][reference], arrays["points"]):
        raise InputError(f"its reference frame does not have the points of the map. {files.AGAIN}")


def mesh_of_vertices(
    places: NDArray[np.float64], ids: NDArray[np.int64], faces: NDArray[Any], count: int, structure: str | None
) -> Mesh:
    """Return a flat map as a mesh with the flattened mesh's vertices; at cuts, the side with more triangles is kept."""
    rows = one_point_a_vertex(ids, faces)
    is_kept = triangles_of(rows, faces)
    if not is_kept.all():
        told = "%d of %d triangles lie at a cut that duplicates vertices. They are not written to the file"
        log.warning(told, len(faces) - int(is_kept.sum()), len(faces))
    placed = np.zeros((count, 3))
    placed[ids[rows]] = places[rows]
    return Mesh(placed, ids[faces[is_kept]], structure=structure)
