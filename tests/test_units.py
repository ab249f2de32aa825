"""Lengths are shown in the unit of the surface, and without a unit if it is unknown."""

import logging
import re
from dataclasses import replace
from xml.etree import ElementTree

import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
import shapes
import tifffile
import trimesh
from command_line import run, succeed
from matplotlib.text import Text
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from refusals import refused

import voxflat
from voxflat import figures
from voxflat.io.grid import in_unit, named_unit

SIZE = 0.5 * 0.65  # µm, half a voxel
MM = re.compile(r"(?<![A-Za-z])mm(?![A-Za-z])")


def test_units_have_their_usual_names():
    assert {named_unit(given) for given in ("µm", "um", "micron", "micrometer", "Micrometre")} == {"µm"}
    for given in ("", "?", "unknown", "ms", "furlong", 3, None):
        refused("Pass one of mm, cm, m, µm, nm, inch", named_unit, given)


@pytest.mark.parametrize(
    ("text", "in_micrometres", "without"),
    [
        ("33 x 28 mm, error", "33 x 28 µm, error", "33 x 28, error"),
        ("u (mm)", "u (µm)", "u"),
        ("(256 mm in total)", "(256 µm in total)", "(256 in total)"),
        ("area, mm²", "area, µm²", "area"),
        ("hammer", "hammer", "hammer"),
    ],
)
def test_a_text_is_put_into_a_unit(text, in_micrometres, without):
    assert in_unit(text, "mm") == text
    assert in_unit(text, "µm") == in_micrometres
    assert in_unit(text, "unknown") == without


def told_of(surface, tmp_path, caplog):
    """Return all texts about a surface and its map, and the map."""
    with caplog.at_level(logging.INFO):
        opened = surface.cut()
        flat_map = opened.flatten()
    flat_map.save(tmp_path / "map.npz")
    again = voxflat.load(tmp_path / "map.npz")
    judged = voxflat.measure(surface, again)
    texts = [repr(surface), surface._repr_html_(), opened._repr_html_(), repr(flat_map), repr(again)]
    worst, atlas = voxflat.worst_places(again, beyond=1.01), surface.patches(max_angle=30)
    texts += [worst.table(), atlas.table(), atlas.glue(bound=1.5).table(), *map(repr, (worst, atlas, atlas.page()))]
    texts += [again.distortion.table(), judged.table(), *(record.message for record in caplog.records)]
    for figure in (figures.scatter(again), figures.heat_map(again), figures.flat_map(again)):
        texts += [text.get_text() for text in figure.findobj(Text)]
    return [re.sub(r'base64,[^"]*', "", text) for text in texts if "MiB" not in text], again


@pytest.mark.medium
def test_micrometres_are_carried_through(tmp_path, caplog):
    cells = shapes.ball(8)
    texts, flat_map = told_of(voxflat.surface(cells, spacing=(0.65,) * 3, unit="um"), tmp_path, caplog)
    assert not [text for text in texts if MM.search(text)]
    assert sum("µm" in text for text in texts) > 10
    other = voxflat.surface(cells, spacing=(0.65,) * 3).flatten()
    np.testing.assert_array_equal(flat_map.uv, other.uv)  # lengths do not change


@pytest.mark.medium
@pytest.mark.parametrize("mesh", [pv.Sphere(radius=30), pv.Sphere(radius=3e6)])
def test_nothing_says_mm_of_an_unknown_unit(mesh, tmp_path, caplog):
    texts, _ = told_of(voxflat.surface(mesh), tmp_path, caplog)
    assert not [text for text in texts if MM.search(text)]
    told, _ = told_of(voxflat.surface(mesh, unit="mm"), tmp_path, caplog)
    assert sum(bool(MM.search(text)) for text in told) > 10


