"""What every format holds of every kind of map, as an independent reader of that format finds it.

    | kind of map                  | .npz | .vtp | .ply .obj | .surf.gii | .patch.flat .flat.patch.3d |
    | ---------------------------- | ---- | ---- | --------- | --------- | -------------------------- |
    | mesh                         | all  | all  | all       | all       | all                        |
    | mesh with cuts, also glued   | all  | all  | all       | cuts      | lips                       |
    | surface or sheet of voxels   | all  | all  | all       | all       | refused                    |
    | grossmann2002, where torn    | all  | all  | torn      | torn      | refused                    |

all: every triangle comes back, with its corners where the map has them. cuts, lips, torn: those are left out that a cut
doubles, that patches cannot hold at a cut, and that are torn; the message says how many, and that is what is missing.
"""

import logging
import re

import freesurfer_rule
import nibabel
import numpy as np
import pytest
import pyvista as pv
from mesh_files import grid, needs_workbench, workbench
from refusals import refused
from scipy.spatial import cKDTree
from shapes import ball, curled_sheet

import voxflat
from voxflat.io.meshes import write_mesh
from voxflat.methods import Grossmann2002, Voxflat

FORMATS = ("map.npz", "map.vtp", "map.ply", "map.obj", "map.surf.gii", "lh.map.patch.flat", "lh.map.flat.patch.3d")
CUT = np.arange(6, 6 + 13 * 8, 13)


ROW, COLUMN = np.indices((13, 13)).reshape(2, -1)
MESH = grid(13, 2 * np.sin(ROW * 0.9) + np.cos(COLUMN * 0.8), 2.0)
BUMPS = MESH.points, MESH.faces
HOLED = MESH.points, np.delete(MESH.faces, [60, 84], axis=0)

KINDS = {
    "mesh": lambda: voxflat.flatten(BUMPS, Voxflat(sources=40)),
    "mesh with a cut": lambda: voxflat.flatten(BUMPS, Voxflat(sources=40), cuts=[CUT]),
    "mesh without two triangles": lambda: voxflat.surface(BUMPS).keep(HOLED).flatten(Voxflat(sources=40)),
    "glued": lambda: voxflat.flatten(BUMPS, method="saucan2006", cuts=[CUT]),
    "voxels": lambda: voxflat.surface(ball(7)).disk((9, 9, 16), 9.0).flatten(Voxflat(sources=40), relax=False),
    "sheet": lambda: voxflat.flatten(curled_sheet(40, 20), Voxflat(sources=40)),
    # half of a ball cannot be flat: the map over the 26-neighbour graph is torn
    "torn": lambda: voxflat.surface(ball(7)).disk((9, 9, 16), 12.0).flatten(Grossmann2002(sources=60)),
}


@pytest.fixture(scope="module", params=KINDS)
def flat(request):
    made = KINDS[request.param]()
    doubled = len(made) - len(np.unique(made.ids, axis=0))
    assert (doubled > 0) == (request.param in ("mesh with a cut", "glued"))
    assert made.torn.any() == (request.param == "torn")
    return made


def from_npz(path, flat):
    with np.load(path) as arrays:
        return arrays["uv"][arrays["faces"]], None


def from_vtk(path, flat):
    mesh = pv.read(path)
    return np.asarray(mesh.points)[mesh.regular_faces], mesh.cell_data.get("torn")


def from_gifti(path, flat):
    points, faces = (array.data for array in nibabel.load(path).darrays)
    if not flat.is_voxels:
        assert len(points) == flat.metadata["vertices"]
    return points[faces], None


def from_patch(path, flat):
    places, _, triangles = freesurfer_rule.read_patch(path, MESH.faces)
    return np.array([[places[vertex] for vertex in triangle] for triangle in triangles]), None


READERS = {"npz": from_npz, "gii": from_gifti, "flat": from_patch, "3d": from_patch}


