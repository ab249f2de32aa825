"""Files of several maps on the flat map: values that are linear on a plane come back as they are, pixel by pixel."""

import json
import tracemalloc
from dataclasses import replace

import nibabel as nib
import numpy as np
import pytest
from command_line import fail, run, succeed
from mesh_files import gifti, grid, needs_workbench, workbench
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from refusals import refused

import voxflat
from voxflat.io.meshes import write_mesh
from voxflat.methods import Voxflat

SIZE, COUNT = 13, 169
NAMES = ("rest", "2BK-0BK", "3")
BOTH = ("CIFTI_STRUCTURE_CORTEX_LEFT", "CIFTI_STRUCTURE_CORTEX_RIGHT")


def plane(structure=None):
    return replace(grid(SIZE, step=2.0), structure=structure)


def flattened(structure):
    """Return the map of the plane, its places on the map those in space to be exact."""
    mesh = plane(structure)
    return replace(voxflat.flatten(mesh, Voxflat(sources=30)), uv=mesh.points[:, :2])


@pytest.fixture(scope="module", params=["CortexLeft", None])
def flat(request):
    return flattened(request.param)


def linear(places, k):
    """Return what channel k is at places (..., 2 or 3)."""
    return 3.0 * places[..., 0] - 2.0 * places[..., 1] + 50 * k


def pixels(image):
    """Return the places of all pixels."""
    rows, columns = np.meshgrid(*map(np.arange, image.data.shape), indexing="ij")
    return np.stack([rows, columns, 0 * rows, 0 * rows + 1], axis=-1) @ image.affine.T


def assert_shows(image, k):
    inside = ~np.isnan(image.data)
    assert inside.mean() > 0.5
    assert_allclose(image.data[inside], linear(pixels(image), k)[inside], atol=1e-4)


def at_vertices(k):
    return linear(plane().points, k).astype(np.float32)


def overlays(folder, count=3):
    """Write the same channels in every format that has values at points; return the files and their names."""
    columns = [at_vertices(k) for k in range(count)]

    def named(image):
        for array, name in zip(image.darrays, NAMES, strict=False):
            array.meta["Name"] = name

    gifti(folder / "z.func.gii", [(column, "estimate") for column in columns], named)
    stacked = np.stack(columns, axis=-1)
    frames = (count,) if count > 1 else ()
    for name, shape in (("a.mgh", (COUNT, 1, 1)), ("b.mgz", (1, COUNT, 1)), ("c.mgz", (1, 1, COUNT))):
        nib.save(nib.MGHImage(stacked.reshape(*shape, *frames), np.eye(4)), folder / name)
    for name in ("d.nii", "e.nii.gz"):
        nib.save(nib.Nifti1Image(stacked[:, None, None], np.eye(4)), folder / name)
    np.save(folder / "f.npy", stacked)
    others = ("a.mgh", "b.mgz", "c.mgz", "d.nii", "e.nii.gz", "f.npy")
    return {"z.func.gii": NAMES[:count], **dict.fromkeys(others, ("",) * count)}


def cifti(path, axis, values, vertices=None, structures=BOTH):
    """Write a CIFTI file of values at the vertices of both sides, those on the right 1000 more."""
    vertices = np.arange(COUNT) if vertices is None else vertices
    models = [nib.cifti2.BrainModelAxis.from_surface(vertices, COUNT, name) for name in structures]
    brain = sum(models[1:], models[0])
    data = np.concatenate([values[:, vertices] + 1000 * n for n in range(len(models))], axis=1)
    nib.save(nib.Cifti2Image(data, header=(axis, brain)), path)


