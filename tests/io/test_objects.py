"""Convert surfaces and values from and to nilearn, nibabel, trimesh, meshio, PyVista and VTK."""

import base64
import hashlib
import io
import struct

import meshio
import nibabel
import numpy as np
import pytest
import pyvista as pv
import trimesh
import vtk
from matplotlib.figure import Figure
from nilearn import plotting
from nilearn.surface import FileMesh, InMemoryMesh, PolyData, PolyMesh, SurfaceImage
from PIL import Image
from refusals import refused

import voxflat
from voxflat.io.formats.polygons import of_scene
from voxflat.io.label_tables import own_table
from voxflat.io.provenance import described

HILL = voxflat.samples.hill()
POINTS, FACES = HILL.points, HILL.faces.astype(np.int64)
COUNT = len(POINTS)
VALUES = np.linspace(-1, 1, COUNT).astype(np.float32)


def gifti_surface():
    gifti = nibabel.gifti
    meta = gifti.GiftiMetaData({"AnatomicalStructurePrimary": "CortexLeft"})
    points = gifti.GiftiDataArray(POINTS.astype("f4"), intent="NIFTI_INTENT_POINTSET", meta=meta)
    return gifti.GiftiImage(darrays=[points, gifti.GiftiDataArray(FACES.astype("i4"), intent="NIFTI_INTENT_TRIANGLE")])


def gifti_values(structure="CortexLeft", values=VALUES):
    meta = nibabel.gifti.GiftiMetaData({"AnatomicalStructurePrimary": structure})
    array = nibabel.gifti.GiftiDataArray(values, intent="NIFTI_INTENT_NONE", datatype="NIFTI_TYPE_FLOAT32")
    return nibabel.gifti.GiftiImage(meta=meta, darrays=[array])


def cifti():
    axes, both = nibabel.cifti2, np.concatenate([VALUES, -VALUES])[None]
    sides = [axes.BrainModelAxis.from_mask(np.ones(COUNT, bool), name=f"Cortex{side}") for side in ("Left", "Right")]
    return axes.Cifti2Image(both, header=(axes.ScalarAxis(["effect"]), sides[0] + sides[1]))


def vtk_polydata():
    raw = vtk.vtkPolyData()
    raw.ShallowCopy(pv.PolyData.from_regular_faces(POINTS, FACES))
    return raw


NILEARN = InMemoryMesh(POINTS, FACES)
BOTH = PolyMesh(left=NILEARN, right=NILEARN)
SURFACES = {
    "InMemoryMesh": lambda: NILEARN,
    "PolyMesh": lambda: PolyMesh(left=NILEARN),
    "SurfaceImage": lambda: SurfaceImage(PolyMesh(left=NILEARN), PolyData(left=VALUES)),
    "GiftiImage": gifti_surface,
    "Trimesh": lambda: trimesh.Trimesh(POINTS, FACES, process=False),
    "meshio": lambda: meshio.Mesh(POINTS, [("vertex", [[0]]), ("triangle", FACES)]),
    "PyVista": lambda: pv.PolyData.from_regular_faces(POINTS, FACES),
    "VTK": vtk_polydata,
}


@pytest.mark.parametrize("kind", SURFACES)
def test_a_surface_of_another_package_is_that_of_its_arrays(kind):
    given = SURFACES[kind]()
    surface = voxflat.surface(given)
    np.testing.assert_allclose(surface.points, POINTS, atol=1e-5)
    np.testing.assert_array_equal(surface.faces, FACES)
    assert voxflat.check(given).euler_characteristic == 1


def test_a_file_mesh_is_read_as_its_file(tmp_path):
    (tmp_path / "white_left.gii").write_bytes(gifti_surface().to_bytes())
    surface = voxflat.surface(FileMesh(tmp_path / "white_left.gii"))
    assert surface.metadata["structure"] == "CortexLeft"
    assert surface.metadata["input"].endswith("white_left.gii")


def test_a_quadrilateral_of_meshio_is_cut_in_two():
    quads = meshio.Mesh([[0, 0], [1, 0], [1, 1], [0, 1]], [("quad", [[0, 1, 2, 3]])])
    assert len(voxflat.surface(quads).faces) == 2


