"""What goes in through every door, function, command line, PyVista, VTK and napari, so that the same must come out."""

from hard_shapes import sheet

from voxflat.io.meshes import Mesh
from voxflat.io.meshes import write_mesh as write

OPTIONS = {"sources": 20, "seed": 3}


def write_mesh(path):
    """Write a bowl of 12 by 12 points that is no plane; return the path."""
    points, faces = sheet(lambda u, v: (u - 3, v - 3, 0.1 * ((u - 3) ** 2 + (v - 3) ** 2)), (6, 6), (12, 12))
    write(path, Mesh(points, faces))
    return path
