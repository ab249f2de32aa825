"""Problems reported for other tools, solved with voxflat; docs/decisions/0038-reports.md lists them."""

from pathlib import Path

import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
import trimesh
from anatomy import fsaverage5, fsaverage5_file
from hard_shapes import signed_areas
from mesh_files import grid
from nilearn import datasets, plotting, surface
from PIL import Image
from scipy.spatial import Delaunay

import voxflat
from voxflat.figures import Overlay, flat_map, save

pytestmark = pytest.mark.slow

LAYNII = Path(__file__).parent / "data" / "laynii" / "occipital_midGM.nii.gz"


def error(one):
    return one.distortion.raw.relative_error


@pytest.fixture(scope="module")
def hemispheres():
    """Maps of both hemispheres of fsaverage5 along standard cuts."""
    return [
        voxflat.surface(fsaverage5_file("white", side), pial=fsaverage5_file("pial", side))
        .cut("standard", sphere=fsaverage5_file("sphere", side))
        .flatten()
        for side in ("left", "right")
    ]


@pytest.fixture(scope="module")
def motor():
    """A contrast in MNI space, as a volume and on fsaverage5."""
    image = nib.load(datasets.load_sample_motor_activation_image())
    return image, surface.vol_to_surf(image, str(fsaverage5_file("pial", "left")))


# ------------------------------------------------------------------------------ pycortex, PySurfer, MNE


def test_a_cut_patch_is_flattened_without_folds(tmp_path):
    """pycortex 376, 419: the cuts are saved as FreeSurfer's patch."""
    white = voxflat.surface(fsaverage5_file("white", "left"))
    white.save(tmp_path / "lh.white")
    white.cut("standard", sphere=fsaverage5_file("sphere", "left")).save(tmp_path / "lh.cortex.patch.3d")
    found = voxflat.surface(tmp_path / "lh.white").keep(tmp_path / "lh.cortex.patch.3d").flatten()
    assert error(found) < 0.13
    assert found.distortion.triangles.flipped == 0


def test_both_hemispheres_are_in_the_picture(hemispheres, tmp_path):
    """pycortex 331."""
    save(flat_map(hemispheres), tmp_path / "both.png")
    ink = np.asarray(Image.open(tmp_path / "both.png").convert("L")) < 250
    assert min(half.mean() for half in np.array_split(ink[: int(0.8 * len(ink))], 2, axis=1)) > 0.2


def test_flat_files_are_what_viewers_open(hemispheres, tmp_path):
    """pycortex 121, 469: GIFTI has the triangles of the surface."""
    left = hemispheres[0]
    left.save(tmp_path / "lh.flat.surf.gii")
    points, faces = nib.load(tmp_path / "lh.flat.surf.gii").agg_data()
    used = np.unique(faces)
    assert len(points) == 10242
    assert set(used) <= set(left.ids)
    assert np.ptp(points[used, 2]) == 0


def test_hemispheres_lie_alike(hemispheres):
    """pycortex 488: directions agree with the standard frame."""
    for one in hemispheres:
        towards = np.linalg.lstsq(one.uv - one.uv.mean(axis=0), one.points - one.points.mean(axis=0), rcond=None)[0]
        up = towards[:, 2]
        assert up[1] > abs(up[0])


def test_points_of_the_map_are_vertices_of_the_surface(hemispheres, tmp_path):
    """MNE 8081, PySurfer 214: a patch has the vertex numbers of the surface."""
    left = hemispheres[0]
    left.save(tmp_path / "lh.flat.patch.3d")
    white, pial = (nib.load(fsaverage5_file(kind, "left")).agg_data("pointset") for kind in ("white", "pial"))
    np.testing.assert_allclose(left.points, ((white + pial) / 2)[left.ids], atol=1e-4)
    other = np.fromfile(tmp_path / "lh.flat.patch.3d", dtype=">i4", count=2)
    assert other[0] == -1
    assert 0.98 < other[1] / len(np.unique(left.ids)) <= 1  # without one side of each cut


def test_a_volume_in_mni_space_lies_on_a_template(hemispheres, motor):
    """pycortex 322, nilearn 4312."""
    image, of_vertices = motor
    sampled = hemispheres[0].image(image, 2.0, fraction=0.5).data
    values = hemispheres[0].raster(2.0).interpolate(of_vertices[hemispheres[0].ids])
    seen = np.isfinite(sampled) & np.isfinite(values)
    assert np.corrcoef(sampled[seen], values[seen])[0, 1] > 0.8