def test_what_is_no_surface_is_told():
    refused(r"object: this object is not supported. Pass a path, a NumPy array, .*nilearn.*", voxflat.surface, object())
    refused("dict: this object is not supported", voxflat.surface, {"a": 1})
    refused("NoneType: this object is not supported", voxflat.surface, None)
    refused(r"PolyMesh: has the parts left, right. Pass one of them, such as .parts\['left'\]", voxflat.surface, BOTH)
    image = SurfaceImage(BOTH, PolyData(left=VALUES, right=VALUES))
    refused("two hemispheres. Pass .*, such as .mesh.parts", voxflat.surface, image)
    refused("PolyData: contains values, not a surface", voxflat.surface, PolyData(left=VALUES))
    refused("GiftiImage: contains values, not a surface", voxflat.surface, gifti_values())
    lines = meshio.Mesh([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])])
    refused(r"contains no triangles, quadrilaterals or polygons \(line\)", voxflat.surface, lines)


@pytest.fixture(scope="module")
def left():
    """Return the map of the surface of the left hemisphere."""
    return voxflat.flatten(gifti_surface(), relax=False)


OVERLAYS = {
    "GiftiImage": gifti_values,
    "Cifti2Image": cifti,
    "SurfaceImage": lambda: SurfaceImage(BOTH, PolyData(left=VALUES, right=-VALUES)),
    "PolyData": lambda: PolyData(left=VALUES, right=-VALUES),
    "one side": lambda: PolyData(left=VALUES),
}


@pytest.mark.medium
@pytest.mark.parametrize("kind", OVERLAYS)
def test_values_of_another_package_are_those_of_this_side(left, kind):
    given = OVERLAYS[kind]()
    np.testing.assert_array_equal(left.image(given, 1.0).data, left.image(VALUES, 1.0).data)
    assert len(left.plot(given).axes) == 3
    assert 0 < len(voxflat.surface(gifti_surface()).keep(gifti_values(values=np.float32(VALUES > 0)))) < COUNT


def test_values_of_another_surface_are_refused(left):
    right = gifti_values("CortexRight")
    refused("GiftiImage: belongs to the right hemisphere, but the surface belongs to the left one", left.image, right)
    refused("has 9 values, but the surface has 441", left.image, gifti_values(values=VALUES[:9]))
    refused("has values for right, but the surface belongs to CortexLeft", left.image, PolyData(right=VALUES))
    refused("has 9 values for left, but the surface has 441 points", left.image, PolyData(left=VALUES[:9]))
    unknown = voxflat.flatten(NILEARN, relax=False)
    refused("the hemisphere of the surface is unknown", unknown.image, PolyData(left=VALUES, right=-VALUES))


def test_labels_of_another_package_bring_their_table():
    labels = gifti_values(values=np.ones(COUNT, np.float32))
    label = nibabel.gifti.GiftiLabel(key=1, red=1.0, green=0.5, blue=0.0, alpha=1.0)
    label.label = "V1"
    labels.labeltable.labels.append(label)
    assert (own_table(labels).names, own_table(labels).colours) == ({1: "V1"}, {1: (255, 128, 0)})


@pytest.mark.medium
def test_maps_become_objects_of_other_packages(left):
    places = np.zeros((COUNT, 3))
    places[left.ids, :2] = left.uv
    nilearn, gifti, mesh, polydata = left.to_nilearn(), left.to_gifti(), left.to_trimesh(), left.to_pyvista()
    np.testing.assert_array_equal(nilearn.coordinates, places)
    np.testing.assert_array_equal(mesh.vertices, places)
    np.testing.assert_allclose(gifti.agg_data("pointset"), places, rtol=1e-6)
    np.testing.assert_array_equal(polydata.points[:, :2], left.uv)
    for faces in (nilearn.faces, mesh.faces, gifti.agg_data("triangle")):
        np.testing.assert_array_equal(faces, left.ids[left.faces])
    assert len(plotting.plot_surf(nilearn, VALUES, view="dorsal", engine="matplotlib").axes[0].collections) == 1
    back = voxflat.measure(gifti_surface(), nilearn)
    assert back.raw.relative_error == pytest.approx(left.distortion.raw.relative_error, abs=0.01)


def picture_of(value):
    return Image.open(io.BytesIO(base64.b64decode(value._repr_html_().split("base64,")[1].split('"')[0])))


@pytest.mark.medium
def test_jupyter_shows_a_picture_and_figures(left):
    assert picture_of(left).size[0] > 400
    assert "relative error, %" in left._repr_html_()
    surface = voxflat.surface(voxflat.samples.ball())
    opened, atlas = surface.cut(relax=False), surface.patches()
    told = {"extent, mm": surface, "cut 1, ": opened, "triangles": atlas, "stress-1": left.distortion}
    for said, value in told.items():
        page = value._repr_html_()
        assert page.startswith("<p><code>&lt;")
        assert said in page
        assert ("base64," in page) == (value is opened or value is atlas)
    red, green, _ = np.asarray(picture_of(opened).convert("RGB")).astype(int).transpose(2, 0, 1)
    assert 20 < (red > green + 100).sum() < 0.05 * red.size  # its cuts


