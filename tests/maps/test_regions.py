"""To the map and back: regions to vertices and voxels and onto the map again, points to the map; by other readers."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import lab
import mesh_files
import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
import tifffile
from brain_spaces import ball, header, to_scanner, write_freesurfer
from command_line import fail, run, succeed
from mesh_files import icosphere, needs_workbench, workbench
from PIL import Image
from refusals import refused

import voxflat
from voxflat.io import Volume, write_volume
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.io.tables import read_points
from voxflat.maps.raster import FlatImage
from voxflat.methods import Voxflat

INNER, OUTER = 20.0, 23.0


@pytest.fixture(scope="module")
def m():
    """Return the map of a disk of 20 mm around a pole of concentric spheres, 2,500 vertices 0.8 mm apart."""
    return voxflat.surface(icosphere(INNER, 5), pial=icosphere(OUTER, 5)).disk(0, 20.0).flatten(Voxflat(sources=40))


@pytest.fixture(scope="module")
def grid(m):
    """Return an empty volume of voxels of 0.5 mm around the disk, with axes turned."""
    turned = np.array([[0.0, -0.5, 0], [0.5, 0, 0], [0, 0, 0.5]])
    corners = np.concatenate([m.white_points, m.pial_points])
    low, high = (corners @ np.linalg.inv(turned).T).min(axis=0) - 4, (corners @ np.linalg.inv(turned).T).max(axis=0) + 4
    affine = nib.affines.from_matvec(turned, turned @ np.floor(low))
    return Volume(np.zeros(np.ceil(high - low).astype(int), np.uint8), affine)


def circle(u, v, radius, n=60):
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([u + radius * np.cos(turn), v + radius * np.sin(turn)])


def drawn(m):
    middle = m.uv.mean(axis=0)
    return {"V1": circle(middle[0] - 8, middle[1], 8.5), "V2": circle(middle[0] + 9, middle[1] + 2, 7.0)}


def dice(a, b):
    return 2 * np.count_nonzero((a == b) & (a > 0)) / (np.count_nonzero(a > 0) + np.count_nonzero(b > 0))


class TestRoundTrips:
    @pytest.mark.medium
    def test_from_the_map_through_voxels_to_the_map(self, m, grid):
        regions = m.regions(drawn(m))
        there = regions.volume(grid)
        back = m.image(there, 0.5, fraction=(0.1, 0.3, 0.5, 0.7, 0.9), interpolation="majority").data
        assert dice(np.nan_to_num(back), np.nan_to_num(regions.image(0.5).data)) > 0.99
        for value in (0.1, 0.9):  # a column is a column at all depths
            shown = m.image(there, 0.5, fraction=value, interpolation="majority").data
            assert dice(np.nan_to_num(shown), np.nan_to_num(back)) > 0.98

    @pytest.mark.medium
    def test_from_voxels_through_the_map_to_voxels(self, m, grid):
        """Cones from the middle of the spheres are columns: what of them lies in the cortex of the disk comes back."""
        xyz = nib.affines.apply_affine(grid.affine, np.moveaxis(np.indices(grid.data.shape), 0, -1))
        radius = np.linalg.norm(xyz, axis=-1)
        axis = m.points.mean(axis=0)
        across = np.cross(axis, [0.3, 0.4, 0.8])
        axis = axis / np.linalg.norm(axis) + 0.3 * across / np.linalg.norm(across)
        angle = np.arccos(np.clip(xyz @ axis / radius / np.linalg.norm(axis), -1, 1))
        labels = np.where((radius > INNER) & (radius < OUTER) & (angle < 0.4), 7, 0).astype(np.int16)
        inside = (radius > INNER + 0.05) & (radius < OUTER - 0.05)  # triangles lie within the spheres, by 0.004 mm
        for pixel_size in (0.5, 0.25):
            how = {"fraction": (0.2, 0.4, 0.6, 0.8), "interpolation": "majority"}
            again = m.regions(m.image(Volume(labels, grid.affine), pixel_size, **how)).volume(grid).data
            assert set(np.unique(again)) == {0, 7}
            assert dice(again * inside, labels * inside) > 0.985

    @pytest.mark.medium
    def test_from_vertices_through_the_map_to_vertices(self, m):
        labels = np.zeros(m.metadata["vertices"], np.int64)
        points = m.points - m.points.mean(axis=0)
        labels[m.ids[points[:, 0] > 3]] = 4
        labels[m.ids[points[:, 0] < -5]] = 2
        assert dice(m.regions(m.image(labels, 0.1)).vertex_labels, labels) > 0.995

    def test_from_the_map_through_vertices_to_the_map(self, m):
        """Vertices are 0.8 mm apart here: that is the limit."""
        regions = m.regions(drawn(m))
        back = m.image(regions.vertex_labels, 0.5).data
        assert dice(np.nan_to_num(back), np.nan_to_num(regions.image(0.5).data)) > 0.97


class TestVoxels:
    def test_the_whole_map_is_the_whole_cortex(self, m, grid):
        """All voxels whose centres lie between the spheres, on the disk's side of its border, and no other."""
        low, high = m.uv.min(axis=0) - 1, m.uv.max(axis=0) + 1
        box = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
        found = m.regions(box).volume(grid).data
        xyz = nib.affines.apply_affine(grid.affine, np.moveaxis(np.indices(grid.data.shape), 0, -1))
        radius = np.linalg.norm(xyz, axis=-1)
        assert INNER - 0.01 < radius[found > 0].min() <= radius[found > 0].max() <= OUTER
        axis = m.points[np.argmin(np.linalg.norm(m.ids[:, None] - 0, axis=1))]
        angle = np.arccos(xyz @ axis / radius / np.linalg.norm(axis))
        rim = np.arccos(m.points @ axis / np.linalg.norm(m.points, axis=1) / np.linalg.norm(axis)).max()
        well_within = (angle < rim - 0.08) & (radius > INNER) & (radius < OUTER - 0.02)
        assert found[well_within].all()
        solid = pv.PolyData.from_regular_faces(m.points, m.faces).area / ((INNER + OUTER) / 2) ** 2
        assert np.count_nonzero(found) * 0.125 == pytest.approx(solid / 3 * (OUTER**3 - INNER**3), rel=0.01)

    @pytest.mark.slow
    def test_along_normals_where_no_pial_surface_is_known(self, grid):
        white = voxflat.surface(icosphere(INNER, 5)).disk(0, 20.0).flatten(Voxflat(sources=30))
        regions = white.regions(circle(*white.uv.mean(axis=0), 10.0))
        found = regions.volume(grid, depth=(0.5, 2.0)).data
        radius = np.linalg.norm(nib.affines.apply_affine(grid.affine, np.argwhere(found)), axis=1)
        assert INNER + 0.49 < radius.min() <= radius.max() < INNER + 2.0
        assert np.count_nonzero(found) * 0.125 == pytest.approx(np.pi * 100 * 1.5 * (21.25 / 20) ** 2, rel=0.03)
        refused(r"has no pial surface. Pass depth", regions.volume, grid)
        refused(r"depth is 2 to 1. Pass two finite numbers, the smaller one", regions.volume, grid, depth=(2, 1))
        refused("the depth is None. Pass a number", regions.volume, grid, depth=(None, 1.0))

    def test_a_voxel_within_reach_of_several_places_belongs_to_the_nearest(self):
        """Near the axis of a tube with a radius of 3 mm, depths from -4 to 1 mm reach the opposite wall as well."""
        turn, along = np.meshgrid(np.radians(np.arange(10, 351, 5)), np.arange(9.0), indexing="ij")
        points = np.stack([3 * np.cos(turn), 3 * np.sin(turn), along], axis=-1).reshape(-1, 3)
        tube = voxflat.surface((points, mesh_files.grid(len(turn), columns=9).faces)).flatten(Voxflat(sources=30))
        labels = tube.image(np.where(tube.points[:, 1] > 0, 1, 2).astype(np.int32), 0.25)
        affine = nib.affines.from_matvec(np.eye(3) * 0.25, [-1.125, -1.125, 4.0])
        found = tube.regions(labels).volume(Volume(np.zeros((10, 10, 1)), affine), depth=(-4.0, 1.0)).data[..., 0]
        x, y = 0.25 * np.indices((10, 10)) - 1.125
        clear = (np.hypot(x, y) < 0.95) & (np.abs(y) > 0.3) & (x < 0)
        np.testing.assert_array_equal(found[clear], np.where(y > 0, 1, 2)[clear])

    def test_means_over_a_range_of_depths_are_over_steps_of_a_pixel(self, tmp_path):
        sheet = voxflat.surface(mesh_files.grid(13, step=1.0)).flatten(Voxflat(sources=30))
        heights = np.arange(-5.0, 6.0)
        affine = nib.affines.from_matvec(np.eye(3), [-1, -1, -5])
        volume = Volume(np.broadcast_to(heights**2, (15, 15, 11)).copy(), affine)
        regions = sheet.regions(sheet.raster(1.0).inside.astype(np.int32), pixel_size=1.0)
        regions.save(tmp_path / "r.tsv", volume=volume, depth=(-3.0, 3.0))
        header, row = ((tmp_path / "r.tsv").read_text().splitlines()[n].split("\t") for n in (0, 1))
        assert float(row[header.index("mean")]) == pytest.approx(np.mean([9, 4, 1, 0, 1, 4, 9]))

    def test_the_flattened_volume_is_the_default(self, tmp_path):
        i, j, k = np.indices((24, 24, 24)) - 11.5
        volume = Volume((i**2 + j**2 + k**2 < 81).astype(np.uint8), np.diag([2.0, 2, 2, 1]))
        solid = voxflat.surface(volume).disk((11, 11, 20), 16.0).flatten(Voxflat(sources=30))
        regions = solid.regions(circle(*solid.uv.mean(axis=0), 9.0))
        regions.save(tmp_path / "l.nii.gz", depth=(-3.0, 1.0))
        image = nib.load(tmp_path / "l.nii.gz")
        np.testing.assert_array_equal(image.affine, volume.affine)
        assert image.shape == (24, 24, 24)
        assert 0 < np.count_nonzero(image.dataobj) < 200
        refused("has no mesh vertices", regions.save, tmp_path / "l.annot")

    @pytest.mark.parametrize(("unit", "of_file"), [("mm", "mm"), ("µm", "mm"), ("pixel", "unknown")])
    def test_voxels_that_have_no_unit_get_none_in_files(self, tmp_path, caplog, unit, of_file):
        """Lengths in µm are converted to mm, in which other programs expect them."""
        volume = Volume(voxflat.samples.ball(), np.diag([2.0, 2, 2, 1]), unit="mm" if unit == "pixel" else unit)
        solid = voxflat.surface(volume).disk((11, 11, 20), 16.0).flatten(Voxflat(sources=30))
        solid = replace(solid, origin=replace(solid.origin, in_pixels=unit == "pixel"))
        regions = solid.regions(circle(*solid.uv.mean(axis=0), 9.0))
        regions.save(tmp_path / "l.nii.gz", depth=(-3.0, 1.0))
        for name in ("i.nii.gz", "i.tif"):
            solid.heat_map().save(tmp_path / name)
        with tifffile.TiffFile(tmp_path / "i.tif") as file:
            assert ("PhysicalSizeX" in str(file.ome_metadata or file.imagej_metadata)) == (unit != "pixel")
        size = 2e-3 if unit == "µm" else 2.0
        regions.save(tmp_path / "a.nii.gz", volume=volume.data, depth=(-3.0, 1.0))  # on the grid of the map
        for name in ("l", "i", "a"):
            header = nib.load(tmp_path / f"{name}.nii.gz").header
            assert header.get_xyzt_units()[0] == of_file
        np.testing.assert_allclose(nib.load(tmp_path / "l.nii.gz").header.get_zooms(), size, rtol=1e-6)
        regions.save(tmp_path / "r.tsv")
        words = (tmp_path / "r.tsv").read_text().split("\n")[0].split("\t")
        assert {"mm": "area_mm2", "µm": "area_um2", "pixel": "area"}[unit] in words
        solid.points_to_map(np.full((20, 3), 1e4))
        assert f"are within 5{'' if unit == 'pixel' else ' ' + unit} of the surface" in caplog.text

    def test_far_and_coarse_grids_are_told(self, m):
        regions = m.regions(drawn(m))
        far = nib.affines.from_matvec(np.eye(3), [500, 500, 500])
        for volume in (Volume(np.zeros((5, 5, 5)), far), Volume(np.zeros((2, 2, 2)), np.diag([100.0, 100, 100, 1]))):
            refused(r"no region contains the centre of a voxel", regions.volume, volume)