def rows(corners, flat):
    """Return one row a triangle, of the map's places nearest to its corners, so that both sides compare as sets."""
    apart, numbers = cKDTree(np.unique(flat.uv, axis=0)).query(np.asarray(corners, dtype=np.float64)[..., :2])
    assert (apart < 1e-3).all()  # of a file's float32 or 9 digits
    first = numbers.argmin(axis=1)
    turned = [np.take_along_axis(numbers, ((first + k) % 3)[:, None], axis=1)[:, 0] for k in range(3)]
    return [tuple(row) for row in np.stack(turned, axis=1).tolist()]


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_what_comes_back(flat, name, tmp_path, caplog):
    path = tmp_path / name
    caplog.clear()
    with caplog.at_level(logging.WARNING, "voxflat"):
        if flat.is_voxels and ".patch." in name:
            refused("this map has voxels. Save as .surf.gii", flat.save, path)
            assert not path.exists()
            return
        flat.save(path)
    corners, torn = READERS.get(name.rsplit(".", 1)[1], from_vtk)(path, flat)
    found = rows(corners, flat)
    own = rows(flat.uv[flat.faces], flat)
    assert len(set(found)) == len(found)
    assert set(found) <= set(own)  # as the map has them, and turned as there
    missing = len(own) - len(found)
    numbers = [[int(n) for n in re.findall(r"\d+", record.getMessage())] for record in caplog.records]
    told = [said[2:] if ".patch." in name else said[:2] for said in numbers]
    assert told == ([[missing, len(own)]] if missing else [])
    is_doubled = not flat.is_voxels and len(flat) > len(np.unique(flat.ids))
    is_cut = is_doubled or (not flat.is_voxels and len(flat.bridges) > 0)
    expected = {"gii": is_doubled, "flat": is_cut, "3d": is_cut}.get(name.rsplit(".", 1)[1], False)
    if name.endswith((".ply", ".obj", ".gii")):
        expected = expected or flat.torn.any()
    assert (missing > 0) == expected
    if flat.torn.any():
        kept = set(rows(flat.uv[flat.faces[~flat.torn]], flat))
        if name.endswith(".vtp"):
            assert {row for row, is_torn in zip(found, torn, strict=True) if not is_torn} == kept
        elif not name.endswith(".npz"):
            assert set(found) == kept


@pytest.mark.slow
@needs_workbench
def test_workbench_finds_the_same_areas(flat, tmp_path):
    paths = [tmp_path / name for name in ("lh.flat.surf.gii", "areas.func.gii")]
    flat.save(paths[0])
    workbench("-surface-vertex-areas", *paths)
    corners, _ = from_gifti(paths[0], flat)
    a, b = (corners[:, k, :2].astype(np.float64) - corners[:, 0, :2] for k in (1, 2))
    areas = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert nibabel.load(paths[1]).darrays[0].data.sum(dtype=np.float64) == pytest.approx(areas.sum(), rel=1e-5)


@pytest.mark.parametrize("name", ["lh.white", "cut.surf.gii", "cut.vtp", "cut.ply", "cut.obj"])
@pytest.mark.parametrize("cuts", [(), (CUT,)])
def test_what_comes_back_of_surfaces(name, cuts, tmp_path):
    surface = voxflat.surface(BUMPS).cut(cuts=list(cuts), relax=False).surface
    surface.save(tmp_path / name)
    if name.startswith("lh."):
        points, faces = nibabel.freesurfer.read_geometry(tmp_path / name)
    elif name.endswith(".gii"):
        points, faces = (array.data for array in nibabel.load(tmp_path / name).darrays)
    else:
        mesh = pv.read(tmp_path / name)
        points, faces = mesh.points, mesh.regular_faces
    np.testing.assert_array_equal(faces, surface.faces)
    np.testing.assert_allclose(points, surface.points, rtol=1e-6, atol=1e-6)


def test_a_mesh_of_others_is_written_as_it_was_read(tmp_path):
    write_mesh(tmp_path / "lh.white", MESH)
    voxflat.surface(tmp_path / "lh.white").save(tmp_path / "lh.again")
    assert (tmp_path / "lh.again").read_bytes() == (tmp_path / "lh.white").read_bytes()