def test_other_structures_are_flattened():
    """pycortex 154: a deep nucleus, here an ellipsoid of its size."""
    x, y, z = np.indices((40, 30, 30)) - np.array([20, 15, 15])[:, None, None, None]
    thalamus = (x / 15.0) ** 2 + (y / 9.0) ** 2 + (z / 8.0) ** 2 < 1
    assert error(voxflat.flatten(thalamus)) < 0.1
    assert voxflat.surface(thalamus).cut().cuts[0].reason == "closed sphere"


# ------------------------------------------------------------------------------------ autoflatten, BFF


def test_what_is_no_disk_becomes_one():
    """autoflatten 64 and 24, BFF 87: a torus with holes, and a second component."""
    ring = pv.ParametricTorus(ringradius=30, crosssectionradius=9).triangulate().clean()
    holes = np.random.default_rng(0).choice(ring.n_points, 3, replace=False)
    pieces = ring.remove_points(holes)[0].extract_surface() + pv.Sphere(radius=4, center=(90, 0, 0))
    opened = voxflat.surface(pieces.triangulate()).cut()
    topology = opened.surface.core.topology()
    assert (topology["handles"], len(topology["loops"])) == (0, 1)
    assert opened.flatten().distortion.triangles.flipped == 0


def test_edges_of_three_triangles_are_named():
    """BFF 87: without repair, the error names the edge that is not manifold."""
    points = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, -10, 0], [0, 0, 10.0]])
    with pytest.raises(voxflat.InputError, match="edge"):
        voxflat.surface((points, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])), repair="none")


def test_equal_holes_stay_equal():
    """BFF 89, 33: a developable plate with two equal holes."""
    plate = pv.Plane(i_size=60, j_size=40, i_resolution=60, j_resolution=40).triangulate()
    middle = plate.cell_centers().points
    is_hole = (np.abs(np.abs(middle[:, 0]) - 15) < 6) & (np.abs(middle[:, 1]) < 8)
    folded = plate.extract_cells(~is_hole).extract_surface()
    angle = folded.points[:, 0] / 25
    folded.points = np.column_stack([25 * np.sin(angle), folded.points[:, 1], 25 * np.cos(angle)])
    found = voxflat.flatten(folded)
    areas, side = np.abs(signed_areas(found.uv, found.faces)), np.sign(found.points[found.faces].mean(axis=1)[:, 0])
    assert areas[side < 0].sum() == pytest.approx(areas[side > 0].sum(), rel=0.01)
    assert found.distortion.triangles.flipped == 0


def test_arms_do_not_overlap():
    """BFF 12: a closed body with long arms."""
    body = np.zeros((64, 64, 30), dtype=bool)
    x, y, z = np.indices(body.shape)
    body |= (x - 32) ** 2 + (y - 32) ** 2 + (z - 15) ** 2 < 100
    for at in (12, 32, 52):
        body |= (y - at) ** 2 + (z - 15) ** 2 < 12
        body |= (x - at) ** 2 + (z - 15) ** 2 < 12
    body[:, :, :4] = body[:3] = body[-3:] = body[:, :3] = body[:, -3:] = False
    found = voxflat.flatten(body)
    assert found.distortion.triangles.covering == 0
    assert found.distortion.triangles.flipped == 0


@pytest.mark.parametrize("sides", [8, 80])
def test_a_tube_becomes_a_strip(sides):
    """BFF 97: a tube with few or many triangles."""
    tube = pv.Cylinder(radius=10, height=60, resolution=sides, capping=False).triangulate().subdivide(2)
    found = voxflat.flatten(tube)
    assert error(found) < 0.01
    assert sorted(np.ptp(found.uv, axis=0)) == pytest.approx([60, 2 * sides * 10 * np.sin(np.pi / sides)], rel=0.03)


def test_vertices_and_places_on_the_map_correspond(hemispheres):
    """BFF 28."""
    left = hemispheres[0]
    a, b, _ = left.faces.T
    lengths, flat = (np.linalg.norm(places[a] - places[b], axis=1) for places in (left.points, left.uv))
    assert np.corrcoef(lengths, flat)[0, 1] > 0.5


# ----------------------------------------------------------------------------------- nilearn, neuromaps