class TestFiles:
    def test_annot(self, m, tmp_path):
        regions = m.regions(drawn(m))
        regions.save(tmp_path / "lh.rois.annot", sidecar=True)
        labels, table, names = nib.freesurfer.read_annot(tmp_path / "lh.rois.annot")
        assert names == [b"unknown", b"V1", b"V2"]
        np.testing.assert_array_equal(labels, regions.vertex_labels)
        np.testing.assert_array_equal(table[1:, :3], regions.colours)
        assert json.loads((tmp_path / "lh.rois.annot.json").read_text())["labels"] == {"1": "V1", "2": "V2"}
        flat = m.image(tmp_path / "lh.rois.annot", 0.5).data  # and onto the map again
        np.testing.assert_array_equal(flat, m.image(regions.vertex_labels, 0.5).data)

    def test_label(self, m, tmp_path):
        one = m.regions({"V1": drawn(m)["V1"]})
        one.save(tmp_path / "lh.V1.label")
        vertices = nib.freesurfer.read_label(tmp_path / "lh.V1.label")
        np.testing.assert_array_equal(np.sort(vertices), np.flatnonzero(one.vertex_labels))
        rows = np.loadtxt(tmp_path / "lh.V1.label", skiprows=2)
        np.testing.assert_allclose(rows[:, 1:4], icosphere(INNER, 5)[0][vertices], atol=6e-4)  # on the white one
        refused(r"a .label file can store only one region, not 2", m.regions(drawn(m)).save, tmp_path / "lh.both.label")

    def test_points_of_a_label_are_tkras(self, tmp_path):
        (points, faces), of = ball(4), header()
        write_freesurfer(tmp_path / "lh.white", points, faces, of)
        write_mesh(tmp_path / "lh.surf.gii", Mesh(to_scanner(points.astype(np.float64), of), faces.astype(np.int64)))
        for name in ("lh.white", "lh.surf.gii"):
            flat = voxflat.surface(tmp_path / name).disk(0, 25.0).flatten(Voxflat(sources=20))
            flat.regions(circle(*flat.uv.mean(axis=0), 8.0)).save(tmp_path / "lh.x.label")
            rows = np.loadtxt(tmp_path / "lh.x.label", skiprows=2)
            if name == "lh.white":
                np.testing.assert_allclose(rows[:, 1:4], points[rows[:, 0].astype(int)], atol=6e-4)

    @pytest.mark.slow
    @needs_workbench
    def test_label_gii(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        lab.write(tmp_path)
        whole = voxflat.surface("lh.white", pial="lh.pial").disk(700, 40.0).flatten(Voxflat(sources=20))
        regions = whole.regions({"V1": circle(*whole.uv.mean(axis=0), 15.0)})
        regions.save("lh.rois.label.gii")
        image = nib.load("lh.rois.label.gii")
        np.testing.assert_array_equal(image.agg_data(), regions.vertex_labels)
        assert image.labeltable.get_labels_as_dict() == {0: "???", 1: "V1"}
        assert image.meta["AnatomicalStructurePrimary"] == "CortexLeft"
        assert json.loads(image.meta["Provenance"])["function"] == "regions"
        workbench("-gifti-label-to-roi", "lh.rois.label.gii", "roi.func.gii", "-name", "V1")
        np.testing.assert_array_equal(nib.load("roi.func.gii").agg_data(), regions.vertex_labels)

    def test_volume(self, m, grid, tmp_path):
        write_volume(tmp_path / "t1.mgz", grid.data, grid.affine)
        regions = m.regions(drawn(m))
        regions.save(tmp_path / "l.nii.gz", volume=tmp_path / "t1.mgz")
        image = nib.load(tmp_path / "l.nii.gz")
        np.testing.assert_array_equal(np.asarray(image.dataobj), regions.volume(grid).data)
        np.testing.assert_allclose(image.affine, grid.affine)
        assert "t1.mgz" in json.loads(image.header.extensions[0].get_content())["files"]
        refused("it is an input", regions.save, tmp_path / "t1.mgz", volume=tmp_path / "t1.mgz")
        refused("Pass volume to define the grid", regions.save, tmp_path / "l.nii.gz")
        refused("Omit them", regions.save, tmp_path / "l.annot", volume=grid)
        refused("Use a name that ends in", regions.save, tmp_path / "l.txt")

    @pytest.mark.slow
    def test_both_sides_of_a_cut(self):
        points, faces = icosphere(INNER, 2)
        whole = voxflat.flatten((points, faces), Voxflat(sources=30))
        labels = whole.regions(whole.image(np.ones(len(points), int), 0.5)).vertex_labels
        assert np.count_nonzero(labels) == len(points)  # up to the map's border, which pixels meet only in part


SVG = """<?xml version="1.0" encoding="UTF-8"?>
<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
  width="200pt" height="100pt" viewBox="10 0 400 200" {where}>
<g inkscape:groupmode="layer" id="layer1" inkscape:label="rois" transform="translate(10,0)">
<path id="path1" inkscape:label="ring" style="fill:#ff0000;fill-rule:evenodd"
  d="m 90,60 h 80 v 80 h -80 z m 20,20 h 40 v 40 h -40 z"/>
<g inkscape:label="round"><circle cx="125" cy="100" r="20" transform="matrix(2,0,0,1,0,0)" style="fill:none"/></g>
<path id="p4" d="M 290 100 c 0 -55.2285 -44.7715 -100 -100 -100 l 0 100 z"><title>quarter</title></path>
</g>
<g inkscape:groupmode="layer" id="layer2" inkscape:label="names"><path d="m 0 0 h 9 v 9 z"/></g></svg>"""
WHERE = 'data-voxflat-extent="-25 25 -12.5 12.5" data-voxflat-axes="10 0 400 200"'


class TestDrawings:
    def test_svg(self, m, tmp_path):
        m = replace(m, uv=m.uv - m.uv.mean(axis=0))
        path = tmp_path / "drawn.svg"
        path.write_text(SVG.format(where=WHERE))
        regions = m.regions(path)
        assert regions.names == ("ring", "round", "quarter")
        assert regions.colours[0].tolist() == [255, 0, 0]
        # user units to mm: u = (x - 210) / 8, v = (100 - y) / 8, x after the layer's own shift by 10
        u, v = np.random.default_rng(0).uniform(-14, 14, (2, 4000))
        x, y = 8 * u + 210 - 10, 100 - 8 * v
        ring = (abs(x - 130) < 40) & (abs(y - 100) < 40) & ~((abs(x - 130) < 20) & (abs(y - 100) < 20))
        round_ = (x - 250) ** 2 / 4 + (y - 100) ** 2 < 400
        quarter = (x > 190) & (y < 100) & ((x - 190) ** 2 + (y - 100) ** 2 < 1e4)
        expected = np.where(quarter, 3, np.where(round_, 2, np.where(ring, 1, 0)))
        off = regions.at(np.column_stack([u, v])) != expected
        assert off.mean() < 0.002  # a Bézier quarter is a circle up to 0.03 %
        assert np.hypot(x[off] - 190, y[off] - 100) == pytest.approx(100, abs=0.1)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (WHERE, "", "its root does not define data-voxflat-extent"),
            ("-25 25 -12.5 12.5", "1 2 3", "data-voxflat-extent as four numbers"),
            ("-25 25 -12.5 12.5", "1 1 2 3", "has no area"),
            ("M 290", "M 1e999", "has a path with infinite coordinates"),
            ("translate(10", "translate(1e999", "has a path with infinite coordinates"),
            ("rois", "areas", "has no layer 'rois' .layers: 'areas', 'names'.. Draw"),
        ],
    )
    def test_what_is_no_drawing(self, m, tmp_path, old, new, message):
        path = tmp_path / "drawn.svg"
        path.write_text(SVG.format(where=WHERE).replace(old, new))
        refused(message, m.regions, path, layer="rois")

    def test_damaged_svg(self, m, tmp_path):
        path = tmp_path / "drawn.svg"
        for text in ("", "<svg", "no drawing", SVG.format(where=WHERE)[:400]):
            path.write_text(text)
            refused("", m.regions, path)
        with pytest.raises(FileNotFoundError):
            m.regions(tmp_path / "none.svg")

    @pytest.mark.slow
    def test_shapes_of_napari(self, m):
        """In napari's world the axes are −v and u; its ellipses have the corners of their boxes."""
        layer = pytest.importorskip("napari.layers").Shapes(
            [np.array([[-2.0, 0], [2, 0], [2, 6], [-2, 6]]), np.array([[4.0, 1], [8, 1], [8, 7], [4, 7]])],
            shape_type=["polygon", "ellipse"],
            scale=(0.5, 0.5),
            translate=(-m.uv[:, 1].mean(), m.uv[:, 0].mean()),
            features={"name": ["box", "round"]},
        )
        regions = m.regions(layer)
        assert regions.names == ("box", "round")
        u, v = np.random.default_rng(0).uniform(-5, 5, (2, 4000))
        box = (abs(v) < 1) & (u > 0) & (u < 3)
        round_ = ((-v - 3) / 1) ** 2 + ((u - 2) / 1.5) ** 2 < 1
        found = regions.at(np.column_stack([u, v]) + m.uv.mean(axis=0))
        assert np.mean(found != np.where(round_, 2, np.where(box, 1, 0))) < 0.001
        line = SimpleNamespace(name="l", data=[np.zeros((2, 2))], shape_type=["line"], features={}, data_to_world=tuple)
        refused("is a line, which encloses no area", m.regions, line)

    def test_label_images(self, m, tmp_path):
        regions = m.regions(drawn(m))
        shown = regions.image(0.5)
        labels = np.nan_to_num(shown.data)
        Image.fromarray(labels.astype(np.uint8)).save(tmp_path / "r.png")
        for name, size in (("r.tif", None), ("r.nii.gz", None), ("r.npy", 0.5), ("r.png", 0.5)):
            if name != "r.png":
                shown.save(tmp_path / name)
            again = m.regions(tmp_path / name, pixel_size=size)
            assert again.names == ("1", "2")
            np.testing.assert_array_equal(np.nan_to_num(again.image(0.5).data), labels)
        np.testing.assert_array_equal(m.regions(shown).labels, again.labels)
        assert dice(again.labels, regions.labels) > 0.97
        refused(r"has 88 x \d+ pixels, but the map has .* Pass the pixel size", m.regions, np.ones((50, 88), int))
        refused("values that are not whole numbers", m.regions, FlatImage(shown.data / 3, 0.5, shown.origin, ""))
        refused("is 0 everywhere", m.regions, 0 * shown.data, pixel_size=0.5)

    def test_holes_and_overlaps(self, m, caplog):
        u, v = m.uv.mean(axis=0)
        ring = m.regions({"ring": [circle(u, v, 8.0), circle(u, v, 4.0)[::-1]]})
        assert ring.at([[u, v], [u + 6, v], [u + 9, v]]).tolist() == [0, 1, 0]
        both = m.regions([circle(u, v, 8.0), circle(u + 4, v, 8.0)])
        assert "Points in several regions belong to the region drawn last: " in caplog.text
        assert both.at([[u - 7, v], [u, v], [u + 11, v]]).tolist() == [1, 2, 2]
        assert both.names == ("region 1", "region 2")

    def test_what_is_no_region(self, m):
        for given, message in (
            ({"a": [[0, 0], [1, 1]]}, "a: not a polygon .* at least 3 corners"),
            ([("a", [[0, 0], [1, 1], [1, 0]])], "region 1: not a polygon"),
            ({"a": [[0, 0], [1, 1], [np.nan, 3]]}, "a: corner 2 is not finite"),
            ({"a": [[900, 0], [901, 1], [900, 1]]}, "a lies outside the map: its centre is at u = 900"),
            ({}, "there are no regions"),
            (3, "cannot read regions from int. Pass polygons"),
            ("rois.xcf", "Pass regions as .svg, .json"),
        ):
            refused(message, m.regions, given)


