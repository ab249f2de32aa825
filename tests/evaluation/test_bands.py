"""The distance bands of the figures: the same for an object in any unit, and named with their lengths."""

import json

import numpy as np
import pytest
import pyvista as pv
import shapes
from command_line import fail, succeed
from mesh_files import fsaverage5
from numpy.testing import assert_allclose
from refusals import refused

import voxflat
from voxflat.distortion.bands import usual_bands
from voxflat.methods import Voxflat

UNITS = {"m": 1e-3, "cm": 0.1, "mm": 1.0, "µm": 1e3, "nm": 1e6, "inch": 1 / 25.4, "unknown": 1.0}
FIELDS = ("relative_error_0_5mm", "relative_error_5_15mm", "relative_error_15_30mm", "relative_error_10mm")


def surface_in(unit, points, faces):
    if unit == "unknown":
        return voxflat.surface(pv.PolyData.from_regular_faces(points, faces))
    return voxflat.surface((points, faces), unit=unit)


@pytest.fixture(scope="module")
def disk():
    """A disk of fsaverage5 of the size of a human hemisphere, and its map."""
    part = voxflat.surface(fsaverage5("white_left")).disk(5000, 60.0)
    part = voxflat.surface((part.points, part.faces), unit="mm")
    return part, part.flatten(Voxflat(sources=60))


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS)
def test_figures_of_a_disk_of_cortex_do_not_depend_on_its_unit(disk, unit):
    part, flat_map = disk
    factor = UNITS[unit]
    surface = surface_in(unit, factor * part.points, part.faces)
    found = voxflat.measure(surface, factor * flat_map.uv, sources=20, reference="graph")
    expected = voxflat.measure(part, flat_map.uv, sources=20, reference="graph")
    assert_allclose(np.multiply(found.bands, 1 / factor), (5, 10, 15, 30), rtol=1e-9)
    for one, other, tolerance in ((found.raw, expected.raw, 1e-6), (found.interior, expected.interior, 1e-5)):
        values, wanted = ([getattr(of, name) for name in (*FIELDS, "relative_error")] for of in (one, other))
        assert np.isfinite(wanted).all()
        assert_allclose(values, wanted, rtol=tolerance)  # the best scale is known to 1e-6
    assert_allclose(found.raw.absolute_error, factor * expected.raw.absolute_error, rtol=1e-6)
    names = [name for name in found.figures()["raw"] if name.startswith("relative_error_")]
    own = "" if unit == "unknown" else "mm"
    assert names == [f"relative_error_{name}{own}" for name in ("0_5", "5_15", "15_30", "10", "30")]
    assert f"  up to 10 {own}".rstrip() + " " in found.table()
    if unit in ("m", "µm", "inch"):
        remade = surface.flatten(Voxflat(sources=60))
        assert_allclose(remade.distortion.bands, found.bands)
        assert_allclose(
            remade.distortion.raw.relative_error_10mm, flat_map.distortion.raw.relative_error_10mm, rtol=0.01
        )


@pytest.mark.medium
@pytest.mark.parametrize(
    ("unit", "size", "name"), [("µm", 1.0, "40um"), ("nm", 1e3, "40um"), ("mm", 1e-3, "40um"), ("nm", 1.0, "40nm")]
)
def test_a_small_organ_has_finite_figures_with_plain_names(tmp_path, unit, size, name):
    points, faces = shapes_of_an_organ(size)
    surface = voxflat.surface((points, faces), unit=unit)
    flat_map = surface.flatten(Voxflat(sources=30))
    flat_map.save(tmp_path / "map.npz")
    again = voxflat.load(tmp_path / "map.npz")
    for distortion in (
        flat_map.distortion,
        again.distortion,
        voxflat.measure(surface, flat_map, sources=10, reference="graph"),
    ):
        assert np.isfinite([getattr(distortion.raw, field) for field in FIELDS]).all()
        assert_allclose(distortion.bands, np.multiply(size, (20, 40, 60, 100)))
    assert again.distortion.figures()["raw"][f"relative_error_{name}"] == flat_map.distortion.raw.relative_error_10mm
    assert again.distortion.figures()["bands"] == list(again.distortion.bands)
    assert f"  up to 40 {name[2:].replace('u', 'µ')} " in again.distortion.table()


