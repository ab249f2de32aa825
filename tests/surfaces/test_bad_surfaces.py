"""Invalid surfaces raise an error that names the location and the remedy in one line, and write no file."""

import re

import composed
import numpy as np
import pytest
import pyvista as pv
import shapes
from command_line import run, succeed
from hard_shapes import quads
from refusals import refused, warnings_as_errors
from triangle_meshes import square

import voxflat
from voxflat.io.meshes import Mesh, read_mesh, write_mesh
from voxflat.methods import Voxflat


def put(array, index, value):
    array = array.astype(np.result_type(array, type(value)))
    array[index] = value
    return array


def mobius(n=12):
    angle = 2 * np.pi * np.arange(n) / n
    rows = [(5 + side * np.cos(angle / 2), side * np.sin(angle / 2)) for side in (-1.0, 1.0)]
    points = [np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1) for r, z in rows]
    a, b = np.arange(n), n + np.arange(n)
    return np.concatenate(points), quads(a, np.append(a[1:], n), np.append(b[1:], 0), b)


NAN = float("nan")
POINTS, FACES = square()
FIN = np.vstack([POINTS, [[0.2, 0.2, 3.0]]]), np.vstack([FACES, [[FACES[0][0], FACES[0][2], len(POINTS)]]])
MESHES = {
    "index beyond": ((POINTS, put(FACES, (3, 1), 99)), r"face 3 is \[3, 99, 11\], .* points 0 to 48"),
    "index negative": ((POINTS, put(FACES, (3, 1), -2)), r"3 .*-2"),
    "NaN": ((put(POINTS, (7, 2), NAN), FACES), r"vertex 7|point 7"),
    "infinity": ((put(POINTS, (7, 2), np.inf), FACES), r"point 7.*inf.*beyond"),
    "no point": ((np.zeros((0, 3)), np.zeros((0, 3), int)), r"no points"),
    "no triangle": ((POINTS, np.zeros((0, 3), int)), r"no (triangle|face)"),
    "quads": ((POINTS, np.array([[0, 1, 8, 7]])), r"\(1, 4\)"),
    "an edge of three": (FIN, r"more than two triangles meet at an edge, between the vertices 0 and 8"),
    "a vertex of two fans": ((POINTS, np.array([[0, 7, 8], [8, 16, 9]])), r"touches itself at vertex 8 \(1 such"),
    "a corner twice": ((POINTS, np.vstack([FACES, [[3, 3, 4]]])), "triangle 72 has no area"),
    "no area": ((POINTS[[*range(8), 0, *range(9, 49)]], FACES), r"has no area \(\d+ such triangles\)"),
    "a triangle twice": ((POINTS, np.vstack([FACES, FACES[:1]])), "triangle 72 has the same corners as another"),
    "a Möbius strip": (mobius(), r"only one side, like a Möbius strip"),
    "text": ((np.array([["a", "b", "c"]]), np.array([[0, 0, 0]])), r"<U1"),
    "fractional faces": ((POINTS, np.array([[0, 1.5, 8]])), r"float64"),
}
MENDED = ("NaN", "an edge of three", "a vertex of two fans", "a corner twice", "no area", "a triangle twice")


def strictly(mesh):
    return voxflat.surface(mesh, repair="none")


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("call", [voxflat.flatten, voxflat.surface, lambda m: voxflat.surface(m).geodesic(3), strictly])
def test_meshes(name, call):
    mesh, message = MESHES[name]
    if name in MENDED and call is not strictly:
        assert len(voxflat.surface(mesh).faces) >= 2
        return
    refused(message, call, mesh)


def test_check_lists_all_defects():
    faces = np.vstack([FIN[1], FIN[1][9]])
    faces[2] = faces[2][[1, 0, 2]]
    found = voxflat.check((FIN[0], faces))
    assert any("2 components" in advice for advice in found.advice)  # the fin is left out
    assert len(found.defects["edges of more than two triangles"]) >= 1
    assert len(found.defects["triangles given twice"]) == 1
    assert "edges of more than two triangles" in found.table()


@pytest.mark.medium
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"label": 1}, "label does not apply when the input is a mesh"),
        ({"threshold": 0.5}, "threshold does not apply when the input is a mesh"),
        ({"method": "grossmann2002"}, "this surface has none. Pass a surface from a volume"),
        ({"seed_point": (1, 2, 3), "radius": 3.0}, "Pass a vertex number of the mesh"),
        ({"seed_point": 99, "radius": 3.0}, "vertex 99 is not on the surface"),
        ({"seed_point": 24, "radius": 0.1}, "no triangle around vertex 24 lies within 0.1 mm"),
        ({"keep": np.zeros(49, bool)}, "contains no triangle of the surface"),
        ({"keep": np.ones(50, bool)}, r"region to keep has data type bool and shape \(50,\)"),
        ({"keep": [3, 77]}, "refers to vertex 77, but the mesh has 49"),
        ({"keep": np.arange(49) % 7 != 3}, "consists of 2 separate pieces"),
        ({"cuts": [[0, 2]]}, "0 and 2"),
        ({"cuts": [[0, 99]]}, "vertex 99 is not on the surface"),
        ({"cuts": "auto"}, "cannot read the cuts from auto: No such file"),
        ({"cuts": 5}, "cuts has type int. Pass a list of paths"),
        ({"sources": [0, 1, 1]}, "source 1 is given 2 times"),
        ({"sources": [[0, 0, 2]] * 3}, r"must be vertex numbers \(integers\) of shape \(m,\)"),
        ({"memory_limit": 1000}, "of memory is needed"),
    ],
)
def test_options(options, message):
    refused(message, composed.flatten, square(), **options)


