"""Arguments of the wrong kind cause a one-line error that names the argument and its value."""

import inspect
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refused, warnings_as_errors

import voxflat
from voxflat import figures, io
from voxflat.arguments import checked_instance, checked_limit, checked_number, checked_path, shown
from voxflat.methods import Voxflat

VOLUME = np.pad(np.ones((8, 8, 1), np.uint8), [(0, 0), (0, 0), (2, 2)])
ROW, COLUMN = np.mgrid[:6, :6].reshape(2, -1)
POINTS = np.column_stack([5.0 * ROW, 5.0 * COLUMN, np.zeros(36)])
CORNER = np.flatnonzero((ROW < 5) & (COLUMN < 5))[:, None]
FACES = np.concatenate([CORNER + np.array(corners) for corners in ([0, 6, 1], [1, 6, 7])])

VALUES = np.arange(36.0)
ARRAY = np.zeros(3)
LONG = np.broadcast_to(np.uint8(0), (2**31, 1, 1))
SQUARE = [[1.0, 1], [1, 20], [20, 20], [20, 1]]


def test_paths_of_all_kinds_stay():
    assert checked_path("a/b") == checked_path(Path("a/b")) == Path("a/b")
    assert checked_path("\udcff") == Path("\udcff")  # bytes that are not UTF-8
    assert checked_path(".") == Path()


def test_whole_numbers_that_no_float_holds_are_infinite():
    assert checked_number(10**400, "depth") == np.inf
    assert checked_number(-(10**400), "depth") == -np.inf
    assert checked_number(2**62, "depth") == 2.0**62


def test_a_limit_is_positive_and_finite():
    for limit in (float("nan"), float("inf"), "x", np.ones((9, 9)), 0, -5):
        refused(r"^the memory limit is [^\n]*. Pass a number of bytes$", checked_limit, limit)


def test_values_are_shown_on_one_short_line():
    assert "\n" not in shown(np.ones((99, 99)))
    assert shown("x" * 999) == "'" + 75 * "x" + " ..."
    assert shown(10**9999) == "a number of the type int"
    checked_instance([], list, "list", "a list")
    refused(r"^the list is 3. Pass a list$", checked_instance, 3, list, "list", "a list")


@pytest.fixture(scope="module")
def of_mesh():
    return voxflat.surface((POINTS, FACES))


