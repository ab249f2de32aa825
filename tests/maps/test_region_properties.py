"""Areas, perimeters and shapes of regions on a map are those on the surface, on analytic shapes."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import tifffile
from command_line import fail, succeed
from mesh_files import grid, icosphere
from refusals import refused

import voxflat
from voxflat.maps.region_properties import _along_outline
from voxflat.methods import Voxflat

RADIUS = 20.0
STRETCHED = np.array([[1.6, 0.0], [0.5, 0.7]])


@pytest.fixture(scope="module")
def cap():
    """Return the map of a disk of 18 mm around a pole of a sphere."""
    return voxflat.surface(icosphere(RADIUS, 5)).disk(0, 18.0).flatten(Voxflat(sources=30))


@pytest.fixture(scope="module")
def tube():
    """Return the map of half of a cylinder around x with a radius of 30 µm, which can be flattened exactly."""
    sheet = grid(61, step=1.0, columns=95)
    x, turn = sheet.points[:, 0], sheet.points[:, 1] / 30
    points = np.column_stack([x, 30 * np.sin(turn), 30 * np.cos(turn)])
    return voxflat.surface((points, sheet.faces), unit="µm").flatten(Voxflat(sources=30))


@pytest.fixture(scope="module")
def egg():
    """Return the map, with cuts, of a closed ellipsoid with semi-axes of 20, 12 and 10 µm."""
    points, faces = icosphere(1.0, 4)
    return voxflat.surface((points * [20, 12, 10], faces), unit="µm").flatten(Voxflat(sources=30))


def near(m, centre, radius, pixel_size):
    """Return a label image of the pixels within a distance, in space, of a point."""
    return (np.linalg.norm(m.locate(pixel_size)[1] - centre, axis=-1) < radius).astype(np.int32)


def measured(m, labels, pixel_size, **how):
    return m.regions(labels, pixel_size=pixel_size).properties(**how)


@pytest.mark.medium
@pytest.mark.parametrize("corner", [(0.0, 0.0), (-3.3, 1.7), (0.21, -0.4)])
def test_the_area_of_a_drawn_outline_does_not_depend_on_the_pixels(corner):
    """Whole pixels made it up to 5 % too large or too small."""
    flat_map = voxflat.samples.hill().flatten()
    for width in (5.0, 8.0, 10.0):
        square = np.array([(0.0, 0.0), (width, 0.0), (width, width), (0.0, width)]) + corner
        assert flat_map.regions({"a": square}).properties()["map_area"] == pytest.approx(width**2, rel=0.004)


@pytest.mark.medium
def test_a_spherical_cap(cap):
    """Its area, perimeter, centroid and second moments are known."""
    angle = 0.35
    pole = cap.points[cap.ids == 0][0]
    for size in (0.25, 0.1):
        found = measured(cap, near(cap, pole, 2 * RADIUS * np.sin(angle / 2), size), size)
        assert found["area"] == pytest.approx(2 * np.pi * RADIUS**2 * (1 - np.cos(angle)), rel=0.01)
        assert found["perimeter"] == pytest.approx(2 * np.pi * RADIUS * np.sin(angle), rel=0.015)
        centre = np.array([found[axis][0] for axis in "xyz"])
        np.testing.assert_allclose(centre, pole * (1 + np.cos(angle)) / 2, atol=0.05)
        np.testing.assert_allclose([found["u"][0], found["v"][0]], cap.uv[cap.ids == 0][0], atol=0.1)
        assert found["elongation"] == pytest.approx(1, abs=0.02)
        height = RADIUS * (1 - np.cos(angle))  # by Archimedes, the height is distributed evenly over the area
        heights = np.linspace(RADIUS - height, RADIUS, 1001)
        wide = 4 * np.sqrt(np.mean(RADIUS**2 - heights**2) / 2)
        assert found["major_axis"] == pytest.approx(wide, rel=0.015)


@pytest.mark.medium
def test_an_ellipse_on_a_cylinder(tube):
    """An ellipse of 12 x 6 µm, 30 degrees from the axis, in the plane into which the cylinder unrolls."""
    at = tube.locate(0.2)[1]
    along = np.stack([at[..., 0] - 30, 30 * np.arctan2(at[..., 1], at[..., 2]) - 45], axis=-1)
    turned = along @ np.array([[np.cos(np.pi / 6), -np.sin(np.pi / 6)], [np.sin(np.pi / 6), np.cos(np.pi / 6)]])
    found = measured(tube, ((turned / [6.0, 3.0]) ** 2).sum(axis=-1) < 1, 0.2)
    assert found["area"] == pytest.approx(18 * np.pi, rel=0.01)
    assert found["perimeter"] == pytest.approx(4 * 6 * scipy.special.ellipe(0.75), rel=0.015)
    assert found["major_axis"] == pytest.approx(12, rel=0.01)
    assert found["minor_axis"] == pytest.approx(6, rel=0.01)
    assert found["elongation"] == pytest.approx(2, rel=0.01)
    direction = np.array([found[f"direction_{axis}"][0] for axis in "xyz"])
    true = np.array([np.cos(np.pi / 6), *(np.sin(np.pi / 6) * np.array([np.cos(1.5), -np.sin(1.5)]))])
    assert abs(direction @ true) > np.cos(np.radians(1))
    ends = np.array([[found[axis][0] for axis in "xyz"] + step * direction for step in (0.0, 0.5)])
    step = np.diff(tube.points_to_map(ends)[0], axis=0)[0]
    assert np.degrees(np.arctan2(step[1], step[0])) == pytest.approx(found["map_direction"][0], abs=1)


def test_a_region_of_few_pixels_has_the_moments_of_its_squares():
    """Pixels are squares, not points: a rectangle a x b has second moments a²/12 and b²/12."""
    sheet = grid(21)
    m = replace(voxflat.surface(sheet).flatten(Voxflat(sources=10)), uv=sheet.points[:, :2])
    labels = np.zeros(m.raster(1.0).shape, dtype=int)
    for wide, high in ((1, 1), (3, 1), (3, 2)):
        labels[:] = 0
        labels[4 : 4 + high, 6 : 6 + wide] = 1
        found = measured(m, labels, 1.0)
        assert found["major_axis"] == pytest.approx(4 * wide / np.sqrt(12), rel=1e-6)
        assert found["minor_axis"] == pytest.approx(4 * high / np.sqrt(12), rel=1e-6)


def ellipse(wide, high):
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    return np.column_stack([wide / 2 * np.cos(turn), high / 2 * np.sin(turn)])


def rectangle(wide, high):
    """Return a rectangle with the second moments of an ellipse of this width and height."""
    return np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array([wide, high]) * np.sqrt(3) / 4


@pytest.mark.medium
@pytest.mark.parametrize("shape", [ellipse, rectangle])
@pytest.mark.parametrize("size", [(4.0, 2.0), (6.0, 3.0)])
def test_second_moments_of_a_drawn_outline_do_not_depend_on_coarse_pixels(shape, size):
    """Samples of border pixels that counted as whole pixels made the minor axis up to 15 % too long."""
    sheet = grid(21, step=2.0)
    m = replace(voxflat.surface(sheet).flatten(Voxflat(sources=10)), uv=sheet.points[:, :2])
    for degrees in (0, 30, -70, 45):
        along = np.radians(degrees)
        turn = np.array([[np.cos(along), np.sin(along)], [-np.sin(along), np.cos(along)]])
        middles = 20 + np.random.default_rng(0).uniform(-1, 1, (10, 2))
        drawn = [m.regions({"a": shape(*size) @ turn + middle}).properties(pixel_size=1.0) for middle in middles]
        axes = np.mean([(one["major_axis"][0], one["minor_axis"][0]) for one in drawn], axis=0)
        np.testing.assert_allclose(axes, size, rtol=0.015)
        off = np.concatenate([one["map_direction"] for one in drawn]) - degrees
        assert abs(np.mean((off + 90) % 180 - 90)) < 2


@pytest.mark.medium
def test_a_stretched_map_changes_no_property_of_the_surface(cap):
    """A patch drawn on a map that is stretched by 1.69 and 0.66 along its axes has the same properties."""
    other = replace(cap, uv=cap.uv @ STRETCHED)
    of = []
    for m in (cap, other):
        at = m.locate(0.1)[1] - cap.points[cap.ids == 0][0]
        labels = ((at / [5.0, 3.0, 9.0]) ** 2).sum(axis=-1) < 1
        of.append(measured(m, labels, 0.1, image=np.nan_to_num(at[..., 0])))
    for name in ("area", "x", "y", "z", "major_axis", "minor_axis", "mean"):
        assert of[0][name] == pytest.approx(of[1][name], rel=0.01, abs=0.02), name
    assert of[0]["perimeter"] == pytest.approx(of[1]["perimeter"], rel=0.03)
    axes = [np.array([one[f"direction_{axis}"][0] for axis in "xyz"]) for one in of]
    assert abs(axes[0] @ axes[1]) > 0.999
    assert of[1]["map_area"] / of[0]["map_area"] == pytest.approx(np.linalg.det(STRETCHED), rel=0.01)
    assert of[0]["mean"] == pytest.approx(of[0]["x"] - cap.points[cap.ids == 0][0][0], abs=1e-9)


@pytest.mark.medium
def test_a_region_across_a_cut_is_measured_as_a_whole(egg):
    """A disk around a point of a cut, in several parts on the map, has its whole area and no border along the cut."""
    ids, counts = np.unique(egg.ids, return_counts=True)
    on_cut = egg.points[np.isin(egg.ids, ids[counts > 1])]
    centre = on_cut[np.abs(on_cut[:, 0]).argmin()]
    labels = near(egg, centre, 4.0, 0.1)
    assert scipy.ndimage.label(labels)[1] > 1
    found = measured(egg, labels, 0.1)
    points, faces = icosphere(1.0, 7)
    corners = (points * [20, 12, 10])[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    inside = np.linalg.norm(corners.mean(axis=1) - centre, axis=1) < 4
    assert found["area"] == pytest.approx(areas[inside].sum(), rel=0.01)
    assert found["perimeter"] == pytest.approx(np.sqrt(4 * np.pi * areas[inside].sum()), rel=0.03)
    true = (areas[inside, None] * corners[inside].mean(axis=1)).sum(axis=0) / areas[inside].sum()
    np.testing.assert_allclose([found[axis][0] for axis in "xyz"], true, atol=0.05)


@pytest.mark.medium
def test_cells_of_a_closed_surface_cover_it(egg):
    """The areas of all cells sum to the area of the ellipsoid, by Knud Thomsen's formula within 1 %."""
    seeds = egg.points[:: len(egg) // 30]
    at = egg.locate(0.2)[1]
    cells = scipy.spatial.cKDTree(seeds).query(np.nan_to_num(at))[1] + 1
    found = measured(egg, cells, 0.2)
    whole = 4 * np.pi * np.mean([240**1.6075, 200**1.6075, 120**1.6075]) ** (1 / 1.6075)
    assert found["area"].sum() == pytest.approx(whole, rel=0.01)
    assert (found["perimeter"] > np.sqrt(4 * np.pi * found["area"]) * 0.97).all()  # the isoperimetric inequality


@pytest.mark.medium
def test_curvature_is_that_of_the_surface(cap, egg):
    whole = measured(cap, near(cap, cap.points[cap.ids == 0][0], 9.0, 0.25), 0.25)
    assert whole["curvature"] == pytest.approx(1 / RADIUS, rel=0.01)
    at, axes = egg.locate(0.2)[1], np.array([20.0, 12, 10])
    cells = scipy.spatial.cKDTree(egg.points[:: len(egg) // 30]).query(np.nan_to_num(at))[1] + 1
    slope = ((at / axes**2) ** 2).sum(axis=-1) ** 1.5
    true = ((axes**2).sum() - (at**2).sum(axis=-1)) / (2 * axes.prod() ** 2 * slope)
    found = measured(egg, cells, 0.2, image=true)
    np.testing.assert_allclose(found["curvature"], found["mean"], rtol=0.06)


@pytest.mark.medium
def test_the_border_of_the_surface_counts_as_perimeter(tube):
    """The whole sheet of 60 x 94 µm ends at its own border."""
    low, high = tube.uv.min(axis=0) - 1, tube.uv.max(axis=0) + 1
    box = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    found = tube.regions(box).properties()
    assert found["area"] == pytest.approx(60 * 94, rel=0.01)
    assert found["perimeter"] == pytest.approx(2 * (60 + 94), rel=0.01)


def test_a_region_that_ends_on_the_border_of_the_surface_is_measured_without_bias():
    """Of the border of a square of 20 x 20, regions x < c contain 20 + 2 c, on average over places between samples."""
    sheet = voxflat.surface(grid(3, step=10.0)).flatten(Voxflat(sources=9))
    there, *_ = np.linalg.lstsq(np.column_stack([sheet.uv, np.ones(9)]), sheet.points[:, 0])
    ends = np.arange(4.0, 16.0, 0.1) + 0.05
    found = [
        _along_outline(sheet, np.array([1]), lambda uv, c=c: (uv @ there[:2] + there[2] < c).astype(np.int64), 2.0)[0]
        for c in ends
    ]
    np.testing.assert_allclose(found, 20 + 2 * ends, atol=1.01)  # samples are 1 mm apart
    assert np.mean(np.array(found) - 20 - 2 * ends) == pytest.approx(0, abs=0.05)


AXES, SPACING = np.array([20.0, 12.0, 10.0]), np.array([0.4, 0.4, 1.0])  # µm, of an ellipsoid and its voxels


@pytest.fixture(scope="module")
def organ(tmp_path_factory):
    """Write a stack of an ellipsoid with two channels, its map with cuts, and cells on the map; return the folder.

    The first channel is the probability of the inside, and the second is the position along z.
    """
    folder = tmp_path_factory.mktemp("organ")
    shape = np.ceil(2 * (AXES + 4) / SPACING).astype(int)
    xyz = (np.moveaxis(np.indices(shape), 0, -1)) * SPACING
    solid = ((((xyz - AXES - 4) / AXES) ** 2).sum(-1) < 1).astype(np.float32)
    channels = np.stack([scipy.ndimage.gaussian_filter(solid, 1 / SPACING), xyz[..., 2].astype(np.float32)])
    told = {f"PhysicalSize{axis}": size for axis, size in zip("XYZ", SPACING.tolist(), strict=True)}
    told |= {"axes": "CZYX", "Channel": {"Name": ["inside", "z position"]}}
    tifffile.imwrite(folder / "stack.ome.tif", channels.transpose(0, 3, 2, 1), metadata=told)
    surface = voxflat.surface(voxflat.io.read_volume(folder / "stack.ome.tif", "inside"), threshold=0.5)
    m = surface.flatten(Voxflat(sources=30))
    m.save(folder / "map.npz")
    at = m.locate()[1]
    seeds = m.points[:: len(m) // 60]
    cells = np.where(np.isnan(at[..., 0]), 0, scipy.spatial.cKDTree(seeds).query(np.nan_to_num(at))[1] + 1)
    tifffile.imwrite(folder / "cells_cp_masks.tif", cells.astype(np.uint16))
    return folder


def overlap(one, other):
    """Return the Dice coefficient of two label images."""
    both = np.count_nonzero((one == other) & (one > 0))
    return 2 * both / (np.count_nonzero(one) + np.count_nonzero(other))


@pytest.mark.slow
def test_labels_return_from_an_anisotropic_volume_in_micrometres(organ, monkeypatch):
    """From 60 cells on the map to voxels and back, by the command line, across cuts, with Dice >= 0.98."""
    monkeypatch.chdir(organ)
    succeed("regions", "map.npz", "--image", "cells_cp_masks.tif", "--depth", "-2,2", "-o", "cells.nii.gz")
    how = ("--depth", "-1.5:1.5:0.75", "--interpolation", "majority", "--projection", "mean")
    succeed("image", "map.npz", "--volume", "cells.nii.gz", *how, "-o", "back.tif")
    cells, back = (tifffile.imread(name) for name in ("cells_cp_masks.tif", "back.tif"))
    assert overlap(cells, np.nan_to_num(back)) >= 0.98
    regions = voxflat.load("map.npz").regions("back.tif")
    drawn = voxflat.load("map.npz").regions("cells_cp_masks.tif")
    areas = drawn.properties()["area"]
    np.testing.assert_allclose(regions.properties()["area"], areas, rtol=0.1)
    corners = drawn.of.points[drawn.of.faces]
    sides = corners[:, 1:] - corners[:, :1]
    assert areas.sum() == pytest.approx(np.linalg.norm(np.cross(*sides.swapaxes(0, 1)), axis=1).sum() / 2, rel=0.01)


@pytest.mark.slow
def test_means_of_channels_over_a_range_of_depths(organ, monkeypatch):
    monkeypatch.chdir(organ)
    command = ("regions", "map.npz", "--image", "cells_cp_masks.tif", "--volume", "stack.ome.tif")
    succeed(*command, "-o", "surface.tsv")
    succeed(*command, "--depth", "-1,1", "-o", "around.tsv")
    for name, within in (("surface.tsv", 0.02), ("around.tsv", 0.3)):
        rows = list(csv.DictReader(Path(name).read_text().splitlines(), delimiter="\t"))
        z, channel = ([float(row[key]) for row in rows] for key in ("z_um", "mean_z_position"))
        np.testing.assert_allclose(channel, z, atol=within)
        inside = np.array([float(row["mean_inside"]) for row in rows])
        np.testing.assert_allclose(inside, 0.5, atol=0.1)
    fail(
        1,
        "--depth is given, but no volume to average over these depths. Pass --volume",
        *command[:4],
        "--depth",
        "-1,1",
        "-o",
        "no.tsv",
    )
    fail(1, "missing.tif", *command[:5], "missing.tif", "-o", "no.tsv")


@pytest.mark.medium
def test_the_table_has_names_units_and_one_row_per_region(tube, tmp_path):
    middle = tube.uv.mean(axis=0)
    corners = {"two": [[0, 0], [9, 0], [9, 6], [0, 6]], "one": [[0, 0], [-6, 0], [-6, -6], [0, -6]]}
    drawn = {name: middle + np.array(at) for name, at in corners.items()}
    regions = tube.regions(drawn)
    regions.save(tmp_path / "cells.tsv", sidecar=True)
    rows = list(csv.DictReader((tmp_path / "cells.tsv").open(), delimiter="\t"))
    found = regions.properties()
    assert [row["name"] for row in rows] == list(found["name"]) == ["two", "one"]
    np.testing.assert_allclose([float(row["area_um2"]) for row in rows], found["area"], rtol=1e-6)
    np.testing.assert_allclose(found["area"], [54, 36], rtol=0.03)
    assert {"perimeter_um", "map_direction_degrees", "u_um", "elongation"} < set(rows[0])
    regions.save(tmp_path / "cells.csv")
    assert (tmp_path / "cells.csv").read_text().startswith("label,name,area_um2,perimeter_um,")


def test_a_region_without_a_pixel_is_missing(tube, tmp_path):
    middle = tube.uv.mean(axis=0)
    small, large = ([[-a, -a], [a, -a], [a, a], [-a, a]] for a in (1.0, 5.0))
    regions = tube.regions({"hidden": middle + small, "above": middle + large})
    found = regions.properties()
    assert found["area"][0] == 0 < found["area"][1]
    assert np.isnan([found[name][0] for name in ("x", "u", "major_axis", "map_direction")]).all()
    regions.save(tmp_path / "cells.tsv")
    assert (tmp_path / "cells.tsv").read_text().splitlines()[1].startswith("1\thidden\t0\t0\t0\tn/a\t")


def test_pixels_without_a_value_are_left_out_of_a_mean_and_counted(cap, caplog):
    flat = cap[0] if isinstance(cap, tuple) else cap
    regions = flat.regions({"a": [[-2, -2], [2, -2], [2, 2], [-2, 2]]})
    shape = flat.raster(0.5).shape
    image = np.full(shape, 7.0)
    inside = np.nan_to_num(regions.image(0.5).data) > 0
    rows, columns = np.nonzero(inside)
    image[rows[::4], columns[::4]] = np.nan
    assert regions.properties(image, pixel_size=0.5)["mean"] == pytest.approx(7.0)
    assert f"{len(rows[::4]):,} of " in caplog.text
    assert "pixels of the regions have no value, and are left out" in caplog.text
    others = flat.regions({"a": [[-2, -2], [2, -2], [2, 2], [-2, 2]], "b": [[3, -2], [5, -2], [5, 2], [3, 2]]})
    assert np.isnan(others.properties(image, pixel_size=0.5, nan_policy="propagate")["mean"]).tolist() == [True, False]
    assert "make the mean of their region NaN" in caplog.text
    refused("nan_policy is 'strict'", others.properties, image, nan_policy="strict")


def test_refusals(cap, tmp_path):
    regions = cap.regions(near(cap, cap.points[0], 9.0, 0.5), pixel_size=0.5)
    refused(r"the image has shape \(3, 3\), but the map has", regions.properties, np.zeros((3, 3)))
    refused("the image are 'a'. Pass numbers", regions.properties, "a")
    for pixel_size in (-1.0, 0.0):
        refused("pixel size", regions.properties, pixel_size=pixel_size)
    refused("depth is given, but no volume to average", regions.save, tmp_path / "a.tsv", depth=(0, 1))
    for depth in (1.0, (1, 0), (0, np.inf)):
        refused("depth is", regions.save, tmp_path / "a.tsv", volume=np.ones(len(cap)), depth=depth)
    for name in ("a.annot", "a.label"):
        refused("does not store voxels, so volume and depth do not apply", regions.save, tmp_path / name, depth=(0, 1))
    assert list(tmp_path.iterdir()) == []
