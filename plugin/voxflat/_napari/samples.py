"""Sample data: a patch of human cortex to flatten."""

from __future__ import annotations

import numpy as np

from voxflat._napari.layers.seed import MARKER
from voxflat._napari.results.flat_layers import LayerData


def demo_cortex() -> list[LayerData]:
    """Open the MNI152 template: T1, white matter, and a seed point on the central cortex.

    Returns
    -------
    list of LayerData
        In mm, RAS+.
    """
    from voxflat.demo import SEED_POINT, THRESHOLD, demo_cortex

    white_matter, t1, _ = demo_cortex()
    labels = np.asarray(white_matter.data > THRESHOLD, dtype=np.uint8)
    place = {"affine": white_matter.affine, "units": ("mm", "mm", "mm")}
    return [
        (t1.data, {"name": "T1", "affine": t1.affine, "units": place["units"]}, "image"),
        (labels, {"name": "white matter", **place}, "labels"),
        ([SEED_POINT], {**MARKER, **place}, "points"),
    ]
