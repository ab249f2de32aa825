"""Find out whether a foreground or its surface looks like noise, such as that of a threshold within the noise."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress

_MANY_PARTS, _MAIN_SHARE = 300, 0.9  # of a foreground that is probably noise, and of its largest part
_MANY_HANDLES = 5000  # of the largest component, if it is probably noise; whole brains have up to 1,022
_MANY_COMPONENTS, _SMALL_SHARE = 50, 0.1  # of a surface, and the share of its largest component
_LEAST_LOOPS, _DENSE = 20, 0.007  # loops of a surface, and their number per vertex; real volumes have up to 0.005


def noise_in_parts(mask: NDArray[np.bool_], progress: Progress | None) -> str | None:
    """Describe the parts of a foreground if they look like noise."""
    counts = _core.component_sizes(mask, progress)
    if len(counts) < _MANY_PARTS or (share := counts.max() / counts.sum()) >= _MAIN_SHARE:
        return None
    return _told("foreground", f"{len(counts)} parts, of which the largest has {_percent(share)} of the voxels")


def noise_in_handles(count: int) -> str | None:
    """Describe the handles of a foreground if they look like noise."""
    return _told("foreground", f"{count} handles") if count >= _MANY_HANDLES else None


def noise_in_surface(components: Sequence[int], used: int, handles: int, loops: int) -> str | None:
    """Describe a surface if its components, or the handles and boundary loops of the part in use, look like noise.

    `components` are numbers of vertices, the largest first; `used` is that of the part.
    """
    if len(components) >= _MANY_COMPONENTS and (share := components[0] / sum(components)) < _SMALL_SHARE:
        return _told(
            "surface", f"{len(components)} components, of which the largest has {_percent(share)} of the vertices"
        )
    if max(_LEAST_LOOPS, _DENSE * used) <= 2 * handles + loops:
        return _told("surface", f"{handles} handles and {loops} boundary loops at only {used} vertices")
    return None


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _told(what: str, found: str) -> str:
    cause = "so it may contain noise, whose surface takes long"
    return f"the {what} has {found}, {cause}. Check the label or threshold, or smooth the volume"
