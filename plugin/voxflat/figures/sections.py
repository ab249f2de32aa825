"""Draw sections through a white-matter mask, with the outline of a template that did not fit it."""

from typing import Any

import nibabel as nib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from voxflat.io.grid import Affine

_NAMES = ("sagittal", "coronal", "axial")
_OUTLINE = "#d62728"


def sections(white: NDArray[np.bool_], affine: Affine, template: NDArray[np.bool_] | None) -> Figure:
    """Draw sections through the middle of a mask, in RAS+, with the outline of a template on the same grid."""
    axes = nib.orientations.io_orientation(affine)  # type: ignore[no-untyped-call]
    turned = _turned(white, axes)
    other = None if template is None else _turned(template, axes)
    sizes = np.linalg.norm(affine[:3, :3], axis=0)[np.argsort(axes[:, 0])]
    places = np.argwhere(turned)
    middle = np.round(places.mean(axis=0)).astype(int) if len(places) else np.array(turned.shape) // 2
    figure = Figure(figsize=(9, 3.4), dpi=120, layout="constrained")
    for axis, (name, ax) in enumerate(zip(_NAMES, figure.subplots(1, 3), strict=True)):
        across, up = (other_axis for other_axis in range(3) if other_axis != axis)
        aspect = sizes[up] / sizes[across]
        ax.imshow(turned.take(middle[axis], axis).T, cmap="gray", vmin=0, vmax=1, origin="lower", aspect=aspect)
        if other is not None and (outline := other.take(middle[axis], axis).T).any():
            ax.contour(outline, [0.5], colors=_OUTLINE, linewidths=1)
        ax.set_title(name if axis == 0 else f"{name}, left on the left", fontsize=9)
        ax.set_axis_off()
    legend = "white: assumed white matter" + ("" if other is None else "; red: white matter of MNI152, best fit")
    figure.supxlabel(legend, fontsize=9)
    return figure


def _turned(mask: NDArray[np.bool_], axes: NDArray[Any]) -> NDArray[np.uint8]:
    turned = nib.orientations.apply_orientation(mask.astype(np.uint8), axes)  # type: ignore[no-untyped-call]
    return np.asarray(turned)