CALLS = {
    "read_volume": (lambda s: io.read_volume(1j), "path is 1j"),
    "read_mesh": (lambda s: io.read_mesh("a\0b"), "path is 'a.x00b'"),
    "load": (lambda s: voxflat.load(np.ones((2, 2, 2))), "of type ndarray, but only a mesh can be loaded"),
    "figures": (lambda s: figures.heat_maps({}), "comparison is {}. Pass a Comparison"),
    "save": (lambda s: figures.save([1], "x.png"), r"figure is \[1\]. Pass a Matplotlib figure"),
    "in_patch": (lambda s: s._in_patch(np.arange(3)), "patch is array.*. Pass a Patch"),
    "nearest": (lambda s: s.nearest((0, 0, 2)), "a surface from a mesh has no voxels"),
    "no voxel": (lambda s: voxflat.surface(VOLUME).nearest("x"), "voxel are 'x'. Pass numbers"),
    "page": (lambda s: voxflat.map_page(3), "flat map is 3. Pass a FlatMap"),
    "border": (lambda s: io.patch_border(FACES, [0], "64"), "number of points is '64'"),
    "points of a border": (lambda s: io.patch_border(FACES, [0], 10**25), "memory is needed"),
    "method": (lambda s: voxflat.flatten(s, method=np.ma.masked_array([1, 2], [1, 0])), "method is masked_array"),
    "solver": (lambda s: s.geodesic(9, geodesic=ARRAY), "geodesic is array.*. Pass 'graph', 'marching'"),
    "solver of a map": (lambda s: voxflat.flatten(s, method=Voxflat(geodesic=ARRAY)), "geodesic is array"),
    "way": (lambda s: s.path(0, 9, geodesic=ARRAY), "geodesic is array.*'edges' or 'chain'"),
    "stops": (lambda s: s.path(0, (0, 0, 2)), r"the stops are \(0, \(0, 0, 2\)\). Pass rows of equal length"),
    "sampling": (lambda s: s.geodesic(9, sampling=1e19), r"sampling is 1e\+19. Pass 'farthest', 'curvature'"),
    "no sampling": (lambda s: s.geodesic(9, sampling=None), "sampling is None. Pass"),
    "no sources": (lambda s: s.geodesic(None), "no sources are given. Pass the number of sources, or points"),
    "seeds": (lambda s: s.patches(5, seeds=ARRAY), "seeds is array.*. Pass 'curvature', 'flattest' or"),
    "side": (lambda s: s.register(side=ARRAY), "side is array.*. Pass 'left' or 'right'"),
    "mirror": (lambda s: voxflat.flatten(s, mirror=ARRAY), "mirror is array.*. Pass True or False"),
    "unit": (lambda s: voxflat.surface(VOLUME, unit={1, 2}), r"unit is \{1, 2\}. Pass one of mm, cm"),
    "cuts of a volume": (lambda s: voxflat.surface(VOLUME).cut(cuts=ARRAY), "cut 1: the path must be voxel indices"),
    "label": (lambda s: io.read_region("lh.annot", 9, name=ARRAY), "name of a label is array.*. Pass a string"),
    "rows": (lambda s: voxflat.flatten(s, rows=ARRAY), "rows is array.*. Pass True or False"),
    "maps": (lambda s: voxflat.compare(s, [1, [2, 3]]), r"maps is \[1, \[2, 3\]\]. Pass a dict of maps, keyed by name"),
    "map": (lambda s: voxflat.compare(s, {"a": [1, [2, 3]]}), r"places are \[1, \[2, 3\]\]. Pass rows of equal length"),
    "reference": (lambda s: voxflat.measure(s, POINTS[:, :2], reference=ARRAY), "reference is array"),
    "name": (lambda s: voxflat.measure(s, "\ud800"), "the path is"),
    "on surface": (lambda s: voxflat.measure(s, POINTS[:, :2], on_surface="no"), "on_surface is 'no'. Pass True"),
    "sources": (lambda s: voxflat.measure(s, POINTS[:, :2], sources=ARRAY), "sources is array"),
    "threads": (lambda s: voxflat.surface(VOLUME, threads=np.array("x")), "threads is array"),
    "repair": (lambda s: voxflat.surface(VOLUME, repair=np.ma.masked_array([1, 2], [1, 0])), "repair is masked_array"),
    "smoothing": (lambda s: s.mean_curvature(smoothing=None), "smoothing is None. Pass a length"),
    "flow": (lambda s: s.sulcal_depth(flow=None), "flow is None. Pass a positive number"),
    "bridges": (lambda s: s._bridges(3), "faces have data type int64 and shape"),
    "jump": (lambda s: voxflat.range_image(np.eye(9), 1.0, jump=np.ones((9, 9))), "jump is array"),
    "steps": (lambda s: voxflat.range_image(np.eye(9), spacing=([1], 1, 2)), "spacings are .*. Pass rows"),
    "spacing": (lambda s: voxflat.surface(VOLUME, spacing=np.full((9, 9), "x")), "spacing is array.* Pass 3 positive"),
    "values of a volume": (lambda s: io.Volume([1, [2, 3]], np.eye(4)), r"values are \[1, \[2, 3\]\]. Pass rows"),
    "a long volume": (lambda s: io.Volume(LONG, np.eye(4)), "has an axis of more than 2147483647 voxels"),
    "volume of one number": (lambda s: io.Volume(2**64, np.eye(4)), "values have data type object. Convert"),
    "geometry": (lambda s: io.VolumeGeometry(np.eye(3), np.zeros(3), shape=1.5), "shape is 1.5 .* Pass 3-tuples"),
    "texture": (lambda s: io.Mesh(POINTS, FACES, texture_coordinates=b"x"), "coordinates are b'x'. Pass numbers"),
    "point data": (lambda s: io.Mesh(POINTS, FACES, point_data=ARRAY), "point data is array.*. Pass arrays by"),
    "face data": (lambda s: io.Mesh(POINTS, FACES, face_data={"a": 3}), "face data 'a' has 0 values, .* has 50"),
    "entries": (lambda s: io.Patch([1, [2, 3]], POINTS[:3], np.ones(3)), "the vertices are .*Pass rows"),
    "mask": (lambda s: io.Patch([1, 2], POINTS[:2], [1, [2, 3]]), "entries of the border are .*Pass numbers"),
    "not a picture": (lambda s: figures.save_picture(ARRAY, "x.png"), r"\(3,\) and data type float64. Pass a uint8"),
    "record": (lambda s: figures.save_picture(np.zeros((4, 4, 3), np.uint8), "x.png", ARRAY), "record array.* JSON"),
    "cuts of numbers": (lambda s: voxflat.flatten(s, cuts=ARRAY), "cut"),
    "cuts": (lambda s: voxflat.flatten(s, cuts=np.array("x")), "cuts has type ndarray. Pass a list of paths"),
    "number of a cut": (lambda s: s.cut(relax=False).title(0), "cut number is 0, but there are 0"),
    "numbers of a cut": (lambda s: s.cut(relax=False).title(ARRAY), "cut number is array.*, but there are"),
    "flat map": (lambda s: figures.flat_map(1), "flat map is 1. Pass a FlatMap"),
    "movie": (lambda s: figures.movie(1e19, VOLUME), r"flat map is 1e\+19. Pass a FlatMap"),
    "atlas": (lambda s: figures.atlas_3d("x"), "atlas is 'x'. Pass an atlas"),
}

