"""The arrays of results are read-only: a result cannot be made to contradict the compiled core or its own figures."""

import copy
import inspect
import pickle

import numpy as np
import pytest

import voxflat
from voxflat.read_only import ReadOnly


@pytest.fixture(scope="module")
def results():
    hill = voxflat.samples.hill()
    flat_map = hill.flatten(voxflat.methods.Voxflat(sources=20), rows=True)
    atlas = hill.patches(15)
    glued = atlas.glue(1.6)
    cut = voxflat.surface(voxflat.samples.ball()).cut()
    worst = voxflat.worst_places(flat_map, 1, beyond=1.0001)
    rim = voxflat.rim(voxflat.samples.rim())
    series = voxflat.flatten_series([hill] * 2)
    compared = voxflat.compare(hill, {"a": flat_map}, sources=5)
    values = np.arange(len(hill), dtype=float)
    picture = np.zeros((8, 8, 3), dtype=np.uint8)
    return [
        *(
            hill,
            flat_map,
            flat_map.distortion,
            flat_map.distortion.triangles,
            flat_map.raster(),
            flat_map.image(values),
        ),
        *(
            flat_map.images(np.stack([values] * 2, axis=1)),
            flat_map.look_up(flat_map.uv[:3]),
            flat_map.textured(picture),
        ),
        *(atlas, atlas[0], atlas[0].plane, atlas.page(), glued, glued[0], glued.seams, cut, cut.cuts[0], cut.surface),
        *(worst, worst.places[0], worst.places[0].cut, rim, rim.profile(rim.thickness()), rim.columns(9)),
        *(
            series,
            compared,
            compared.maps["a"],
            hill.geodesic(5),
            hill.geodesic_matrix(),
            hill.path(0, 440),
            hill.check(),
            voxflat.samples.embryo(1),
        ),
        hill.check(),
        flat_map.regions({"a": flat_map.uv[[0, 20, 440]]}),
    ]


def arrays_of(result):
    """Yield the name and the value of each public attribute of a result that is an array."""
    for name in dir(result):
        if not name.startswith("_") and not callable(inspect.getattr_static(result, name)):
            try:
                value = getattr(result, name)
            except (AttributeError, voxflat.InputError):  # not known for this result
                continue
            if isinstance(value, np.ndarray):
                yield name, value


@pytest.mark.medium
def test_the_arrays_of_each_result_are_read_only(results):
    found = set()
    for result in results:
        for other in (result, copy.copy(result)):
            for name, array in arrays_of(other):
                found.add(f"{type(other).__name__}.{name}")
                assert not array.flags.writeable, f"{type(other).__name__}.{name}"
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 0
    assert {"Surface.points", "FlatMap.uv", "FlatImage.data", "DistanceRows.rows", "FlatAtlas.areal"} <= found
    assert len(found) > 70


@pytest.mark.medium
def test_each_public_class_with_arrays_is_read_only(results):
    public = {getattr(voxflat, name) for name in voxflat.__all__}
    classes = {one for one in public if inspect.isclass(one) and not issubclass(one, Exception | voxflat.Citation)}
    assert {one for one in classes if not issubclass(one, ReadOnly)} == set()
    assert {one for one in classes if not any(isinstance(result, one) for result in results)} == {
        voxflat.FlatMovie,
        voxflat.Registration,
    }


@pytest.mark.medium
def test_a_map_from_another_process_is_read_only(results):
    assert results[1].look_up(results[1].uv[:1]).face_ids[0] >= 0  # prepared values are not copied
    flat_map = pickle.loads(pickle.dumps(results[1]))
    assert not flat_map.uv.flags.writeable
    np.testing.assert_array_equal(flat_map.uv, results[1].uv)


def test_the_arrays_of_the_user_stay_writeable():
    points, faces = voxflat.samples.hill().points.copy(), voxflat.samples.hill().faces.copy()
    given = voxflat.surface((points, faces), pial=(points + np.array([0, 0, 1.0]), faces))
    assert given.thickness is not None
    points[0], faces[0] = 7.0, faces[0]
    assert given.points[0, 0] != 7.0


def test_other_tools_get_arrays_that_they_may_write(results):
    pytest.importorskip("pyvista")
    from voxflat._pyvista import to_surface_polydata

    flat_map = results[1]
    for mesh in (flat_map.to_pyvista(), to_surface_polydata(flat_map)):
        before = flat_map.uv.copy(), flat_map.points.copy(), flat_map.ids.copy(), flat_map.torn.copy()
        mesh.points[:] = 0
        for data in (mesh.point_data, mesh.cell_data):
            for name in data:
                data[name][:] = 0
        for old, new in zip(before, (flat_map.uv, flat_map.points, flat_map.ids, flat_map.torn), strict=True):
            np.testing.assert_array_equal(old, new)
