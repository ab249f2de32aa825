"""Landmarks of a movie: known positions of the same material points in several frames."""

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import shown
from voxflat.errors import InputError
from voxflat.io.grid import in_unit
from voxflat.pipeline.shapes import Shape
from voxflat.pipeline.surface import Surface

_AWAY = 0.2  # greatest distance of a landmark from its surface, relative to the radius of a sphere of the same area


def checked_landmarks(landmarks: object, frames: list[Surface], reference: int) -> NDArray[np.float64] | None:
    """Check that landmarks (T, K, 3) lie near the surfaces, and return the nearest points on the surfaces."""
    if landmarks is None:
        return None
    try:
        places = np.array(landmarks, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"landmarks is {shown(landmarks)}. Pass an array of shape (frames, landmarks, 3)") from None
    if places.ndim != 3 or len(places) != len(frames) or places.shape[1] == 0 or places.shape[2] != 3:
        raise InputError(
            f"landmarks has shape {places.shape}. Pass an array of shape ({len(frames)}, landmarks, 3), with NaN where "
            "a position is not known"
        )
    is_known = np.asarray(np.isfinite(places).all(axis=2))
    places[np.isnan(places).any(axis=2)] = np.nan
    for frame, surface in enumerate(frames):
        wrong = np.flatnonzero(np.isinf(places[frame]).any(axis=1))
        if len(wrong):
            raise InputError(f"landmark {wrong[0]} is infinite in frame {frame}. Pass NaN where it is not known")
        missing = np.flatnonzero(~is_known[frame])
        if frame == reference and len(missing):
            raise InputError(
                f"landmark {missing[0]} is not known in frame {frame}, the reference frame. Remove it, or choose "
                "another reference"
            )
        shape = Shape(surface.points, np.ascontiguousarray(surface.faces))
        corners, weights, near = shape.nearest(places[frame][is_known[frame]])
        far = np.zeros(len(is_known[frame]))
        far[is_known[frame]] = near
        worst = int(far.argmax())
        if far[worst] > _AWAY * shape.size:
            text = f"landmark {worst} is {far[worst]:.3g} mm away from the surface of frame {frame}"
            raise InputError(
                f"{in_unit(text, surface.origin.named_unit)}. Correct it, or pass NaN if its position is not known"
            )
        places[frame][is_known[frame]] = shape.mixed(shape.points, corners, weights)
    return places
