"""Depth: fractions of the cortex' volume and thickness, mm, means, stacks; by analytic volumes and Workbench."""

import json
import warnings
from dataclasses import replace

import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
from brain_spaces import at_vertices
from command_line import run, succeed
from mesh_files import grid, icosphere, needs_workbench, workbench
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import voxflat
from voxflat.io import Volume, write_volume
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.maps.depth import Depths, equivolume, smooth_areas, vertex_areas
from voxflat.methods import Voxflat

INNER, OUTER = 10.0, 13.0
FRACTIONS = (0.0, 0.1, 0.5, 0.8, 1.0)
GRID = np.array([[0.5, 0, 0, -15], [0, 0.5, 0, -15], [0, 0, 0.5, -15], [0, 0, 0, 1.0]])


@pytest.fixture(scope="module")
def shells():
    """Return the map of a disk of concentric spheres: what lies between them is known in closed form."""
    return voxflat.surface(icosphere(INNER), pial=icosphere(OUTER)).disk(0, 9.0).flatten(Voxflat(sources=40))


def volume_of(function, affine=GRID, n=61):
    """Return a volume whose value is a function of where it lies, x, y, z in mm."""
    ijk = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1)
    return Volume(function(*np.moveaxis(nib.affines.apply_affine(affine, ijk), -1, 0)), affine)


def radius_volume(affine=GRID, n=61):
    return volume_of(lambda x, y, z: np.sqrt(x**2 + y**2 + z**2), affine, n)


