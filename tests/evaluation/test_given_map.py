"""Maps of other tools keep their positions, and are drawn, read and saved like maps that voxflat makes."""

import json
import pickle

import nibabel as nib
import numpy as np
import PIL.Image
import pytest
import pyvista as pv
from command_line import fail, succeed
from hard_shapes import sheet, signed_areas
from mesh_files import icosphere, write_obj
from refusals import refused

import voxflat
from voxflat.evaluation import given_map
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.surfaces.manifold import patch_of

POINTS, FACES = sheet(lambda u, v: (u, v, 3 * np.sin(u / 7) * np.cos(v / 9)), (36.0, 36.0), (13, 13))
PLACES = 1.1 * POINTS[:, :2] + 0.05 * POINTS[:, 1::-1]
PLACES[40] += 4.5  # beyond its neighbours, so that some triangles are flipped
FLAT = np.pad(PLACES.astype(np.float32), ((0, 0), (0, 1)))  # files hold float32
SURFACE = POINTS, FACES


def forms(folder):
    """Return the map in the forms of many tools."""
    flat = Mesh(FLAT, FACES, structure="CortexLeft")
    surface = voxflat.surface(SURFACE)
    for name in ("lh.flat.surf.gii", "flat.ply", "flat.obj", "lh.flat"):
        write_mesh(folder / name, flat)
    whole = np.arange(len(POINTS))
    patch = patch_of(FLAT, whole, FACES, FACES[:0], len(POINTS), FACES[:0, :2])
    voxflat.io.write_patch(folder / "lh.patch.flat", patch)
    write_obj(folder / "texture.obj", POINTS, FACES, FLAT[:, :2].astype(np.float64)[FACES])
    voxflat.load(FLAT, surface).save(folder / "map.npz")
    names = ("lh.flat.surf.gii", "flat.ply", "flat.obj", "lh.flat", "lh.patch.flat", "texture.obj", "map.npz")
    objects = {"array": FLAT[:, :2], "pair": (FLAT, FACES), "rows": (FLAT, FACES, whole)}
    objects["pyvista"] = pv.PolyData.from_regular_faces(FLAT, FACES)
    return {name: folder / name for name in names} | objects


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    folder = tmp_path_factory.mktemp("given")
    write_mesh(folder / "lh.mid.surf.gii", Mesh(*SURFACE, structure="CortexLeft"))
    return folder, forms(folder)


@pytest.fixture(scope="module")
def flat_map(given):
    folder, flat = given
    return voxflat.load(flat["lh.flat.surf.gii"], surface=folder / "lh.mid.surf.gii")


@pytest.mark.medium
def test_no_point_of_any_form_moves(given):
    folder, flat = given
    expected = nib.load(flat["lh.flat.surf.gii"]).darrays[0].data[:, :2]
    for name, form in flat.items():
        loaded = voxflat.load(form, surface=folder / "lh.mid.surf.gii")
        digits = 6 if name in ("flat.obj", "texture.obj") else 99  # decimal text
        np.testing.assert_allclose(loaded.uv, expected[loaded.ids], rtol=10.0**-digits, atol=0, err_msg=name)
        assert (loaded.method, loaded.cuts_by, len(loaded)) == ("given", "given", len(POINTS)), name


def test_flipped_triangles_stay_and_a_warning_counts_them(flat_map):
    flipped = int((signed_areas(FLAT[:, :2].astype(np.float64), FACES) < 0).sum())
    assert flipped > 0
    text = f"the map folds over: {flipped} of {len(FACES)} triangles are flipped"
    assert text in flat_map.warnings
    assert flat_map.distortion.triangles.flipped == flipped


def test_its_distortion_is_that_of_measure(flat_map):
    measured = voxflat.measure(SURFACE, PLACES.astype(np.float32), reference="graph")
    assert flat_map.distortion.raw.relative_error == pytest.approx(measured.raw.relative_error, rel=1e-6)
    np.testing.assert_allclose(flat_map.distortion.triangles.areal, measured.triangles.areal, rtol=1e-5, atol=1e-6)


