"""One map for a group of people on their own meshes: `voxflat.flatten_group` with `spheres`."""

import lab
import nibabel as nib
import numpy as np
import pytest
from command_line import fail, succeed

import voxflat
from voxflat.errors import Cancelled, InputError
from voxflat.surfaces.standard.pattern import icosphere

SCALES = ([1, 1, 1], [1.1, 0.95, 1], [0.95, 1, 1.1])


def person(number, count):
    """Return points and triangles of a person's hemisphere with the vertices of fsaverage."""
    white, _, faces = lab.hemisphere(count)
    return white * SCALES[number], faces


@pytest.fixture(scope="module")
def common():
    """Return the sphere of the common mesh."""
    return voxflat.io.Mesh(lab.fsaverage5("sphere_left")[0][:642], lab.hemisphere(642)[2])


@pytest.fixture(scope="module")
def native():
    """Return surfaces on finer meshes with other numbers of their vertices, and their spheres of different radii."""
    surfaces, spheres = [], []
    for number in range(3):
        points, faces = person(number, 2562)
        order = np.random.default_rng(number).permutation(2562)
        sphere = lab.fsaverage5("sphere_left")[0][:2562] * (1 + number)
        surfaces.append((points[order], np.argsort(order)[faces]))
        spheres.append(sphere[order])
    return surfaces, spheres


@pytest.fixture(scope="module")
def of_people(native, common):
    surfaces, spheres = native
    return voxflat.flatten_group(surfaces, spheres=spheres, sphere=common)


@pytest.mark.medium
def test_people_on_their_own_meshes_have_the_map_of_their_surfaces_on_the_common_mesh(of_people, common):
    expected = voxflat.flatten_group([person(number, 642) for number in range(3)], sphere=common)
    assert [cut.name for cut in of_people.cuts] == [cut.name for cut in expected.cuts] != []
    np.testing.assert_array_equal(of_people.ids, expected.ids)
    np.testing.assert_allclose(of_people.points, expected.points, atol=1e-6)  # the last bits do not choose the pose
    rows = [[row["relative_error"] for row in flat.metadata["people"]] for flat in (of_people, expected)]
    np.testing.assert_allclose(*rows, rtol=0.02)


@pytest.mark.medium
def test_the_order_of_people_and_the_number_of_threads_do_not_matter(of_people, native, common):
    surfaces, spheres = native
    flat = voxflat.flatten_group(surfaces[::-1], spheres=spheres[::-1], sphere=common, threads=1)
    assert np.array_equal(flat.uv, of_people.uv)


@pytest.mark.slow
def test_a_person_without_a_sphere_can_be_registered(common):
    of_folds = voxflat.io.Mesh(lab.fsaverage5("sphere_left")[0][:642], common.faces)
    surfaces = [voxflat.surface(person(number, 2562)) for number in range(2)]
    registered = [one.register() for one in surfaces]
    flat = voxflat.flatten_group(surfaces, spheres=registered, sphere=of_folds)
    white = person(0, 642)[0] * np.mean(SCALES[:2], axis=0)
    apart = np.linalg.norm(flat.points - white[flat.ids], axis=1)
    assert np.median(apart) < 8  # mm, and the vertices are 15 mm apart
    assert flat.distortion.triangles.flipped == 0


@pytest.fixture(scope="module")
def folders(native, tmp_path_factory):
    """Return the white surfaces of people in FreeSurfer's layout, with their spheres beside."""
    folder, files = tmp_path_factory.mktemp("people"), []
    for number, (surface, sphere) in enumerate(zip(*native, strict=True)):
        surf = folder / f"sub-{number}" / "surf"
        surf.mkdir(parents=True)
        nib.freesurfer.write_geometry(surf / "lh.white", *surface)
        nib.freesurfer.write_geometry(surf / "lh.sphere.reg", sphere, surface[1])
        files.append(surf / "lh.white")
    return files


