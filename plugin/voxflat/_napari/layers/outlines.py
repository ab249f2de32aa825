"""Convert shapes and points to the corners of a polygon."""

import numpy as np
from napari.layers import Layer, Points, Shapes
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace, moved
from voxflat.errors import InputError

_FEWEST = 3


def corners(drawn: Points | Shapes, surface: Layer, world: str) -> NDArray[np.float64]:
    """Return polygon corners in RAS+ mm from all points, or from the selected or last shape; or raise InputError."""
    if isinstance(drawn, Shapes):
        chosen = sorted(drawn.selected_data)
        places = [drawn.data[chosen[0] if len(chosen) == 1 else -1]] if len(drawn.data) else []
        found = np.concatenate(places) if places else np.empty((0, 3))
    else:
        found = np.asarray(drawn.data, dtype=np.float64).reshape(-1, 3)
    if len(found) < _FEWEST:
        raise InputError(
            f"Layer '{drawn.name}' has {len(found)} corners on '{surface.name}'. Draw at least {_FEWEST} corners"
        )
    return moved(found, LayerPlace.of(drawn, world).affine)