@pytest.mark.medium
def test_plot_draws_on_given_axes(left):
    ax = Figure().add_subplot()
    assert left.plot(VALUES, ax=ax, title="effect") is ax
    assert len(ax.child_axes) == 3


def test_every_dataset_with_a_surface_is_a_surface_with_its_own_vertex_numbers():
    ball = pv.Sphere()
    x, y = np.meshgrid(np.arange(9.0), np.arange(7.0), indexing="ij")
    for dataset in (ball.cast_to_unstructured_grid(), pv.StructuredGrid(x, y, x * y / 9)):
        surface = voxflat.surface(dataset)
        assert len(surface) == dataset.n_points
        np.testing.assert_allclose(surface.points, dataset.points[surface.ids])
        assert surface.metadata["unit"] == "unknown"
    block = pv.ImageData(dimensions=(5, 5, 5)).cast_to_unstructured_grid()
    shell = voxflat.surface(block)
    assert (len(shell), shell.core.topology()["loops"]) == (5**3 - 3**3, [])
    np.testing.assert_allclose(shell.points, block.points[shell.ids])
    both = voxflat.surface(pv.MultiBlock([ball, pv.MultiBlock([ball.translate((9, 0, 0))])]))
    assert len(both.core.topology()["components"]) == 2
    refused("ImageData: no array of the image is active", voxflat.surface, pv.ImageData(dimensions=(4, 4, 4)))
    refused("UnstructuredGrid: has no points", voxflat.surface, pv.UnstructuredGrid())


def test_a_trimesh_scene_is_placed_and_a_known_unit_is_kept():
    ball = trimesh.creation.icosphere()
    ball.units = "mm"
    assert "unit" not in voxflat.surface(ball).metadata
    ball.units = "feet"
    assert any("feet" in warning for warning in voxflat.surface(ball).warnings)
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([7, 0, 0]))
    np.testing.assert_allclose(voxflat.surface(scene).points.mean(axis=0), [7, 0, 0], atol=1e-9)


def _datasets():
    x, y = np.meshgrid(np.arange(9.0), np.arange(7.0), indexing="ij")
    grid = pv.StructuredGrid(x, y, np.sin(2 * x) * np.cos(3 * y))
    image = pv.ImageData(dimensions=(24, 24, 24))
    image["labels"] = voxflat.samples.ball().ravel(order="F")
    corners = np.column_stack([np.full(48, 4), grid.cast_to_unstructured_grid().cell_connectivity.reshape(-1, 4)])
    return {
        "structured": grid,
        "unstructured": grid.cast_to_unstructured_grid(),
        "quadrilaterals": pv.PolyData(grid.points, corners.ravel()),
        "solid": pv.ImageData(dimensions=(5, 4, 3)).cast_to_unstructured_grid(),
        "strips": pv.Icosphere(nsub=1).strip(),
        "lines too": pv.Icosphere(nsub=1).append_polydata(pv.Line()),
        "image": image,
        "points only": pv.PolyData(np.eye(3)),
        "nothing": pv.UnstructuredGrid(),
        "no array": pv.ImageData(dimensions=(4, 4, 4)),
    }


def _tried(work):
    try:
        return work()
    except voxflat.InputError as error:
        return str(error).split(": ")[-1]


@pytest.mark.parametrize("kind", _datasets())
def test_every_dataset_has_the_same_surface_at_every_door(kind):
    given = _datasets()[kind]
    own = _tried(lambda: voxflat.surface(given))
    raw = getattr(vtk, given.GetClassName())()
    raw.ShallowCopy(given)
    others = [_tried(lambda: voxflat.surface(raw)), _tried(given.voxflat.surface)]
    others.append(_tried(lambda: pv.MultiBlock([given]).voxflat.surface()[0]))
    if isinstance(own, str):
        assert others == [own] * 3
        return
    triangles = own.points[own.faces]
    np.testing.assert_array_equal(others[0].points[others[0].faces], triangles)
    for polydata in others[1:]:
        np.testing.assert_array_equal(np.asarray(polydata.points)[polydata.regular_faces], triangles)
    if kind != "image":
        joined = voxflat.surface(pv.MultiBlock([given]))
        np.testing.assert_array_equal(joined.points[joined.faces], triangles)
    assert any("lines and points" in one for one in own.warnings) == (kind == "lines too")


