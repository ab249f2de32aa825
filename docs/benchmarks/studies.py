"""Directories as FreeSurfer and sMRIPrep leave them, of nilearn's fsaverage5 and warped variants of it: studies to try.

The vertices of fsaverage5 are those of an icosahedron that was subdivided five times; the first 2,562 are those of the
fourth time, 642 of the third, 162 of the second.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np
from anatomy import fsaverage5_file
from numpy.typing import NDArray

SIDES = {"lh": ("left", "L"), "rh": ("right", "R")}
SIZES = (10_242, 2562, 642, 162)
C_RAS = (3.0, -17.0, 22.0)
THIN = 0.3  # mm: where white and pial surface are closer than this is the medial wall

Hemisphere = dict[str, NDArray[Any]]


@lru_cache
def hemisphere(hemi: str, vertices: int = SIZES[0]) -> Hemisphere:
    """Return white, pial, sphere, each (N, 3), curv, thickness, cortex, each (N,), and faces (F, 3), by their names."""

    def arrays(name: str) -> Any:
        return nib.load(fsaverage5_file(name, SIDES[hemi][0])).agg_data()

    (white, faces), (pial, _), (sphere, _) = (arrays(name) for name in ("white", "pial", "sphere"))
    faces = faces.astype(np.int64)
    for size in SIZES[1 : 1 + SIZES.index(vertices)]:
        faces = before_subdivision(faces, size)
    found = {"white": white, "pial": pial, "sphere": sphere, "curv": arrays("curv"), "thickness": arrays("thick")}
    found = {name: np.asarray(values[:vertices], dtype=np.float64) for name, values in found.items()}
    return {**found, "faces": faces, "cortex": np.linalg.norm(found["pial"] - found["white"], axis=1) >= THIN}


def before_subdivision(faces: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the triangles of the first vertices, before a subdivision: each holds three midpoints of two corners."""
    parents: dict[int, set[int]] = {}
    for edge in np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist():
        for middle, corner in (edge, edge[::-1]):
            if middle >= size > corner:
                parents.setdefault(middle, set()).add(corner)
    inner = faces[(faces >= size).all(axis=1)].tolist()
    between = [[parents[middle] for middle in triangle] for triangle in inner]
    return np.array([[*(a & c), *(a & b), *(b & c)] for a, b, c in between])


def warped(of: Hemisphere, seed: int, amplitude: float = 2.5) -> Hemisphere:
    """Return another subject: another size, every place moved by long waves (mm), and another thickness."""
    random = np.random.default_rng(seed)
    size, waves = random.uniform(0.94, 1.06, 3), random.normal(scale=0.04, size=(3, 3))
    phases = random.uniform(0, 2 * np.pi, 3)

    def moved(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(points * size + amplitude * np.sin(points @ waves + phases))

    thickness = of["thickness"] * random.uniform(0.9, 1.1)
    return {**of, "white": moved(of["white"]), "pial": moved(of["pial"]), "thickness": thickness}


def write_freesurfer(folder: Path, hemi: str, of: Hemisphere, c_ras: tuple[float, float, float] = (0, 0, 0)) -> None:
    """Write ``surf`` and ``label`` as recon-all does."""
    for name in ("surf", "label"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, points in (("white", "white"), ("smoothwm", "white"), ("pial", "pial"), ("sphere.reg", "sphere")):
        path = folder / "surf" / f"{hemi}.{name}"
        nib.freesurfer.write_geometry(path, of[points], of["faces"], volume_info=footer(c_ras))
    for name in ("curv", "thickness"):
        nib.freesurfer.write_morph_data(folder / "surf" / f"{hemi}.{name}", of[name])
    write_label(folder / "label" / f"{hemi}.cortex.label", np.flatnonzero(of["cortex"]), of["white"])


def footer(c_ras: tuple[float, float, float]) -> dict[str, Any]:
    """Return what FreeSurfer writes behind a surface of a conformed volume."""
    return {
        "head": np.array([2, 0, 20], np.int32),
        "valid": "1  # volume info valid",
        "filename": "../mri/orig.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.ones(3),
        **{"xras": np.array([-1.0, 0, 0]), "yras": np.array([0.0, 0, -1]), "zras": np.array([0.0, 1, 0])},
        "cras": np.array(c_ras, dtype=float),
    }


def write_label(path: Path, vertices: NDArray[Any], points: NDArray[Any]) -> None:
    """Write a label of vertices as FreeSurfer does."""
    placed = zip(vertices, points[vertices], strict=True)
    rows = "".join(f"{v}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for v, (x, y, z) in placed)
    path.write_text(f"#!ascii label , from subject\n{len(vertices)}\n{rows}")


def write_derivatives(folder: Path, name: str, hemi: str, of: Hemisphere) -> None:
    """Write the surfaces of a participant such as ``sub-01`` as sMRIPrep does, into its ``anat``."""
    folder.mkdir(parents=True, exist_ok=True)
    letter = SIDES[hemi][1]
    structure = {"L": "CortexLeft", "R": "CortexRight"}[letter]

    def save(ending: str, *arrays: Any) -> None:
        meta = nib.gifti.GiftiMetaData(AnatomicalStructurePrimary=structure)
        nib.save(nib.gifti.GiftiImage(darrays=list(arrays), meta=meta), folder / f"{name}_hemi-{letter}_{ending}.gii")

    def values(data: NDArray[Any], intent: str, kind: str) -> Any:
        return nib.gifti.GiftiDataArray(data.astype(kind), f"NIFTI_INTENT_{intent}")

    triangles = values(of["faces"], "TRIANGLE", "i4")
    surfaces = {"white": of["white"], "pial": of["pial"], "midthickness": (of["white"] + of["pial"]) / 2}
    for ending, points in {**surfaces, "space-fsaverage_desc-reg_sphere": of["sphere"]}.items():
        save(f"{ending}.surf", values(points, "POINTSET", "f4"), triangles)
    save("thickness.shape", values(of["thickness"], "SHAPE", "f4"))
    save("desc-cortex_mask.label", values(of["cortex"], "LABEL", "i4"))


def write_z(path: Path) -> None:
    """Write a volume whose values are z in scanner RAS, mm, 4 mm a voxel."""
    path.parent.mkdir(parents=True, exist_ok=True)
    affine = np.diag([4.0, 4, 4, 1])
    affine[:3, 3] = -140
    z = np.broadcast_to(affine[2, 3] + 4.0 * np.arange(70), (70, 70, 70))
    nib.save(nib.MGHImage(z.astype(np.float32), affine), path)
