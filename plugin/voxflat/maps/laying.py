"""Where a map lies in space when it is laid near its surface."""

import numpy as np
from numpy.typing import NDArray


def laid(plane: NDArray[np.float64], surface: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lay a map near its surface: turned and moved, such that the sum of the squares of all ways is least."""
    flat, middle = plane - plane.mean(axis=0), surface.mean(axis=0)
    left, _, right = np.linalg.svd((surface - middle).T @ flat)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ sign @ right
    return turn, flat @ turn.T + middle