class TestOverlays:
    def test_every_format(self, flat, tmp_path):
        for name, names in overlays(tmp_path).items():
            stack = flat.images(tmp_path / name)
            assert (len(stack), stack.names) == (3, tuple(names))
            for k, image in enumerate(stack):
                assert_shows(image, k)
                assert image.name == ", ".join(part for part in (name, names[k]) if part)
            assert_shows(flat.image(tmp_path / name, channel=2), 2)
            assert_shows(flat.image(tmp_path / name, channel=-3), 0)
            refused(rf"{name}: has 3 maps \(.*\). Choose one by its name or number", flat.image, tmp_path / name)
            refused(r"has no map 3. Pass a number from 0 to 2", flat.image, tmp_path / name, channel=3)

    def test_one_map_needs_no_choice(self, flat, tmp_path):
        for name in overlays(tmp_path, 1):
            assert_shows(flat.image(tmp_path / name), 0)

    def test_names_come_before_numbers(self, flat, tmp_path):
        overlays(tmp_path)
        for channel, number in (("2BK-0BK", 1), ("3", 2), ("1", 1)):
            assert_shows(flat.image(tmp_path / "z.func.gii", channel=channel), number)
        for channel, told in (("none", "has no map 'none'. Choose one of rest, 2BK-0BK, 3"), (True, "channel is True")):
            refused(told, flat.image, tmp_path / "z.func.gii", channel=channel)

    def test_another_count(self, flat, tmp_path):
        values = np.ones((7, 1, 1), np.float32)
        nib.save(nib.MGHImage(values, np.eye(4)), tmp_path / "a.mgz")
        nib.save(nib.Nifti1Image(values, np.eye(4)), tmp_path / "b.nii.gz")
        for name in ("a.mgz", "b.nii.gz"):
            refused(f"{name}: has 7 values, but the surface has 169 points", flat.image, tmp_path / name)

    def test_regions(self, tmp_path):
        mesh = plane()
        inside = (mesh.points[:, 0] < 15).astype(np.float32)
        nib.save(nib.Nifti1Image(inside[:, None, None], np.eye(4)), tmp_path / "roi.nii.gz")
        nib.save(nib.MGHImage(inside[None, :, None], np.eye(4)), tmp_path / "roi.mgz")
        cifti(tmp_path / "roi.dscalar.nii", nib.cifti2.ScalarAxis(["roi"]), inside[None], structures=BOTH[:1])
        for name in ("roi.nii.gz", "roi.mgz", "roi.dscalar.nii"):
            assert_array_equal(voxflat.surface(mesh).keep(tmp_path / name).geodesic(1).ids, np.flatnonzero(inside))