@pytest.mark.medium
def test_a_cut_surface_and_maps_of_parts_are_measured_like_the_map_itself():
    part = HILL.disk(220, 9.0)
    for surface in (part, voxflat.surface(voxflat.samples.ball())):
        opened = surface.cut()
        flat = opened.flatten()
        expected = voxflat.measure(surface, flat).raw.relative_error
        for given, of in ((opened, flat), (surface, flat.to_pyvista()), (opened, flat.to_pyvista())):
            assert voxflat.measure(given, of).raw.relative_error == pytest.approx(expected, rel=1e-6)
        for work in (voxflat.surface, voxflat.check):
            refused("is cut open already. Call its methods, or pass its `whole`", work, opened)


OWN_UNITS = {"mm": 1 / 25.4, "µm": 1e-3 / 25.4, "nm": 1e-6 / 25.4, "cm": 10 / 25.4, "m": 1000 / 25.4, "inch": 1.0}


@pytest.mark.parametrize("units", sorted(trimesh.units.keys() | {"um", "micrometers", "nm"}))
def test_every_unit_of_trimesh_is_kept_or_counts_as_unknown_with_a_warning(units):
    inches = {"nm": 1e-6 / 25.4, "um": 1e-3 / 25.4, "micrometers": 1e-3 / 25.4}.get(units) or trimesh.units.to_inch(
        units
    )
    known = [unit for unit, size in OWN_UNITS.items() if np.isclose(inches, size, rtol=1e-9)]
    ball = trimesh.creation.icosphere(subdivisions=1)
    ball.units = units
    for given in (ball, trimesh.Scene(ball)):
        if given is not ball:
            given.units = units
        surface = voxflat.surface(given)
        assert surface.metadata.get("unit", "mm") == (known[0] if known else "unknown")
        assert [units in warning for warning in surface.warnings] == [True] * (not known)
        assert voxflat.surface(given, unit=known[0] if known else "nm").warnings == ()
        if known and known != ["mm"]:
            refused(f"mesh defines its coordinates in {known[0]}", voxflat.surface, given, unit="mm")


@pytest.mark.parametrize("unit", OWN_UNITS)
def test_units_return_from_trimesh(unit):
    flat = voxflat.surface((POINTS, FACES), unit=unit).flatten(relax=False)
    made = flat.to_trimesh()
    np.testing.assert_allclose(trimesh.units.to_inch(made.units), OWN_UNITS[unit], rtol=1e-9)
    assert voxflat.surface(made).metadata.get("unit", "mm") == unit


@pytest.mark.medium
def test_partners_in_another_unit_are_refused():
    white, pial = (trimesh.Trimesh(POINTS + np.array([0, 0, lift]), FACES, process=False) for lift in (0, 1))
    white.units, pial.units = "mm", "um"
    refused("the pial surface is in µm, but the surface is in mm", voxflat.surface, white, pial=pial)
    flat = voxflat.surface(white).flatten(relax=False).to_trimesh()
    assert voxflat.measure(white, flat).raw.relative_error < 0.1
    refused("the map is in mm, but the surface is in µm", voxflat.measure, pial, flat)


def test_mirrored_parts_of_a_scene_keep_their_outside():
    ball = trimesh.creation.icosphere(subdivisions=1)
    scene = trimesh.Scene()
    scene.add_geometry(ball)
    scene.add_geometry(ball, transform=np.diag([-1.0, 1, 1, 1]) + np.array([[0, 0, 0, 5.0], *np.zeros((3, 4))]))
    read = of_scene(scene)
    a, b, c = (read["points"][read["faces"][:, corner]] for corner in range(3))
    volumes = np.einsum("fx,fx->f", a - [[5.0, 0, 0]] * (a[:, :1] > 2.5), np.cross(b - a, c - a)) / 6
    np.testing.assert_allclose(volumes.reshape(2, -1).sum(axis=1), ball.volume)


def test_records_hold_the_values_of_an_affine_and_the_hash_of_long_arrays():
    affine, many = np.diag([2.0, 2, 3, 1]), np.arange(64, dtype=">f4").reshape(2, 32)
    assert described({"affine": affine, "seeds": tuple(range(20))}) == {
        "affine": affine.tolist(),
        "seeds": [*range(20)],
    }
    little = hashlib.sha256(struct.pack("<64f", *range(64))).hexdigest()
    assert described(many) == {"dtype": "float32", "shape": [2, 32], "sha256": little}
    for array in (many.astype("<f4"), np.asfortranarray(many)):
        assert described(array) == described(many)
    assert described(many + 1) != described(many) != described(many.reshape(32, 2))
    for shape in ((2**20 + 3,), (2**19 + 3, 3)):  # hashed in several blocks
        long = np.asfortranarray(np.random.default_rng(0).random(shape, np.float32))
        assert described(long)["sha256"] == hashlib.sha256(long.tobytes("C")).hexdigest()
