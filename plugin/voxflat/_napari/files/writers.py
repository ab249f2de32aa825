"""Writers of complete flat maps, of flat images, of labels in the volume, and of regions on a mesh."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from napari import current_viewer
from napari.layers import Labels, Layer
from napari.utils.notifications import show_info
from numpy.typing import NDArray

from voxflat._napari.layers.volumes import LayerVolume
from voxflat._napari.layers.world import WORLD, unit_ratio
from voxflat._napari.map_viewer.drawings import OF_MAP, depths_of_regions, reach
from voxflat._napari.map_viewer.segmentations import REMEDY, Segmentation
from voxflat._napari.notifications import showing_warnings
from voxflat._napari.results.flat_layers import IMAGE, KEPT, MOVIE, STACK, LayerData, in_unit_of, unit_of_map
from voxflat._napari.results.outputs import is_painted
from voxflat._napari.stacks import world_of
from voxflat._napari.viewer_state import ViewerState
from voxflat._napari.wording import error_text
from voxflat.atlases.atlas import Atlas
from voxflat.errors import InputError, VoxflatError
from voxflat.io.channels import Channels
from voxflat.io.volumes import write_volume
from voxflat.maps.flat_map import MAP_ENDINGS, FlatMap
from voxflat.maps.image_files import IMAGE_ENDINGS
from voxflat.maps.raster import FlatImage, FlatStack
from voxflat.maps.regions import TABLE_ENDINGS, VERTEX_ENDINGS, Regions
from voxflat.pipeline.flat_movie import FlatMovie

_VOXEL_ENDINGS = (".nii", ".nii.gz")

Written: TypeAlias = Any  # list[str], which napari's commands cannot compare with classes on Python 3.10


def write_flat_map(path: str | None = None, layers: Sequence[LayerData] = ()) -> Written:
    """Save the flat map or atlas to which layers belong.

    Without a path (from napari's command palette), ask for a file and save the selected layers. Raises VoxflatError
    if the layers do not belong to exactly one map, or if the file format cannot store it.
    """
    if path is None:
        return _ask("Save a flat map", MAP_ENDINGS)
    with _reporting_errors():
        found, viewer = _map_of(layers), current_viewer()
        if viewer is None:
            found.save(path)
        else:
            ViewerState.of(viewer).save(found, path)
    return [path]


def write_flat_image(path: str | None = None, layers: Sequence[LayerData] = ()) -> Written:
    """Save the image of one layer of a map or page, or labels painted on it, in the same way as `write_flat_map`.

    Volumes, such as regions and layers of depth, are saved with the position of their voxels.
    """
    if path is None:
        return _ask("Save a flat image", IMAGE_ENDINGS)
    with _reporting_errors():
        if any(map(_is_volume, layers)):
            _save_volume(path, layers)
        else:
            _image_of(layers).save(path)
    if path.lower().endswith((".tif", ".tiff")):
        show_info(f"napari opens {Path(path).name} as an image in pixels, without its position. Use .nii.gz to keep it")
    return [path]


def write_regions(path: str | None = None, layers: Sequence[LayerData] = ()) -> Written:
    """Save regions or labels drawn on a map: a table, vertices of a mesh, or voxels through the cortex."""
    if path is None:
        return _ask("Save regions", (*VERTEX_ENDINGS, *_VOXEL_ENDINGS, *TABLE_ENDINGS))
    with _reporting_errors():
        if len(layers) != 1:
            raise InputError("Regions are saved one layer at a time. Select one layer with regions of a map")
        is_voxels = path.lower().endswith(_VOXEL_ENDINGS)
        if is_voxels and OF_MAP in layers[0][1]["metadata"] and _is_volume(layers[0]):
            _save_volume(path, layers)
            return [path]
        regions = _regions_of(layers[0])
        if is_voxels:
            _save_voxels(path, regions)
        else:
            regions.save(path, overwrite=True)
    return [path]


def _save_voxels(path: str, regions: Regions) -> None:
    """Save regions in the volume that was flattened, and tell their depths."""
    flat_map, viewer = regions.of, current_viewer()
    if not isinstance(flat_map, FlatMap) or not flat_map.is_voxels:
        raise InputError(f"The map of a mesh has no voxels. Save its regions as {', '.join(VERTEX_ENDINGS)}")
    runs = () if viewer is None else ViewerState.of(viewer).runs
    is_movie = any(run.flat_map is flat_map and run.layers.movie is not None for run in runs)
    depths = depths_of_regions(flat_map, movie=is_movie)
    regions.save(path, depth=depths, overwrite=True)
    show_info(f"Saved the regions in the volume {reach(flat_map, depths)}")


def _regions_of(data: LayerData) -> Regions:
    """Return the regions that were drawn, or of labels that were painted over a map."""
    values, keywords, kind = data
    viewer, found = current_viewer(), keywords["metadata"].get(OF_MAP)
    if found is None and kind == "labels":
        flat_map = _map_under(data)
        if not isinstance(flat_map, FlatMap):
            raise InputError("Regions need a flat map, not a page of patches. Use Flatten surface instead")
        return Segmentation.of(Labels(values, **keywords)).regions(flat_map, None)
    if found is None:
        raise InputError(f"Layer '{keywords['name']}' contains no regions. Select a layer with regions of a map")
    if viewer is not None and is_painted(viewer.layers[keywords["name"]]):
        raise InputError(f"The values of '{keywords['name']}' were changed. Draw the regions on the map again")
    return found  # type: ignore[no-any-return]  # metadata are Any


def _map_under(data: LayerData) -> FlatMap | Atlas:
    """Return the map that a flat layer shows, or on whose pixels a layer of the user lies."""
    values, keywords, _ = data
    found: FlatMap | Atlas | None = keywords["metadata"].get("voxflat")
    if found is not None:
        return found
    viewer, name = current_viewer(), keywords["name"]
    if viewer is None or np.ndim(values) != 2:
        raise InputError(f"Layer '{name}' does not lie on a flat map. Select a layer on a flattened image")
    state = ViewerState.of(viewer)
    run = state.run_under(viewer.layers[name])
    if run is None:
        maps = ", ".join(f"'{one.title}'" for one in state.runs) or "none"
        raise InputError(f"The pixels of '{name}' are not those of an open map ({maps}). {REMEDY}")
    return run.flat_map


def _is_volume(data: LayerData) -> bool:
    """Return whether a layer is a volume, neither an image of a map nor labels from the window of a movie."""
    _, keywords, kind = data
    is_own = not {"voxflat", KEPT}.isdisjoint(keywords["metadata"])
    return kind in ("image", "labels") and not is_own and Layer.create(*data).ndim > 2


def _save_volume(path: str, layers: Sequence[LayerData]) -> None:
    """Save labels or an image in space, in RAS+ mm."""
    if len(layers) != 1:
        raise InputError(f"{len(layers)} layers are selected. Select exactly one volume")
    layer, viewer = Layer.create(*layers[0]), current_viewer()
    if path.lower().endswith(".png"):
        raise InputError(f"Layer '{layer.name}' contains voxels with a position in space. Save it as .nii.gz")
    world = layer.metadata.get(WORLD)
    if world is None:
        world = "RAS" if viewer is None else world_of(viewer, viewer.layers[layer.name])
    volume = LayerVolume.of(layer, world).read()
    write_volume(path, volume.data, volume.in_unit("mm").affine, has_unit=str(layer.units[-1]) != "pixel")


def _ask(title: str, endings: Sequence[str]) -> list[str]:
    from qtpy.QtWidgets import QFileDialog

    viewer = current_viewer()
    path, _ = QFileDialog.getSaveFileName(None, title, "", " ".join(f"*{ending}" for ending in endings))
    return list(viewer.layers.save(path, selected=True, plugin="voxflat")) if viewer is not None and path else []


@contextmanager
def _reporting_errors() -> Iterator[None]:
    """Raise errors in the words of the window, as VoxflatError: napari does not report InputError, a ValueError."""
    try:
        with showing_warnings():
            yield
    except (VoxflatError, OSError) as error:
        raise VoxflatError(error_text(error)) from error


def _map_of(layers: Sequence[LayerData]) -> FlatMap | Atlas:
    maps = {id(flat_map): flat_map for _, keywords, _ in layers if (flat_map := keywords["metadata"].get("voxflat"))}
    if not maps:
        remedy = "Select a layer of a flat map. Save labels and volumes as 'voxflat flat image' or 'voxflat regions'"
        raise InputError(f"The selected layers do not belong to a flat map. {remedy}")
    if len(maps) > 1:
        raise InputError(f"The selected layers belong to {len(maps)} flat maps. Select layers of one map")
    return next(iter(maps.values()))  # type: ignore[no-any-return]  # metadata are Any


def _image_of(layers: Sequence[LayerData]) -> FlatImage | FlatStack | FlatMovie:
    """Return the image, flat volume or flat movie of a layer, with its position on the map."""
    images = [layer for layer in layers if layer[2] in ("image", "labels")]
    if len(images) != 1:
        raise InputError(f"{len(images)} flat images are selected. Select exactly one")
    data, keywords, kind = images[0]
    flat_map = _map_under(images[0])
    stack: FlatStack | None = keywords["metadata"].get(STACK)
    if stack is not None:
        values = np.asarray(data, dtype=np.float32)
        values = np.where(values == 0, np.float32(np.nan), values) if kind == "labels" else values
        return replace(stack, channels=Channels(stack.channels.names, values.__getitem__))
    if (frame := keywords["metadata"].get(MOVIE)) is not None:
        return _movie_of(np.asarray(data), frame, kind == "labels")
    layer = Layer.create(*images[0])
    ratio = unit_ratio(layer.units, (unit_of_map(flat_map),) * 2)
    height, width = (layer.scale * ratio).tolist()
    if not np.isclose(height, width, rtol=1e-6, atol=0):
        size = in_unit_of(flat_map, f"{height:g} x {width:g} mm")
        raise InputError(f"The pixels of '{layer.name}' are not square ({size}). Set equal scales for both axes")
    down, u = (layer.translate * ratio).tolist()
    is_labels, pixels = kind == "labels", np.asarray(data)
    if keywords.get("rgb"):
        pixels = _with_opacity(pixels)
    elif is_labels:
        pixels = np.where(pixels == 0, np.nan, pixels.astype(np.float64))  # 0 means no label, or outside the map
    made: FlatImage | None = keywords["metadata"].get(IMAGE)
    record = flat_map.provenance if made is None else made.provenance
    return FlatImage(pixels, width, (u, -down), layer.name, is_labels, record, flat_map.origin.named_unit)


def _movie_of(data: NDArray[Any], frame: FlatStack, is_labels: bool) -> FlatMovie:
    """Return the movie of an array (frame, row, column)."""
    values = np.where(data == 0, np.nan, data.astype(np.float64)) if is_labels else data

    def read(number: int) -> FlatStack:
        return replace(frame, channels=replace(frame.channels, read=lambda _: values[number]))

    about: dict[str, Any] = {"timing": frame.channels.timing, "provenance": frame.provenance}
    return FlatMovie(len(values), read, lambda _: None, frame.pixel_size, frame.name, ("",), **about)


def _with_opacity(colours: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours with an opacity channel, like those of `FlatImage`."""
    whole = np.round(255 * colours).astype(np.uint8) if colours.dtype.kind == "f" else colours.astype(np.uint8)
    if whole.shape[-1] == 4:
        return whole
    return np.concatenate([whole, np.full((*whole.shape[:2], 1), 255, dtype=np.uint8)], axis=2)