class TestFractions:
    def test_of_thickness(self, shells):
        for value in FRACTIONS:
            (points,) = shells._triangles.on_surface.at(Depths.of(fraction=value, layering="equidistant"))
            assert_allclose(np.linalg.norm(points, axis=1), INNER + value * (OUTER - INNER), atol=1e-12)

    def test_of_volume(self, shells):
        """Waehnert's formula with areas as r²; the true shell, whose area is a square, is 0.4 % of the way off."""
        for value in FRACTIONS:
            (points,) = shells._triangles.on_surface.at(Depths.of(fraction=value))
            way = (np.linalg.norm(points, axis=1) - INNER) / (OUTER - INNER)
            a, b = INNER**2, OUTER**2
            formula = (np.sqrt(value * b**2 + (1 - value) * a**2) - a) / (b - a)
            assert_allclose(way, formula, atol=1e-12)
            shell = (((1 - value) * INNER**3 + value * OUTER**3) ** (1 / 3) - INNER) / (OUTER - INNER)
            assert_allclose(way, shell, atol=0.004)

    def test_of_areas(self):
        assert equivolume(0.3, 2.0, 2.0) == pytest.approx(0.3, abs=1e-15)  # where the formula as printed is 0/0
        assert equivolume(0.3, 0.0, 0.0) == 0.3
        assert equivolume(0.25, 0.0, 7.0) == pytest.approx(0.5)  # a wedge
        assert equivolume(0.75, 7.0, 0.0) == pytest.approx(0.5)
        crowns, fundi = equivolume(0.5, 1.0, 2.0), equivolume(0.5, 2.0, 1.0)
        assert crowns > 0.5 > fundi
        assert crowns + fundi == pytest.approx(1)
        points, faces = icosphere(INNER)
        assert vertex_areas(points, faces).sum() == pytest.approx(pv.PolyData.from_regular_faces(points, faces).area)

    @pytest.mark.parametrize("edge", [1.0, 0.5])
    def test_areas_are_smoothed_over_half_the_thickness_for_any_triangles(self, edge):
        """The area of a sheet trebles at x = 0. The step is blurred as by the random walk of the averages."""
        sheet = grid(int(40 / edge) + 1, step=edge, columns=int(28 / edge) + 1)
        points = sheet.points - [20.0, 0, 0]
        wide = points * np.where(points[:, :1] > 0, [3.0, 1, 1], [1.0, 1, 1])
        (areas,) = smooth_areas([wide], points, sheet.faces, thickness=6.0)
        middle = np.isclose(points[:, 1], 14.0)
        slope, x = np.diff(areas[middle]) / (2 * edge**2), points[middle][:-1, 0] + edge / 2
        near = np.abs(x) < 12
        steps = (3.0 / edge) ** 2 + 1  # of a vertex and its six neighbours, four of which are one edge away along x
        assert slope[near].sum() == pytest.approx(1, rel=0.01)
        spread = np.sqrt((slope * x**2)[near].sum())
        assert spread == pytest.approx(edge * np.sqrt(steps * 4 / 7 + 0.25), rel=0.02)  # 1/4: areas are of vertices

    @pytest.mark.medium
    def test_lips_of_a_cut_have_one_depth(self):
        whole = voxflat.surface(icosphere(INNER, 2), pial=icosphere(OUTER, 2))
        m = voxflat.flatten(whole, Voxflat(sources=30))  # cut open
        rows = m._triangles.on_surface.at(Depths.of(fraction=0.5))[0]
        first = {int(v): row for v, row in zip(m.ids[::-1], rows[::-1], strict=True)}
        assert len(first) < len(m)
        assert_array_equal(rows, np.array([first[int(v)] for v in m.ids]))

    def test_linear_volumes_are_met_exactly(self, shells):
        """The value is x, y or z: between voxels, and between vertices, exactly linear."""
        raster = shells.raster(0.3)
        for how in ({"fraction": 0.3}, {"fraction": 0.3, "layering": "equidistant"}, {"depth": -0.7}):
            (points,) = shells._triangles.on_surface.at(Depths.of(**how))
            there = raster.interpolate(points)
            for axis in range(3):
                shown = shells.image(volume_of(lambda *xyz, axis=axis: xyz[axis]), 0.3, **how).data
                if "depth" in how:  # along normals that are of length 1 in every pixel
                    assert np.nanmax(np.abs(shown - there[..., axis])) < 0.01
                else:
                    assert_allclose(shown, there[..., axis], atol=1e-9)

    def test_they_are_kept_in_the_file(self, shells, tmp_path):
        shells.save(tmp_path / "m.npz")
        again = voxflat.load(tmp_path / "m.npz")
        assert_array_equal(again.white_points, icosphere(INNER)[0][shells.ids])
        assert_array_equal(again.pial_points, icosphere(OUTER)[0][shells.ids])
        assert_allclose(again.points, (again.white_points + again.pial_points) / 2)
        assert voxflat.surface(icosphere(INNER)).disk(0, 5.0).flatten(Voxflat(sources=10)).white_points is None