@pytest.mark.medium
def test_the_command_line_takes_a_unit(tmp_path):
    pv.Sphere(radius=300.0, theta_resolution=20, phi_resolution=20).save(tmp_path / "cell.ply")
    given = ["flatten", tmp_path / "cell.ply", "-o", tmp_path / "map.npz"]
    assert not MM.search(succeed(*given).output)
    assert "µm" in succeed(*given, "--unit", "µm").output
    assert "size" in succeed("check", tmp_path / "cell.ply", "--unit", "nm").output
    succeed("figure", tmp_path / "map.npz", "-o", tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.size[0] > 500


def test_a_volume_that_tells_its_size_has_its_unit(tmp_path):
    nib.save(nib.Nifti1Image(shapes.ball(8).astype(np.uint8), np.eye(4)), tmp_path / "ball.nii")
    refused("this volume defines its voxel size in mm", voxflat.surface, tmp_path / "ball.nii", unit="µm")
    assert run("flatten", tmp_path / "ball.nii", "--unit", "µm", "-o", tmp_path / "m.npz").exit_code == 1


@pytest.mark.medium
def test_pyvista_takes_a_unit(caplog):
    with caplog.at_level(logging.INFO):
        pv.Sphere(radius=300.0).voxflat(unit="µm")
    assert "µm in total" in caplog.text


@pytest.mark.medium
@pytest.mark.parametrize("name", ["hill.surf.gii", "lh.white", "hill.patch.3d", "map.surf.gii", "map.flat.patch.3d"])
def test_a_warning_says_when_lengths_that_are_not_known_to_be_in_mm_become_mm(tmp_path, name, caplog):
    voxflat.samples.hill().save(tmp_path / "hill.obj")
    for unit, told in ((None, "is unknown, but this format is in mm"), ("m", "are in m, but"), ("mm", None)):
        surface = voxflat.surface(tmp_path / "hill.obj", unit=unit)
        made = surface.flatten(voxflat.methods.Voxflat(sources=9)) if name.startswith("map") else surface
        caplog.clear()
        made.save(tmp_path / name)
        assert [told in text for text in caplog.messages] == [True] * (told is not None)
        if unit is None:
            made.save(tmp_path / "plain.obj")
            assert len(caplog.messages) == 1


@pytest.mark.medium
def test_a_warning_says_when_a_map_in_another_unit_becomes_a_gifti_image(tmp_path, caplog):
    voxflat.samples.hill().save(tmp_path / "hill.obj")
    for unit, told in ((None, "is unknown, but this format is in mm"), ("µm", "are in µm, but"), ("mm", None)):
        flat = voxflat.surface(tmp_path / "hill.obj", unit=unit).flatten(voxflat.methods.Voxflat(sources=9))
        for convert in (flat.to_gifti, lambda flat=flat: flat.to_pyvista().save(tmp_path / "flat.surf.gii")):
            caplog.clear()
            convert()
            assert [told in text for text in caplog.messages] == [True] * (told is not None)


def test_a_warning_says_when_a_mesh_of_unknown_unit_is_written_in_mm(tmp_path, caplog):
    voxflat.samples.hill().save(tmp_path / "hill.ply")
    for name in ("hill.surf.gii", "lh.white", "hill.vtp"):
        voxflat.io.write_mesh(tmp_path / name, voxflat.io.read_mesh(tmp_path / "hill.ply"))
    told = "the unit of the coordinates is unknown, but this format is in mm. Pass unit when reading the mesh"
    assert caplog.messages == [f"{tmp_path / name}: {told}" for name in ("hill.surf.gii", "lh.white")]


@pytest.fixture(scope="module")
def maps():
    """Maps of a ball in µm and of a surface with an unknown unit."""
    cell = voxflat.surface(shapes.ball(8), spacing=(0.65,) * 3, unit="µm").flatten()
    return cell, voxflat.flatten(pv.Sphere(radius=5))


@pytest.mark.medium
def test_images_in_files_have_the_size_of_the_cell_or_no_unit(maps, tmp_path):
    for flat_map, size in zip(maps, (SIZE, None), strict=True):
        shape = flat_map.volume_shape if flat_map.is_voxels else (flat_map.metadata["vertices"],)
        values = np.arange(2.0 * np.prod(shape)).reshape(*shape, 2)
        for ending in ("png", "tif", "nii.gz"):
            flat_map.heat_map(None if size else 0.5).save(tmp_path / f"map.{ending}")
            if ending != "png":
                flat_map.images(values, None if size else 0.5).save(tmp_path / f"stack.{ending}", overwrite=True)
        for name in ("map.nii.gz", "stack.nii.gz"):
            header = nib.load(tmp_path / name).header
            assert header.get_xyzt_units()[0] == ("mm" if size else "unknown")
            assert header.get_zooms()[0] == pytest.approx(1e-3 * size if size else 0.5)
        with Image.open(tmp_path / "map.png") as png, Image.open(tmp_path / "map.tif") as tiff:
            told = png.text["Pixel size"], tiff.tag_v2[270].split("; ")[1].removeprefix("Pixel size: ")
            per_cm = tiff.tag_v2.get(282)
        assert told == (("0.325 um",) * 2 if size else ("0.5",) * 2)
        if size:
            assert float(per_cm) == pytest.approx(1e4 / size, rel=1e-3)
        with tifffile.TiffFile(tmp_path / "stack.tif") as file:
            assert ('PhysicalSizeX="0.325" PhysicalSizeXUnit="&#181;m"' in file.ome_metadata) == bool(size)
            assert ("PhysicalSizeXUnit" in file.ome_metadata) == bool(size)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["map.tif", "map.ome.tif"])
