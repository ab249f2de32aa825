"""The tasks of *Cortical depth*, which run in another thread."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._napari.layers.foreground import rim_of
from voxflat._napari.layers.sampled import Sampled
from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.results.flat_layers import STACK, LayerData, limits, unit_of_map
from voxflat.arguments import Progress
from voxflat.errors import Cancelled, InputError
from voxflat.laminar.profile import Profile
from voxflat.maps.flat_map import FlatMap

_FEWEST, _MOST = 3, 20  # automatic layers


def _counted(
    layers: dict[str, Any], thickness: NDArray[np.floating], of: LayerVolume, unit: str = ""
) -> dict[str, Any]:
    """Return the layers with their number: by default, one per voxel of the median thickness, within limits."""
    if layers["count"] is not None:
        return layers
    volume = of.lazily()
    voxels = np.nanmedian(thickness) / np.mean(volume.in_unit(unit or volume.unit).spacing)
    return {**layers, "count": int(np.clip(np.round(voxels), _FEWEST, _MOST))}


def divide_into_layers(rim: tuple[LayerVolume, str], layers: dict[str, Any], progress: Progress) -> NDArray[np.integer]:
    """Return the layer of each voxel."""
    whole = rim_of(*rim, progress)
    return np.asarray(whole.layers(**_counted(layers, whole.values.thickness, rim[0])).data)


def divide_into_columns(rim: tuple[LayerVolume, str], area: float, progress: Progress) -> NDArray[np.integer]:
    """Return the column of each voxel; `area` is the mean area of a column in mm²."""
    return np.asarray(rim_of(*rim, progress).columns(area=area, progress=progress).volume.data)


def flat_volume(flat_map: FlatMap, shown: Sampled, layers: dict[str, Any], progress: Progress) -> LayerData:
    """Return a layer (depth, row, column) with a volume in the middle of each layer of a map."""
    assert flat_map.white_points is not None
    assert flat_map.pial_points is not None
    thickness = np.linalg.norm(flat_map.pial_points - flat_map.white_points, axis=1)
    layers = _counted(layers, thickness, shown.volume, unit_of_map(flat_map))
    count = layers["count"]
    look = {"interpolation": "nearest" if shown.kind == "labels" else "linear", "layering": layers["layering"]}
    stack = flat_map.images(shown.volume.lazily(), depths=count, **look)
    images = []
    for k in range(count):
        if progress("sampling the volume", k, count) is False:
            raise Cancelled("cancelled while sampling the volume")
        images.append(stack[k])
    if images[0].is_colour:
        raise InputError(f"Layer '{shown.name}' contains colours. Choose a layer with one value per voxel")
    data = np.stack([image.data for image in images])
    (u, v), size = stack.origin, stack.pixel_size
    about = {"voxflat": flat_map, STACK: stack}
    units = ("pixel", *(unit_of_map(flat_map),) * 2)  # the depth is a share of the thickness
    place = {"metadata": about, "units": units, "scale": (1 / count, size, size), "translate": (0.5 / count, -v, u)}
    keywords = {**shown.display, "name": f"{shown.name} flattened", "axis_labels": ("depth", "−v", "u"), **place}
    if shown.kind == "labels":
        return np.nan_to_num(data).astype(np.int64), keywords, "labels"
    keywords.setdefault("contrast_limits", limits(data))
    return data.astype(np.float32), keywords, "image"


def profile(
    rim: tuple[LayerVolume, str],
    shown: Sampled,
    region: LayerVolume | None,
    layers: dict[str, Any],
    progress: Progress,
) -> tuple[Profile, Any]:
    """Return the profile of a volume, and its picture."""
    from matplotlib.figure import Figure

    regions = None if region is None else region.read()
    whole = rim_of(*rim, progress)
    layers = _counted(layers, whole.values.thickness, rim[0])
    means = whole.profile(shown.volume.lazily(), regions=regions, **layers)
    figure = Figure(layout="constrained")
    if region is not None:
        means = replace(means, names=tuple(f"region {name}" for name in means.names))
    means.plot(label=shown.name, ax=figure.subplots())
    return means, figure
