"""Textured surfaces (Zigelman et al. 2002, section V) and their files: with a picture, or colours at points (PLY)."""

import io
import os
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path
from voxflat.errors import InputError
from voxflat.io.files import atomic_path, beside, by_ending, naming, naming_file
from voxflat.io.formats import gltf, obj, ply, vtk
from voxflat.io.provenance import Record, Recorded, as_text, check_beside, check_not_read, saving
from voxflat.maps.textures.pictures import values_at
from voxflat.maps.textures.subdivision import subdivide
from voxflat.read_only import ReadOnly

_Files = list[Path]


@dataclass(frozen=True, eq=False)
class TexturedSurface(ReadOnly, Recorded):
    """A surface with a picture on it, as returned by `FlatMap.textured` and `FlatPage.textured`.

    3-D programs display the saved surface with its picture.

    Parameters
    ----------
    points : ndarray of float64, shape (N, 3)
        Positions in RAS+ mm, in scanner RAS if the transform is known.
    faces : ndarray of int64, shape (F, 3)
        Triangles of points.
    texture_coordinates : ndarray of float64, shape (N, 2) or (P, 2)
        The position (s, t) of each point in the picture, from 0 to 1. Values outside this range repeat the picture.
    picture : ndarray of uint8, shape (H, W, 3) or (H, W, 4)
        Colours, optionally with opacity. Row 0 is the top row (t = 1).
    repeat : bool
        Whether the picture is repeated beyond its borders.
    source : Path or None
        File of the picture.
    texture_faces : ndarray of int64, shape (F, 3), or None
        Corners of each triangle as rows of `texture_coordinates`, if the texture has seams, where a point has several
        coordinates; otherwise None.
    unit : str
        Unit of the points, or "unknown". ``.glb`` files are in metres; points of an unknown unit are written unchanged.
    is_ras : bool
        Whether the axes point to the right, anterior and superior, as in volumes, GIFTI and FreeSurfer files and
        arrays. ``.glb`` files have the y axis upwards, so these points are turned, and others keep their axes.
    provenance : dict
        Record of how the textured surface was made.

    See Also
    --------
    FlatMap.textured : Return the surface with a picture on it.

    Examples
    --------
    >>> textured = voxflat.samples.hill().flatten().textured(np.full((8, 8, 3), 255, np.uint8))
    >>> textured
    <TexturedSurface: 441 points, 800 triangles, 8 x 8 texels>
    """

    points: NDArray[np.float64]
    faces: NDArray[np.int64]
    texture_coordinates: NDArray[np.float64]
    picture: NDArray[np.uint8]
    repeat: bool = False
    source: Path | None = None
    texture_faces: NDArray[np.int64] | None = None
    unit: str = "mm"
    is_ras: bool = True
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        height, width = self.picture.shape[:2]
        return f"<TexturedSurface: {len(self.points)} points, {len(self.faces)} triangles, {width} x {height} texels>"

    @property
    def colours(self) -> NDArray[np.uint8]:
        """The colour of the picture at each texture coordinate, shape (N, 3) or (N, 4).

        Interpolation is linear between texels.
        """
        return np.round(values_at(self.picture, self.texture_coordinates, self.repeat)).astype(np.uint8)

    def opened(self) -> "TexturedSurface":
        """Return the surface cut open along the seams of the texture.

        Returns
        -------
        TexturedSurface
            The cut surface, or this object if there are no seams.

        See Also
        --------
        FlatPage.textured : Return a surface whose texture has seams.
        """
        if self.texture_faces is None:
            return self
        points = np.empty((len(self.texture_coordinates), 3))
        points[self.texture_faces] = self.points[self.faces]
        return replace(self, points=points, faces=self.texture_faces, texture_faces=None)

    def subdivided(self, tolerance: float = 16.0) -> "TexturedSurface":
        """Split triangles that are too coarse to show the picture with colours at their corners.

        The method follows section IV of Zigelman et al. (2002). New points lie on edges of the triangles, so the
        surface has no cracks and keeps its shape, its first N points and their texture coordinates. Triangles are
        bisected at the edge that is longest in the picture (Rivara 1984). No angle in the picture becomes smaller than
        half of the smallest original angle.

        Parameters
        ----------
        tolerance : float
            Greatest difference, on a scale of 255 grey levels, between the picture and the interpolated colours within
            a triangle. Triangles no longer than a texel are not split.

        Returns
        -------
        TexturedSurface
            The surface with more triangles.

        Raises
        ------
        InputError
            If the tolerance is not positive, or the picture is so fine that there would be too many triangles.
        """
        whole = self.opened()
        points, faces, coordinates = subdivide(
            whole.points, whole.faces, whole.texture_coordinates, self.picture, tolerance, repeat=self.repeat
        )
        return replace(whole, points=points, faces=faces, texture_coordinates=coordinates)

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the surface with its picture.

        All files are written completely before the first one is moved into place.

        Parameters
        ----------
        path : path
            An ``.obj`` file is accompanied by an ``.mtl`` and a ``.png`` file, and a ``.vtp`` file by a ``.png`` file.
            ``.glb`` is a single glTF 2.0 file in metres; points in RAS+ are turned so that y is up, as the format
            requires. ``.ply`` files have colours and texture coordinates at the points, but no picture; see
            `subdivided`. At seams, OBJ keeps the points of the surface, and the other formats duplicate them. The
            ``.png`` file includes `provenance`.
        sidecar, overwrite : bool
            As in `FlatMap.save`.

        Raises
        ------
        InputError
            If the file extension is not supported, or a file would replace an input file or one that voxflat did not
            write.
        OSError
            If a file cannot be written.

        Examples
        --------
        >>> textured = voxflat.samples.hill().flatten().textured(np.full((8, 8, 3), 255, np.uint8))
        >>> textured.save("hill_textured.glb")
        """
        path = checked_path(path)
        with naming(path, "choose another format"):
            write = by_ending(path, _WRITERS)
        names = [path, *(others := files_beside(path))]
        for name in names:
            if self.source is not None and name.exists() and self.source.exists() and name.samefile(self.source):
                raise InputError(f"cannot write {path}: {name} is the picture itself. Choose another name")
            check_not_read(name, self.provenance)
        for name in others:
            check_beside(path, name, overwrite=overwrite)
        surface = self if path.suffix.lower() == ".obj" else self.opened()  # OBJ files can have seams
        with ExitStack() as files:  # put into place in reverse: the surface after the files that it names
            files.enter_context(saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite))
            temporary = [files.enter_context(atomic_path(name)) for name in names]
            with naming_file(path), naming(path, "choose another format"):
                write(temporary, surface, [name.name for name in names])


def files_beside(path: Path) -> list[Path]:
    """Return the additional files that are written with a textured surface."""
    return [beside(path, ending) for ending in _BESIDE.get(path.suffix.lower(), ())]


def _write_obj(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    _, library, picture = names
    # no -clamp on, which VTK would read as part of the file name
    lines = ["# voxflat", "newmtl texture", "Ka 1 1 1", "Kd 1 1 1", "Ks 0 0 0", "illum 1", f"map_Kd {picture}"]
    if surface.picture.shape[2] == 4:
        lines.append(f"map_d {picture}")
    files[1].write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    obj.write_obj(files[0], surface.points, surface.faces, surface.texture_coordinates, library, surface.texture_faces)
    files[2].write_bytes(_png(surface))


def _write_vtp(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    vtk.write_vtp(files[0], surface.points, surface.faces, surface.texture_coordinates, {}, {})
    files[1].write_bytes(_png(surface))


def _write_ply(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    ply.write_ply(files[0], surface.points, surface.faces, surface.texture_coordinates, surface.colours)


def _png(surface: TexturedSurface) -> bytes:
    from PIL import Image, PngImagePlugin

    file, text = io.BytesIO(), PngImagePlugin.PngInfo()
    for key, value in {"Software": "voxflat", "Provenance": as_text(surface.provenance)}.items():
        text.add_itxt(key, value)
    Image.fromarray(surface.picture).save(file, format="PNG", pnginfo=text)
    return file.getvalue()


def _write_glb(files: _Files, surface: TexturedSurface, names: list[str]) -> None:
    arrays = (surface.points, surface.faces, surface.texture_coordinates)
    look = {"repeat": surface.repeat, "transparent": surface.picture.shape[2] == 4}
    gltf.write_glb(files[0], *arrays, _png(surface), unit=surface.unit, is_ras=surface.is_ras, **look)


_WRITERS: dict[str, Callable[[_Files, TexturedSurface, list[str]], None]] = {
    ".obj": _write_obj,
    ".vtp": _write_vtp,
    ".glb": _write_glb,
    ".ply": _write_ply,
}
_BESIDE = {".obj": (".mtl", ".png"), ".vtp": (".png",)}
TEXTURED_ENDINGS = tuple(_WRITERS)  # endings of the files that `TexturedSurface.save` writes