def test_a_closed_surface_without_cuts_is_refused():
    refused(r"not a disk: it has 1 component\(s\), 0 boundary loop", voxflat.flatten, shapes.ball(), cuts=[])


@pytest.mark.slow
def test_a_closed_mesh_is_cut_open_and_says_so(caplog):
    sphere = pv.Icosphere(radius=20.0, nsub=2)
    flat = voxflat.flatten(sphere)
    first, *others = flat.metadata["automatic_cuts"]
    assert first["reason"] == "closed sphere"
    assert first["length"] > 30
    assert others
    assert all(cut["reason"] == "relaxation" for cut in others)
    # a cut doubles its inner vertices, one from the boundary its first one, too
    assert len(flat) == sphere.n_points + len(first["ids"]) - 2 + sum(len(cut["ids"]) - 1 for cut in others)
    assert any("it was cut open along 1 path (" in record.getMessage() for record in caplog.records)


def test_the_largest_component_is_that_of_the_largest_area_and_so_it_is_told():
    coarse = np.array([10.0, 10.0, 1.0]) * square(4)[0], square(4)[1]  # 1,600 mm² in 32 triangles
    fine = np.array([1.0, 1.0, 1.0]) * square(20)[0] + [0.0, 0.0, 9.0], square(20)[1]  # 400 mm² in 800
    for first, second in ((coarse, fine), (fine, coarse)):
        both = np.vstack([first[0], second[0]]), np.vstack([first[1], second[1] + len(first[0])])
        flat = voxflat.flatten(both, Voxflat(sources=9))
        assert len(flat) == len(coarse[0])
        warning = (
            "the surface has 2 components; only the largest is used (3.8 % of the triangles, 80.0 % of the area). "
        )
        warning += "To use another one, select its label or keep a part"
        assert flat.metadata["warnings"][0] == warning
        found = voxflat.check(both)
        assert (found.components, found.used) == ((len(coarse[0]), len(fine[0])), len(coarse[0]))
        # what is chosen may have little beside it
        with pytest.raises(voxflat.InputError, match=r"2 separate pieces \(with areas of 1600, 400 mm²\)"):
            voxflat.surface(both).keep(np.ones(len(both[0]), bool)).flatten()


@pytest.mark.medium
def test_a_stray_triangle_with_a_corner_far_away_does_not_replace_the_surface():
    points, faces = square(20)
    stray = np.array([[0.0, 0.0, 9.0], [1.0, 0.0, 9.0], [1e6, 1e6, 9.0]])
    both = np.vstack([points, stray]), np.vstack([faces, len(points) + np.arange(3)])
    surface = voxflat.surface(both)
    flat = voxflat.flatten(surface, Voxflat(sources=9))
    np.testing.assert_array_equal(np.sort(flat.ids), np.arange(len(points)))
    assert flat.uv.tobytes() == voxflat.flatten((points, faces), Voxflat(sources=9)).uv.tobytes()
    (warning,) = (one for one in flat.metadata["warnings"] if "2 components" in one)
    assert "(99.9 % of the triangles, 0.1 % of the area). A component with a larger area was ignored" in warning
    assert voxflat.check(both).components == (len(points), 3)
    assert surface.geodesic(5).shape == (5, len(points))


