"""Prepare the surfaces: read their files, cut them for the first track, and write them for all tools.

The folder of a surface contains `uncut` and `cut`, each as ``.npz`` (``points``, ``faces``; the cut one also
``vertices``, the vertex of the uncut surface for each vertex), ``.surf.gii`` and ``.obj``. Points are rounded to single
precision, so that all files describe the same surface. `published.npz` holds a flat map that came with the surface.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import log
from voxflat.benchmark.manifest import NONE, PUBLISHED, STANDARD, Entry
from voxflat.benchmark.shapes import SHAPES
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.maps.matching import match
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.hemispheres import hemisphere

_Points: TypeAlias = NDArray[np.float64]
_Numbers: TypeAlias = NDArray[np.int64]
_FACTS = "surface.json"


@dataclass(frozen=True, eq=False)
class Prepared:
    """A surface of the benchmark, before and after it is cut for the first track."""

    name: str
    uncut_points: _Points  # (V, 3)
    uncut_faces: _Numbers  # (G, 3)
    points: _Points  # (N, 3), of the cut surface
    faces: _Numbers  # (F, 3)
    vertices: _Numbers  # (N,), vertex of the uncut surface
    unit: str = "mm"
    published: _Points | None = None  # (N, 2), of a flat map that came with the surface

    @property
    def uncut(self) -> Surface:
        """The surface before it is cut."""
        return surface((self.uncut_points, self.uncut_faces), unit=self.unit)

    @property
    def cut(self) -> Surface:
        """The surface after it is cut."""
        return surface((self.points, self.faces), unit=self.unit)

    @property
    def hashes(self) -> dict[str, str]:
        """The SHA-256 hashes of the uncut and the cut surface."""
        return {"uncut": fingerprint(self.uncut_points, self.uncut_faces), "cut": fingerprint(self.points, self.faces)}


def fingerprint(points: _Points, faces: _Numbers) -> str:
    """Return the SHA-256 hash of points in single precision and of triangles."""
    parts = points.astype("<f4").tobytes(), faces.astype("<i4").tobytes()
    return hashlib.sha256(b"".join(parts)).hexdigest()


def is_prepared(folder: Path, entry: Entry) -> bool:
    """Return whether a surface is in a folder with the hashes of the manifest."""
    path = folder / entry.name / _FACTS
    if not path.is_file():
        return False
    facts = json.loads(path.read_text(encoding="utf-8"))
    return entry.is_computed or not entry.hashes or facts["hashes"] == entry.hashes


def prepare(folder: Path, entry: Entry, files: Mapping[str, Path]) -> Prepared:
    """Make a surface from its files, and write it."""
    made = made_of(entry, files)
    if entry.hashes and made.hashes != entry.hashes:
        problem = f"{entry.name} differs from that of the published results after its preparation"
        if not entry.is_computed:
            raise InputError(f"{problem}. Report this as a bug of voxflat")
        log.warning("%s, because this processor rounds differently. Do not mix results of both", problem)
    write(folder / entry.name, made)
    return made


def made_of(entry: Entry, files: Mapping[str, Path]) -> Prepared:
    """Read a surface and cut it."""
    whole = _whole(entry, files)
    points = whole.points.astype(np.float32).astype(np.float64)
    uncut = surface((points, whole.faces.astype(np.int64)), unit=entry.unit)
    if len(uncut) != len(points):
        raise InputError(f"{entry.name} has triangles without area after rounding to single precision")
    published = None
    if entry.cuts == PUBLISHED:
        core, published = _as_published(whole, files["flat"])
        vertices, faces = core.ids, core.faces
    elif entry.cuts == NONE:
        vertices, faces = uncut.core.ids, uncut.faces
    else:
        sphere = read_mesh(files["sphere"]) if entry.cuts == STANDARD else None
        opened = uncut.cut(entry.cuts, sphere=sphere)
        vertices, faces = opened.surface.core.ids, opened.faces
    used, corners = np.unique(faces, return_inverse=True)
    vertices, published = vertices[used].astype(np.int64), None if published is None else published[used]
    parts: dict[str, Any] = {"points": points[vertices], "faces": corners.reshape(-1, 3), "vertices": vertices}
    uncut_faces = uncut.faces.astype(np.int64)
    return Prepared(entry.name, points, uncut_faces, **parts, unit=entry.unit, published=published)


def _whole(entry: Entry, files: Mapping[str, Path]) -> Surface:
    """Return the largest component of a surface without its cuts."""
    if entry.shape:
        return surface(SHAPES[entry.shape](), unit=entry.unit)
    if "volume" in files:
        return surface(hemisphere(files["volume"], entry.side), repair="voxels")
    mesh = read_mesh(files["surface"])
    points = mesh.points
    if "other" in files:
        points = (points + read_mesh(files["other"]).points) / 2
    return surface((points, mesh.faces), unit=entry.unit)


def _as_published(whole: Surface, flat: Path) -> tuple[_core.Surface, _Points]:
    """Return the largest component of the surface as a flat map cuts it, and the positions of the map.

    The vertices of the result are numbered as in the surface.
    """
    mesh = read_mesh(flat)
    matched = match(whole, mesh if mesh.texture_coordinates is None else flat)
    rows = matched.core.with_ids(np.arange(len(matched.uv), dtype=np.uint32)).largest_piece().ids
    numbers = np.full(whole.count, -1, dtype=np.int64)
    numbers[whole.vertices] = np.arange(len(whole))
    core = matched.core.largest_piece()
    vertices = numbers[core.ids]
    if not np.allclose(whole.points[vertices], core.points, atol=1e-3 * whole.usual_edge):
        raise InputError("the published map does not belong to the surface")
    return core.with_ids(vertices.astype(np.uint32)), matched.uv[rows]


def write(folder: Path, made: Prepared) -> None:
    """Write a surface for all tools."""
    folder.mkdir(parents=True, exist_ok=True)
    _savez(folder / "uncut.npz", points=made.uncut_points, faces=made.uncut_faces)
    _savez(folder / "cut.npz", points=made.points, faces=made.faces, vertices=made.vertices)
    for name, points, faces in (("uncut", made.uncut_points, made.uncut_faces), ("cut", made.points, made.faces)):
        for ending in (".surf.gii", ".obj"):
            write_mesh(folder / f"{name}{ending}", Mesh(points, faces))
    if made.published is not None:
        _savez(folder / "published.npz", uv=made.published)
    facts = {"name": made.name, "unit": made.unit, "hashes": made.hashes}
    with atomic_path(folder / _FACTS) as temporary:
        temporary.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8", newline="\n")


def load(folder: Path, name: str) -> Prepared:
    """Read a prepared surface."""
    path = folder / name / _FACTS
    if not path.is_file():
        raise InputError(f"{folder} does not contain the surface {name}. Run `voxflat bench fetch {folder}`")
    facts = json.loads(path.read_text(encoding="utf-8"))
    with np.load(folder / name / "uncut.npz") as file:
        parts = {"uncut_points": file["points"], "uncut_faces": file["faces"]}
    with np.load(folder / name / "cut.npz") as file:
        parts |= {key: file[key] for key in ("points", "faces", "vertices")}
    published = None
    if (folder / name / "published.npz").is_file():
        with np.load(folder / name / "published.npz") as file:
            published = file["uv"]
    made = Prepared(name, **parts, unit=facts["unit"], published=published)
    if made.hashes != facts["hashes"]:
        raise InputError(f"{folder / name} was changed. Delete it, and run `voxflat bench fetch {folder}`")
    return made


def _savez(path: Path, **arrays: Any) -> None:
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)