def test_a_single_image_is_an_ome_tiff_with_its_name_and_pixel_size(maps, tmp_path, name):
    for flat_map, size in zip(maps, (SIZE, None), strict=True):
        image = replace(flat_map.heat_map(None if size else 0.5), name="α & <β>")
        colours = np.random.default_rng(0).integers(0, 255, (*image.data.shape, 4)).astype(np.uint8)
        for data, axes in ((image.data.astype(np.float32), "YX"), (colours[..., :3], "YXS"), (colours, "YXS")):
            replace(image, data=data).save(tmp_path / name, overwrite=True)
            with tifffile.TiffFile(tmp_path / name) as file:
                assert (file.is_ome, len(file.series), len(file.pages)) == (True, 1, 1)
                assert file.series[0].axes == axes
                np.testing.assert_array_equal(file.series[0].asarray(), data)
                root = ElementTree.fromstring(file.ome_metadata)
            pixels, channel = root.find(".//{*}Pixels"), root.find(".//{*}Channel")
            assert (root.find("{*}Image").get("Name"), channel.get("Name")) == ("α & <β>",) * 2
            assert pixels.get("Type") == data.dtype.name.removesuffix("32")
            assert pixels.get("SizeC") == channel.get("SamplesPerPixel") == str((*data.shape, 1)[2])
            known = [pixels.get(f"PhysicalSize{axis}{end}") for axis in "XY" for end in ("", "Unit")]
            assert known == (["0.325", "µm"] * 2 if size else [None] * 4)
            with Image.open(tmp_path / name) as opened:
                np.testing.assert_array_equal(np.asarray(opened), data)


