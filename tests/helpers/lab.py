"""A directory as FreeSurfer leaves it, of a small real hemisphere: nilearn's fsaverage5, a quarter of its vertices.

The vertices of fsaverage5 are those of an icosahedron that was subdivided five times; the first 2,562 are those of
the fourth time.
"""

from importlib.util import find_spec
from pathlib import Path

import nibabel as nib
import numpy as np
import studies

VERTICES = 2562
C_RAS = (3.0, -17.0, 22.0)


def fsaverage5(name):
    """Return points and faces of a surface such as ``"white_left"``."""
    folder = Path(find_spec("nilearn").origin).parent / "datasets" / "data" / "fsaverage5"
    arrays = nib.load(folder / f"{name}.gii.gz").agg_data()
    return arrays[0].astype(np.float64), arrays[1].astype(np.int64)


def hemisphere(vertices=VERTICES):
    """Return points of the white and of the pial surface, shape (vertices, 3), and triangles."""
    of = studies.hemisphere("lh", vertices)
    return of["white"].copy(), of["pial"].copy(), of["faces"].copy()


def write(folder, vertices=VERTICES):
    """Write lh.white, lh.pial, lh.midthickness.surf.gii and lh.Medial_wall.label, with their c_ras."""
    white, pial, faces = hemisphere(vertices)
    affine = np.array([[-1.0, 0, 0, 128], [0, 0, 1, -128], [0, -1, 0, 128], [0, 0, 0, 1]])
    affine[:3, 3] += C_RAS
    footer = {
        "head": np.array([2, 0, 20], np.int32),
        "valid": "1  # volume info valid",
        "filename": "../mri/orig.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.ones(3),
        "xras": affine[:3, 0],
        "yras": affine[:3, 1],
        "zras": affine[:3, 2],
        "cras": np.array(C_RAS),
    }
    for name, points in (("white", white), ("pial", pial)):
        nib.freesurfer.write_geometry(folder / f"lh.{name}", points, faces, volume_info=footer)
    wall = np.flatnonzero(np.linalg.norm(pial - white, axis=1) < 0.3)
    rows = "".join(f"{v}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for v, (x, y, z) in zip(wall, white[wall], strict=True))
    (folder / "lh.Medial_wall.label").write_text(f"#!ascii label , from subject lab\n{len(wall)}\n{rows}")
    arrays = [
        nib.gifti.GiftiDataArray(((white + pial) / 2 + C_RAS).astype("f4"), "NIFTI_INTENT_POINTSET"),
        nib.gifti.GiftiDataArray(faces.astype("i4"), "NIFTI_INTENT_TRIANGLE"),
    ]
    nib.save(nib.gifti.GiftiImage(darrays=arrays), folder / "lh.midthickness.surf.gii")
    return wall
