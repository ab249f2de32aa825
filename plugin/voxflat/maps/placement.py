"""Place a flat map near its surface in space."""

import numpy as np
from numpy.typing import NDArray


def aligned(
    plane: NDArray[np.float64], surface: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotate and translate a map onto its surface, minimising the squared distances between corresponding points."""
    flat, middle = plane - plane.mean(axis=0), surface.mean(axis=0)
    left, _, right = np.linalg.svd((surface - middle).T @ flat)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ sign @ right
    return turn, flat @ turn.T + middle