class TestCifti:
    def test_scalars_by_structure(self, tmp_path):
        values = np.stack([at_vertices(k) for k in range(3)])
        listed = np.flatnonzero(plane().points[:, 0] > 3)
        cifti(tmp_path / "z.dscalar.nii", nib.cifti2.ScalarAxis(NAMES), values, listed)
        for structure, more in (("CortexLeft", 0), ("CortexRight", 1000)):
            stack = flattened(structure).images(tmp_path / "z.dscalar.nii")
            assert stack.names == NAMES
            image = stack["2BK-0BK"]
            inside = ~np.isnan(image.data)
            assert_allclose(image.data[inside], more + linear(pixels(image), 1)[inside], atol=1e-3)
            assert pixels(image)[inside, 0].min() >= 4 > pixels(image)[..., 0].min()  # not listed: no value

    def test_which_side_has_to_be_known(self, tmp_path):
        cifti(tmp_path / "z.dscalar.nii", nib.cifti2.ScalarAxis(["z"]), at_vertices(0)[None])
        both = "contains CORTEX_LEFT, CORTEX_RIGHT, each with 169 vertices, and the hemi"
        for structure, told in ((None, both), ("Cerebellum", "CORTEX_RIGHT, but the surface belongs to CEREBELLUM")):
            refused(told, flattened(structure).image, tmp_path / "z.dscalar.nii")
        cifti(tmp_path / "l.dscalar.nii", nib.cifti2.ScalarAxis(["z"]), at_vertices(0)[None], structures=BOTH[:1])
        assert_shows(flattened(None).image(tmp_path / "l.dscalar.nii"), 0)

    def test_series_and_labels(self, flat, tmp_path):
        count = 150  # more than are read at once
        values = np.stack([at_vertices(k) for k in range(count)])
        series = nib.cifti2.SeriesAxis(0, 0.72, count, "SECOND")
        cifti(tmp_path / "bold.dtseries.nii", series, values, structures=BOTH[:1])
        stack = flat.images(tmp_path / "bold.dtseries.nii")
        assert stack.names[:3] == ("0 second", "0.72 second", "1.44 second")
        for k in (0, 63, 64, 149, 5):
            assert_shows(stack[k], k)
        labels = 1 + (plane().points[:, 0] > 11)
        table = {0: ("???", (0, 0, 0, 0)), 1: ("V1", (1, 0, 0, 1)), 2: ("V2", (0, 1, 0, 1))}
        listed = np.arange(100)
        axis = nib.cifti2.LabelAxis(["areas"], [table])
        cifti(tmp_path / "a.dlabel.nii", axis, labels[None].astype(np.float32), listed, BOTH[:1])
        image = flat.image(tmp_path / "a.dlabel.nii")
        assert set(np.unique(image.data[~np.isnan(image.data)])) == {0, 1, 2}
        nearest, _ = flat.locate()
        inside = nearest >= 0
        assert_array_equal(image.data[inside], np.where(nearest < 100, labels[nearest], 0)[inside])

    @pytest.mark.parametrize("wrong", [np.nan, np.inf, 1.5, 2.99, 1e19, -1e30])
    def test_labels_that_are_no_whole_numbers(self, flat, tmp_path, wrong):
        axis = nib.cifti2.LabelAxis(["areas"], [{0: ("???", (0, 0, 0, 0)), 1: ("V1", (1, 0, 0, 1))}])
        labels = np.ones(100, np.float32)
        labels[7] = wrong
        cifti(tmp_path / "a.dlabel.nii", axis, labels[None], np.arange(100), BOTH[:1])
        refused(r"a\.dlabel\.nii: label .* is not a whole number", flat.image, tmp_path / "a.dlabel.nii")

    @pytest.mark.slow
    @needs_workbench
    def test_what_workbench_makes(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        for k, name in enumerate("ab"):
            gifti(tmp_path / f"{name}.func.gii", [(at_vertices(k), "none")])
            workbench("-set-structure", f"{name}.func.gii", "CORTEX_LEFT")
            workbench("-set-map-names", f"{name}.func.gii", "-map", 1, f"map {name}")
        workbench("-metric-merge", "ab.func.gii", "-metric", "a.func.gii", "-metric", "b.func.gii")
        workbench("-cifti-create-dense-scalar", "ab.dscalar.nii", "-left-metric", "ab.func.gii")
        for name in ("ab.func.gii", "ab.dscalar.nii"):
            stack = flattened("CortexLeft").images(tmp_path / name)
            assert stack.names == ("map a", "map b")
            for k, image in enumerate(stack):
                assert_shows(image, k)


def series(folder, count=4, name="bold.nii.gz", shape=(17, 15, 5)):
    """Write volumes that are linear in the world, and return the file."""
    affine = np.array([[2.0, 0, 0, -3], [0, 2, 0, -2], [0, 0, 2, -4], [0, 0, 0, 1]])
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) @ affine[:3, :3].T + affine[:3, 3]
    data = np.stack([linear(grid, k) for k in range(count)], axis=-1).astype(np.float32)
    nib.save((nib.MGHImage if ".mg" in name else nib.Nifti1Image)(data, affine), folder / name)
    return folder / name


