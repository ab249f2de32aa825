"""Read and write files: volumes with their voxel grids, and meshes with values at their points.

This module exports the public functions. `files`, `grid` and `triangles` contain code shared by the formats, and
`subprocess_reader` runs the process in which ITK and VTK read files. Readers do not depend on surfaces or maps.
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


def __dir__() -> list[str]:
    return sorted(__all__)
