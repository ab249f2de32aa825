"""The texture of a surface on its flat map: the flat texture image of Zigelman et al. (2002), figure 3.

Each pixel of the map lies in a triangle of the surface. Its barycentric coordinates give its texture coordinates, and
these give its colour. Colours at the vertices are interpolated directly.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.errors import InputError
from voxflat.io import meshes
from voxflat.io.files import REMEDY, beside, contents, naming
from voxflat.io.formats.obj import read_obj_texture
from voxflat.io.formats.ply import read_ply_texture
from voxflat.maps.raster import Raster
from voxflat.maps.textures.pictures import as_picture, values_at
from voxflat.unique_rows import numbered

TEXTURE_ENDINGS = (".obj", ".vtp", ".ply")  # of surface files that may have a texture, or colours at vertices
_PICTURES = (".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG")


@dataclass(frozen=True, eq=False)
class SurfaceTexture:
    """A picture, and the position of each triangle of a surface in it."""

    faces: NDArray[np.int64]  # (F, 3), of the surface's vertices
    coordinates: NDArray[np.float64]  # (F, 3, 2); NaN if there are none. A vertex on a seam has several coordinates
    picture: NDArray[np.uint8]  # (H, W, 3 or 4); row 0 is the top


def are_colours(values: object, count: int) -> bool:
    """Return whether an array holds one colour for each of `count` vertices."""
    return isinstance(values, np.ndarray) and values.dtype == np.uint8 and values.shape in ((count, 3), (count, 4))


def read_texture(path: Path, count: int) -> SurfaceTexture | NDArray[np.uint8]:
    """Read the texture of a surface of `count` vertices, or colours at its vertices.

    ``.obj`` files need a material with a picture (map_Kd). ``.vtp`` and ``.ply`` files have either colours at the
    vertices, or texture coordinates and a picture, which has the same name or is named in the PLY comment TextureFile.
    """
    with naming(path, REMEDY):
        mesh = meshes.read_mesh(path)
        if len(mesh.points) != count:
            raise InputError(f"has {len(mesh.points)} vertices, but the flattened mesh has {count}. Pass the same mesh")
        if path.suffix.lower() == ".obj":
            return _obj_texture(path)
        picture = _picture_beside(path)
        if mesh.texture_coordinates is not None and picture is not None:
            corners = read_ply_texture(contents(path)) if path.suffix.lower() == ".ply" else None
            faces, coordinates = corners or (mesh.faces, mesh.texture_coordinates[mesh.faces])
            return SurfaceTexture(faces, coordinates, as_picture(picture)[0])
        return _vertex_colours(mesh)


def _vertex_colours(mesh: meshes.Mesh) -> NDArray[np.uint8]:
    names = [name for name in ("red", "green", "blue", "alpha") if name in mesh.point_data]
    if names[:3] == ["red", "green", "blue"] and all(mesh.point_data[name].dtype == np.uint8 for name in names):
        return np.column_stack([mesh.point_data[name] for name in names])
    arrays = {name: values for name, values in mesh.point_data.items() if are_colours(values, len(mesh.points))}
    if len(arrays) == 1:
        colours: NDArray[np.uint8] = np.asarray(next(iter(arrays.values())))
        return colours
    if arrays:
        raise InputError(f"has several colour arrays at its vertices ({', '.join(arrays)}). Pass one as an array")
    raise InputError("has no texture (texture coordinates with a picture, or colours at vertices). Add a texture")


def _picture_beside(path: Path) -> Path | None:
    """Return the picture of a file: one with the same name, or the one named in the header of a PLY file."""
    named = re.search(rb"(?m)^comment TextureFile (.*?)\s*$", contents(path)[:4096])
    if named and path.suffix.lower() == ".ply":
        return path.with_name(named[1].decode("utf-8", "replace"))
    names = [path.with_suffix(ending) for ending in _PICTURES] + [beside(path, ending) for ending in _PICTURES]
    return next((name for name in names if name.is_file()), None)


def _obj_texture(path: Path) -> SurfaceTexture:
    faces, coordinates, names = read_obj_texture(contents(path))
    files: dict[str, str] = {}
    for library in sorted(names["mtllib"]):
        files |= _material_pictures(path.parent / library)
    pictures = {path.parent / files[material] for material in names["usemtl"] if material in files}
    if np.isnan(coordinates).all() or not pictures:
        raise InputError("has no texture. Add texture coordinates (vt) and a material (mtllib) with map_Kd")
    if len(pictures) > 1:
        listing = ", ".join(sorted(picture.name for picture in pictures))
        raise InputError(f"has {len(pictures)} pictures ({listing}). Bake them into one picture")
    if plain := sorted(names["usemtl"] - set(files)):
        raise InputError(f"its material {plain[0]!r} has no picture, but others do. Bake all pictures into one")
    return SurfaceTexture(faces, coordinates, as_picture(pictures.pop())[0])


def _material_pictures(library: Path) -> dict[str, str]:
    """Return the colour picture of each material of an .mtl file."""
    pictures: dict[str, str] = {}
    material = ""
    for line in contents(library).decode("utf-8", "replace").splitlines():
        key, _, rest = line.strip().partition(" ")
        if key == "newmtl":
            material = rest.strip()
        elif key == "map_Kd":  # options, which start with a dash, precede the name
            name = rest.split()[-1] if rest.strip().startswith("-") else rest.strip()
            pictures[material] = name.replace("\\", "/")
    return pictures


def paint(texture: SurfaceTexture | NDArray[np.uint8], raster: Raster, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the RGBA colours of a texture, or of vertices, at the pixels of a map; opacity 0 means no colour."""
    values = raster.interpolate(texture[ids]) if isinstance(texture, np.ndarray) else _sampled(texture, raster, ids)
    seen = np.isfinite(values[..., 0])
    image = np.zeros((*raster.shape, 4), dtype=np.uint8)
    image[seen, 3] = 255
    image[seen, : values.shape[2]] = np.round(values[seen])
    return image