class TestSeveral:
    def test_a_stack_is_depth_row_column(self, shells):
        radius = radius_volume()
        stack = shells.images(radius, 0.4, fraction=FRACTIONS, layering="equidistant")
        assert stack.data.shape == (5, *shells.raster(0.4).shape)
        assert stack.names == tuple(f"equidistant {value:g}" for value in FRACTIONS)
        for value, layer, one in zip(FRACTIONS, stack.data, stack, strict=True):
            assert_array_equal(layer, shells.image(radius, 0.4, fraction=value, layering="equidistant").data)
            assert_array_equal(layer, one.data)
            assert np.nanmedian(layer) == pytest.approx(INNER + value * (OUTER - INNER), abs=0.05)
        onion = shells.images(radius, 0.4, depth=(-1, 0, 1))
        assert [round(float(np.nanmedian(layer)), 1) for layer in onion.data] == [10.5, 11.5, 12.5]
        assert onion["-1 mm"].provenance["parameters"]["layer"] == "-1 mm"

    def test_their_mean(self, shells):
        radius = radius_volume()
        mean = shells.image(radius, 0.4, fraction=(0.2, 0.5, 0.9))
        assert_allclose(mean.data, shells.images(radius, 0.4, fraction=(0.2, 0.5, 0.9)).data.mean(axis=0))
        assert_array_equal(mean.data, shells.images(radius, 0.4, fraction=(0.2, 0.5, 0.9), projection="mean")[0].data)

    @pytest.mark.parametrize("is_series", [False, True])
    @pytest.mark.parametrize("projection", ["mean", "max", "sum"])
    def test_depths_without_a_value_are_left_out_and_counted(self, shells, projection, is_series, caplog):
        """By NumPy's nan-functions of each depth alone; values are missing as NaN and outside the volume."""
        radius, middle = radius_volume(), shells.pial_points.mean(axis=0)
        beyond = volume_of(lambda x, y, z: (x**2 + y**2 + z**2 > 12.2**2) & (x > middle[0])).data
        cropped = np.where(beyond, np.nan, radius.data)[:, :, : 4 + int((middle[2] + 15) / 0.5)]
        fractions = (0.0, 0.4, 1.0)
        layers = shells.images(Volume(cropped, GRID), 0.4, fraction=fractions).data
        count = (~np.isnan(layers)).sum(axis=0)
        some, seen = np.count_nonzero((count > 0) & (count < 3)), np.count_nonzero(count)
        assert 0 < some < seen < shells.raster(0.4).inside.sum()
        given = Volume(cropped, GRID)
        if is_series:
            given = nib.Nifti1Image(np.stack([cropped, 2 * cropped], axis=-1), GRID)
        found = shells.images(given, 0.4, fraction=fractions, projection=projection)[0].data
        assert f"{some:,} of {seen:,} pixels have no value at some of the 3 depths" in caplog.text
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy warns about pixels without any value
            expected = {"mean": np.nanmean, "max": np.nanmax, "sum": np.sum}[projection](layers, axis=0)
        assert_allclose(found, expected, rtol=1e-12)
        strict = shells.images(given, 0.4, fraction=fractions, projection=projection, nan_policy="propagate")[0].data
        assert_allclose(strict, {"mean": np.mean, "max": np.max, "sum": np.sum}[projection](layers, axis=0), rtol=1e-12)
        assert f"They have no {projection}" in caplog.text

    def test_infinite_values_are_missing(self, shells, caplog):
        """A map of log-probabilities is −∞ where a probability is 0, which has no mean with other depths."""
        radius = radius_volume()
        data = np.where(radius.data < 11.0, -np.inf, radius.data)
        layers = shells.images(Volume(np.where(np.isinf(data), np.nan, data), GRID), 0.4, fraction=(0.2, 0.9)).data
        expected = np.where(np.isnan(layers).any(axis=0), np.nanmax(layers, axis=0), layers.mean(axis=0))
        for given in (Volume(data, GRID), nib.Nifti1Image(np.stack([data] * 2, axis=-1), GRID)):
            found = shells.images(given, 0.4, fraction=(0.2, 0.9), projection="mean")[0].data
            assert_allclose(found, expected, rtol=1e-12)
        assert "no value at some of the 2 depths" in caplog.text

    def test_majorities_and_colours_leave_out_depths_outside_the_volume(self, shells, caplog):
        labels = np.arange(61)[:, None, None] // 7 + np.zeros((61, 61, 61))
        top = 4 + int((shells.pial_points[:, 2].mean() + 15) / 0.5)
        small = Volume(labels[:, :, :top].astype(np.int16), GRID)
        how = {"fraction": (0.0, 1.0), "interpolation": "majority"}
        layers = shells.images(small, 0.4, **how).data
        strict = shells.image(small, 0.4, nan_policy="propagate", **how).data
        assert_array_equal(np.isnan(strict), np.isnan(layers).any(axis=0))
        is_partly = np.isnan(layers).any(axis=0) & ~np.isnan(layers).all(axis=0)
        assert is_partly.any()
        found = shells.image(small, 0.4, **how).data
        assert "no value at some of the 2 depths" in caplog.text
        assert_array_equal(found[is_partly], np.nanmax(layers[:, is_partly], axis=0))
        caplog.clear()
        rgb = Volume(np.repeat(labels[:, :, :top, None], 3, axis=3).astype(np.uint8), GRID)
        layers = shells.images(rgb, 0.4, fraction=(0.0, 1.0)).data
        found = shells.image(rgb, 0.4, fraction=(0.0, 1.0)).data
        assert "no value at some of the 2 depths" in caplog.text
        is_partly = (layers[..., 3] > 0).sum(axis=0) == 1
        strict = shells.image(rgb, 0.4, fraction=(0.0, 1.0), nan_policy="propagate").data
        assert_array_equal(strict[..., 3] > 0, (layers[..., 3] > 0).all(axis=0))
        assert_array_equal(found[is_partly], layers.max(axis=0)[is_partly])

    def test_channels_stay_channels(self, shells, tmp_path):
        x, y = (volume_of(lambda *xyz, axis=axis: xyz[axis]).data for axis in range(2))
        path = tmp_path / "series.nii.gz"
        nib.save(nib.Nifti1Image(np.stack([x, y, x - y], axis=-1).astype("f4"), GRID), path)
        stack = shells.images(path, 0.4, fraction=(0.25, 0.75))
        assert len(stack) == 6
        assert stack.data.shape[:2] == (3, 2)
        assert_allclose(stack.data[1, 0], shells.image(path, 0.4, channel=1, fraction=0.25).data, rtol=1e-12)
        assert_array_equal(shells.images(path, 0.4, channel=1, fraction=(0.25, 0.75)).data, stack.data[1])
        assert_allclose(
            shells.images(path, 0.4, fraction=(0.25, 0.75), projection="mean").data, stack.data.mean(axis=1)
        )
        stack.save(tmp_path / "out.nii.gz")
        image = nib.load(tmp_path / "out.nii.gz")
        assert image.shape == (*stack.data.shape[2:], 2, 3)
        assert_allclose(image.get_fdata(), np.transpose(stack.data, (2, 3, 1, 0)), rtol=1e-6)
        names = json.loads(image.header.extensions[0].get_content())["names"]
        assert names[:3] == ["equivolume 0.25", "equivolume 0.75", "equivolume 0.25"]
        stack.save(tmp_path / "out.npy")
        assert_allclose(np.load(tmp_path / "out.npy"), stack.data, rtol=1e-6)

    def test_colours(self, shells):
        grey = np.zeros((61, 61, 61, 3), np.uint8)
        grey[..., 0] = np.clip(10 * radius_volume().data, 0, 255)
        mean = shells.image(Volume(grey, GRID), 0.4, fraction=(0.0, 1.0), layering="equidistant").data
        assert np.median(mean[mean[..., 3] > 0][:, 0]) == pytest.approx(115, abs=2)
        assert set(np.unique(mean[..., 3])) == {0, 255}