class TestSeries:
    @pytest.mark.parametrize("name", ["bold.nii", "bold.nii.gz", "bold.mgh", "bold.mgz"])
    def test_volumes_one_after_the_other(self, flat, tmp_path, name):
        path = series(tmp_path, name=name)
        stack = flat.images(path)
        assert (len(stack), stack.names) == (4, ("",) * 4)
        for k in (2, 0, 3, 1):
            assert_shows(stack[k], k)
        assert_shows(flat.image(nib.load(path), channel=3), 3)
        refused(rf"{name}: has 4 maps \(0 to 3\). Choose one", flat.image, path)

    def test_one_volume_of_a_series_is_a_volume(self, flat, tmp_path):
        assert_shows(flat.image(series(tmp_path, 1)), 0)

    @pytest.mark.parametrize("name", ["bold.nii.gz", "bold.mgz"])
    def test_a_gzipped_series_is_decompressed_once(self, flat, tmp_path, monkeypatch, name):
        """Opened again for each frame, a file is decompressed from its start up to that frame."""
        opened, opener = [], nib.openers.ImageOpener
        image = nib.load(series(tmp_path, 6, name))
        monkeypatch.setattr(nib.openers, "ImageOpener", lambda *a, **b: opened.append(a) or opener(*a, **b))
        for k, shown in enumerate(flat.images(image)):
            assert_shows(shown, k)
        assert len(opened) == 1

    def test_an_array(self):
        """Of a map of voxels: shape and place are those of the volume that was flattened."""
        ball = np.linalg.norm(np.stack(np.meshgrid(*[np.arange(15.0)] * 3)) - 7, axis=0) < 5
        flat = voxflat.surface(ball.astype(np.uint8)).disk((7, 7, 12), 6.0).flatten(Voxflat(sources=30))
        stack = flat.images(np.stack([np.full(ball.shape, k, np.float32) for k in range(3)], axis=-1))
        assert [np.nanmax(image.data) for image in stack] == pytest.approx([0, 1, 2])

    def test_a_volume_of_vectors_is_not_shown_as_colours(self, flat):
        vectors = voxflat.io.Volume(np.ones((9, 9, 9, 3)), np.eye(4), is_vectors=True)
        refused("holds vectors, which have no image", flat.image, vectors)

    def test_a_series_cut_short(self, flat, tmp_path):
        path = series(tmp_path, name="bold.nii")
        path.write_bytes(path.read_bytes()[:-100])
        refused(r"bold.nii: ends after \d+ of \d+ bytes", flat.images, path)

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["long_flat.nii", "long_flat.tif", "long_flat.zarr", "long_flat.npy"])
    def test_a_long_series_is_never_in_memory(self, flat, tmp_path, name):
        path = series(tmp_path, 80, "long.nii", (33, 31, 20))  # 6.5 MB, and as much on the map
        stack = flat.images(path, 0.17)
        peaks = []
        for count in (2, 20, 80):  # the first one imports what writes
            part = replace(stack, channels=replace(stack.channels, names=("",) * count))
            tracemalloc.start()
            part.save(tmp_path / f"{count}_{name}")
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
        assert peaks[2] < peaks[1] + 1e6
        if name.endswith(".npy"):
            written = np.load(tmp_path / f"80_{name}", mmap_mode="r")
            assert_allclose(written[79], flat.image(path, 0.17, channel=79).data, rtol=1e-6)


class TestStackFiles:
    def test_tiff(self, flat, tmp_path):
        overlays(tmp_path)
        stack = flat.images(tmp_path / "z.func.gii")
        stack.save(tmp_path / "z.tif")
        with Image.open(tmp_path / "z.tif") as pages:
            assert pages.n_frames == 3
            for k, image in enumerate(stack):
                pages.seek(k)
                assert_array_equal(np.asarray(pages), image.data.astype(np.float32))
                assert pages.tag_v2[285] == NAMES[k]
                assert pages.info["dpi"][0] == pytest.approx(25.4 / image.pixel_size)
            pages.seek(0)
            assert "Title: z.func.gii; Pixel size: " in pages.tag_v2[270]

    def test_the_command(self, flat, tmp_path):
        flat.save(tmp_path / "map.npz")
        overlays(tmp_path)
        command = ["image", tmp_path / "map.npz", "--volume", tmp_path / "z.func.gii", "-o"]
        succeed(*command, tmp_path / "all.nii.gz")
        image = nib.load(tmp_path / "all.nii.gz")
        assert image.shape[3] == 3
        assert json.loads(image.header.extensions[0].get_content())["names"] == list(NAMES)
        told = "can hold only one image, but there are 3 (rest, 2BK-0BK, 3). Select one by name or number"
        fail(1, told, *command, tmp_path / "all.png")
        expected = flat.image(tmp_path / "z.func.gii", channel=1).data
        for channel in ("2BK-0BK", "1"):
            succeed(*command, tmp_path / "one.npy", "--channel", channel)
            assert_array_equal(np.load(tmp_path / "one.npy"), expected)
        assert run(*command, tmp_path / "one.png", "--channel", "none").exit_code == 1
        assert not list(tmp_path.glob("*.png"))

    def test_pages_of_atlases(self, tmp_path):
        write_mesh(tmp_path / "lh.plane", plane())
        overlays(tmp_path)
        atlas = voxflat.surface(tmp_path / "lh.plane").patches(bound=1.2)
        assert len(atlas.images(tmp_path / "z.func.gii")) == 3
        assert np.nanmax(atlas.image(tmp_path / "z.func.gii", channel="rest").data) == pytest.approx(72, abs=3)
