"""What goes in through every door, function, command line, PyVista, VTK and napari, so that the same must come out."""

import numpy as np

from voxflat.io.meshes import Mesh
from voxflat.io.meshes import write_mesh as write

OPTIONS = {"sources": 20, "seed": 3}


def write_mesh(path):
    """Write a bowl of 12 by 12 points that is no plane; return the path."""
    row, column = np.indices((11, 11)).reshape(2, -1)
    first = 12 * row + column
    faces = np.vstack(
        [np.stack(corners, axis=1) for corners in ((first, first + 12, first + 1), (first + 1, first + 12, first + 13))]
    )
    x, y = np.meshgrid(np.linspace(-3, 3, 12), np.linspace(-3, 3, 12), indexing="ij")
    points = np.stack([x, y, 0.1 * (x * x + y * y)], axis=-1).reshape(-1, 3)
    write(path, Mesh(points, faces))
    return path
