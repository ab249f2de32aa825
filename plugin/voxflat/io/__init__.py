"""Files in and out: volumes on their grids, and meshes with what lies on their points.

What users call stands here; a module a format, or a family of them. No reader knows of surfaces or maps. From below:
`files`, `grid` and `triangles` are what formats share; `readers` and `volumes` are of volumes, `formats` tells those of
meshes apart, `meshes` and `overlays` read and write them all, and `spaces` says where coordinates lie; `apart` is the
process in which ITK and VTK read.
"""

from voxflat.io.files import atomic_path
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.io.overlays import read_overlay, read_region
from voxflat.io.patches import Patch, patch_border, patch_faces, read_patch, write_patch
from voxflat.io.sources import as_volume
from voxflat.io.spaces import Space, VolumeGeometry
from voxflat.io.volumes import VOLUME_ENDINGS, Volume, read_volume, write_volume

__all__ = [
    "VOLUME_ENDINGS",
    "Mesh",
    "Patch",
    "Space",
    "Volume",
    "VolumeGeometry",
    "as_volume",
    "atomic_path",
    "patch_border",
    "patch_faces",
    "read_mesh",
    "read_overlay",
    "read_patch",
    "read_region",
    "read_volume",
    "write_mesh",
    "write_patch",
    "write_volume",
]