@pytest.mark.parametrize("bad", [True, False, np.True_])
def test_true_and_false_are_no_numbers(bad):
    mesh, volume = square(), shapes.sheet((12, 12))
    flat = voxflat.flatten(mesh, Voxflat(sources=9))
    image = np.zeros((3, 3, 3))
    options = {"voxflat": ("threads", "seed", "sources", "weighting", "memory_limit"), "saucan2006": ("bound",)}
    for method, names in (options | {"schwartz1989": ("neighbourhood", "starts")}).items():
        for name in names:
            refused(name.replace("_", " "), composed.flatten, mesh, method=method, **{name: bad})
    for call in (
        lambda: voxflat.surface(mesh).disk(24, bad),
        lambda: voxflat.surface(volume, label=bad),
        lambda: voxflat.surface(volume, threshold=bad),
        lambda: voxflat.surface(volume, spacing=[bad] * 3),
        lambda: composed.flatten(volume, method="grossmann2002", sources=bad),
        lambda: voxflat.surface(mesh).geodesic(bad),
        lambda: voxflat.measure(mesh, flat, sources=bad),
        lambda: voxflat.check(mesh, threads=bad),
        lambda: voxflat.surface(mesh).patches(bad),
        lambda: voxflat.surface(mesh).patches(bound=bad),
        lambda: voxflat.surface(mesh).patches(count=bad),
        lambda: voxflat.surface(mesh).patches().glue(bad),
        lambda: voxflat.surface(mesh).patches().page(bad),
        lambda: voxflat.range_image(image[0], 1.0, jump=bad),
        lambda: flat.heat_map(bad),
        lambda: flat.image(np.zeros(len(mesh[0])), depth=bad),
    ):
        with pytest.raises(voxflat.InputError):
            call()


@pytest.mark.parametrize(("jump", "count"), [(10**20, 4), (10**400, 4), (np.float16(2), 2), (np.float32(2), 2)])
def test_a_jump_may_be_any_number(jump, count):
    with warnings_as_errors():
        assert len(voxflat.range_image(np.array([[0.0, 1.0, 9.0]] * 2), 1.0, jump=jump).faces) == count


@pytest.mark.slow
def test_check_is_the_same_with_any_number_of_threads():
    sphere = pv.Icosphere(radius=20.0, nsub=2)
    one = voxflat.check(sphere, threads=1)
    assert one == voxflat.check(sphere, threads=3)
    assert one.automatic_cuts


def test_flipped_and_unused_are_mended_and_told():
    points, faces = square()
    faces[3] = faces[3][[1, 0, 2]]
    surface = voxflat.surface((np.vstack([points, [[9.0, 9.0, 9.0]]]), faces))
    assert surface.warnings[0] == "1 of 72 triangles were reversed, so that all of them face outwards"
    assert surface.warnings[1] == "1 of 50 vertices belong to no triangle and are excluded"


def test_a_single_voxel_and_a_checkerboard_are_surfaces():
    # the dual of a cube is an octahedron; a checkerboard is many of them
    single = shapes.two_sided(np.pad(np.ones((1, 1, 1), np.uint8), 2))
    assert (len(single), len(single.faces)) == (6, 8)
    board = (np.indices((4, 4, 4)).sum(axis=0) % 2).astype(np.uint8)
    topology = shapes.two_sided(board).core.topology()
    assert topology["euler"] == 2 * 32
    assert len(topology["components"]) == 32


def test_a_label_at_the_border_is_told():
    volume = np.zeros((12, 12, 12), np.uint8)
    volume[:8, 2:10, 2:10] = 1
    (warning,) = voxflat.surface(volume).warnings
    touches = "the foreground touches the border of the volume (first layer of axis 0)"
    assert warning == f"{touches}; the surface is closed there"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pial": square(5)}, "pial surface has 36 vertices, but the given surface has 49"),
        ({"pial": POINTS}, "pial has type ndarray. Pass a path"),
        ({"pial": "rh.pial"}, r"rh\.pial: the file does not exist"),
        ({"repair": "voxels"}, "a mesh has no voxels. Pass 'cuts' or 'none'"),
        ({"repair": "glue"}, "repair is 'glue'"),
        ({"repair": True}, "repair is True. Pass 'none'"),
        ({"flat": np.zeros((48, 2))}, "the map has 48 points, but the surface has 49 vertices"),
        ({"flat": np.zeros(49)}, r"shape \(49,\) and data type float64. Pass positions"),
        ({"flat": np.full((49, 2), NAN)}, "does not contain a complete triangle"),
        ({"flat": POINTS + np.arange(49)[:, None]}, "the map is not flat: its third coordinate varies by"),
    ],
)
def test_what_comes_with_a_mesh(options, message):
    refused(message, voxflat.measure if "flat" in options else voxflat.surface, square(), **options)


@pytest.mark.parametrize("name", ["an edge of three", "a Möbius strip", *MENDED])
def test_command_line(name, tmp_path):
    (points, faces), message = MESHES[name]
    write_mesh(tmp_path / "in.ply", Mesh(points, faces))
    for command in (["flatten", "-o", tmp_path / "out.npz"], ["surface", "-o", tmp_path / "out.vtp"]):
        result = run(*command, tmp_path / "in.ply", *(["--repair", "none"] if name in MENDED else []))
        assert result.exit_code == 1
        assert re.search(f"^voxflat: error: .*{message}", result.stderr.splitlines()[-1])
        assert [path.name for path in tmp_path.iterdir()] == ["in.ply"]
    if name in MENDED:
        succeed("surface", tmp_path / "in.ply", "-o", tmp_path / "out.vtp")
        assert len(read_mesh(tmp_path / "out.vtp").faces) == len(voxflat.surface((points, faces)).faces)
