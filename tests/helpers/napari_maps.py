"""Maps in layers of napari."""

from dataclasses import replace

import composed
from numpy.testing import assert_array_equal

from voxflat._napari.map_viewer.prepared_map import PreparedMap
from voxflat._napari.results.flat_layers import Run
from voxflat._napari.results.maps import map_layers


def same_map(layer, expected):
    """Whether a layer has exactly this map."""
    flat_map = layer.metadata["voxflat"]
    for name in ("uv", "points", "ids", "faces", "sources", "eigenvalues"):
        assert_array_equal(getattr(flat_map, name), getattr(expected, name))
    assert_array_equal(flat_map.distortion.per_point, expected.distortion.per_point)
    own = {name: flat_map.metadata[name] for name in ("napari", "provenance")}  # calls differ, by Volume or by array
    assert flat_map.metadata == {**expected.metadata, **own}


def prepared_map_of(points, faces, **how):
    flat_map = composed.flatten((points, faces), sources=20, **how)
    origin = {"layer": "it", "world_axes": "RAS", "unit": "millimeter"}
    flat_map = replace(flat_map, metadata={**flat_map.metadata, "napari": origin})
    return PreparedMap.of(Run(map_layers(flat_map, "it"), "it"))
