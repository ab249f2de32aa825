"""Surfaces in the spaces of FreeSurfer, Workbench and sMRIPrep, as written by these programs, and volumes."""

import nibabel as nib
import numpy as np
import pyvista as pv

from voxflat.maps.depth import Depths
from voxflat.maps.raster import at_points
from voxflat.maps.sampling import Sampling
from voxflat.maps.sources import source_of

C_RAS = (3.0, -17.0, 22.0)
CONFORMED = ((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))  # xras, yras, zras


def ball(n=3):
    """Return a ball with a radius of 40 mm at the position of a left hemisphere in tkRAS."""
    mesh = pv.Icosphere(radius=40.0, nsub=n)
    points = np.asarray(mesh.points, dtype=np.float32).astype(np.float64) * [0.8, 1.2, 1.0] + [-32.0, -15.0, 18.0]
    return points.astype(np.float32), np.asarray(mesh.regular_faces).astype(np.int32)


def oblique():
    """Return axes rotated by 20 degrees about two axes: xras, yras, zras."""
    a = np.radians(20)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return tuple(map(tuple, (about_z @ about_x @ np.transpose(CONFORMED)).T))


def header(axes=CONFORMED, c_ras=C_RAS, shape=(256, 256, 256), size=(1.0, 1.0, 1.0)):
    """Return a header of a FreeSurfer volume, which provides vox2ras and vox2ras_tkr."""
    of = nib.freesurfer.mghformat.MGHHeader()
    of["dims"][:3], of["delta"], of["goodRASFlag"] = shape, size, 1
    of["Mdc"], of["Pxyz_c"] = axes, c_ras
    return of


def to_scanner(points, of):
    """Convert tkRAS to scanner RAS by nibabel's matrices."""
    return nib.affines.apply_affine(of.get_vox2ras() @ np.linalg.inv(of.get_vox2ras_tkr()), points)


def at_vertices(m, volume, **how):
    """Sample as `FlatMap.image` does, by pixels that lie at the vertices."""
    source = source_of(m._triangles.on_surface, volume)
    return source.image(at_points(len(m)), Sampling(Depths.of(**how), "mean")).data[:, 0]


def footer(of, valid="1  # volume info valid"):
    """Return the footer of a FreeSurfer surface."""
    axes = dict(zip(("xras", "yras", "zras"), of["Mdc"], strict=True))
    file = {"head": np.array([2, 0, 20]), "valid": valid, "filename": "/subjects/bert/mri/filled.mgz"}
    return {**file, "volume": of["dims"][:3], "voxelsize": of["delta"], **axes, "cras": of["Pxyz_c"]}


def volume_geometry(of, read_from):
    """Return the GIFTI metadata of FreeSurfer's mris_convert (utils/gifti.cpp), with six decimals."""
    meta = {"VolGeomFname": "filled.mgz"}
    meta |= {f"VolGeom{name}": str(n) for name, n in zip(("Width", "Height", "Depth"), of["dims"], strict=False)}
    meta |= {f"VolGeom{axis}size": f"{h:f}" for axis, h in zip("XYZ", of["delta"], strict=True)}
    for axis, cosines in zip("XYZC", [*of["Mdc"], of["Pxyz_c"]], strict=True):
        meta |= {f"VolGeom{axis}_{row}": f"{value:f}" for row, value in zip("RAS", cosines, strict=True)}
    middle = (read_from.min(axis=0) + read_from.max(axis=0)) / 2
    return meta | {f"SurfaceCenter{axis}": f"{value:f}" for axis, value in zip("XYZ", middle, strict=True)}


