"""The filestore of pycortex: the files of a subject, and how they are made from those of FreeSurfer."""

import configparser
import io
import os
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags

from voxflat.arguments import checked_path, checked_text, log, shown
from voxflat.errors import InputError
from voxflat.io.files import REMEDY, atomic_path, contents, naming
from voxflat.io.formats.freesurfer import read_morph
from voxflat.io.formats.gifti import surface_bytes
from voxflat.io.meshes import Mesh, read_mesh
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.volumes import read_volume, write_volume
from voxflat.lab.layouts import HEMISPHERES
from voxflat.surfaces.standard.template import SIDES

SURFACES = {"wm": "white", "pia": "pial", "inflated": "inflated"}
"""Surfaces of pycortex and of FreeSurfer."""

_VOLUMES = {"raw": "T1.mgz", "aseg": "aseg.mgz", "raw_wm": "wm.mgz"}
_VALUES = {"sulcaldepth": "sulc", "thickness": "thickness", "curvature": "curv"}
_OF_FLAT = ("distortion", "flat_border", "bumpy_flatmap")  # surface-info that pycortex computes from the flat surfaces
_FOLDERS = ("transforms", "anatomicals", "cache", "surfaces", "surface-info", "views")
_POINTS_A_STEP = 300  # points per smoothing step


@dataclass(frozen=True)
class StoredSubject:
    """The files of a subject in a filestore."""

    folder: Path

    def surface(self, name: str, hemi: str) -> Path:
        """Return the path of a surface: wm, pia, inflated or flat."""
        return self.folder / "surfaces" / f"{name}_{hemi}.gii"

    @property
    def overlays(self) -> Path:
        """The drawing of the regions of interest."""
        return self.folder / "overlays.svg"

    @property
    def flat_files(self) -> list[Path]:
        """The existing flat surfaces, and the drawing, which belongs to them."""
        flat = [self.surface("flat", hemi) for hemi in HEMISPHERES]
        return [path for path in (*flat, self.overlays) if path.exists()]

    def outdated(self) -> Iterator[Path]:
        """Yield the files that pycortex computed from the flat surfaces, beside its cache."""
        for path in sorted((self.folder / "surface-info").glob("*.npz")):
            if path.name.partition("[")[0].removesuffix(".npz") in _OF_FLAT:
                yield path

    def keep_aside(self) -> Path | None:
        """Copy everything that depends on the flat surfaces to a new directory; return it, or None if there is nothing.

        The directory has the layout of the subject, so that copying its content back restores the subject.
        """
        files = [*self.flat_files, *self.outdated()]
        if not files:
            return None
        number = 1
        while (backup := self.folder / f"voxflat-backup-{number}").exists():
            number += 1
        for path in files:
            copy = backup / path.relative_to(self.folder)
            copy.parent.mkdir(parents=True, exist_ok=True)
            with atomic_path(copy) as temporary:
                shutil.copy2(path, temporary)
        return backup

    def clear(self) -> None:
        """Delete what pycortex computed from the previous flat surfaces."""
        for path in self.outdated():
            path.unlink()
        caches = [self.folder / "cache"]
        if elsewhere := _configured("cache"):
            caches.append(Path(elsewhere).expanduser() / self.folder.name / "cache")
        for cache in caches:
            shutil.rmtree(cache, ignore_errors=True)
        (self.folder / "cache").mkdir(exist_ok=True)

    def make_folders(self) -> None:
        """Make the directories that pycortex expects."""
        for name in _FOLDERS:
            (self.folder / name).mkdir(parents=True, exist_ok=True)


def filestore_of(filestore: str | os.PathLike[str] | None) -> Path:
    """Return the directory of the filestore: the given one, or that of pycortex."""
    if filestore is not None:
        folder = checked_path(filestore, "filestore")
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file. Pass the directory of the filestore")
        return folder
    database = sys.modules.get("cortex.database")  # of a running pycortex, in which the user may have changed it
    named = getattr(database, "default_filestore", None) or _configured("filestore")
    if not named:
        raise InputError("the configuration of pycortex defines no filestore. Pass its directory (--filestore)")
    if not Path(named).is_dir():
        raise InputError(f"{named}, the filestore of pycortex, does not exist. Pass its directory (--filestore)")
    return Path(named)