@pytest.mark.parametrize("kind", ["path", "text", "array", "image"])
def test_values_come_as_they_are_at_hand(hemispheres, kind, tmp_path):
    """nilearn 2603."""
    path = fsaverage5_file("sulc", "left")
    given = {"path": path, "text": str(path), "array": fsaverage5("left")["sulc"], "image": nib.load(path)}[kind]
    save(flat_map(hemispheres[0], given), tmp_path / "sulc.png")
    assert (tmp_path / "sulc.png").stat().st_size > 20_000


def test_a_map_has_a_threshold(hemispheres, motor, tmp_path):
    """nilearn 2747: values below the threshold are hidden."""
    shown = []
    for threshold in (None, 3.0, 100.0):
        save(flat_map(hemispheres[0], Overlay(motor[1], threshold=threshold)), tmp_path / "map.png")
        pixels = np.asarray(Image.open(tmp_path / "map.png").convert("RGB")).astype(int)
        shown.append((np.ptp(pixels, axis=2) > 40).mean())
    assert shown[0] > 3 * shown[1] > 9 * shown[2]


def test_every_resolution_of_a_template_is_flattened(hemispheres):
    """nilearn 3171: nilearn draws the map with values of the surface."""
    mesh = hemispheres[0].to_nilearn()
    figure = plotting.plot_surf(mesh, np.zeros(len(mesh.coordinates)), engine="matplotlib", view="dorsal")
    assert len(mesh.coordinates) == 10242
    assert figure.axes


def test_right_is_right(hemispheres):
    """nilearn 1745: the side is determined by the folds, not by the file name."""
    assert voxflat.surface(fsaverage5_file("white", "right")).register().side == "right"


def test_values_all_equal_are_drawn(hemispheres, tmp_path):
    """neuromaps 197."""
    save(flat_map(hemispheres[0], Overlay(np.ones(10242, dtype=np.float32))), tmp_path / "ones.png")
    assert (tmp_path / "ones.png").exists()


# ---------------------------------------------------------------------------------------------- LayNii


def test_a_patch_around_a_control_point_is_flattened():
    """LayNii 48, 75: the middle of grey matter; the error for an absent label lists the labels."""
    sheet = nib.load(LAYNII)
    found = voxflat.surface(sheet, threshold=0).disk((53, 49, 57), 20.0).flatten()
    assert error(found) < 0.08
    assert np.linalg.norm(found.points - sheet.affine[:3] @ (53, 49, 57, 1), axis=1).min() < 1
    with pytest.raises(voxflat.InputError, match="no voxel has label 7; the volume has labels 1, 2"):
        voxflat.surface(sheet, label=7)


# ------------------------------------------------------------------- PyVista, pygeodesic, pmp, napari


def test_distances_on_a_loaded_mesh(tmp_path):
    """pyvista-support 233, pygeodesic 14: duplicate points, and separate components."""
    solid = np.zeros((30, 30, 60))
    x, y, z = np.indices(solid.shape)
    solid = np.minimum(np.hypot(np.hypot(x - 15, y - 15), z - 15), np.hypot(np.hypot(x - 15, y - 15), z - 44)) - 9.6
    grid = pv.ImageData(dimensions=solid.shape)
    grid["values"] = solid.ravel(order="F")
    soup = grid.contour([0.0]).triangulate()
    loose = trimesh.Trimesh(soup.points[soup.regular_faces].reshape(-1, 3), np.arange(3 * soup.n_cells).reshape(-1, 3))
    trimesh.Trimesh(loose.vertices, loose.faces, process=False).export(tmp_path / "soup.obj")
    made = voxflat.surface(tmp_path / "soup.obj")
    for side in (made.points[:, 2] < 30, made.points[:, 2] > 30):
        source = made.ids[np.flatnonzero(side)[0]]
        rows = made.geodesic([source])
        assert len(rows.points) == side.sum()
        assert rows[0].max() == pytest.approx(np.pi * 9.6, rel=0.03)
        place = made.points[made.find([source])[0]]
        assert (rows[0] >= np.linalg.norm(rows.points - place, axis=1) - 1e-4).all()
    with pytest.raises(voxflat.InputError, match="lie on 2 separate components"):
        made.geodesic(made.ids[[np.argmin(made.points[:, 2]), np.argmax(made.points[:, 2])]])


def test_distance_from_a_line():
    """pmp 78: the distance is the minimum over several sources."""
    plane = pv.Plane(i_size=20, j_size=20, i_resolution=20, j_resolution=20).triangulate()
    rows = voxflat.surface(plane).geodesic(np.flatnonzero(np.isclose(plane.points[:, 0], -10)))
    np.testing.assert_allclose(np.min(rows, axis=0), plane.points[:, 0] + 10, atol=1e-5)


