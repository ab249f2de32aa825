"""Rows that a map keeps are those that it was made of: measured once, and as `voxflat.geodesic` measures them."""

from dataclasses import replace

import composed
import numpy as np
import pytest
import shapes
from triangle_meshes import bump

import voxflat
from voxflat.methods import grossmann2002, method

METHODS = {
    "links": ({"sources": 60}, "graph"),
    "exact": ({"sources": 40, "geodesic": "exact"}, "exact"),
    "marching": ({"sources": 40, "geodesic": "marching"}, "marching"),
    "zigelman2002": ({"method": "zigelman2002", "sources": 60}, "marching"),
    "schwartz1989": ({"method": "schwartz1989", "sources": 30, "starts": 1}, "exact"),
    "grossmann2002": ({"method": "grossmann2002", "sources": 60}, "chain"),
}


class Watched:
    """The core's surface, with the names of what was called of it."""

    def __init__(self, core, called):
        self._core, self._called = core, called

    def __getattr__(self, name):
        self._called.append(name)
        return getattr(self._core, name)

    def __len__(self):
        return len(self._core)


@pytest.fixture
def called(monkeypatch):
    """The names of what methods call of the core's surface."""
    names = []

    def cut_out(*args, **options):
        cut = cut_it_out(*args, **options)
        return replace(cut, part=replace(cut.part, core=Watched(cut.part.core, names)))

    def voxel_graph(*args, **options):
        graph = graph_of(*args, **options)
        return replace(graph, core=Watched(graph.core, names))

    cut_it_out, graph_of = method.cut_open, grossmann2002.voxel_graph
    monkeypatch.setattr(method, "cut_open", cut_out)
    monkeypatch.setattr(grossmann2002, "voxel_graph", voxel_graph)
    return names


def source(name):
    return shapes.sheet((30, 24)) if name == "grossmann2002" else bump(20)


@pytest.mark.slow
@pytest.mark.parametrize("name", METHODS)
def test_rows_are_measured_once_and_the_map_is_the_same(name, called):
    options, geodesic = METHODS[name]
    plain = composed.flatten(source(name), **options)
    del called[:]
    kept = composed.flatten(source(name), **options, rows=True)
    assert {"voxflat", "grossmann2002", "zigelman2002", "schwartz1989"} & set(called)
    assert "rows" not in called
    assert plain.rows is None
    assert kept.rows.shape == (len(kept.sources), len(kept))
    np.testing.assert_array_equal(kept.uv, plain.uv)
    assert kept.metadata["memory_need_bytes"] > plain.metadata["memory_need_bytes"]
    measured = voxflat.surface(source(name)).geodesic(kept.ids[kept.sources], geodesic=geodesic)
    np.testing.assert_array_equal(kept.rows, measured.rows)


@pytest.mark.parametrize("sources", [60, 149, 400])
def test_whatever_way_distances_are_measured(sources):
    volume = shapes.sheet((60, 50))  # for judging there are 200 more: of 60 and 149 sources alone they go another way
    flat = voxflat.flatten(volume, method=voxflat.methods.Grossmann2002(sources=sources), rows=True)
    measured = voxflat.surface(volume).geodesic(flat.ids[flat.sources], geodesic="chain")
    np.testing.assert_array_equal(flat.rows, measured.rows)