def test_the_distortion_is_measured_when_it_is_first_read(monkeypatch):
    calls, measured = [], given_map.measured_maps
    monkeypatch.setattr(given_map, "measured_maps", lambda *of, **how: calls.append(of) or measured(*of, **how))
    loaded = voxflat.load(FLAT, SURFACE)
    image = loaded.image(POINTS[:, 2])
    assert repr(loaded).endswith("relative error not measured yet>")
    assert image.provenance["parameters"]["of"]["figures"] is None
    assert not calls
    turned = loaded._with(seed=1)  # a copy shares the measurement
    distortion = turned.distortion
    assert loaded.distortion is turned.distortion is distortion
    assert len(calls) == 1
    assert f"relative error {distortion._summary()}" in repr(loaded)
    again = pickle.loads(pickle.dumps(voxflat.load(FLAT, SURFACE)))
    np.testing.assert_array_equal(again.distortion.per_point, distortion.per_point)
    assert len(calls) == 2


def test_large_errors_are_logged_when_they_are_measured(caplog):
    squeezed = voxflat.load(FLAT[:, :2] * [0.1, 1], SURFACE)
    caplog.clear()
    assert squeezed.distortion.best_scale.relative_error > 0.2
    assert "the mean relative distance error of interior pairs is" in caplog.text


def test_it_is_saved_and_loaded(flat_map, tmp_path):
    flat_map.save(tmp_path / "map.npz")
    again = voxflat.load(tmp_path / "map.npz")
    for name in ("uv", "points", "ids", "faces", "curvature", "sulcal_depth"):
        np.testing.assert_array_equal(getattr(again, name), getattr(flat_map, name))
    for name in ("method", "cuts_by", "warnings", "details"):
        assert getattr(again, name) == getattr(flat_map, name)
    assert again.provenance["function"] == "load"
    assert len(again.provenance["files"]) == 2


def test_a_region_drawn_on_it_contains_the_vertices_within(flat_map, tmp_path):
    corners = np.array([[8.0, 8.0], [30.0, 9.0], [20.0, 33.0]])
    ends, x, y = np.roll(corners, -1, axis=0), FLAT[:, 0], FLAT[:, 1]
    sides = [(b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0]) for a, b in zip(corners, ends, strict=True)]
    inside = np.all(np.array(sides) > 0, axis=0)
    flat_map.regions({"V1": corners}).save(tmp_path / "lh.V1.label.gii")
    np.testing.assert_array_equal(nib.load(tmp_path / "lh.V1.label.gii").darrays[0].data > 0, inside)


def with_a_duplicate():
    """Return the surface and the map with a copy of vertex 84, which triangles without area connect with it."""
    around = FACES[(FACES == 84).any(axis=1)]
    following = dict(np.roll(face, -list(face).index(84))[1:].tolist() for face in around)
    ring = [int(around[0][around[0] != 84][0])]
    while len(ring) < len(following):
        ring.append(following[ring[-1]])
    half, copy = len(ring) // 2, len(POINTS)
    faces = [[84 if n < half else copy, ring[n], ring[(n + 1) % len(ring)]] for n in range(len(ring))]
    faces += [[84, ring[half], copy], [copy, ring[0], 84]]
    faces = np.vstack([FACES[(FACES != 84).all(axis=1)], faces])
    return (np.vstack([POINTS, POINTS[84]]), faces), np.vstack([FLAT[:, :2], FLAT[84, :2] + [0.3, 0.2]])