class TestPoints:
    def test_places_of_the_map_come_back(self, m):
        """Points above places of the map come back to them, with their height as the distance."""
        places = m.uv.mean(axis=0) + np.random.default_rng(0).uniform(-9, 9, (500, 2))
        found = m.look_up(places)
        corners = m.points[m.faces[found.face_ids]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        for height in (0.0, 0.7, -0.4):
            uv, distance = m.points_to_map(found.points + height * normal, 2.0)
            if height > 0:  # outside a sphere a point above a triangle is nearest to it
                np.testing.assert_allclose(uv, places, atol=1e-9)
            np.testing.assert_allclose(uv, places, atol=0.03)
            np.testing.assert_allclose(distance, abs(height), atol=1e-3)

    def test_vertices(self, m):
        uv, distance = m.points_to_map(m.points.reshape(2, -1, 3) if len(m) % 2 == 0 else m.points[None])
        np.testing.assert_allclose(uv.reshape(-1, 2), m.uv, atol=1e-9)
        assert np.abs(distance).max() < 1e-9

    def test_distance_is_that_of_vtk(self, m):
        points = m.points.mean(axis=0) + np.random.default_rng(1).normal(size=(300, 3)) * 6
        _, distance = m.points_to_map(points, np.inf)
        mesh = pv.PolyData(points).compute_implicit_distance(pv.PolyData.from_regular_faces(m.points, m.faces))
        np.testing.assert_allclose(distance, np.abs(mesh["implicit_distance"]), atol=1e-5)

    @pytest.mark.parametrize(("factor", "unit"), [(1e3, "µm"), (1e-3, "m")])
    def test_points_in_another_unit_are_reported_with_that_unit(self, m, factor, unit, caplog):
        points = m.points[:20]
        _, distance = m.points_to_map(points * factor, 1.0)
        assert np.isnan(distance).all()
        (message,) = caplog.messages
        assert message.startswith("0 of 20 points are within 1 mm")
        assert f"if they are in {unit}. Convert them" in message

    def test_points_that_are_far_in_every_unit_are_reported_without_one(self, m, caplog):
        m.points_to_map(m.points[:20] + 1e4, 1.0)
        (message,) = caplog.messages
        assert message.startswith("0 of 20 points are within 1 mm")
        assert "the map is in mm" in message
        caplog.clear()
        m.points_to_map(np.concatenate([m.points[:20], m.points[:20] + 1e4]), 1.0)
        assert not caplog.messages

    def test_beyond_the_limit(self, m):
        points = np.array([[0.0, 0, 0], [np.nan, 0, 0], m.points[5] * (1 + 4 / np.linalg.norm(m.points[5]))])
        uv, distance = m.points_to_map(points)
        assert np.isnan(uv[:2]).all()
        np.testing.assert_allclose(distance, [np.nan, np.nan, 4], atol=0.01)
        assert np.isnan(m.points_to_map(points, 3.9)[1]).all()
        refused("points has shape", m.points_to_map, np.zeros((2, 2)))
        for wrong in (-1, np.nan):
            refused("Pass 0 or a positive number", m.points_to_map, np.zeros(3), wrong)
        refused("space is 'MNI'. Pass 'surface' or 'scanner'", m.points_to_map, np.zeros(3), space="MNI")

    def test_space(self, tmp_path):
        (points, faces), of = ball(3), header()
        path = write_freesurfer(tmp_path / "lh.white", points, faces, of)
        flat = voxflat.surface(path).disk(0, 25.0).flatten(Voxflat(sources=20))
        own, _ = flat.points_to_map(flat.points)
        scanner, distance = flat.points_to_map(to_scanner(points.astype(np.float64), of)[flat.ids], space="scanner")
        np.testing.assert_allclose(scanner, own, atol=1e-6)
        assert distance.max() < 1e-5

    def test_by_the_command_line(self, m, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        m.save("m.npz")
        rows = [("E1", *m.points[3], "good"), ("E2", 0, 0, 0, "far"), ("E3", "n/a", "n/a", "n/a", "lost")]
        table = [("name", "x", "y", "z", "status"), *rows]
        Path("electrodes.tsv").write_text("".join("\t".join(map(str, row)) + "\n" for row in table))
        assert np.isnan(read_points("electrodes.tsv").points[2]).all()
        result = succeed("points", "m.npz", "electrodes.tsv", "-o", "uv.csv", "--json")
        assert json.loads(result.output)["on_map"] == 1
        lines = Path("uv.csv").read_text().splitlines()
        assert lines[0] == "name,x,y,z,status,u,v,distance"
        np.testing.assert_allclose([float(x) for x in lines[1].split(",")[5:]], [*m.uv[3], 0], atol=2e-6)
        assert lines[2].endswith("far,n/a,n/a,n/a")
        np.savetxt("bare.txt", m.points[:4])
        succeed("points", "m.npz", "bare.txt", "-o", "uv.csv")
        np.testing.assert_allclose(np.loadtxt("uv.csv", delimiter=",", skiprows=1)[:, 3:5], m.uv[:4], atol=2e-6)
        bad = {"": "is empty", "x,y,z\n": "no point", "x,y,z\n1,2\n": "cells", "1,2,q\n3,4,5\n": "row 1: 'q' is not a"}
        for text, message in bad.items():
            Path("bad.csv").write_text(text)
            fail(1, message, "points", "m.npz", "bad.csv", "-o", "uv.csv")


@pytest.mark.slow
def test_regions_by_the_command_line(m, grid, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    m.save("m.npz")
    write_volume("t1.nii.gz", grid.data, grid.affine)
    Path("p.json").write_text(json.dumps({name: polygon.tolist() for name, polygon in drawn(m).items()}))
    Path("bad.json").write_text("[1]")
    regions = m.regions(drawn(m))
    succeed("regions", "m.npz", "--polygons", "p.json", "-o", "o.annot")
    np.testing.assert_array_equal(nib.freesurfer.read_annot("o.annot")[0], regions.vertex_labels)
    command = ["regions", "m.npz", "-o", "o.nii.gz"]
    result = succeed(*command, "--polygons", "p.json", "--volume", "t1.nii.gz", "--json")
    image = nib.load("o.nii.gz")
    np.testing.assert_array_equal(np.asarray(image.dataobj), regions.volume(grid).data)
    points, voxels = ({"V1": (a == 1).sum(), "V2": (a == 2).sum()} for a in (regions.labels, image.get_fdata()))
    assert (json.loads(result.output)["regions"], json.loads(result.output)["voxels"]) == (points, voxels)
    result = succeed(*command, "--polygons", "p.json", "--volume", "t1.nii.gz")
    assert f"V1: {points['V1']} points of the map, {voxels['V1']} voxels\n" in result.output
    assert {"m.npz", "p.json", "t1.nii.gz"} <= set(json.loads(image.header.extensions[0].get_content())["files"])
    for wrong, code in (([], 2), (["--polygons", "p.json", "--layer", "x"], 2), (["--polygons", "bad.json"], 1)):
        assert run(*command, *wrong).exit_code == code


class TestLabelsOfVertices:
    """Label files of a mesh are regions of its map, with their names and colours."""

    NAMES, COLOURS = ("area one", "V2", "MT+"), np.array([[200, 30, 40], [20, 180, 60], [20, 30, 250]])

    def labels(self, m):
        """Return labels of all vertices: three sectors on the map, and none elsewhere."""
        labels = np.zeros(m.origin.mesh.vertices, dtype=np.int64)
        away = m.uv - m.uv.mean(axis=0)
        labels[m.ids] = np.where(np.hypot(*away.T) > 14, 0, 1 + (np.arctan2(*away.T) + np.pi) // (2 * np.pi / 2.999))
        return labels

    def annot(self, m, path):
        table = np.column_stack([np.vstack([[0, 0, 0], self.COLOURS]), np.zeros(4), np.arange(4)]).astype(np.int32)
        nib.freesurfer.write_annot(
            path, self.labels(m).astype(np.int32), table, ["unknown", *self.NAMES], fill_ctab=True
        )
        return path

    def check(self, regions):
        assert regions.names == self.NAMES
        np.testing.assert_array_equal(regions.colours, self.COLOURS)

    @pytest.mark.medium
    def test_names_colours_and_vertices_survive_every_way_out(self, m, tmp_path):
        regions, expected = m.regions(self.annot(m, tmp_path / "lh.areas.annot")), self.labels(m)
        self.check(regions)
        np.testing.assert_array_equal(regions.vertex_labels, expected)
        np.testing.assert_array_equal(regions.labels, expected[m.ids])
        for name in ("lh.b.label.gii", "lh.b.annot", "lh.b.svg"):
            regions.save(tmp_path / name)
            again = m.regions(tmp_path / name)
            self.check(again)
            np.testing.assert_array_equal(again.vertex_labels, expected)
        image = nib.load(tmp_path / "lh.b.label.gii")
        axis = nib.cifti2.BrainModelAxis.from_surface(
            np.arange(len(expected)), len(expected), "CIFTI_STRUCTURE_CORTEX_LEFT"
        )
        table = {label.key: (label.label, label.rgba) for label in image.labeltable.labels}
        dense = nib.Cifti2Image(expected[None].astype(np.float32), (nib.cifti2.LabelAxis(["areas"], table), axis))
        nib.save(dense, tmp_path / "areas.dlabel.nii")
        self.check(m.regions(tmp_path / "areas.dlabel.nii"))

    @needs_workbench
    @pytest.mark.medium
    def test_dense_labels_of_cifti_are_those_that_workbench_reads(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        write_mesh("lh.ball.surf.gii", Mesh(*icosphere(30.0, 3)))
        flat = voxflat.surface("lh.ball.surf.gii").disk(0, 25.0).flatten(Voxflat(sources=40))
        regions = flat.regions({"V1": circle(0.0, 0.0, 6.0), "V2": circle(9.0, 3.0, 5.0)})
        regions.save("lh.a.dlabel.nii")
        workbench("-cifti-separate", "lh.a.dlabel.nii", "COLUMN", "-label", "CORTEX_LEFT", "b.label.gii")
        image = nib.load("b.label.gii")
        np.testing.assert_array_equal(image.agg_data(), regions.vertex_labels)
        rows = {label.label: label.rgba for label in image.labeltable.labels}
        assert set(rows) == {"???", "V1", "V2"}
        np.testing.assert_allclose([rows[name][:3] for name in regions.names], regions.colours / 255, atol=1e-6)
        again = flat.regions("lh.a.dlabel.nii")
        assert again.names == regions.names
        np.testing.assert_array_equal(again.colours, regions.colours)
        np.testing.assert_array_equal(again.vertex_labels, regions.vertex_labels)
        unknown = voxflat.samples.hill().flatten().regions({"V1": [[-5, -5], [5, -5], [0, 5]]})
        refused("CIFTI files store the hemisphere, which is not known", unknown.save, "a.dlabel.nii")

    @pytest.mark.medium
    def test_several_labels_are_written_with_the_names_of_the_regions(self, m, tmp_path):
        regions = m.regions(self.annot(m, tmp_path / "lh.areas.annot"))
        (tmp_path / "out").mkdir()
        regions.save(tmp_path / "out" / "lh.{name}.label", sidecar=True)
        files = sorted(path.name for path in (tmp_path / "out").iterdir())
        labels = ["lh.MT+.label", "lh.V2.label", "lh.area_one.label"]
        assert files == sorted([*labels, *(f"{name}.json" for name in labels)])
        for file, key in zip(labels, (3, 2, 1), strict=True):
            vertices = nib.freesurfer.read_label(tmp_path / "out" / file)
            np.testing.assert_array_equal(vertices, np.flatnonzero(self.labels(m) == key))
        again = m.regions([tmp_path / "out" / labels[n] for n in (2, 1, 0)])
        np.testing.assert_array_equal(again.vertex_labels, regions.vertex_labels)
        same = m.regions({"a b": circle(0.0, 0.0, 4.0), "a/b": circle(9.0, 0.0, 4.0)})
        refused("two regions would be saved as a_b.label", same.save, tmp_path / "{name}.label")

    @pytest.mark.medium
    def test_regions_with_holes_and_equal_colours_survive_a_drawing(self, m, tmp_path):
        u, v = m.uv.T
        labels = np.zeros(m.origin.mesh.vertices, dtype=np.int32)
        labels[m.ids] = np.select([np.hypot(u, v) < 4, np.hypot(u, v) < 9, u > 10, v > 12], [2, 1, 2, 3], 0)
        table = np.array([[0, 0, 0, 0, 0], [9, 9, 9, 0, 1], [9, 9, 8, 0, 2], [8, 8, 8, 0, 3]], dtype=np.int32)
        nib.freesurfer.write_annot(tmp_path / "lh.a.annot", labels, table, ["unknown", "a", "b", "c"], fill_ctab=True)
        regions = m.regions(tmp_path / "lh.a.annot")
        regions = replace(regions, colours=np.array([[9, 9, 9]] * 3, dtype=np.uint8))
        regions.save(tmp_path / "drawn.svg")
        again = m.regions(tmp_path / "drawn.svg")
        assert again.names == ("a", "b", "c")
        np.testing.assert_array_equal(again.colours, regions.colours)
        np.testing.assert_array_equal(again.vertex_labels, labels)
        polygons = m.regions(drawn(m))
        polygons.save(tmp_path / "polygons.svg")
        again = m.regions(tmp_path / "polygons.svg")
        places = np.random.default_rng(0).uniform(-20, 20, (2000, 2))
        np.testing.assert_array_equal(again.at(places), polygons.at(places))

    @pytest.mark.medium
    def test_a_drawing_of_a_label_image_follows_its_pixels(self, m, tmp_path):
        regions = m.regions(m.regions(drawn(m)).image(0.25))
        regions.save(tmp_path / "pixels.svg")
        again = m.regions(tmp_path / "pixels.svg").image(0.25).data
        np.testing.assert_array_equal(again, regions.image(0.25).data)

    @pytest.mark.medium
    def test_areas_are_those_of_the_vertices(self, m, tmp_path):
        """A region reaches halfway to the next vertex, so that its area is that around its vertices."""
        table = m.regions(self.annot(m, tmp_path / "lh.areas.annot")).properties()
        a, b, c = np.moveaxis(m.points[m.faces], 1, 0)
        around = np.repeat(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6, 3)
        areas = np.bincount(self.labels(m)[m.ids][m.faces.ravel()], around)
        np.testing.assert_allclose(table["area"], areas[1:], rtol=0.02)

    @pytest.mark.medium
    def test_several_freesurfer_labels(self, m, tmp_path):
        labels, paths = self.labels(m), []
        for key, name in enumerate(("V1", "MT", "FFA"), 1):
            rows = "".join(f"{vertex} 0 0 0 0\n" for vertex in np.flatnonzero(labels == key))
            paths.append(tmp_path / f"lh.{name}.label")
            paths[-1].write_text(f"#!ascii label\n{np.count_nonzero(labels == key)}\n{rows}")
        regions = m.regions(paths)
        assert regions.names == ("V1", "MT", "FFA")
        np.testing.assert_array_equal(regions.vertex_labels, labels)
        assert m.regions(paths[1]).names == ("MT",)
        regions.save(tmp_path / "lh.rois.annot")
        assert m.regions(tmp_path / "lh.rois.annot").names == regions.names

    @pytest.mark.medium
    def test_the_command_and_a_region_with_the_number_0(self, m, tmp_path):
        m.save(tmp_path / "map.npz")
        annot = self.annot(m, tmp_path / "lh.areas.annot")
        succeed("regions", tmp_path / "map.npz", "--labels", annot, "-o", tmp_path / "t.tsv")
        assert [row.split("\t")[1] for row in (tmp_path / "t.tsv").read_text().splitlines()[1:]] == list(self.NAMES)
        table = np.column_stack([self.COLOURS, np.zeros(3), np.arange(3)]).astype(np.int32)
        nib.freesurfer.write_annot(tmp_path / "b.annot", self.labels(m) % 3, table, list(self.NAMES), fill_ctab=True)
        regions = m.regions(tmp_path / "b.annot")
        assert (regions.names, regions.keys) == (self.NAMES, (3, 1, 2))
        assert np.count_nonzero(regions.labels == 3) == np.count_nonzero(self.labels(m)[m.ids] % 3 == 0)

    def test_maps_of_volumes_have_no_vertices(self, tmp_path):
        flat = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), 6.0).flatten()
        refused("label files hold vertices of a mesh, but this is the map of a volume", flat.regions, "lh.aparc.annot")
