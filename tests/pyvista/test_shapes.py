"""All operations on all kinds of datasets, and PyVista's shapes, which are flattened or rejected with the reason."""

import composed
import numpy as np
import pytest
import pyvista as pv
from command_line import succeed
from numpy.testing import assert_array_equal
from pyvista import examples
from refusals import refused
from triangle_meshes import ON_BOWL, write_bowl

import voxflat

ALGORITHM = {"algorithm": "dataset_surface"} if pv.version_info >= (0, 47) else {}
QUICK = {"method": voxflat.methods.Voxflat(sources=8), "relax": False}


def surface_of(dataset):
    return dataset.extract_surface(**ALGORITHM)


def rectilinear():
    whole = examples.load_rectilinear()
    return pv.RectilinearGrid(whole.x[::8], whole.y[::8], whole.z[::8])


def structured():
    return examples.load_structured().extract_subset((0, 79, 0, 79, 0, 0), (8, 8, 1))


def image():
    made = examples.load_uniform()
    made["mask"] = (made["Spatial Point Data"] > 90).astype(np.uint8)
    return made


DATASETS = {
    "PolyData of triangles": lambda: examples.load_sphere().clip("z").triangulate(),
    "PolyData of quads": lambda: surface_of(structured()),
    "PolyData of strips": lambda: surface_of(structured()).triangulate().strip(),
    "StructuredGrid": structured,
    "RectilinearGrid": rectilinear,
    "UnstructuredGrid of hexahedra": examples.load_hexbeam,
    "UnstructuredGrid of tetrahedra": examples.load_tetbeam,
    "ExplicitStructuredGrid": examples.load_explicit_structured,
    "ImageData": image,
    "MultiBlock": lambda: pv.MultiBlock({"grid": structured(), "beam": examples.load_hexbeam()}),
}
NO_MESH = {"geodesic", "path"}  # for an image, only its surface has distances
OF_ONE = {"texture", "plot", "morph"}  # apply to a single block


def called(verb, mesh):
    """Return the result of an operation with fast options, and the expected type."""
    of = mesh.voxflat
    calls = {
        "measure": (lambda: of.measure(of(**QUICK), sources=5), pv.PolyData),
        "__call__": (lambda: of(**QUICK), pv.PolyData),
        "flatten": (lambda: of.flatten(**QUICK), voxflat.FlatMap),
        "surface": (of.surface, pv.PolyData),
        "check": (of.check, voxflat.surfaces.findings.Check),
        "geodesic": (lambda: of.geodesic(0), type(mesh)),
        "path": (lambda: of.path(0, 7), pv.PolyData),
        "patches": (lambda: of.patches(max_angle=30), pv.PolyData),
        "cut": (lambda: of.cut(relax=False), pv.PolyData),
        "texture": (lambda: of.texture(np.zeros((4, 4), dtype=np.uint8), **QUICK), tuple),
        "plot": (lambda: of.plot(show=False, off_screen=True, **QUICK), pv.Plotter),
        "morph": (lambda: of.morph(2, **QUICK), object),
    }
    call, kind = calls[verb]
    if isinstance(mesh, pv.MultiBlock):
        kind = dict if verb in ("flatten", "check") else pv.MultiBlock
    return call(), kind


