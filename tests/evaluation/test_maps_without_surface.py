"""Maps without their surface show values at the vertices; what needs the surface says so in one line."""

import logging

import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
from command_line import fail, succeed
from hard_shapes import sheet, signed_areas
from mesh_files import write_obj
from refusals import refused

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.surfaces.manifold import patch_of

POINTS, FACES = sheet(lambda u, v: (u, v, 3 * np.sin(u / 7) * np.cos(v / 9)), (36.0, 36.0), (13, 13))
FLAT = np.pad((1.1 * POINTS[:, :2] + 0.05 * POINTS[:, 1::-1]).astype(np.float32), ((0, 0), (0, 1)))
KEPT = FACES[(FACES != 84).all(axis=1)]  # of a map that does not show vertex 84
SHOWN = np.delete(np.arange(len(POINTS)), 84)
FLAT[84] = 0  # as many tools place vertices beside the map
VALUES = np.arange(len(POINTS), dtype=np.float32)
REFUSAL = "this map was loaded without its surface, so .*. Also pass surface, the surface that it shows"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    write_mesh(folder / "lh.mid.surf.gii", Mesh(POINTS, FACES, structure="CortexLeft"))
    for name in ("lh.flat.surf.gii", "flat.ply", "flat.obj", "lh.flat"):
        write_mesh(folder / name, Mesh(FLAT, KEPT, structure="CortexLeft"))
    write_mesh(folder / "rh.flat.surf.gii", Mesh(FLAT * [-1, 1, 1], KEPT[:, ::-1], structure="CortexRight"))
    return folder


@pytest.fixture(scope="module")
def alone(folder):
    return voxflat.load(folder / "lh.flat.surf.gii")


def test_meshes_of_any_tool_keep_their_positions_and_vertex_numbers(folder):
    forms = {name: folder / name for name in ("lh.flat.surf.gii", "flat.ply", "flat.obj", "lh.flat")}
    forms |= {"pair": (FLAT, KEPT), "flat pair": (FLAT[:, :2], KEPT), "nibabel": nib.load(forms["lh.flat.surf.gii"])}
    forms["pyvista"] = pv.PolyData.from_regular_faces(FLAT, KEPT)
    for name, form in forms.items():
        alone = voxflat.load(form)
        digits = 6 if name == "flat.obj" else 99  # decimal text
        np.testing.assert_allclose(alone.uv, FLAT[SHOWN, :2], rtol=10.0**-digits, atol=0, err_msg=name)
        np.testing.assert_array_equal(alone.ids, SHOWN)
        np.testing.assert_array_equal(alone.ids[alone.faces], KEPT)
        assert (alone.method, alone.has_surface, alone.origin.vertices) == ("given", False, len(POINTS)), name
        assert "without its surface" in repr(alone)


def test_values_are_drawn_as_with_the_surface(folder, alone):
    whole = voxflat.load(folder / "lh.flat.surf.gii", folder / "lh.mid.surf.gii")
    assert whole.has_surface
    np.testing.assert_array_equal(alone.image(VALUES).data, whole.image(VALUES).data)
    assert len(alone.images(np.column_stack([VALUES, VALUES]))) == 2
    seen = alone.look_up(alone.uv[[3, 50]])
    np.testing.assert_array_equal(seen.face_ids, whole.look_up(alone.uv[[3, 50]]).face_ids)
    refused(REFUSAL, getattr, seen, "points")


@pytest.mark.parametrize("ending", [".label.gii", ".annot"])
def test_regions_are_written_back_to_the_vertices(alone, tmp_path, ending):
    corners = np.array([[8.0, 8.0], [30.0, 9.0], [20.0, 33.0]])
    ends, (x, y) = np.roll(corners, -1, axis=0), FLAT[:, :2].T.astype(np.float64)
    sides = [(b - a)[0] * (y - a[1]) - (b - a)[1] * (x - a[0]) for a, b in zip(corners, ends, strict=True)]
    inside = np.all(np.array(sides) > 0, axis=0)
    assert 0 < inside.sum() < len(SHOWN)
    regions = alone.regions({"V1": corners})
    np.testing.assert_array_equal(regions.vertex_labels > 0, inside)
    regions.save(tmp_path / f"lh.V1{ending}")
    path = tmp_path / f"lh.V1{ending}"
    saved = nib.load(path).darrays[0].data if ending == ".label.gii" else nib.freesurfer.read_annot(path)[0]
    np.testing.assert_array_equal(saved > 0, inside)
    assert np.nanmax(regions.image().data) == 1


def test_it_is_saved_loaded_and_joined_with_its_surface(folder, alone, tmp_path):
    alone.save(tmp_path / "map.npz")
    again = voxflat.load(tmp_path / "map.npz")
    for name in ("uv", "ids", "faces"):
        np.testing.assert_array_equal(getattr(again, name), getattr(alone, name))
    assert (again.has_surface, again.details, again.origin.structure) == (False, alone.details, "CortexLeft")
    whole = voxflat.load(folder / "lh.flat.surf.gii", folder / "lh.mid.surf.gii")
    joined = voxflat.load(tmp_path / "map.npz", folder / "lh.mid.surf.gii")
    np.testing.assert_array_equal(joined.image(VALUES).data, whole.image(VALUES).data)
    assert joined.distortion.raw.relative_error == pytest.approx(whole.distortion.raw.relative_error)
    measured = voxflat.measure(folder / "lh.mid.surf.gii", alone, reference="graph")
    assert measured.raw.relative_error == pytest.approx(whole.distortion.raw.relative_error)
    alone.save(tmp_path / "flat.surf.gii")
    np.testing.assert_array_equal(nib.load(tmp_path / "flat.surf.gii").darrays[0].data, FLAT)
    flat = alone.to_pyvista()
    assert "surface_points" not in flat.point_data
    np.testing.assert_array_equal(flat.point_data["vertex_ids"], SHOWN)