def test_a_mesh_gets_texture_coordinates_and_stays():
    """UVgami 15."""
    mesh = pv.examples.load_nut() if hasattr(pv.examples, "load_nut") else pv.examples.load_ant()
    mesh = mesh.extract_surface().triangulate().clean()
    before = mesh.points.copy()
    flat = mesh.voxflat()
    np.testing.assert_array_equal(mesh.points, before)
    assert flat.active_texture_coordinates is not None
    assert ((flat.active_texture_coordinates >= 0) & (flat.active_texture_coordinates <= 1)).all()


def test_micrometres_of_an_image_are_kept(tmp_path):
    """brainrender-napari 140: a stack with sizes in µm and its mesh coincide."""
    tifffile = pytest.importorskip("tifffile")
    ball = (np.linalg.norm(np.indices((30, 30, 30)) - 15, axis=0) < 10).astype(np.uint8)
    size = {f"PhysicalSize{axis}": 25.0 for axis in "XYZ"}
    tifffile.imwrite(tmp_path / "ball.ome.tif", ball, metadata={"axes": "ZYX", **size})
    made = voxflat.surface(tmp_path / "ball.ome.tif")
    assert np.ptp(made.points, axis=0) == pytest.approx(3 * [20 * 25.0], abs=50)  # µm


def test_meshes_of_vtk_take_values_of_volumes(tmp_path):
    """nighres 106."""
    pv.Sphere(radius=10).save(tmp_path / "white.vtk")
    affine = np.eye(4)
    affine[:3, 3] = -20
    along_x = nib.Nifti1Image(np.indices((40, 40, 40))[0].astype(np.float32) - 20, affine)
    found = voxflat.flatten(tmp_path / "white.vtk")
    sampled, truth = found.image(along_x, 0.5).data, found.raster(0.5).interpolate(found.points[:, 0])
    np.testing.assert_allclose(sampled, truth, atol=0.2, equal_nan=True)


# ------------------------------------------------------------------------------ distances


DART = np.array([[0, 0, 0], [1, -3, 0], [2, 0, 0], [1, 3, 0]], dtype=float), np.array([[0, 1, 2], [0, 2, 3]])
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=float), np.array([[0, 1, 2]])
EVERY_WAY = pytest.mark.parametrize("geodesic", ["exact", "marching", "graph"])


@EVERY_WAY
def test_distances_on_the_smallest_meshes(geodesic):
    """potpourri3d 5 and 30, pygeodesic 17, with the meshes of the reports: distances to the vertices are edges."""
    for points, faces in (DART, CORNER):
        for source, expected in enumerate(np.linalg.norm(points[:, None] - points, axis=2)):
            found = voxflat.surface((points, faces)).geodesic([source], geodesic=geodesic)[0]
            neighbours = np.unique(faces[(faces == source).any(axis=1)])
            np.testing.assert_allclose(found[neighbours], expected[neighbours], rtol=1e-4)