@pytest.mark.medium
def test_a_channel_of_ome_zarr_becomes_a_surface_in_its_unit(tmp_path):
    cell = shapes.ball(8).astype(np.uint8)
    zarr = pytest.importorskip("zarr", minversion="3")
    group = zarr.open_group(str(tmp_path / "cell.zarr"), mode="w", zarr_format=2)
    array = group.create_array("0", shape=(2, *cell.T.shape), chunks=(1, 7, 7, 7), dtype=np.uint8)
    array[1] = cell.T
    axes = [{"name": "c", "type": "channel"}]
    axes += [{"name": axis, "type": "space", "unit": unit} for axis, unit in (("z", "nanometer"), ("y", "micrometer"))]
    axes += [{"name": "x", "type": "space", "unit": "micrometer"}]
    steps = [{"type": "scale", "scale": [1, 2000, 0.65, 0.65]}]
    images = [{"path": "0", "coordinateTransformations": steps}]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": images}]
    refused("has 2 channels or time points .c0, c1.*Choose one", voxflat.surface, tmp_path / "cell.zarr")
    volume = voxflat.io.read_volume(tmp_path / "cell.zarr", "c1")
    assert volume.unit == "µm"
    np.testing.assert_allclose(volume.spacing, (0.65, 0.65, 2))
    expected = voxflat.surface(cell, spacing=(0.65, 0.65, 2), unit="µm")
    np.testing.assert_allclose(voxflat.surface(volume).points, expected.points, atol=1e-9)
    flat_map = expected.flatten()
    shown = flat_map.images(tmp_path / "cell.zarr")[1].data
    np.testing.assert_allclose(shown, flat_map.image(cell).data, atol=1e-6)


def test_units_have_their_lengths():
    """An inch is 254/10 mm by definition, and 39.3701 inches are a metre."""
    sizes = {"inch": 1000 / 39.3701, "cm": 1000 / 100, "m": 1000 / 1, "nm": 1000 / 1e9, "µm": 1000 / 1e6, "mm": 1.0}
    for unit, length in sizes.items():
        volume = voxflat.io.Volume(np.zeros((2, 2, 2)), np.diag([2.0, 3.0, 5.0, 1.0]), unit=unit)
        np.testing.assert_allclose(volume.in_unit("mm").spacing, np.multiply([2, 3, 5], length), rtol=1e-6)


@pytest.mark.parametrize(
    ("unit", "in_nm"), [("angstrom", 0.1), ("nanometer", 1.0), ("micrometer", 1000.0), ("inch", 25.4e6)]
)
def test_ome_zarr_has_the_lengths_of_its_units(tmp_path, unit, in_nm):
    zarr = pytest.importorskip("zarr", minversion="3")
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="w", zarr_format=2)
    group.create_array("0", shape=(4, 4, 4), chunks=(4, 4, 4), dtype=np.uint8)[:] = 1
    axes = [{"name": axis, "type": "space", "unit": unit} for axis in "zyx"]
    steps = [{"type": "scale", "scale": [3.0, 2.0, 1.5]}]
    images = [{"path": "0", "coordinateTransformations": steps}]
    group.attrs["multiscales"] = [{"version": "0.4", "axes": axes, "datasets": images}]
    volume = voxflat.io.read_volume(tmp_path / "a.zarr")
    np.testing.assert_allclose(volume.in_unit("nm").spacing, np.multiply([1.5, 2.0, 3.0], in_nm), rtol=1e-9)


@pytest.mark.parametrize(
    ("told", "in_um"),
    [
        ({"PhysicalSizeX": 0.5, "PhysicalSizeY": 0.25, "PhysicalSizeZ": 2.0}, (0.5, 0.25, 2.0)),  # OME's default is µm
        (
            {"PhysicalSizeX": 5, "PhysicalSizeY": 2, "PhysicalSizeZ": 3}
            | {f"PhysicalSize{axis}Unit": unit for axis, unit in zip("XYZ", ("nm", "µm", "mm"), strict=True)},
            (0.005, 2, 3000),
        ),
    ],
)
def test_ome_tiff_has_the_sizes_of_its_voxels(tmp_path, told, in_um):
    tifffile.imwrite(tmp_path / "a.ome.tif", np.ones((3, 4, 5), np.uint8), metadata={"axes": "ZYX", **told})
    volume = voxflat.io.read_volume(tmp_path / "a.ome.tif")
    np.testing.assert_allclose(volume.in_unit("µm").spacing, in_um, rtol=1e-9)


