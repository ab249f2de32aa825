"""Convert shapes and points to the corners of a polygon."""

import numpy as np
from napari.layers import Points, Shapes
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace, moved
from voxflat.errors import InputError

_FEWEST = 3


def corners(drawn: Points | Shapes, world: str) -> NDArray[np.float64]:
    """Return polygon corners in RAS+ mm from all points, or from the selected or last shape, or raise InputError."""
    found = drawn.data
    if isinstance(drawn, Shapes) and len(found):
        chosen = sorted(drawn.selected_data)
        found = found[chosen[0] if len(chosen) == 1 else -1]
    if len(found) < _FEWEST:
        count = f"{len(found)} corner{'s' * (len(found) != 1)}"
        raise InputError(f"The polygon in layer '{drawn.name}' has {count}. Draw at least {_FEWEST} corners")
    return moved(found, LayerPlace.of(drawn, world).affine)