@pytest.mark.parametrize(("geodesic", "tolerance"), [("exact", 1e-6), ("marching", 1e-6), ("graph", 0.003)])
def test_distances_in_a_square_are_straight(geodesic, tolerance):
    """gptoolbox 31, with the mesh of the report: the diagonal of the unit square is √2."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(101) / 100, np.arange(101) / 100))
    square = voxflat.surface((np.column_stack([x, y, 0 * x]), Delaunay(np.column_stack([x, y])).simplices))
    found = square.geodesic([0], geodesic=geodesic)[0]
    np.testing.assert_allclose(found, np.hypot(x, y), atol=tolerance)


@EVERY_WAY
def test_neighbours_are_an_edge_away(geodesic):
    """libigl 2442."""
    ball = trimesh.creation.icosphere(4)
    found = voxflat.surface(ball).geodesic([7], geodesic=geodesic)[0]
    neighbours = ball.vertex_neighbors[7]
    lengths = np.linalg.norm(ball.vertices[neighbours] - ball.vertices[7], axis=1)
    np.testing.assert_allclose(found[neighbours], lengths, rtol=1e-5)


def test_distances_from_the_whole_border():
    """compas 538, compas_cgal 73: many sources at once."""
    plane = pv.Plane(i_size=20, j_size=20, i_resolution=20, j_resolution=20).triangulate()
    inside = 10 - np.abs(plane.points[:, :2]).max(axis=1)
    found = plane.voxflat.geodesic(np.flatnonzero(inside < 1e-6), method="exact")
    np.testing.assert_allclose(found["geodesic_distance"], inside, atol=1e-5)


def test_a_path_between_components_and_across_a_triangle_soup():
    """potpourri3d 3: the message says why there is none; triangles without shared vertices are joined."""
    one = pv.Plane(i_resolution=5, j_resolution=5).triangulate()
    two = one.merge(one.translate((3, 0, 0)))
    with pytest.raises(voxflat.InputError, match="no path connects 0 and 71: they lie in different components"):
        two.voxflat.path(0, 71)
    soup = one.points[one.regular_faces].reshape(-1, 3)
    along = voxflat.surface((soup, np.arange(len(soup)).reshape(-1, 3))).path(0, len(soup) - 1)
    assert along.length == pytest.approx(np.linalg.norm(soup[-1] - soup[0]), rel=0.02)


# ------------------------------------------------------------------------------ libigl, BFF, scrolls


def test_a_large_plain_mesh_is_flattened(tmp_path):
    """libigl-python-bindings 54: a fine triangulation of a plane in an STL file."""
    plain = grid(120, 0.0, step=0.05)
    trimesh.Trimesh(plain.points, plain.faces, process=False).export(tmp_path / "plain.stl")
    found = voxflat.flatten(tmp_path / "plain.stl")
    assert len(found) == 120**2
    assert error(found) < 0.001


def test_stray_points_and_components_are_left_out():
    """libigl 66, 343, 2439, BFF 77: points that no triangle uses, and a second component."""
    hills = pv.ParametricRandomHills(u_res=30, v_res=30).triangulate()
    stray = np.random.default_rng(0).normal(scale=50, size=(500, 3))
    points = np.vstack([hills.points, stray, [[99, 0, 0], [99, 1, 0], [99, 0, 1]]])
    faces = np.vstack([hills.regular_faces, np.arange(len(points) - 3, len(points))[None]])
    found = voxflat.flatten((points, faces))
    assert np.array_equal(found.ids, np.arange(hills.n_points))
    assert np.isfinite(found.uv).all()
    assert error(found) < 0.06


def test_half_a_cylinder_is_a_rectangle():
    """libigl 2409."""
    angle, height = (axis.ravel() for axis in np.meshgrid(np.linspace(0, np.pi, 40), np.linspace(0, 3, 30)))
    points = np.column_stack([np.cos(angle), np.sin(angle), height])
    found = voxflat.flatten((points, Delaunay(np.column_stack([angle, height])).simplices))
    assert error(found) < 0.002
    np.testing.assert_allclose(sorted(np.ptp(found.uv, axis=0)), [3, np.pi], rtol=0.01)


def test_a_sheet_with_many_holes_has_no_folds():
    """villa 941, 1012: a wavy sheet of a scroll with sixty holes, without texture coordinates."""
    i, j = np.indices((100, 100))
    sheet = grid(100, (6 * np.sin(i / 12) + 4 * np.cos(j / 9)).ravel(), step=1.0)
    middles, chosen = sheet.points[sheet.faces].mean(axis=1), np.random.default_rng(1)
    kept = np.ones(len(sheet.faces), dtype=bool)
    for _ in range(60):
        x, y = chosen.uniform(5, 94, 2)
        kept &= np.hypot(middles[:, 0] - x, middles[:, 1] - y) > chosen.uniform(1, 4)
    found = voxflat.flatten((sheet.points, sheet.faces[kept]))
    assert np.isfinite(found.uv).all()
    assert found.distortion.triangles.flipped == 0


def test_areas_are_those_of_the_surface():
    """villa 463: the area of a region does not depend on how the map stretches it."""
    hill = voxflat.samples.hill()
    found = hill.flatten()
    corners = np.asarray(found.points)[found.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    across = np.ptp(found.uv, axis=0).max()
    everywhere = np.array([[-across, -across], [across, -across], [across, across], [-across, across]])
    whole = found.regions({"all": everywhere + found.uv.mean(axis=0)}).properties()
    assert whole["area"] == pytest.approx([area], rel=0.01)  # up to the pixels of the border


# ------------------------------------------------------------------------------ texture coordinates


def test_texture_coordinates_of_objects_are_maps(tmp_path):
    """pyvista 3992, pyvista-support 230, vedo 371: also where a seam has two of them."""
    angle, height = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.arange(10) * 0.3))
    flat = np.column_stack([angle, height])
    split = np.column_stack([np.cos(angle), np.sin(angle), height]), Delaunay(flat).simplices  # double at the seam
    whole = trimesh.Trimesh(*split, visual=trimesh.visual.TextureVisuals(uv=flat / 7), process=False)
    of_pyvista = pv.PolyData.from_regular_faces(*split)
    of_pyvista.active_texture_coordinates = flat / 7
    own = voxflat.measure(split, np.column_stack([flat, 0 * angle]))
    for mesh in (whole, of_pyvista):
        found = voxflat.measure(mesh, mesh)
        assert found.best_scale.scale == pytest.approx(7, rel=0.01)
        assert found.best_scale.relative_error == pytest.approx(own.best_scale.relative_error, abs=1e-6)
    whole.export(tmp_path / "tube.obj")
    assert voxflat.measure(tmp_path / "tube.obj", tmp_path / "tube.obj").best_scale.relative_error < 0.002


# ------------------------------------------------------------------------------ nilearn, pycortex, hippunfold, LayNii


def test_nearest_values_are_those_of_the_volume(hemispheres):
    """nilearn 2068, 5169: an atlas of whole numbers keeps them, also when depths are combined."""
    labels = np.random.default_rng(0).integers(1, 400, (91, 109, 91)).astype(np.int16)
    atlas = nib.Nifti1Image(labels, np.array([[-2.0, 0, 0, 90], [0, 2, 0, -126], [0, 0, 2, -72], [0, 0, 0, 1]]))
    for how in ({"interpolation": "nearest"}, {"interpolation": "majority", "fraction": [0.25, 0.5, 0.75]}):
        values = hemispheres[0].image(atlas, **how).data
        assert set(np.unique(values[np.isfinite(values)])) <= set(range(1, 400))


def test_values_of_another_structure_are_refused(hemispheres):
    """hippunfold 344: a file of the dentate with the values of the hippocampus."""
    with pytest.raises(voxflat.InputError, match="has 7262 values, but the mesh has 10242 vertices"):
        flat_map(hemispheres[0], np.zeros(7262))


def test_a_surface_that_meets_itself_is_flattened():
    """hippunfold 241: a roll of nearly two turns whose layers coincide."""
    turn, along = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 3.6 * np.pi, 60), np.linspace(0, 20, 20)))
    points = np.column_stack([6 * np.cos(turn), 6 * np.sin(turn), along])
    found = voxflat.flatten((points, Delaunay(np.column_stack([turn, along])).simplices))
    assert error(found) < 0.01


def test_vertices_beside_the_map_are_used_by_no_triangle(hemispheres, tmp_path):
    """pycortex 497, 408: they are at the origin, and the map has one border."""
    hemispheres[0].save(tmp_path / "lh.flat.surf.gii")
    points, faces = (part.data for part in nib.load(tmp_path / "lh.flat.surf.gii").darrays)
    beside = np.setdiff1d(np.arange(len(points)), faces)
    assert len(beside) == len(points) - len(np.unique(faces))
    assert not points[beside].any()
    edges, counts = np.unique(trimesh.Trimesh(points, faces, process=False).edges_sorted, axis=0, return_counts=True)
    assert len(edges[counts == 1]) > 100


def test_regions_drawn_on_a_part_are_in_place(tmp_path):
    """pycortex 318: a map with fewer vertices than the surface, and a polygon drawn on it."""
    white = voxflat.surface(fsaverage5_file("white", "left"))
    patch = white.disk(100, 40.0).flatten()
    corners = patch.uv[patch.ids == 100][0] + 10 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    drawn = patch.regions({"square": corners})
    inside = np.flatnonzero(np.abs(patch.uv - patch.uv[patch.ids == 100][0]).max(axis=1) < 10)
    drawn.save(tmp_path / "lh.square.label.gii")
    labels = nib.load(tmp_path / "lh.square.label.gii").darrays[0].data
    assert len(labels) == 10242
    assert set(patch.ids[inside]) == set(np.flatnonzero(labels))


@pytest.mark.parametrize("count", [100, 101, 120])
def test_there_are_as_many_columns_as_asked_for(count):
    """LAYNII 108."""
    columns = voxflat.rim(voxflat.samples.rim()).columns(count)
    assert np.array_equal(np.unique(columns.volume.data), np.arange(count + 1))
