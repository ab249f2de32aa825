"""Maps in layers of napari."""

from numpy.testing import assert_array_equal


def same_map(layer, expected):
    """Whether a layer has exactly this map."""
    flat_map = layer.metadata["voxflat"]
    for name in ("uv", "points", "ids", "faces", "sources", "eigenvalues"):
        assert_array_equal(getattr(flat_map, name), getattr(expected, name))
    assert_array_equal(flat_map.distortion.per_point, expected.distortion.per_point)
    own = {name: flat_map.metadata[name] for name in ("napari", "provenance")}  # calls differ, by Volume or by array
    assert flat_map.metadata == {**expected.metadata, **own}