def write_gifti(path, points, faces, meta, spaces=(0, 0), matrix=None):
    system = nib.gifti.GiftiCoordSystem(*spaces, np.eye(4) if matrix is None else matrix)
    meta = {"AnatomicalStructurePrimary": "CortexLeft"} | meta
    how = {"datatype": "NIFTI_TYPE_FLOAT32", "meta": nib.gifti.GiftiMetaData(meta), "coordsys": system}
    placed = nib.gifti.GiftiDataArray(points.astype("f4"), "NIFTI_INTENT_POINTSET", **how)
    triangles = nib.gifti.GiftiDataArray(faces, "NIFTI_INTENT_TRIANGLE", datatype="NIFTI_TYPE_INT32")
    path.write_bytes(nib.gifti.GiftiImage(darrays=[placed, triangles]).to_bytes())
    return path


def write_freesurfer(path, points, faces, of):
    nib.freesurfer.write_geometry(path, points, faces, "me", footer(of))
    return path


def mris_convert(path, points, faces, of):
    """Write tkRAS and the matrix to scanner RAS, like FreeSurfer 7.4."""
    matrix = of.get_vox2ras() @ np.linalg.inv(of.get_vox2ras_tkr())
    return write_gifti(path, points, faces, volume_geometry(of, points), (0, 1), matrix)


def mris_convert_old(path, points, faces, of):
    """Write tkRAS, like FreeSurfer 5 to 7.3."""
    return write_gifti(path, points, faces, volume_geometry(of, points), (0, 3))


def to_scanner_new(path, points, faces, of):
    """Write scanner RAS and the matrix to tkRAS, like mris_convert --to-scanner of FreeSurfer 7.4."""
    matrix = of.get_vox2ras_tkr() @ np.linalg.inv(of.get_vox2ras())
    return write_gifti(path, to_scanner(points, of), faces, volume_geometry(of, points), (1, 0), matrix)


def to_scanner_old(path, points, faces, of):
    """Write scanner RAS with the metadata of tkRAS, like mris_convert --to-scanner of FreeSurfer 6 to 7.3."""
    return write_gifti(path, to_scanner(points, of), faces, volume_geometry(of, points), (0, 3))


def smriprep(path, points, faces, of):
    """Write scanner RAS without axes and centre in the metadata, like sMRIPrep."""
    left_out = {f"VolGeom{axis}_{row}" for axis in "XYZC" for row in "RAS"}
    meta = {name: value for name, value in volume_geometry(of, points).items() if name not in left_out}
    return write_gifti(path, to_scanner(points, of), faces, meta, (0, 3))


def smriprep_old(path, points, faces, of):
    """Write scanner RAS with the centre set to 0, like sMRIPrep until 2022."""
    meta = volume_geometry(of, points) | {f"VolGeomC_{row}": "0.000000" for row in "RAS"}
    return write_gifti(path, to_scanner(points, of), faces, meta, (0, 3))


def workbench(path, points, faces, of):
    """Write scanner RAS with all metadata of tkRAS, like wb_command -surface-apply-affine."""
    return write_gifti(path, to_scanner(points, of), faces, volume_geometry(of, points), (3, 3))


WAYS = {"lh.white": write_freesurfer, "mris_convert.surf.gii": mris_convert}
WAYS |= {"mris_convert_old.surf.gii": mris_convert_old, "to_scanner.surf.gii": to_scanner_new}
WAYS |= {"to_scanner_old.surf.gii": to_scanner_old, "smriprep.surf.gii": smriprep, "workbench.surf.gii": workbench}
"""Writers of a surface at the same position, by file name."""

AFFINES = {
    "RAS": np.array([[4.0, 0, 0, -120], [0, 4, 0, -140], [0, 0, 4, -80], [0, 0, 0, 1]]),
    "LAS": np.array([[-3.5, 0, 0, 90], [0, 4, 0, -140], [0, 0, 4.5, -80], [0, 0, 0, 1]]),
    "conformed": header(shape=(60, 60, 60), size=(4.0, 4.0, 4.0)).get_vox2ras(),
    "oblique": header(axes=oblique(), shape=(60, 60, 60), size=(4.0, 4.0, 4.0)).get_vox2ras(),
}
"""Affines of volumes with 60 voxels per side around the ball."""