def test_merged_vertices_keep_their_own_positions(tmp_path):
    surface, places = with_a_duplicate()
    assert len(voxflat.surface(surface).merged) == 1
    write_mesh(tmp_path / "lh.flat.surf.gii", Mesh(np.pad(places, ((0, 0), (0, 1))), surface[1]))
    for flat in (places, (places, surface[1]), tmp_path / "lh.flat.surf.gii"):
        loaded = voxflat.load(flat, surface)
        np.testing.assert_allclose(loaded.uv, places[loaded.ids], atol=1e-5)
        assert any("1 of 170 vertices coincide with others on the surface, but" in text for text in loaded.warnings)
    places[-1] = places[84]
    assert not any("but not on the map" in text for text in voxflat.load(places, surface).warnings)


def test_a_map_from_inside_is_reported_with_the_remedy(flat_map):
    advice = "unless it belongs to the other hemisphere. To show it from outside, multiply the first coordinate"
    inside = voxflat.load(FLAT[:, :2] * [-1, 1], SURFACE)
    assert sum(advice in text for text in inside.warnings) == 1
    assert inside.metadata["mirrored"]
    assert not any(advice in text for text in flat_map.warnings)
    own = voxflat.flatten(SURFACE, voxflat.methods.Voxflat(sources=30), mirror=True)
    assert not any(advice in text for text in voxflat.load(own, SURFACE).warnings)


def test_white_and_pial_surfaces_define_depths():
    pial = POINTS + voxflat.surface(SURFACE).core.normals * 2.0
    loaded = voxflat.load(FLAT, surface=SURFACE, pial=(pial, FACES))
    np.testing.assert_allclose(loaded.pial_points, pial)
    np.testing.assert_allclose(loaded.white_points, POINTS)
    affine = np.eye(4)
    affine[2, 3] = -5
    volume = voxflat.io.as_volume(np.ones((40, 40, 16)) * (np.arange(16.0) - 5), affine=affine)
    image = loaded.image(volume, fraction=0.5, layering="equidistant", interpolation="linear")
    middle = loaded.image(0.5 * (POINTS + pial)[:, 2])
    both = np.isfinite(image.data)
    assert both.mean() > 0.5
    np.testing.assert_allclose(image.data[both], middle.data[both], atol=1e-5)


@pytest.mark.medium
def test_pages_show_maps_of_all_forms(given, flat_map):
    flat = given[1]
    inside = voxflat.load(FLAT[:, :2] * [-1, 1], SURFACE)
    duplicated, places = with_a_duplicate()
    for loaded in (flat_map, inside, voxflat.load(places, duplicated), voxflat.load(flat["texture.obj"])):
        page = voxflat.map_page(loaded, "given")
        assert f"A flat map of {len(loaded):,} points" in page.html
        assert "mean relative error of distances" in page.html


@pytest.mark.medium
def test_seams_of_texture_coordinates_are_cuts(tmp_path):
    points, faces = icosphere(10.0, 2)
    made = voxflat.flatten((points, faces))
    faces = made.ids[made.faces]
    write_obj(tmp_path / "unwrapped.obj", points, faces, made.uv[made.faces])
    loaded = voxflat.load(tmp_path / "unwrapped.obj", surface=(points, faces))
    assert len(loaded) == len(made)
    cut = {tuple(sorted(edge)) for one in loaded.cuts for edge in zip(one.ids[:-1], one.ids[1:], strict=True)}
    assert cut == {tuple(sorted(edge)) for one in made.cuts for edge in zip(one.ids[:-1], one.ids[1:], strict=True)}


def test_islands_of_texture_coordinates_are_one_map(tmp_path):
    places = PLACES[FACES]
    is_second = places[..., 0].mean(axis=1) > 20
    places[is_second] += (30.0, 5.0)
    write_obj(tmp_path / "islands.obj", POINTS, FACES, places)
    loaded = voxflat.load(tmp_path / "islands.obj")
    corners = loaded.ids[loaded.faces], loaded.uv[loaded.faces]
    order, expected = np.lexsort(corners[0].T), np.lexsort(FACES.T)
    np.testing.assert_array_equal(corners[0][order], FACES[expected])
    np.testing.assert_allclose(corners[1][order], places[expected], atol=1e-5)
    assert np.isfinite(loaded.distortion.per_point).all()
    outline = [[20.0, 5.0], [80.0, 5.0], [80.0, 40.0], [20.0, 40.0]]
    inside = np.unique(FACES[((places > (20, 5)) & (places < (80, 40))).all(axis=2)])
    np.testing.assert_array_equal(np.flatnonzero(loaded.regions({"A": outline}).vertex_labels), inside)


