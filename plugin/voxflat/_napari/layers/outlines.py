"""From shapes and points to the corners of a polygon."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from napari.layers import Shapes
from numpy.typing import NDArray

from voxflat._napari.layers.world import LayerPlace, moved
from voxflat.errors import InputError

if TYPE_CHECKING:
    from napari.layers import Layer, Points

_FEWEST = 3


def corners(drawn: Points | Shapes, surface: Layer, world: str) -> NDArray[np.float64]:
    """Return where the corners of a drawn polygon lie.

    `drawn`: points are the corners, in their order; of shapes the selected one, else the last, is the polygon.
    `surface`: what the polygon is drawn on. `world`: one of `WORLDS`. Returns: (k, 3), RAS+ mm. Raises InputError: for
    fewer than three corners, or axes that are no lengths.
    """
    if isinstance(drawn, Shapes):
        chosen = sorted(drawn.selected_data)
        places = [drawn.data[chosen[0] if len(chosen) == 1 else -1]] if len(drawn.data) else []
        found = np.concatenate(places) if places else np.empty((0, 3))
    else:
        found = np.asarray(drawn.data, dtype=np.float64).reshape(-1, 3)
    if len(found) < _FEWEST:
        raise InputError(
            f"layer '{drawn.name}' has {len(found)} corners on '{surface.name}'; a polygon has three at least"
        )
    return moved(found, LayerPlace.of(drawn, world).affine)
