"""Texture coordinates of any format are measured on the undivided surface, and are starts: seams are cuts.

Most formats split vertices at seams, so their points are found at the positions of the surface's vertices.
"""

import numpy as np
import pytest
import pyvista as pv
import scipy
import trimesh
from mesh_files import icosphere
from refusals import refused

import voxflat
from voxflat.io import Mesh, read_mesh, write_mesh
from voxflat.methods import Voxflat

OWN = ["own.obj", "own.ply", "own.vtp", "own.glb"]
OTHERS = ["trimesh.glb", "upright.glb", "pyvista.vtp", "pyvista.ply", "meshlab.ply"]
HEADER = ["ply", "format ascii 1.0", "element vertex {}", *(f"property float {axis}" for axis in "xyz")]
HEADER += ["element face {}", "property list uchar int vertex_indices", "property list uchar float texcoord"]


def of_meshlab(path, points, rows):
    """Write a PLY file of faces with their corners and texture coordinates."""
    lines = [
        line.format(count) for line, count in zip(HEADER, [0, 0, len(points), 0, 0, 0, len(rows), 0, 0], strict=True)
    ]
    lines += ["end_header", *(" ".join(map(repr, point)) for point in np.asarray(points).tolist())]
    lines += [" ".join(map(repr, [len(face), *face, len(texture), *texture])) for face, texture in rows]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write a closed surface, and its map as texture coordinates in all formats; return the folder and the map."""
    folder = tmp_path_factory.mktemp("uv")
    points, faces = icosphere(1.0, 3)
    write_mesh(folder / "egg.ply", Mesh(points * [20, 12, 10] + [5, 0, 0], faces))
    flat_map = voxflat.surface(folder / "egg.ply").flatten(Voxflat(sources=30))
    textured = flat_map.textured(np.full((32, 32, 3), 99, np.uint8))
    for name in OWN:
        textured.save(folder / name)
    split = textured.opened()
    at, corners, uv = split.points, split.faces, split.texture_coordinates
    for name, places in (("trimesh.glb", at), ("upright.glb", at[:, [0, 2, 1]] * [1, 1, -1])):
        visual = trimesh.visual.TextureVisuals(uv=uv)
        trimesh.Trimesh(places, corners, visual=visual, process=False).export(folder / name)
    mesh = pv.PolyData.from_regular_faces(at, corners)
    mesh.active_texture_coordinates = uv.astype(np.float32)  # VTK crashes when it writes doubles into PLY files
    mesh.save(folder / "pyvista.vtp")
    mesh.save(folder / "pyvista.ply")
    whole = flat_map.ids[flat_map.faces].tolist()
    of_meshlab(folder / "meshlab.ply", read_mesh(folder / "egg.ply").points, zip_of(whole, flat_map.uv[flat_map.faces]))
    return folder, flat_map


def zip_of(faces, coordinates):
    return list(zip(faces, coordinates.reshape(len(faces), -1).tolist(), strict=True))


@pytest.mark.medium
@pytest.mark.parametrize("name", OWN + OTHERS)
def test_seams_are_cuts_of_the_undivided_surface(files, name):
    folder, flat_map = files
    expected = voxflat.measure(folder / "egg.ply", flat_map, sources=20)
    found = voxflat.measure(folder / "egg.ply", folder / name, sources=20)
    assert found.best_scale.relative_error == pytest.approx(expected.best_scale.relative_error, rel=1e-4)
    assert found.topology == expected.topology == {"components": 1, "euler": 1, "loops": 1, "handles": 0}
    assert len(found.per_point) == len(flat_map.uv)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["own.glb", "meshlab.ply", "pyvista.vtp"])
def test_a_map_with_seams_is_a_start(files, name):
    folder, flat_map = files
    found = voxflat.surface(folder / "egg.ply").flatten(Voxflat(start=folder / name, sources=30))
    assert len(found.uv) == len(flat_map.uv)
    assert not found.distortion.triangles.flipped
    assert found.distortion.raw.relative_error == pytest.approx(flat_map.distortion.raw.relative_error, rel=0.05)


@pytest.mark.medium
@pytest.mark.parametrize("name", OWN + OTHERS)
def test_other_programs_read_the_same_texture_coordinates(files, name):
    read = read_mesh(files[0] / name)
    if name.endswith("vtp"):
        expected = pv.read(files[0] / name).active_texture_coordinates
    else:
        found = trimesh.load(files[0] / name, process=False, force="mesh")
        expected = found.visual.uv
    away, _ = scipy.spatial.cKDTree(expected).query(read.texture_coordinates)  # at a seam, a point keeps its first one
    assert away.max() < 1e-5


def test_maps_that_do_not_belong_to_the_surface(files, tmp_path):
    folder, _ = files
    points, faces = icosphere(1.0, 3)
    surface = (points * [20, 12, 10], faces)  # elsewhere
    refused(
        r"the map has \d+ points, but the surface has 642 vertices, and none of them is at \(",
        voxflat.measure,
        surface,
        folder / "own.glb",
        sources=3,
    )
    mesh = read_mesh(folder / "egg.ply")
    both = np.vstack([mesh.points, mesh.points])
    twice = (both, np.vstack([mesh.faces, mesh.faces + len(mesh.points)]))
    refused(
        "several vertices of the surface are at .*, so points cannot be matched",
        voxflat.measure,
        twice,
        folder / "own.glb",
        sources=3,
    )


def test_texture_coordinates_of_the_faces_of_a_ply(tmp_path):
    """Faces may have different numbers of corners, and none need texture coordinates."""
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 1], [2, 1, 1]]
    square, triangle, bare = ([0, 1, 2, 3], [0, 0, 1, 0, 1, 1, 0, 1]), ([1, 4, 2], [5, 0, 6, 0, 5, 1]), ([4, 5, 2], [])
    of_meshlab(tmp_path / "a.ply", points, [square, triangle, bare])
    read = read_mesh(tmp_path / "a.ply")
    assert len(read.faces) == 4
    nan = (np.nan, np.nan)
    np.testing.assert_array_equal(read.texture_coordinates, [(0, 0), (1, 0), (1, 1), (0, 1), (6, 0), nan])
    assert "has points on texture seams (2); each keeps only its first texture coordinate" in read.warnings
    of_meshlab(tmp_path / "b.ply", points, [square, (triangle[0], [1.0, 2.0])])
    np.testing.assert_array_equal(read_mesh(tmp_path / "b.ply").texture_coordinates[4], nan)
    of_meshlab(tmp_path / "c.ply", points, [([0, 1, 2], []), ([1, 4, 2], [])])
    assert read_mesh(tmp_path / "c.ply").texture_coordinates is None