class TestRefusals:
    def test_what_is_no_depth(self, shells):
        for how, message in (
            ({"fraction": 1.2}, r"fraction is 1.2. Pass numbers from 0"),
            ({"fraction": float("nan")}, r"fraction is nan. Pass a finite number"),
            ({"fraction": ()}, r"fraction is empty"),
            ({"depth": []}, r"depth is empty"),
            ({"fraction": "deep"}, r"fraction is 'deep'. Pass a number"),
            ({"depth": 1.0, "fraction": 0.5}, r"Pass only one"),
            ({"fraction": 0.5, "layering": "laplace"}, r"layering is 'laplace'. Pass 'equivolume' or 'equidistant'"),
            ({"depth": float("inf")}, r"depth is inf"),
        ):
            refused(message, shells.image, volume_of(lambda x, y, z: x), 1.0, **how)

    def test_what_has_no_depth(self, shells, tmp_path):
        labels = Volume(np.ones((61, 61, 61), np.uint8), GRID)
        refused(r"uint8 may be labels, which have no mean over depths", shells.image, labels, 1.0, fraction=(0.2, 0.8))
        assert np.nanmax(shells.image(labels, 1.0, fraction=(0.2, 0.8), interpolation="majority").data) == 1
        values = volume_of(lambda x, y, z: x + 0.1)
        refused("'majority', but the values are not labels", shells.image, values, 1.0, interpolation="majority")
        linear = shells.image(labels, 1.0, fraction=(0.2, 0.8), interpolation="linear")
        assert np.nanmax(linear.data) == pytest.approx(1, rel=1e-12)
        refused(r"overlay has values only on the surface", shells.image, np.arange(2562.0), fraction=0.5)
        alone = replace(shells, white_points=None, pial_points=None)
        refused("this map has no pial surface. Flatten the white surface with pial=", alone.image, values, fraction=0.5)