ON_MAPS = {
    "atlas as a map": (lambda m, a: figures.heat_map(a), "flat map is <.*. Pass a FlatMap"),
    "packing": (lambda m, a: a.page(packing=ARRAY), "packing is array.*. Pass 'boxes' or 'shapes'"),
    "figure": (lambda m, a: a.heat_map(of=["a"]), r"of is \['a'\]. Pass 'isometric', "),
    "heat map": (lambda m, a: m.heat_map(of="x"), "of is 'x'. Pass 'distances' or 'spread'"),
    "name": (lambda m, a: m.image(VALUES, name=ARRAY), "the name is array.*. Pass a string"),
    "projection": (lambda m, a: m.images(VALUES, projection=ARRAY), "projection is array"),
    "layering": (lambda m, a: m.image(VALUES, layering=ARRAY), "layering is array.*. Pass 'equivolume' or"),
    "depth": (lambda m, a: m.image(VALUES, depth=[0.0, [1.0]]), r"depth is \[1.0\]. Pass a number"),
    "depth of no length": (lambda m, a: m.image(VALUES, depth=np.array(1.0)), r"depth is array\(1\.\). Pass a"),
    "depths of no length": (
        lambda m, a: m.regions({"a": SQUARE}).volume(io.Volume(VOLUME, np.eye(4)), depth=np.array(3.0)),
        r"depth is array\(3\.\). Pass two distances",
    ),
    "no depth": (lambda m, a: m.image(VALUES, depth=[0.0, None]), "depth is None. Pass a number"),
    "interpolation": (lambda m, a: m.image(VALUES, interpolation=ARRAY), "interpolation is array"),
    "phases": (lambda m, a: m.image(VALUES, interpolation=ARRAY, period=3), "interpolation is array"),
    "overlay": (lambda m, a: m.image([1, [2, 3]]), r"overlay's values are \[1, \[2, 3\]\]. Pass rows of equal length"),
    "channel": (lambda m, a: m.images(VALUES, channel=np.ones((2, 2))), "channel is array"),
    "texel size": (lambda m, a: m.textured(np.eye(4), texel_size="1"), "texel_size is '1' mm. Pass"),
    "texels": (lambda m, a: m.textured(np.eye(4), texel_size=[[]]), r"texel_size is \[\[\]\] mm. Pass a positive"),
    "repeat": (lambda m, a: m.textured(np.eye(4), repeat=ARRAY), "repeat is array.*. Pass True or False"),
    "tolerance": (lambda m, a: m.textured(np.eye(4)).subdivided(tolerance=[1]), r"tolerance is \[1\]. Pass a"),
    "sidecar": (lambda m, a: m.save("x.npz", sidecar=ARRAY), "sidecar is array.*. Pass True or False"),
    "paint": (lambda m, a: m.paint([1, [2, 3]]), r"the values are \[1, \[2, 3\]\]. Pass rows of equal length"),
    "background": (lambda m, a: m.paint(VALUES, background=1j), "background is 1j. Pass a number"),
    "None as background": (lambda m, a: m.paint(VALUES, background=None), "background is None. Pass a number"),
    "large background": (lambda m, a: m.paint(VALUES.astype(int), background=2**64), "is 18446744073709551616, which"),
    "half a background": (lambda m, a: m.paint(VALUES > 3, background=0.5), "is 0.5, which bool cannot hold"),
    "long background": (lambda m, a: m.paint(VALUES, background=10**400), r"is 10+ \.\.\., which float64 cannot hold"),
    "infinite background": (lambda m, a: m.paint(VALUES.astype("f4"), background=1e39), "which float32 cannot hold"),
    "no background": (lambda m, a: m.paint(VALUES.astype("u1"), background=np.nan), "is nan, which uint8 cannot hold"),
    "number of places": (lambda m, a: voxflat.worst_places(m, np.ones((9, 9))), "count is array.*. Pass the maximum"),
    "no factor": (lambda m, a: voxflat.worst_places(m, beyond=None), "beyond is None. Pass a factor greater than 1"),
    "cuts of places": (lambda m, a: voxflat.worst_places(m, cuts=ARRAY), "cuts is array.*. Pass True or False"),
    "overwrite": (lambda m, a: m.textured(np.eye(4)).save("x.obj", overwrite=ARRAY), "overwrite is array.*. Pass True"),
    "polygon": (lambda m, a: m.regions({"a": m.uv[:3] + 0j}), "not a polygon"),
    "zero": (lambda m, a: figures.Overlay(VALUES, zero=ARRAY), "zero is array.*. Pass 'right' or 'top'"),
    "underlay": (lambda m, a: figures.flat_map(m, underlay=ARRAY), "underlay is array.*. Pass 'curvature', "),
    "title": (lambda m, a: figures.flat_map(m, title=ARRAY), "the title is array.*. Pass a string"),
    "colour map": (lambda m, a: figures.flat_map(m, figures.Overlay(VALUES, colour_map=[1])), r"no colour map \[1\]"),
    "limits": (lambda m, a: figures.flat_map(m, figures.Overlay(VALUES, limits=3)), "limits is 3. Pass two numbers"),
    "limit": (lambda m, a: figures.flat_map(m, figures.Overlay(VALUES, limits=(None, 1))), "limit is None. Pass"),
    "change": (lambda m, a: figures.movie(m, VALUES, change=ARRAY), "change is array.*. Pass True or False"),
    "towards": (lambda m, a: figures.atlas_3d(a, towards=""), "coordinates of towards are ''. Pass numbers"),
    "size": (lambda m, a: figures.atlas_3d(a, size=-1), "the size is -1. Pass 16 to 16384 pixels"),
    "window": (lambda m, a: figures.patch_3d(m, size=1), "size is 1. Pass the width and height in pixels"),
}