def test_maps_in_another_scale_are_reported_with_the_factor(flat_map):
    small = voxflat.load(FLAT[:, :2] / 500, SURFACE)
    (text,) = [text for text in small.warnings if "times as large" in text]
    assert text.startswith("the map is 0.0021")
    factor = float(text.rsplit(" ", 1)[1])
    assert factor == pytest.approx(500 * flat_map.distortion.triangles.equal_area_scale, rel=1e-3)
    assert not any("times as large" in text for text in flat_map.warnings)


def test_wrong_partners_get_one_line(given, tmp_path):
    folder, flat = given
    surface = folder / "lh.mid.surf.gii"
    file = flat["lh.flat.surf.gii"]
    write_mesh(tmp_path / "rh.mid.surf.gii", Mesh(*SURFACE, structure="CortexRight"))
    other_side = "lh.flat.surf.gii: belongs to the left .* Pass the surface on which the map was made"
    refused(other_side, voxflat.load, file, tmp_path / "rh.mid.surf.gii")
    points, faces = sheet(lambda u, v: (u, v, 0 * u), (36.0, 36.0), (14, 13))
    refused("169 points, but the surface has 182 vertices. Pass the surface", voxflat.load, file, (points, faces))
    order = np.random.default_rng(0).permutation(len(POINTS))
    refused("triangles are triangles of the surface", voxflat.load, file, (POINTS, order[FACES]))
    bent = "lh.mid.surf.gii: the map is not flat: its third coordinate varies by .* Pass a flat surface"
    refused(bent, voxflat.load, surface, surface)
    refused(bent, voxflat.load, surface, file)  # in the wrong order
    refused(bent, voxflat.load, surface)
    sphere = POINTS / np.linalg.norm(POINTS - [18, 18, 40], axis=1)[:, None]
    refused("the map is not flat", voxflat.load, (sphere, FACES), surface)
    refused("the surface is the flat map itself. .* omit surface", voxflat.load, file, file)
    nib.save(nib.Nifti1Image(np.zeros((3, 3, 3)), np.eye(4)), tmp_path / "t1.nii.gz")
    for given in ((surface,), ()):
        refused("t1.nii.gz: is not a flat map. Pass a flat surface, ", voxflat.load, tmp_path / "t1.nii.gz", *given)
    refused("patch, which has no triangles. Also pass surface", voxflat.load, flat["lh.patch.flat"])
    refused("Pass surface and pial, or omit pial", voxflat.load, flat["map.npz"], pial=surface)