VERBS = ("__call__", "flatten", "surface", "check", "geodesic", "path", "patches", "cut", "measure", *sorted(OF_ONE))


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("dataset", DATASETS)
def test_every_verb_on_every_dataset(dataset, verb):
    mesh = DATASETS[dataset]()
    if dataset == "MultiBlock":
        check_blocks(mesh, verb)
        return
    mesh.point_data["number"] = np.arange(mesh.n_points)
    mesh.cell_data["cell"] = np.arange(mesh.n_cells)
    if dataset == "ImageData":
        mesh.set_active_scalars("mask", preference="point")
    before = mesh.copy()
    if dataset == "ImageData" and verb in NO_MESH:
        refused(r"Extract its surface first: image\.voxflat\.surface\(\)", called, verb, mesh)
        return
    result, kind = called(verb, mesh)
    assert isinstance(result, kind)
    assert mesh == before
    if verb in ("__call__", "patches", "cut", "measure") and dataset != "ImageData":
        assert_array_equal(result["number"], result["vertex_ids"])
        corners = result["vertex_ids"][result.regular_faces].tolist()
        for cell, triangle in zip(result["cell"], corners, strict=True):
            assert set(triangle) <= set(mesh.get_cell(cell).point_ids)
        places = result.points if verb == "cut" else result["surface_points"]
        assert np.abs(places - mesh.points[result["number"]]).max() < 1e-5
    if verb == "path":
        assert result["vertex_ids"][[0, -1]].tolist() == [0, 7]
    if verb == "surface":
        assert result.n_cells == surface_of(mesh).triangulate().n_cells or dataset == "ImageData"
        assert result.connectivity()["RegionId"].max() == 0
    if verb == "check":
        assert result.can_flatten
    if verb == "patches":
        assert result.active_scalars_name == "patch"
    if verb == "morph":
        assert result[0].n_points == result[1].n_points
    if verb == "plot":
        result.close()


def check_blocks(blocks, verb):
    before = blocks.copy()
    if verb in OF_ONE | NO_MESH:
        with pytest.raises(AttributeError, match=r"Call it on one block: blocks\['grid'\]"):
            called(verb, blocks)
        return
    result, kind = called(verb, blocks)
    assert isinstance(result, kind)
    assert list(result.keys()) == ["grid", "beam"]
    assert blocks == before
    for name in result.keys():  # noqa: SIM118 (a MultiBlock)
        alone, kind = called(verb, before[name])
        assert isinstance(result[name], kind)
        if isinstance(alone, pv.PolyData):
            assert result[name] == alone


def test_what_is_no_surface_is_refused_by_every_verb():
    for nothing in (pv.PointSet(np.eye(3)), pv.Line(), pv.Spline(np.eye(3), 9), pv.UnstructuredGrid()):
        for verb in VERBS:
            refused("has no (faces|points)", called, verb, nothing)


def coarse(name):
    return getattr(pv, f"Parametric{name}")(u_res=11, v_res=11)


PLAIN = ("Cube", "Triangle", "Rectangle", "Quadrilateral", "Tetrahedron", "Octahedron", "Icosahedron", "Dodecahedron")
SHAPES = {
    **{name: {} for name in (*PLAIN, "Pyramid")},
    **{name: {"resolution": 12} for name in ("Cylinder", "Cone", "Circle", "Ellipse")},
    **{name: {"theta_resolution": 8, "phi_resolution": 8} for name in ("Sphere", "Superquadric")},
    "SolidSphere": {"theta_resolution": 7, "phi_resolution": 7, "radius_resolution": 3},
    "Icosphere": {"nsub": 1},
    "CylinderStructured": {"radius": 1, "theta_resolution": 12, "z_resolution": 4},
    "Box": {"level": 2},
    "Plane": {"i_resolution": 4, "j_resolution": 4},
    "Disc": {"r_res": 3, "c_res": 12},
    "Polygon": {"n_sides": 7},
    "Capsule": {"resolution": 8},
    "Tube": {"n_sides": 8, "resolution": 3, "capping": True},
    "Arrow": {"tip_resolution": 8, "shaft_resolution": 8},
}
CURVED = ("Torus", "Dini", "Enneper", "RandomHills", "ConicSpiral", "Ellipsoid", "SuperEllipsoid", "SuperToroid")
CURVED += ("PluckerConoid", "BohemianDome", "Bour", "CatalanMinimal", "Henneberg", "Kuen", "Pseudosphere")
FLAT = {
    **{name: lambda name=name: getattr(pv, name)(**SHAPES[name]) for name in SHAPES},
    **{f"Parametric{name}": lambda name=name: coarse(name) for name in CURVED},
    "Cylinder, joined": lambda: pv.Cylinder(resolution=12).clean(),
    "Cylinder, open": lambda: pv.Cylinder(resolution=12, capping=False),
    "Text3D": lambda: pv.Text3D("o", depth=0.2),
    "contour of a Wavelet": lambda: pv.Wavelet(extent=(-4, 4, -4, 4, -4, 4)).contour([150]),
}
REFUSED = {
    "Mobius": "An edge must be at least 1e-10 times|has only one side, like a Möbius strip",
    "Boy": "has only one side, like a Möbius strip",
    "Klein": "has only one side, like a Möbius strip",
    "CrossCap": r"has no area .*mesh\.clean\(\)",
    "Roman": r"has no area .*mesh\.clean\(\)",
}