@pytest.mark.parametrize("name", ["labels.png", "labels.tif", "labels.nii.gz"])
def test_labels_drawn_on_an_image_find_their_place_on_the_map(maps, tmp_path, name):
    image = maps[0].heat_map()
    drawn = replace(image, data=np.where(np.isfinite(image.data), 1.0, 0.0))
    drawn.save(tmp_path / name)
    if name.endswith(("png", "tif")):  # as a program for drawing would save them
        with Image.open(tmp_path / name) as saved:
            told = {"pnginfo": PngInfo()} if name.endswith("png") else {"tiffinfo": {270: saved.tag_v2[270]}}
            if name.endswith("png"):
                told["pnginfo"].add_text("Pixel size", saved.text["Pixel size"])
        Image.fromarray(drawn.data.astype(np.uint8)).save(tmp_path / name, **told)
    assert len(maps[0].regions(tmp_path / name)) == 1


@pytest.mark.medium
def test_a_stack_in_micrometres_is_sampled_where_it_lies(tmp_path):
    cell = shapes.ball(8).astype(np.uint8)
    how = {"metadata": {"spacing": 2.0, "unit": "um", "axes": "ZYX"}, "resolution": (1 / 0.65, 1 / 0.65)}
    tifffile.imwrite(tmp_path / "cell.tif", cell.T, imagej=True, **how)
    nib.save(nib.Nifti1Image(cell, np.diag([0.65e-3, 0.65e-3, 2e-3, 1])), tmp_path / "cell.nii")
    surface = voxflat.surface(tmp_path / "cell.tif")
    assert surface.metadata["unit"] == "µm"
    np.testing.assert_allclose(np.ptp(surface.points, axis=0), np.ptp(surface.ids, axis=0) * (0.65, 0.65, 2), rtol=0.2)
    given = voxflat.surface(cell, spacing=(0.65, 0.65, 2), unit="µm")
    np.testing.assert_allclose(surface.points, given.points, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(voxflat.surface(tmp_path / "cell.nii").points * 1000, given.points, rtol=1e-5, atol=1e-5)
    assert len(surface.keep(tmp_path / "cell.nii")) == len(surface)
    flat_map = surface.flatten()
    images = [flat_map.image(volume).data for volume in (cell, tmp_path / "cell.tif", tmp_path / "cell.nii")]
    for image in images:
        assert np.isfinite(image).sum() > 100
        np.testing.assert_allclose(image, images[0], atol=1e-3)
    regions = flat_map.regions({"all": [[-99, -99], [99, -99], [99, 99], [-99, 99]]})
    regions.save(tmp_path / "back.nii", depth=(-2, 1))
    back = nib.load(tmp_path / "back.nii")
    np.testing.assert_allclose(np.diag(back.affine), [0.65e-3, 0.65e-3, 2e-3, 1], rtol=1e-5)
    assert regions.volume(tmp_path / "cell.tif", depth=(-2, 1)).unit == "µm"
    np.testing.assert_array_equal(regions.volume(tmp_path / "cell.nii", depth=(-2, 1)).data, back.get_fdata())


@pytest.mark.parametrize(("name", "warned"), [("map.surf.gii", True), ("map.ply", False)])
def test_a_format_that_means_mm_causes_a_warning(maps, tmp_path, caplog, name, warned):
    for value in (maps[0], voxflat.surface(shapes.ball(8), unit="µm"), maps[1]):
        caplog.clear()
        value.save(tmp_path / name, overwrite=True)
        assert ("coordinates are in µm, but" in caplog.text) == (warned and value is not maps[1])


@pytest.mark.medium
def test_tables_and_json_have_the_unit_in_their_names(maps):
    for flat_map, name in zip(maps, ("area_um2", "area"), strict=True):
        (place, *_) = voxflat.worst_places(flat_map, 1, beyond=1.01).places
        told = place.figures()
        assert told[name] == place.area
        assert not [key for key in told if "mm" in key]
        assert flat_map.description()["unit"] == {"area": "unknown"}.get(name, "µm")
    mesh = pv.Sphere(radius=300)
    assert not MM.search(voxflat.check(mesh).table())
    assert "600 nm" in voxflat.surface(mesh, unit="nm").check().table()


@pytest.mark.medium
@pytest.mark.parametrize(
    ("unit", "name"), [("nm", "1.5nm"), ("µm", "1.5um"), ("mm", "1.5mm"), ("m", "1.5m"), (None, "1.5")]
)
def test_distances_have_the_unit_of_their_surface(tmp_path, unit, name):
    """Both in the figures of a map, of which a file is independent, and in a store of distances."""
    plane = pv.Plane(i_resolution=30, j_resolution=30, i_size=40, j_size=40).triangulate()
    voxflat.surface((plane.points, plane.regular_faces)).save(tmp_path / "plane.ply")
    surface = voxflat.surface(tmp_path / "plane.ply", unit=unit)
    flat_map = surface.flatten()
    flat_map.save(tmp_path / "map.npz")
    measured = [flat_map.distortion, voxflat.load(tmp_path / "map.npz").distortion, voxflat.measure(surface, flat_map)]
    for made in measured:
        told = made.figures()
        for part in (told["raw"], told["best_scale"], told["standard_error"]["raw"]):
            assert {key for key in part if "_1.5" in key} == {f"relative_error_{name}"}
        assert told["raw"][f"relative_error_{name}"] == made.raw.relative_error_10mm
    rows = surface.geodesic(3, store=tmp_path / "rows")
    assert rows.unit == voxflat.open_rows(tmp_path / "rows").unit == (unit or "unknown")
    assert rows.provenance["unit"] == voxflat.open_rows(tmp_path / "rows").provenance["unit"]
    words = ["rows", tmp_path / "plane.ply", *([] if unit is None else ["--unit", unit]), "--sources", 3]
    text = succeed(*words, "--store", tmp_path / "again").stdout
    assert text.startswith(f"3 x 961 distances {f'in {unit}' if unit else 'without a unit'}, ")


@pytest.mark.medium
def test_texts_give_lengths_in_the_unit_of_the_surface(tmp_path, caplog):
    """A closed surface of 30 mm, declared in metres: no length is rounded to 0, and nothing is said to be in mm."""
    ball = trimesh.creation.icosphere(3, radius=0.015)
    ball.export(tmp_path / "ball.ply")
    told = [succeed("flatten", tmp_path / "ball.ply", "--unit", "m", "-o", tmp_path / "map.npz")]
    told += [succeed("measure", tmp_path / "ball.ply", tmp_path / "map.npz", "--unit", "m")]
    told += [succeed("check", tmp_path / "ball.ply", "--unit", "m")]
    told += [succeed("cut", tmp_path / "ball.ply", "--unit", "m", "-o", tmp_path / "cut.json")]
    texts = [text for one in told for text in (one.stdout, one.stderr)]
    flat_map = voxflat.load(tmp_path / "map.npz")
    texts += [caplog.text, repr(flat_map), flat_map.distortion.table(), str(flat_map.metadata["warnings"])]
    texts += [str(voxflat.cite(flat_map)), repr(voxflat.surface(tmp_path / "ball.ply", unit="m").cut())]
    for text in texts:
        without_bands = re.sub(r"(up|[\d.]+) to [\d.]+ mm", "", text)  # as 1.5 mm, not 0.0015 m
        assert not re.search(r"(?<![\w_])mm\b", without_bands), text
        assert not re.search(r"\b0(\.0+)?( x 0(\.0+)?)? m\b", text), text
    assert re.search(r"map +0\.0\d+ x 0\.0\d+ m\n", told[0].stdout)
    assert re.search(r"absolute error, m +0\.00", told[1].stdout)