def _sampled(texture: SurfaceTexture, raster: Raster, ids: NDArray[np.int64]) -> NDArray[np.float64]:
    inside = raster.inside
    vertices, weights = ids[raster.corners[inside]], raster.weights[inside].astype(np.float64)
    face, order = _faces_of(vertices, texture.faces)
    corners = np.take_along_axis(texture.coordinates[face], order[..., None], axis=1)
    corners[face < 0] = np.nan
    coordinates = np.full((*raster.shape, 2), np.nan)
    coordinates[inside] = np.einsum("pc,pcx->px", weights, corners)
    seen = np.isfinite(coordinates[..., 0])
    values = np.full((*raster.shape, texture.picture.shape[2]), np.nan)
    # coordinates outside 0 to 1 repeat the picture, as in OBJ and VTK
    is_beyond = bool((np.abs(texture.coordinates - 0.5) > 0.5 + 1e-6).any())
    values[seen] = values_at(_reduced(texture.picture, coordinates), coordinates[seen], repeat=is_beyond)
    return values


def _faces_of(triples: NDArray[np.int64], faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find triangles by their corners in any order; return their numbers (−1 if not found) and the corner order."""
    sorting, wanted_sorting = faces.argsort(axis=1), triples.argsort(axis=1)
    keys, asked = numbered(np.sort(faces, axis=1), np.sort(triples, axis=1))
    first = np.full(len(keys) + len(asked), -1)
    first[keys[::-1]] = np.arange(len(keys))[::-1]
    face = first[asked]
    order = np.empty_like(triples)
    np.put_along_axis(order, wanted_sorting, sorting[face], axis=1)
    return face, order


def _reduced(picture: NDArray[np.uint8], coordinates: NDArray[np.float64]) -> NDArray[Any]:
    """Average a picture over the texels that a pixel of the map covers, to avoid aliasing."""
    from PIL import Image

    height, width = picture.shape[:2]
    apart = np.linalg.norm(np.diff(coordinates, axis=1) * [width, height], axis=2)
    is_known = np.isfinite(apart)
    texels = int(np.median(apart[is_known])) if is_known.any() else 1
    if texels < 2:
        return picture
    size = (max(1, width // texels), max(1, height // texels))
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