NEED_SURFACE = {
    "volume": lambda of: of.image(nib.Nifti1Image(np.ones((40, 40, 8)), np.eye(4))),
    "depth": lambda of: of.image(nib.Nifti1Image(np.ones((40, 40, 8)), np.eye(4)), depth=1.0),
    "points": lambda of: of.points,
    "normals": lambda of: of.normals,
    "distortion": lambda of: of.distortion,
    "heat map": lambda of: of.heat_map(),
    "figure of the distortion": lambda of: voxflat.figures.heat_map(of),
    "scatter": lambda of: voxflat.figures.scatter(of),
    "patch in 3-D": lambda of: voxflat.figures.patch_3d(of),
    "nearest points": lambda of: of.points_to_map([[1.0, 2.0, 3.0]]),
    "vectors": lambda of: of.vectors_to_surface([[10.0, 10.0]], [[1.0, 0.0]]),
    "locate": lambda of: of.locate(),
    "textured": lambda of: of.textured(np.zeros((8, 8), dtype=np.uint8)),
    "areas of regions": lambda of: of.regions({"V1": [[8, 8], [30, 9], [20, 33]]}).properties(),
    "page": lambda of: voxflat.map_page(of),
    "worst places": lambda of: voxflat.worst_places(of),
    "surface in PyVista": lambda of: pv.Plane().voxflat.to_surface_polydata(of),
}


@pytest.mark.parametrize("needed", NEED_SURFACE)
def test_what_needs_the_surface_says_so(alone, needed):
    refused(REFUSAL, NEED_SURFACE[needed], alone)


def test_both_hemispheres_are_drawn(folder, tmp_path):
    (tmp_path / "v1.json").write_text('{"V1": [[8.0, 8.0], [30.0, 9.0], [20.0, 33.0]]}')
    np.save(tmp_path / "x.npy", VALUES)
    values = nib.gifti.GiftiImage(darrays=[nib.gifti.GiftiDataArray(VALUES, intent="NIFTI_INTENT_SHAPE")])
    nib.save(values, tmp_path / "values.shape.gii")
    left, right = folder / "lh.flat.surf.gii", folder / "rh.flat.surf.gii"
    data = ("--overlay", tmp_path / "values.shape.gii") * 2
    succeed("figure", left, right, *data, "-o", tmp_path / "both.png")
    succeed("image", left, "--volume", tmp_path / "values.shape.gii", "-o", tmp_path / "image.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "image.npy"), voxflat.load(left).image(VALUES).data)
    succeed("regions", left, "--polygons", tmp_path / "v1.json", "-o", tmp_path / "lh.V1.annot")
    succeed("cite", left)
    fail(1, "Also pass --surface, the surface that it shows", "image", left, "--heat-map", "-o", tmp_path / "h.npy")
    fail(1, "Also pass --surface, the surface that it shows", "worst", left)


def test_texture_coordinates_come_with_their_surface(tmp_path):
    write_obj(tmp_path / "unwrapped.obj", POINTS, FACES, FLAT[:, :2].astype(np.float64)[FACES])
    loaded = voxflat.load(tmp_path / "unwrapped.obj")
    assert loaded.has_surface
    np.testing.assert_allclose(loaded.points[np.argsort(loaded.ids)], POINTS, atol=1e-6)


def test_maps_without_triangles_need_their_surface(folder, tmp_path):
    whole = np.arange(len(POINTS))
    patch = patch_of(FLAT, whole, FACES, FACES[:0], len(POINTS), FACES[:0, :2])
    voxflat.io.write_patch(tmp_path / "lh.patch.flat", patch)
    refused(
        "is a FreeSurfer patch, which has no triangles. Also pass surface", voxflat.load, tmp_path / "lh.patch.flat"
    )
    refused("only a mesh can be loaded without its surface. Also pass surface", voxflat.load, FLAT[:, :2])
    refused("only a mesh can be loaded without its surface. Also pass surface", voxflat.load, (FLAT, FACES, whole))
    whole_map = voxflat.load(folder / "lh.flat.surf.gii", folder / "lh.mid.surf.gii")
    refused("does not contain the vertex numbers of its surface", voxflat.load, whole_map.to_pyvista())
    refused("is not flat: its third coordinate varies", voxflat.load, folder / "lh.mid.surf.gii")


def test_flipped_triangles_and_maps_from_inside_are_reported(caplog):
    bent = FLAT.copy()
    bent[40] += [4.5, 4.5, 0]
    flipped = int((signed_areas(bent[:, :2].astype(np.float64), KEPT) < 0).sum())
    assert flipped > 0
    with caplog.at_level(logging.WARNING):
        assert voxflat.load((bent, KEPT)).warnings == (f"the map folds over: {flipped} of 282 triangles are flipped",)
    assert "folds over" in caplog.text
    inside = voxflat.load((bent * [-1, 1, 1], KEPT))
    assert inside.metadata["mirrored"]
    assert inside.warnings[0] == f"the map folds over: {flipped} of 282 triangles are flipped"
    assert "shows the surface from inside" in inside.warnings[1]