def test_more_sources_than_a_machine_counts(of_mesh):
    """All points are sources in this case."""
    all_points = voxflat.measure(of_mesh, POINTS[:, :2], sources=36)
    assert voxflat.measure(of_mesh, POINTS[:, :2], sources=10**25).figures() == all_points.figures()


@pytest.mark.parametrize("name", CALLS)
def test_functions_say_it_so(name, of_mesh):
    call, message = CALLS[name]
    refused(message, call, of_mesh)


@pytest.fixture(scope="module")
def on_mesh(of_mesh):
    return voxflat.flatten(of_mesh, method=Voxflat(sources=9)), voxflat.surface(of_mesh).patches(bound=1.2)


def calls(of_mesh, flat_map):
    """Return calls that take different paths, each as a function with its arguments and options."""
    voxels, rim = voxflat.surface(VOLUME), voxflat.rim(voxflat.samples.rim(), threads=1)
    of_rim = rim.surface.flatten(method=Voxflat(sources=9), relax=False)
    ball, flattest = voxflat.surface(voxflat.samples.ball()), {"count": 2}
    yield voxflat.surface, ((POINTS, FACES),), {}
    yield voxflat.surface, (VOLUME,), {}
    yield of_mesh.disk, (14, 12.0), {}
    yield of_mesh.cut, (), {}
    yield ball.charts, (2,), {}
    yield of_mesh.flatten, (), {}
    yield of_mesh.cut(relax=False).flatten, (), {}
    yield of_mesh.geodesic, (9,), {}
    yield of_mesh.geodesic, ([1, 2],), {}
    yield voxels.geodesic, (9,), {"geodesic": "chain"}
    yield of_mesh.path, (1, 9), {}
    yield voxels.path, ((0, 0, 2), (7, 7, 2)), {"geodesic": "chain"}
    yield of_mesh.mean_curvature, (), {}
    yield of_mesh.sulcal_depth, (), {}
    yield of_mesh.patches, (20.0,), {}
    yield of_mesh.patches, (), flattest
    yield voxflat.measure, (of_mesh, flat_map), {}
    yield voxflat.worst_places, (flat_map,), {}
    yield figures.flat_map, (flat_map,), {}
    yield flat_map.image, (VALUES,), {}
    yield flat_map.images, (voxflat.io.Volume(VOLUME, np.eye(4)),), {}
    yield flat_map.regions, ({"a": SQUARE},), {}
    yield flat_map.regions, (np.ones(flat_map.raster(2.0).shape, int),), {"pixel_size": 2.0}
    yield flat_map.points_to_map, (POINTS,), {}
    yield flat_map.textured, (np.eye(4),), {}
    yield rim.columns, (3,), {}
    yield rim.layers, (3,), {}
    yield rim.paint, (of_rim.images(rim.layers(3), depths=3), of_rim), {}
    yield rim.profile, (rim.layers(3),), {}
    yield voxflat.flatten_series, ([of_mesh, (POINTS, FACES)],), {}