@pytest.mark.slow
def test_by_the_command_line(shells, tmp_path):
    shells.save(tmp_path / "m.npz")
    volume, out = tmp_path / "r.nii.gz", tmp_path / "out.npy"
    write_volume(volume, radius_volume().data.astype(np.float32), GRID)
    command = ["image", tmp_path / "m.npz", "--volume", volume, "--pixel-size", 0.6, "-o", out]
    succeed(*command, "--fraction", "0,0.5,1", "--layering", "equidistant")
    expected = shells.images(volume, 0.6, fraction=(0, 0.5, 1), layering="equidistant").data
    assert_allclose(np.load(out), expected, rtol=1e-6)
    succeed(*command, "--depth", "-1,1", "--projection", "mean")
    assert_allclose(np.load(out), shells.image(volume, 0.6, depth=(-1, 1)).data, rtol=1e-6)
    for wrong in (("--fraction", "0.5", "--depth", "1"), ("--layering", "equidistant"), ("--fraction", "half")):
        assert run(*command, *wrong).exit_code == 2


MEAN_RADIUS = 0.75 * (OUTER**4 - INNER**4) / (OUTER**3 - INNER**3)  # of the volume between the spheres: 11.628


def test_the_mean_over_equal_volumes_is_that_of_the_volume(shells):
    fractions = (np.arange(20) + 0.5) / 20
    ours = at_vertices(shells, radius_volume(), fraction=fractions)
    assert_allclose(ours, MEAN_RADIUS, atol=0.02)  # 0.005 of it by linear interpolation between voxels
    thick = at_vertices(shells, radius_volume(), fraction=fractions, layering="equidistant")
    assert_allclose(thick, (INNER + OUTER) / 2, atol=0.02)  # 11.5


@needs_workbench
@pytest.mark.slow
def test_ribbon_constrained_mapping_of_workbench_has_that_mean_too(tmp_path):
    for name, radius in (("white", INNER), ("mid", (INNER + OUTER) / 2), ("pial", OUTER)):
        write_mesh(tmp_path / f"{name}.surf.gii", Mesh(*icosphere(radius, 3)))
    coarse = GRID * [2, 2, 2, 1]
    write_volume(tmp_path / "v.nii.gz", radius_volume(coarse, 31).data, coarse)
    arguments = ["v.nii.gz", "mid.surf.gii", "out.shape.gii", "-ribbon-constrained", "white.surf.gii", "pial.surf.gii"]
    workbench("-volume-to-surface-mapping", *arguments, "-thin-columns", folder=tmp_path)
    assert nib.load(tmp_path / "out.shape.gii").darrays[0].data.mean() == pytest.approx(MEAN_RADIUS, abs=0.04)


def test_fractions_of_the_depth_are_heights_in_median_thicknesses(shells):
    thick = shells.points[:, 0] > np.percentile(shells.points[:, 0], 70)
    pial = shells.white_points + (shells.pial_points - shells.white_points) * np.where(thick, 4, 1)[:, None]
    stack = replace(shells, pial_points=pial).images(volume_of(lambda x, y, z: x), depths=2, layering="equidistant")
    assert_allclose(stack.heights, [0.25 * (OUTER - INNER), 0.75 * (OUTER - INNER)], rtol=1e-3)