@pytest.mark.medium
def test_spheres_are_found_beside_the_surfaces(folders, common, tmp_path):
    sphere, output = tmp_path / "lh.sphere.surf.gii", tmp_path / "group.npz"
    voxflat.io.write_mesh(sphere, common)
    weights = [2.0, 1.0, 0.5]
    expected = voxflat.flatten_group(folders, spheres="?h.sphere.reg", sphere=sphere, weights=weights)
    text = succeed(
        "group-map", *folders, "--spheres", "lh.sphere.reg", "--sphere", sphere, "--weights", "2,1,0.5", "-o", output
    ).stdout
    found = voxflat.load(output)
    assert np.array_equal(found.uv, expected.uv)
    assert [row["weight"] for row in found.metadata["people"]] == weights
    assert "surface 1 (lh.white)" in text
    wrong = ("--spheres", "lh.sphere", "--sphere", sphere, "-o", tmp_path / "other.npz")
    told = f"spheres is 'lh.sphere', but {folders[0].parent} contains 0 such files"
    fail(1, told, "group-map", *folders, *wrong)


WRONG = {
    "no common mesh": ({"sphere": None}, "spheres needs a common mesh. Pass the registered sphere"),
    "positions alone": ({"sphere": np.eye(3)}, "spheres needs a common mesh. Pass the registered sphere"),
    "one sphere for all": ({"spheres": ["lh.sphere.reg"]}, "Pass one sphere for each of 3 surfaces"),
    "a pattern without files": ({"spheres": "lh.sphere.reg"}, "surface 1 is not a file. Pass one sphere per surface"),
    "another person's sphere": (
        {"spheres": lambda spheres: [spheres[0], spheres[0], spheres[2]]},
        "surface 2: .*triangles are flipped on the sphere",
    ),
    "an unregistered sphere": (
        {"spheres": lambda spheres: [spheres[0], spheres[1][:, [1, 2, 0]], spheres[2]]},
        "surface 2: .*not registered to fsaverage or fs_LR",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_spheres_are_refused_in_one_line(name, native, common):
    surfaces, spheres = native
    changed, message = WRONG[name]
    arguments = {"spheres": spheres, "sphere": common, **changed}
    if callable(arguments["spheres"]):
        arguments["spheres"] = arguments["spheres"](spheres)
    with pytest.raises(InputError, match=message) as caught:
        voxflat.flatten_group(surfaces, **arguments)
    assert "\n" not in str(caught.value)


def test_a_common_mesh_of_another_space_or_hemisphere_is_refused(native, common, tmp_path):
    surfaces, spheres = native
    for name, message in (
        (
            "L.sphere.32k_fs_LR.surf.gii",
            "is registered to fsaverage, but L.sphere.32k_fs_LR.surf.gii is in fs_LR space",
        ),
        (
            "rh.sphere.surf.gii",
            "surface 1: belongs to the left hemisphere, but rh.sphere.surf.gii belongs to the right",
        ),
    ):
        voxflat.io.write_mesh(tmp_path / name, common)
        with pytest.raises(InputError, match=message):
            voxflat.flatten_group(surfaces, spheres=spheres, sphere=tmp_path / name)
    with pytest.raises(InputError, match="is not a sphere around the origin"):
        voxflat.flatten_group(surfaces, spheres=spheres, sphere=person(0, 642))


def test_surfaces_that_do_not_cover_the_common_mesh_are_refused(native, common):
    surfaces, spheres = native
    points, faces = surfaces[0]
    half = faces[(points[faces][:, :, 0] < np.median(points[:, 0])).all(axis=1)]
    cut = [voxflat.io.Mesh(points, half, structure="CortexLeft"), *surfaces[1:]]
    with pytest.raises(InputError, match=r"surface 1: the sphere covers only \d+ % of the points of the sphere"):
        voxflat.flatten_group(cut, spheres=spheres, sphere=common)


def test_resampling_can_be_cancelled(native, common):
    surfaces, spheres = native
    with pytest.raises(Cancelled):
        voxflat.flatten_group(surfaces, spheres=spheres, sphere=common, progress=lambda *_: False)


def test_the_icosphere_serves_as_common_mesh(native):
    surfaces, spheres = native
    flat = voxflat.flatten_group(surfaces[:2], spheres=spheres[:2], sphere=icosphere(3))
    assert flat.distortion.triangles.flipped == 0