@pytest.mark.medium
@pytest.mark.parametrize("name", FLAT)
def test_shapes_are_flattened(name, caplog):
    mesh = FLAT[name]()
    flat = mesh.voxflat(relax=False)
    assert not flat["flipped"].any()
    assert (flat.compute_cell_sizes()["Area"] > 0).all()
    triangles = surface_of(mesh).triangulate().n_cells
    if flat.n_cells < triangles:  # a warning reports the removed triangles
        assert "the largest" in caplog.text or "have no area and were removed" in caplog.text
    assert len(flat["areal"]) == len(flat["angle"]) == flat.n_points
    assert len(flat["isometric"]) == len(flat["flipped"]) == flat.n_cells


@pytest.mark.parametrize("name", REFUSED)
def test_shapes_that_cannot_be_flat_are_refused_with_the_reason(name):
    refused(REFUSED[name], coarse(name).voxflat)


@pytest.mark.slow
def test_the_same_map_through_every_door(tmp_path, caplog):
    """Function, command line, accessor and filter give bit-identical arrays for a mesh in a file."""
    mesh = pv.read(write_bowl(tmp_path / "bowl.vtp"))
    options, given = ON_BOWL, composed.with_method(ON_BOWL)
    own = composed.flatten(str(tmp_path / "bowl.vtp"), **options)
    words = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    succeed("flatten", tmp_path / "bowl.vtp", *words, "-o", tmp_path / "map.npz")
    by_command = voxflat.load(tmp_path / "map.npz")
    flat = mesh.voxflat(**given)
    flatten = voxflat.vtk.FlattenSurface(**given)
    flatten.SetInputData(mesh)
    flatten.Update()
    filtered = pv.wrap(flatten.GetOutput())
    assert len(own) == mesh.n_points
    for other in (by_command, mesh.voxflat.flatten(**given)):
        for name in ("uv", "ids", "faces", "points"):
            assert getattr(other, name).tobytes() == getattr(own, name).tobytes()
        assert other.distortion.per_point.tobytes() == own.distortion.per_point.tobytes()
        assert other.distortion.triangles.areal.tobytes() == own.distortion.triangles.areal.tobytes()
    for other in (flat, filtered):
        assert np.ascontiguousarray(other.points[:, :2]).tobytes() == own.uv.tobytes()
        assert_array_equal(other["vertex_ids"], own.ids)
        assert other["distance_error"].tobytes() == own.distortion.per_point.tobytes()
        assert other["areal"].tobytes() == own.distortion.triangles.areal.tobytes()


def test_all_components_become_blocks_by_area(caplog):
    near = pv.Plane(i_size=4, j_size=4).triangulate()
    both = near.merge(pv.Plane(center=(30, 0, 0), i_size=9, j_size=9).triangulate())
    both.point_data["height"] = np.arange(both.n_points)
    blocks = both.voxflat(components="all", relax=False)
    assert blocks.keys() == ["component 1", "component 2"]
    assert [round(np.ptp(block.points[:, 0])) for block in blocks] == [9, 4]
    for block in blocks:
        assert_array_equal(block["height"], both["height"][block["vertex_ids"]])
    refused("components is 'each'", both.voxflat, components="each")
    refused("cannot be combined", both.voxflat, components="all", keep=np.ones(both.n_points, bool))