@pytest.mark.medium
def test_every_command_takes_the_map_with_its_surface(given, flat_map, tmp_path):
    folder, flat = given
    file, mid = flat["lh.flat.surf.gii"], folder / "lh.mid.surf.gii"
    (tmp_path / "points.csv").write_text("x,y,z\n" + ",".join(map(str, POINTS[60])) + "\n")
    (tmp_path / "v1.json").write_text(json.dumps({"V1": [[8.0, 8.0], [30.0, 9.0], [20.0, 33.0]]}))
    write_mesh(tmp_path / "rh.mid.surf.gii", Mesh(POINTS * [-1, 1, 1], FACES[:, ::-1], structure="CortexRight"))
    write_mesh(tmp_path / "rh.flat.surf.gii", Mesh(FLAT * [-1, 1, 1], FACES[:, ::-1], structure="CortexRight"))
    nib.save(nib.Nifti1Image(POINTS[:, 2].astype(np.float32)[:, None, None], np.eye(4)), tmp_path / "values.nii.gz")
    succeed("image", file, "--surface", mid, "--volume", tmp_path / "values.nii.gz", "-o", tmp_path / "image.npy")
    np.testing.assert_allclose(
        np.load(tmp_path / "image.npy"), flat_map.image(POINTS[:, 2].astype(np.float32)).data, rtol=1e-5, atol=1e-5
    )
    succeed("image", file, "--surface", mid, "--heat-map", "-o", tmp_path / "heat.npy")
    succeed("points", file, tmp_path / "points.csv", "--surface", mid, "-o", tmp_path / "uv.csv")
    row = (tmp_path / "uv.csv").read_text().splitlines()[1].split(",")
    np.testing.assert_allclose([float(cell) for cell in row[3:5]], FLAT[60, :2], atol=1e-4)
    succeed("regions", file, "--surface", mid, "--polygons", tmp_path / "v1.json", "-o", tmp_path / "lh.V1.label")
    series = nib.gifti.GiftiImage(
        darrays=[nib.gifti.GiftiDataArray(k + POINTS[:, 2].astype(np.float32)) for k in range(3)]
    )
    nib.save(series, tmp_path / "series.func.gii")
    movie = ("--overlay", tmp_path / "series.func.gii", "--time-step", 1, "--size", 320)
    succeed("movie", file, "--surface", mid, *movie, "-o", tmp_path / "movie.gif")
    assert PIL.Image.open(tmp_path / "movie.gif").n_frames == 3
    PIL.Image.fromarray(np.full((64, 64, 3), 99, dtype=np.uint8)).save(tmp_path / "picture.png")
    succeed("texture", file, tmp_path / "picture.png", "--surface", mid, "-o", tmp_path / "textured.obj")
    np.testing.assert_allclose(voxflat.io.read_mesh(tmp_path / "textured.obj").points, POINTS, atol=1e-5)
    write_mesh(tmp_path / "lh.pial.surf.gii", Mesh(np.add(POINTS, (0, 0, 2)), FACES, structure="CortexLeft"))
    affine = np.diag([1.0, 1.0, 1.0, 1.0])
    affine[2, 3] = -5
    heights = np.broadcast_to(np.arange(16.0, dtype=np.float32) - 5, (40, 40, 16))
    nib.save(nib.Nifti1Image(heights, affine), tmp_path / "heights.nii.gz")
    between = ("--volume", tmp_path / "heights.nii.gz", "--depths", 4, "-o", tmp_path / "layers.nii.gz")
    succeed("image", file, "--surface", mid, "--pial", tmp_path / "lh.pial.surf.gii", *between)
    layers = np.asanyarray(nib.load(tmp_path / "layers.nii.gz").dataobj)
    np.testing.assert_allclose(np.nanmean(np.diff(layers, axis=2)), 0.5, atol=1e-3)
    succeed("worst", file, "--surface", mid)
    succeed("cite", file, "--surface", mid)
    both = (file, tmp_path / "rh.flat.surf.gii", "--surface", mid, "--surface", tmp_path / "rh.mid.surf.gii")
    succeed("figure", *both, "-o", tmp_path / "both.png")
    fail(2, "--surface is given 1 time for 2 maps. Pass it once per map", "figure", *both[:4], "-o", tmp_path / "a.png")
    fail(1, "lh.mid.surf.gii: the map is not flat", "figure", mid, "--surface", file, "-o", tmp_path / "a.png")
    patch = flat["lh.patch.flat"]
    fail(1, "Also pass --surface, the surface that it shows", "figure", patch, "-o", tmp_path / "a.png")
    fail(1, "Pass --surface and --pial, or omit --pial", "worst", flat["map.npz"], "--pial", mid)


def test_a_methods_text_says_that_the_map_existed(flat_map):
    text = str(voxflat.cite(flat_map))
    assert text.startswith("Data were drawn with voxflat")
    assert "on an existing flat map of the surface" in text
    assert "flattened into the plane with" not in text.split("References")[0]
