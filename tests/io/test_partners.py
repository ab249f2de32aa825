"""Files that are used together belong to the same hemisphere and the same participant, at every door."""

import logging

import nibabel as nib
import numpy as np
import pytest
from command_line import fail, succeed
from mesh_files import gifti
from refusals import refused

import voxflat
from voxflat import figures
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.overlays import read_overlay, read_region

POINTS, FACES = voxflat.samples.hill().points, voxflat.samples.hill().faces
COUNT = len(POINTS)
VALUES = POINTS[:, 2].astype(np.float32)
MASK = (POINTS[:, 0] > 0).astype(np.float32)
OTHER = "belongs to the right hemisphere, but the surface belongs to the left one"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a directory with both hemispheres, which have the same triangles, as fsaverage's have."""
    folder = tmp_path_factory.mktemp("partners")
    for h, side in (("lh", -1), ("rh", 1)):
        points = POINTS + np.array([40.0 * side, 0, 0])
        nib.freesurfer.write_geometry(folder / f"{h}.white", points, FACES)
        nib.freesurfer.write_morph_data(folder / f"{h}.thickness", VALUES)
        nib.freesurfer.write_morph_data(folder / f"{h}.cortex", MASK)
        np.savetxt(folder / f"{h}.mask.txt", MASK)
        (folder / f"{h}.V1.label").write_text("#!ascii label\n3\n1 0 0 0 0\n2 0 0 0 0\n22 0 0 0 0\n")
        voxflat.surface(folder / f"{h}.white").flatten().save(folder / f"{h}.npz")
        voxflat.load(folder / f"{h}.npz").save(folder / f"{h}.flat.patch.3d")
        voxflat.load(folder / f"{h}.npz").save(folder / f"{h}.flat.surf.gii")
    return folder


@pytest.fixture(scope="module")
def left(files):
    return voxflat.load(files / "lh.npz")


REGIONS = ["rh.cortex", "rh.mask.txt", "rh.V1.label", "rh.white", "rh.flat.patch.3d"]


@pytest.mark.medium
@pytest.mark.parametrize("name", REGIONS)
@pytest.mark.parametrize("verb", ["keep", "drop"])
def test_a_region_of_the_other_hemisphere_is_refused(files, name, verb):
    whole = voxflat.surface(files / "lh.white")
    refused(f"{name}: {OTHER}", getattr(whole, verb), files / name)
    fail(1, OTHER, "flatten", files / "lh.white", f"--{verb}", files / name, "-o", files / "none.npz")


@pytest.mark.medium
@pytest.mark.parametrize("name", ["rh.thickness", "rh.mask.txt", "rh.V1.label"])
def test_values_of_the_other_hemisphere_are_refused(files, left, name):
    read = read_region if name.endswith("label") else read_overlay
    refused(f"{name}: {OTHER}", read, files / name, COUNT, structure="CortexLeft")
    if read == read_overlay:
        refused(f"{name}: {OTHER}", left.image, files / name)
        refused(f"{name}: {OTHER}", figures.flat_map, left, np.ones(COUNT), opacity=files / name)


@pytest.mark.medium
def test_gifti_tells_the_hemisphere_where_the_name_does_not(files, left, tmp_path):
    right = {"AnatomicalStructurePrimary": "CortexRight"}
    path = gifti(tmp_path / "values.func.gii", [(MASK, "none")], lambda image: image.meta.update(right))
    whole = voxflat.surface(files / "lh.white")
    for call in (left.image, whole.keep, whole.drop):
        refused(f"values.func.gii: {OTHER}", call, path)
        refused(f"GiftiImage: {OTHER}", call, nib.load(path))
    write_mesh(tmp_path / "map.surf.gii", Mesh(np.pad(left.uv, ((0, 0), (0, 1))), FACES, structure="CortexRight"))
    refused("map.surf.gii: " + OTHER, voxflat.measure, whole, tmp_path / "map.surf.gii")


@pytest.mark.medium
@pytest.mark.parametrize("name", ["lh.npz", "lh.flat.patch.3d", "lh.flat.surf.gii"])
def test_a_map_of_the_other_hemisphere_is_not_measured(files, name):
    other = OTHER.replace("right", "tmp").replace("left", "right").replace("tmp", "left")
    refused(other, voxflat.measure, files / "rh.white", files / name)
    fail(1, other, "measure", files / "rh.white", files / name)
    fail(1, other, "flatten", files / "rh.white", "--start", files / name, "-o", files / "none.npz")
    succeed("measure", files / "lh.white", files / name)


