"""A folder in FreeSurfer's layout with a small real hemisphere: a quarter of the vertices of nilearn's fsaverage5.

The vertices of fsaverage5 are those of an icosahedron that was subdivided five times; the first 2,562 are those after
four subdivisions.
"""

import nibabel as nib
import numpy as np
import studies
from anatomy import fsaverage5_file

VERTICES = 2562
C_RAS = studies.C_RAS


def fsaverage5(name):
    """Return points and faces of a surface such as ``"white_left"``."""
    arrays = nib.load(fsaverage5_file(*name.split("_"))).agg_data()
    return arrays[0].astype(np.float64), arrays[1].astype(np.int64)


def hemisphere(vertices=VERTICES):
    """Return the points of the white and the pial surface, shape (vertices, 3), and the triangles."""
    of = studies.hemisphere("lh", vertices)
    return of["white"].copy(), of["pial"].copy(), of["faces"].copy()


def write(folder, vertices=VERTICES):
    """Write lh.white, lh.pial, lh.midthickness.surf.gii and lh.Medial_wall.label; return the medial wall."""
    white, pial, faces = hemisphere(vertices)
    for name, points in (("white", white), ("pial", pial)):
        nib.freesurfer.write_geometry(folder / f"lh.{name}", points, faces, volume_info=studies.footer(C_RAS))
    wall = np.flatnonzero(np.linalg.norm(pial - white, axis=1) < studies.THIN)
    studies.write_label(folder / "lh.Medial_wall.label", wall, white)
    parts = {"POINTSET": ((white + pial) / 2 + C_RAS).astype("f4"), "TRIANGLE": faces.astype("i4")}
    arrays = [nib.gifti.GiftiDataArray(data, f"NIFTI_INTENT_{kind}") for kind, data in parts.items()]
    nib.save(nib.gifti.GiftiImage(darrays=arrays), folder / "lh.midthickness.surf.gii")
    return wall
