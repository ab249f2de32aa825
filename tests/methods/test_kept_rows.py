"""A map keeps the rows from which it was made, in memory or in a store."""

import composed
import numpy as np
import pytest
import shapes
from triangle_meshes import bump

import voxflat
from voxflat.distances.table import Table

METHODS = {
    "links": ({"sources": 60}, "graph"),
    "exact": ({"sources": 40, "geodesic": "exact"}, "exact"),
    "marching": ({"sources": 40, "geodesic": "marching"}, "marching"),
    "zigelman2002": ({"method": "zigelman2002", "sources": 60}, "marching"),
    "schwartz1989": ({"method": "schwartz1989", "sources": 30, "starts": 1}, "exact"),
    "grossmann2002": ({"method": "grossmann2002", "sources": 60}, "chain"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_kept_rows_are_those_of_geodesic_and_the_map_is_the_same(name, tmp_path):
    options, geodesic = METHODS[name]
    source = shapes.sheet((30, 24)) if name == "grossmann2002" else bump(20)
    plain = composed.flatten(source, **options)
    kept = composed.flatten(source, **options, rows=True)
    assert plain.rows is None
    assert kept.rows.shape == (len(kept.sources), len(kept))
    np.testing.assert_array_equal(kept.uv, plain.uv)
    assert kept.metadata["memory_need_bytes"] > plain.metadata["memory_need_bytes"]
    measured = voxflat.surface(source).geodesic(kept.ids[kept.sources], geodesic=geodesic)
    np.testing.assert_array_equal(kept.rows, measured.rows)
    if name not in ("zigelman2002", "schwartz1989"):  # which know no store
        stored = composed.flatten(source, **options, rows=tmp_path / "store")
        np.testing.assert_array_equal(stored.uv, plain.uv)
        assert stored.distortion.figures() == plain.distortion.figures()
        assert isinstance(stored.rows, Table)
        np.testing.assert_array_equal(stored.rows, kept.rows)
        np.testing.assert_array_equal(voxflat.open_rows(stored.metadata["store"]).sources, stored.sources)


@pytest.mark.medium
@pytest.mark.parametrize("sources", [60, 149, 400])
def test_whatever_way_distances_are_measured(sources):
    volume = shapes.sheet((60, 50))  # for judging there are 200 more: of 60 and 149 sources alone they go another way
    flat = composed.flatten(volume, method="grossmann2002", sources=sources, rows=True)
    measured = voxflat.surface(volume).geodesic(flat.ids[flat.sources], geodesic="chain")
    np.testing.assert_array_equal(flat.rows, measured.rows)