def test_a_map_of_another_surface_is_not_measured(left):
    more = np.vstack([POINTS, POINTS[-1:] + 1]), np.vstack([FACES, [[COUNT, COUNT - 1, COUNT - 2]]])
    refused("made on a surface with 441 vertices, but the given surface has 442", voxflat.measure, more, left)
    order = np.random.default_rng(0).permutation(COUNT)
    mixed = POINTS[order], np.argsort(order)[FACES]  # the same surface with other vertex numbers
    refused("of the map's 800 triangles are triangles of the surface", voxflat.measure, mixed, left)


@pytest.mark.medium
def test_a_figure_of_the_same_map_twice_needs_an_overlay_for_each(files, left):
    twice = [left, voxflat.load(files / "lh.npz")]
    refused("both maps are the same", figures.flat_map, twice)
    refused("both maps are the same", figures.flat_map, twice, VALUES)
    refused("both maps are the same", figures.movie, twice, np.column_stack([VALUES, MASK]))
    fail(1, "both maps are the same", "figure", files / "lh.npz", files / "lh.npz", "-o", files / "twice.png")
    figures.flat_map(twice, [VALUES, MASK])
    figures.flat_map([left, voxflat.load(files / "rh.npz")], VALUES)


@pytest.mark.medium
def test_another_participant_causes_a_warning(files, tmp_path, caplog):
    name = "sub-01_hemi-L_white.surf.gii"
    write_mesh(tmp_path / name, Mesh(POINTS, FACES, structure="CortexLeft"))
    flat = voxflat.surface(tmp_path / name).flatten()
    for participant in ("01", "02"):
        start = tmp_path / f"sub-{participant}"
        gifti(start.with_name(f"{start.name}_mask.shape.gii"), [(MASK, "none")])
        write_mesh(start.with_name(f"{start.name}_pial.surf.gii"), Mesh(POINTS + np.array([0, 0, 2.0]), FACES))
        volume = nib.Nifti1Image(np.ones((60, 60, 30, 2), np.float32), np.diag([1.0, 1, 1, 1]) - 30 * np.eye(4, k=3))
        nib.save(volume, start.with_name(f"{start.name}_bold.nii.gz"))
        write_mesh(start.with_name(f"{start.name}_flat.surf.gii"), Mesh(np.pad(flat.uv, ((0, 0), (0, 1))), FACES))
    whole = voxflat.surface(tmp_path / name)
    doors = {
        "mask.shape.gii": [flat.image, whole.keep, whole.drop],
        "bold.nii.gz": [flat.images],
        "pial.surf.gii": [lambda pial: voxflat.surface(tmp_path / name, pial=pial)],
        "flat.surf.gii": [lambda of: voxflat.measure(whole, of)],
    }
    for ending, calls in doors.items():
        for call in calls:
            for participant, expected in (("01", 0), ("02", 1)):
                caplog.clear()
                with caplog.at_level(logging.WARNING, logger="voxflat"):
                    call(tmp_path / f"sub-{participant}_{ending}")
                told = [message for message in caplog.messages if "belongs to sub-02" in message]
                assert len(told) == expected, (ending, caplog.messages)


MEASURES = {"a file": None, "an array": VALUES, "single precision": VALUES.astype(np.float32)}


@pytest.mark.parametrize("kind", MEASURES)
@pytest.mark.parametrize("verb", ["keep", "drop"])
def test_measurements_are_not_a_region(files, kind, verb):
    region = files / "lh.thickness" if MEASURES[kind] is None else MEASURES[kind]
    refused(
        "contains fractional values .* so it is not a region",
        getattr(voxflat.surface(files / "lh.white"), verb),
        region,
    )


def test_measurements_in_voxels_are_not_a_region():
    ball = voxflat.samples.ball()
    smooth = np.random.default_rng(0).random(ball.shape)
    refused("contains fractional values", voxflat.surface(ball).keep, smooth)
    scaled = np.asarray(ball, dtype=np.float64) * np.float32(1 / 255) * 255  # as files with a scale store a mask
    assert len(voxflat.surface(ball).keep(scaled)) == len(voxflat.surface(ball))


def test_a_mask_is_a_region_whatever_its_type(files):
    whole = voxflat.surface(files / "lh.white")
    expected = len(whole.keep(MASK > 0))
    for mask in (
        MASK,
        MASK.astype(np.int32),
        np.where(MASK > 0, 7.0, np.nan),
        files / "lh.cortex",
        files / "lh.mask.txt",
    ):
        assert len(whole.keep(mask)) == expected