def _configured(option: str) -> str | None:
    """Return an option of the user's configuration of pycortex."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", "~"))
    elif sys.platform == "darwin":
        base = Path("~/Library/Application Support")
    else:
        base = Path(os.environ.get("XDG_CONFIG_HOME") or "~/.config")
    config = configparser.ConfigParser(interpolation=None)
    try:
        config.read(base.expanduser() / "pycortex" / "options.cfg", encoding="utf-8")
        return config.get("basic", option, fallback=None)
    except (configparser.Error, UnicodeDecodeError) as error:
        raise InputError(f"the configuration of pycortex is damaged: {error}. Correct it") from None


def subject_name(name: object) -> str:
    """Return the name of a subject, which is the name of a directory."""
    text = checked_text(name, "name")
    if not text or text.startswith(".") or Path(text).name != text:
        raise InputError(f"name is {shown(name)}. Pass a name without directories, such as sub-01")
    return text


# ------------------------------------------------------------------------------ from recon-all


def surfaces_of(folder: Path, hemi: str) -> dict[str, Mesh]:
    """Return the surfaces of a FreeSurfer subject in scanner coordinates, by their names in pycortex."""
    meshes = {name: read_mesh(folder / "surf" / f"{hemi}.{of}") for name, of in SURFACES.items() if name != "inflated"}
    inflated = folder / "surf" / f"{hemi}.inflated"
    meshes["inflated"] = read_mesh(inflated) if inflated.is_file() else _inflated(meshes["wm"])
    count = len(meshes["wm"].points)
    for name, mesh in meshes.items():
        if len(mesh.points) != count:
            problem = f"{hemi}.{SURFACES[name]} has {len(mesh.points)} vertices, but {hemi}.white has {count}"
            raise InputError(f"{folder / 'surf'}: {problem}. Pass the output of one run of recon-all")
    return {name: _in_scanner(mesh, folder) for name, mesh in meshes.items()}


def _in_scanner(mesh: Mesh, folder: Path) -> Mesh:
    """Move a surface to scanner coordinates, like mris_convert --to-scanner."""
    space = mesh.space
    t1 = folder / "mri" / "T1.mgz"
    if not space.is_known and t1.is_file():
        volume = read_volume(t1)
        space = Space("tkRAS", VolumeGeometry.of_volume(volume.affine, volume.data.shape[:3], t1.name))
    if not space.is_known:
        log.warning("%s", f"{mesh.path}: {space.warning or 'its position in the scanner is unknown'}. It is not moved")
    return Mesh(space.to_scanner(mesh.points), mesh.faces, structure=mesh.structure, space=Space("scanner"))


def _inflated(white: Mesh) -> Mesh:
    """Return a smoothed surface of the same size, for subjects without an inflated surface."""
    faces, count = white.faces, len(white.points)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = coo_matrix((np.ones(len(ends)), ends.T), (count, count)).tocsr()
    links = links + links.T
    mean = diags(1 / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)) @ links
    points = white.points
    for _ in range(max(10, count // _POINTS_A_STEP)):
        points = 0.5 * points + 0.5 * (mean @ points)
    middle = points.mean(axis=0)
    size = np.sqrt(_area(white.points, faces) / _area(points, faces))
    return Mesh(middle + size * (points - middle), faces, structure=white.structure, space=white.space)


def _area(points: NDArray[np.float64], faces: NDArray[Any]) -> float:
    a, b, c = (points[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def gifti_of(points: NDArray[np.floating[Any]], faces: NDArray[np.int64], hemi: str) -> bytes:
    """Return the GIFTI file of a surface in scanner coordinates, or of a flat surface."""
    return surface_bytes(points.astype(np.float64), faces, SIDES[HEMISPHERES[hemi][1]], is_scanner=True)


def write_values(folder: Path, stored: StoredSubject, counts: dict[str, int]) -> list[str]:
    """Write sulcal depth, thickness and curvature, negated like pycortex's own import; return the missing files."""
    missing = []
    for name, of in _VALUES.items():
        path = stored.folder / "surface-info" / f"{name}.npz"
        files = {hemi: folder / "surf" / f"{hemi}.{of}" for hemi in HEMISPHERES}
        missing += [str(file.relative_to(folder)) for file in files.values() if not file.is_file()]
        if path.exists() or not all(file.is_file() for file in files.values()):
            continue
        left, right = (-_values(file, counts[hemi]) for hemi, file in files.items())
        buffer = io.BytesIO()
        np.savez(buffer, left=left, right=right)
        with atomic_path(path) as temporary:
            temporary.write_bytes(buffer.getvalue())
    return missing


def _values(file: Path, count: int) -> NDArray[np.float32]:
    with naming(file, REMEDY):
        values = read_morph(file, contents(file)).astype(np.float32)
        if len(values) != count:
            raise InputError(f"has {len(values)} values for {count} vertices. Pass the files of one subject")
    return values


def write_volumes(folder: Path, stored: StoredSubject) -> list[str]:
    """Write the anatomical volumes as NIfTI; return the missing files."""
    missing = []
    for name, of in _VOLUMES.items():
        path, file = stored.folder / "anatomicals" / f"{name}.nii.gz", folder / "mri" / of
        if not file.is_file():
            missing.append(f"mri/{of}")
        elif not path.exists():
            volume = read_volume(file).in_unit("mm")
            write_volume(path, volume.data, volume.affine)
    return missing