def accepted(call, *arguments, **options):
    call(*arguments, **options)
    pytest.fail(f"{call.__name__} accepts {options}")


@pytest.mark.slow
def test_every_argument_is_checked_on_every_path(of_mesh, on_mesh):
    """An argument that a path does not use is checked, too."""
    for call, arguments, options in calls(of_mesh, on_mesh[0]):
        signature = inspect.signature(call)
        for name in signature.parameters.keys() - signature.bind(*arguments, **options).arguments.keys() - {"progress"}:
            with pytest.raises(voxflat.InputError, match=f"{name.replace('_', '.')}|object"):
                accepted(call, *arguments, **options, **{name: object()})


def test_a_number_that_contradicts_the_pixels_of_a_file_is_refused():
    rim = voxflat.rim(voxflat.samples.rim())
    flat_map = rim.surface.flatten(method=Voxflat(sources=9), relax=False)
    flat_volume = flat_map.images(rim.layers(3), 0.5, depths=3)
    same = rim.paint(flat_volume, flat_map).data
    assert_array_equal(rim.paint(flat_volume, flat_map, pixel_size=0.5).data, same)
    refused("the pixel size is -7, but the flat volume has 0.5. Omit", rim.paint, flat_volume, flat_map, pixel_size=-7)


def test_backgrounds_that_the_type_of_the_values_holds():
    """Numbers of any kind are accepted without a warning."""
    flat_map = voxflat.flatten(VOLUME, method=Voxflat(sources=9))
    values = np.ones(len(flat_map))
    for background in (10**30, np.float32(1e30), np.float16(4), np.inf, -np.inf, np.nan):
        with warnings_as_errors():
            painted = flat_map.paint(values, background)
        assert_array_equal(painted[VOLUME == 0], np.float64(background))


@pytest.mark.slow
@pytest.mark.parametrize("name", ON_MAPS)
def test_maps_and_atlases_say_it_so(name, on_mesh, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, message = ON_MAPS[name]
    refused(message, call, *on_mesh)
    assert not list(tmp_path.iterdir())