def shapes_of_an_organ(size):
    """Return a hill with an area of about (1100 `size`)²."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1050, 60), np.linspace(0, 1050, 60), indexing="ij"))
    corner = np.arange(60 * 60).reshape(60, 60)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:]))
    faces = np.concatenate([np.column_stack([a, b, d]), np.column_stack([a, d, c])])
    height = 300 * np.exp(-((x - 525) ** 2 + (y - 525) ** 2) / 200**2)
    return size * np.column_stack([x, y, height]), faces


def test_bands_are_plain_ascending_and_those_of_a_hemisphere_between_its_sizes():
    for size in np.geomspace(1e-7, 1e9, 2000):
        bands = np.array(usual_bands(size**2, "mm"))
        if 45 <= size <= 500:
            assert bands.tolist() == [5, 10, 15, 30]
            continue
        assert (np.diff(bands) > 0).all()
        assert_allclose(bands / size, np.divide([5, 10, 15, 30], 30 / 0.11), rtol=0.26)
        digits = {f"{band:.3e}"[:5].rstrip("0").rstrip(".") for band in bands}
        assert digits <= {"1", "1.5", "2", "2.5", "3", "4", "5", "6", "8"}
        assert_allclose(usual_bands((size / 1e3) ** 2, "m"), bands / 1e3, rtol=1e-9)


class TestOwnBands:
    def test_they_are_used_and_named(self, tmp_path):
        hill = voxflat.samples.hill()
        found = voxflat.measure(hill, hill.points[:, :2], bands=(4, 8.5, 16, 24))
        usual = voxflat.measure(hill, hill.points[:, :2], bands=[8.5, 24, 25, 26])
        assert found.bands == (4, 8.5, 16, 24)
        assert found.raw.relative_error_10mm == pytest.approx(usual.raw.relative_error_0_5mm)
        assert found.raw.relative_error_30mm == pytest.approx(usual.raw.relative_error_10mm)
        assert found.raw.relative_error == pytest.approx(usual.raw.relative_error)
        names = list(found.figures()["raw"])
        assert names[2:7] == [f"relative_error_{name}" for name in ("0_4mm", "4_16mm", "16_24mm", "8.5mm", "24mm")]
        compared = voxflat.compare(hill, {"above": hill.points[:, :2]}, bands=(4, 8.5, 16, 24))
        assert compared["above"].figures() == found.figures()
        assert "  up to 8.5 mm" in compared.table()

    def test_the_command_line_takes_them(self, tmp_path):
        hill = voxflat.samples.hill()
        hill.save(tmp_path / "hill.ply")
        hill.flatten(Voxflat(sources=30)).save(tmp_path / "map.npz")
        words = ("measure", tmp_path / "hill.ply", tmp_path / "map.npz", "--unit", "mm", "--bands")
        content = json.loads(succeed(*words, "4,8.5,16,24", "--json").stdout)
        assert content["bands"] == [4, 8.5, 16, 24]
        assert content["raw"]["relative_error_8.5mm"] > 0
        fail(2, "'4,8' is not a list of four numbers", *words, "4,8")
        fail(1, "--bands is 4.0, 8.0, 8.0, 9.0. Pass four ascending positive lengths", *words, "4,8,8,9")

    @pytest.mark.parametrize("bands", [(), (5, 10, 15), (5, 10, 15, 30, 60), "1234", "5,10,15,30", 5, "abcd", {"a": 1}])
    def test_other_values_are_refused(self, bands):
        self._is_refused(bands)

    @pytest.mark.parametrize("bands", [(0, 1, 2, 3), (-1, 1, 2, 3), (1, 1, 2, 3), (4, 3, 2, 1), (1, 2, 3, np.inf)])
    def test_other_lengths_are_refused(self, bands):
        self._is_refused(bands)
        self._is_refused((*bands[:3], np.nan))

    def _is_refused(self, bands):
        hill = voxflat.samples.hill()
        remedy = "Pass four ascending positive lengths in the unit of the surface"
        refused(remedy, voxflat.measure, hill, hill.points[:, :2], bands=bands)


@pytest.mark.medium
def test_a_file_without_bands_or_interior_pairs_has_those_of_a_hemisphere(tmp_path):
    flat_map = voxflat.samples.hill().flatten(Voxflat(sources=30))
    flat_map.save(tmp_path / "map.npz")
    with np.load(tmp_path / "map.npz") as file:
        arrays = dict(file)
    metadata = json.loads(str(arrays["metadata"]))
    assert metadata["distortion"]["bands"] == list(flat_map.distortion.bands) != [5, 10, 15, 30]
    for name in ("bands", "interior", "interior_share"):
        del metadata["distortion"][name]
    np.savez(tmp_path / "old.npz", **arrays | {"metadata": np.array(json.dumps(metadata))})
    old = voxflat.load(tmp_path / "old.npz").distortion
    assert (old.bands, old.interior) == ((5, 10, 15, 30), None)
    assert np.isnan(old.interior_share)
    assert old.figures()["raw"]["relative_error_30mm"] == old.raw.relative_error_30mm > 0
    assert "interior" not in repr(old) + old.table()
    again = voxflat.load(tmp_path / "map.npz").distortion
    assert again.interior.relative_error == flat_map.distortion.interior.relative_error
    assert again.interior_share == flat_map.distortion.interior_share > 0.9
    assert "of interior pairs, " in repr(again)


@pytest.mark.medium
def test_distances_by_chain_codes_have_bands_and_no_interior_pairs(tmp_path):
    flat_map = voxflat.flatten(shapes.sheet(), method=voxflat.methods.Grossmann2002(sources=40))
    flat_map.save(tmp_path / "map.npz")
    for distortion in (flat_map.distortion, voxflat.load(tmp_path / "map.npz").distortion):
        assert distortion.interior is None
        assert 3 < distortion.bands[3] < 8


@pytest.mark.medium
def test_a_frame_of_a_series_has_the_bands_of_the_reference():
    hill = voxflat.samples.hill()
    series = voxflat.flatten_series([hill, (2.5 * hill.points, hill.faces)])
    assert series.measure(1).bands == series.flat_map.distortion.bands
    assert series.measure(1).interior_share > 0.9
