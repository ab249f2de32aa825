"""To the map and back: regions to vertices and voxels and onto the map again, points to the map; by other readers."""

import json
import shutil
import subprocess
from dataclasses import replace
from types import SimpleNamespace

import lab
import nibabel as nib
import numpy as np
import pytest
import pyvista as pv
from brain_spaces import C_RAS, ball, header, to_scanner, write_freesurfer
from click.testing import CliRunner
from mesh_files import needs_workbench

import voxflat
from voxflat import cli
from voxflat.errors import InputError
from voxflat.io import Volume, write_volume
from voxflat.maps.raster import FlatImage
from voxflat.methods import Voxflat

INNER, OUTER = 20.0, 23.0


def sphere(radius, nsub=5):
    mesh = pv.Icosphere(radius=1.0, nsub=nsub)
    points = np.asarray(mesh.points, dtype=np.float64)
    return radius * points / np.linalg.norm(points, axis=1)[:, None], np.asarray(mesh.regular_faces)


@pytest.fixture(scope="module")
def m():
    """Return the map of a disk of 20 mm around a pole of concentric spheres, 2,500 vertices 0.8 mm apart."""
    return voxflat.surface(sphere(INNER), pial=sphere(OUTER)).disk(0, 20.0).flatten(Voxflat(sources=40))


@pytest.fixture(scope="module")
def grid(m):
    """Return an empty volume of voxels of 0.5 mm around the disk, with axes turned."""
    turned = np.array([[0.0, -0.5, 0], [0.5, 0, 0], [0, 0, 0.5]])
    corners = np.concatenate([m.white_points, m.pial_points])
    low, high = (corners @ np.linalg.inv(turned).T).min(axis=0) - 4, (corners @ np.linalg.inv(turned).T).max(axis=0) + 4
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = turned, turned @ np.floor(low)
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
    def test_from_the_map_through_voxels_to_the_map(self, m, grid):
        regions = m.regions(drawn(m))
        there = regions.volume(grid)
        back = m.image(there, 0.5, fraction=(0.1, 0.3, 0.5, 0.7, 0.9), interpolation="majority").data
        assert dice(np.nan_to_num(back), np.nan_to_num(regions.image(0.5).data)) > 0.99
        for value in (0.1, 0.9):  # a column is a column at all depths
            shown = m.image(there, 0.5, fraction=value, interpolation="majority").data
            assert dice(np.nan_to_num(shown), np.nan_to_num(back)) > 0.98

    def test_from_voxels_through_the_map_to_voxels(self, m, grid):
        """Cones from the middle of the spheres are columns: what of them lies in the cortex of the disk comes back."""
        ijk = np.moveaxis(np.indices(grid.data.shape), 0, -1)
        xyz = nib.affines.apply_affine(grid.affine, ijk)
        radius = np.linalg.norm(xyz, axis=-1)
        axis = m.points.mean(axis=0) / np.linalg.norm(m.points.mean(axis=0))
        across = np.cross(axis, [0.3, 0.4, 0.8])
        across /= np.linalg.norm(across)
        angle = np.arccos(np.clip((xyz @ (axis + 0.3 * across)) / radius / np.linalg.norm(axis + 0.3 * across), -1, 1))
        labels = np.where((radius > INNER) & (radius < OUTER) & (angle < 0.4), 7, 0).astype(np.int16)
        how = {"fraction": (0.2, 0.4, 0.6, 0.8), "interpolation": "majority"}
        on_map = m.image(Volume(labels, grid.affine), 0.5, **how)
        again = m.regions(on_map).volume(grid)
        assert set(np.unique(again.data)) == {0, 7}
        inside = (radius > INNER + 0.05) & (radius < OUTER - 0.05)  # triangles lie within the spheres, by 0.004 mm
        assert dice(again.data * inside, labels * inside) > 0.985
        finer = m.image(Volume(labels, grid.affine), 0.25, **how)
        assert dice(m.regions(finer).volume(grid).data * inside, labels * inside) > 0.985

    def test_from_vertices_through_the_map_to_vertices(self, m):
        labels = np.zeros(m.metadata["vertices"], np.int64)
        points = m.points - m.points.mean(axis=0)
        labels[m.ids[points[:, 0] > 3]] = 4
        labels[m.ids[points[:, 0] < -5]] = 2
        image = m.image(labels, 0.1)
        assert dice(m.regions(image).vertex_labels, labels) > 0.995

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
        assert radius[found > 0].min() > INNER - 0.01
        assert radius[found > 0].max() <= OUTER
        axis = m.points[np.argmin(np.linalg.norm(m.ids[:, None] - 0, axis=1))]
        angle = np.arccos(xyz @ axis / radius / np.linalg.norm(axis))
        rim = np.arccos(m.points @ axis / np.linalg.norm(m.points, axis=1) / np.linalg.norm(axis)).max()
        well_within = (angle < rim - 0.08) & (radius > INNER) & (radius < OUTER - 0.02)
        assert found[well_within].all()
        volume = np.count_nonzero(found) * 0.125
        solid = pv.PolyData.from_regular_faces(m.points, m.faces).area / ((INNER + OUTER) / 2) ** 2
        assert volume == pytest.approx(solid / 3 * (OUTER**3 - INNER**3), rel=0.01)

    @pytest.mark.slow
    def test_along_normals_where_no_pial_surface_is_known(self, grid):
        white = voxflat.surface(sphere(INNER)).disk(0, 20.0).flatten(Voxflat(sources=30))
        regions = white.regions(circle(*white.uv.mean(axis=0), 10.0))
        found = regions.volume(grid, depth=(0.5, 2.0)).data
        radius = np.linalg.norm(nib.affines.apply_affine(grid.affine, np.argwhere(found)), axis=1)
        assert radius.min() > INNER + 0.49
        assert radius.max() < INNER + 2.0
        assert np.count_nonzero(found) * 0.125 == pytest.approx(np.pi * 100 * 1.5 * (21.25 / 20) ** 2, rel=0.03)
        with pytest.raises(InputError, match=r"knows no pial surface: give depth"):
            regions.volume(grid)
        with pytest.raises(InputError, match=r"depth is 2 to 1 mm; give two finite numbers, the lower one first"):
            regions.volume(grid, depth=(2, 1))
        with pytest.raises(InputError, match="the depth is None; give a number"):
            regions.volume(grid, depth=(None, 1.0))

    def test_the_flattened_volume_is_the_default(self, tmp_path):
        i, j, k = np.indices((24, 24, 24)) - 11.5
        mask = (i**2 + j**2 + k**2 < 81).astype(np.uint8)
        affine = np.diag([2.0, 2, 2, 1])
        solid = voxflat.surface(Volume(mask, affine)).disk((11, 11, 20), 16.0).flatten(Voxflat(sources=30))
        regions = solid.regions(circle(*solid.uv.mean(axis=0), 9.0))
        regions.save(tmp_path / "l.nii.gz", depth=(-3.0, 1.0))
        image = nib.load(tmp_path / "l.nii.gz")
        np.testing.assert_array_equal(image.affine, affine)
        labels = np.asarray(image.dataobj)
        assert labels.shape == (24, 24, 24)
        assert 0 < np.count_nonzero(labels) < 200
        with pytest.raises(InputError, match=r"has no vertices that others know"):
            regions.save(tmp_path / "l.annot")

    def test_far_and_coarse_grids_are_told(self, m):
        regions = m.regions(drawn(m))
        far = np.eye(4)
        far[:3, 3] = 500
        for volume in (Volume(np.zeros((5, 5, 5)), far), Volume(np.zeros((2, 2, 2)), np.diag([100.0, 100, 100, 1]))):
            with pytest.raises(InputError, match=r"no voxel of the volume has its centre in a region"):
                regions.volume(volume)


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
        np.testing.assert_allclose(rows[:, 1:4], sphere(INNER)[0][vertices], atol=6e-4)  # on the white one
        with pytest.raises(InputError, match=r"a .label holds one region, and there are 2"):
            m.regions(drawn(m)).save(tmp_path / "lh.both.label")

    def test_points_of_a_label_are_tkras(self, tmp_path):
        (points, faces), of = ball(4), header()
        scanner = write_gifti_of_scanner(tmp_path, points, faces, of)
        flat = voxflat.surface(scanner).disk(0, 25.0).flatten(Voxflat(sources=20))
        flat.regions(circle(*flat.uv.mean(axis=0), 8.0)).save(tmp_path / "lh.x.label")
        rows = np.loadtxt(tmp_path / "lh.x.label", skiprows=2)
        tk = (
            voxflat.surface(write_freesurfer(tmp_path / "lh.white", points, faces, of))
            .disk(0, 25.0)
            .flatten(Voxflat(sources=20))
        )
        tk.regions(circle(*tk.uv.mean(axis=0), 8.0)).save(tmp_path / "lh.y.label")
        np.testing.assert_allclose(
            np.loadtxt(tmp_path / "lh.y.label", skiprows=2)[:, 1:4], points[rows[:, 0].astype(int)], atol=6e-4
        )

    @pytest.mark.slow
    @needs_workbench
    def test_label_gii(self, tmp_path):
        lab.write(tmp_path)
        surface = voxflat.surface(tmp_path / "lh.white", pial=tmp_path / "lh.pial")
        whole = surface.disk(700, 40.0).flatten(Voxflat(sources=20))
        regions = whole.regions({"V1": circle(*whole.uv.mean(axis=0), 15.0)})
        regions.save(tmp_path / "lh.rois.label.gii")
        image = nib.load(tmp_path / "lh.rois.label.gii")
        np.testing.assert_array_equal(image.agg_data(), regions.vertex_labels)
        assert image.labeltable.get_labels_as_dict() == {0: "???", 1: "V1"}
        assert image.meta["AnatomicalStructurePrimary"] == "CortexLeft"
        assert json.loads(image.meta["Provenance"])["function"] == "regions"
        told = subprocess.run(
            ["wb_command", "-file-information", "lh.rois.label.gii"],
            capture_output=True,
            cwd=tmp_path,
            check=True,
            text=True,
        ).stdout
        assert "CortexLeft" in told
        assert "V1" in told
        roi = ["wb_command", "-gifti-label-to-roi", "lh.rois.label.gii", "roi.func.gii", "-name", "V1"]
        subprocess.run(roi, capture_output=True, cwd=tmp_path, check=True)
        np.testing.assert_array_equal(nib.load(tmp_path / "roi.func.gii").agg_data(), regions.vertex_labels)

    def test_volume(self, m, grid, tmp_path):
        write_volume(tmp_path / "t1.mgz", grid.data, grid.affine)
        regions = m.regions(drawn(m))
        regions.save(tmp_path / "l.nii.gz", volume=tmp_path / "t1.mgz")
        image = nib.load(tmp_path / "l.nii.gz")
        np.testing.assert_array_equal(np.asarray(image.dataobj), regions.volume(grid).data)
        np.testing.assert_allclose(image.affine, grid.affine)
        record = json.loads(image.header.extensions[0].get_content())
        assert "t1.mgz" in record["files"]
        with pytest.raises(InputError, match="it is an input"):
            regions.save(tmp_path / "t1.mgz", volume=tmp_path / "t1.mgz")
        with pytest.raises(InputError, match="give the volume whose grid"):
            regions.save(tmp_path / "l.nii.gz")
        with pytest.raises(InputError, match="leave them out"):
            regions.save(tmp_path / "l.annot", volume=grid)
        with pytest.raises(InputError, match="give a name that ends in"):
            regions.save(tmp_path / "l.txt")

    @pytest.mark.slow
    def test_both_sides_of_a_cut(self):
        points, faces = sphere(INNER, 2)
        whole = voxflat.flatten((points, faces), Voxflat(sources=30))
        labels = whole.regions(whole.image(np.ones(len(points), int), 0.5)).vertex_labels
        assert np.count_nonzero(labels) == len(points)  # up to the map's border, which pixels meet only in part


def write_gifti_of_scanner(folder, points, faces, of):
    from voxflat.io.meshes import Mesh, write_mesh

    write_mesh(folder / "lh.surf.gii", Mesh(to_scanner(points.astype(np.float64), of), faces.astype(np.int64)))
    return folder / "lh.surf.gii"


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
        ("where", "layer", "message"),
        [
            ("", "rois", "its root does not say where the map lies: data-voxflat-extent"),
            (
                'data-voxflat-extent="1 2 3" data-voxflat-axes="0 0 1 1"',
                "rois",
                "data-voxflat-extent must be four numbers",
            ),
            ('data-voxflat-extent="1 1 2 3" data-voxflat-axes="0 0 1 1"', "rois", "have no area"),
            (WHERE, "areas", "has no layer 'areas'; its layers are 'rois', 'round', 'names'"),
        ],
    )
    def test_what_is_no_drawing(self, m, tmp_path, where, layer, message):
        path = tmp_path / "drawn.svg"
        path.write_text(SVG.format(where=where))
        with pytest.raises(InputError, match=message):
            m.regions(path, layer=layer)

    def test_damaged_svg(self, m, tmp_path):
        path = tmp_path / "drawn.svg"
        for text in ("", "<svg", "no drawing", SVG.format(where=WHERE)[:400]):
            path.write_text(text)
            with pytest.raises(InputError):
                m.regions(path)
        with pytest.raises(FileNotFoundError):
            m.regions(tmp_path / "none.svg")

    @pytest.mark.parametrize(("where", "beyond"), [("M 290", "M 1e999"), ("translate(10", "translate(1e999")])
    def test_places_beyond_all_numbers(self, m, tmp_path, where, beyond):
        path = tmp_path / "drawn.svg"
        path.write_text(SVG.format(where=WHERE).replace(where, beyond))
        with pytest.raises(InputError, match="one of its paths leads to infinity"):
            m.regions(path)

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
        line = SimpleNamespace(
            name="l", data=[np.zeros((2, 2))], shape_type=["line"], data_to_world=lambda corner: corner, features={}
        )
        with pytest.raises(InputError, match="is a line, which encloses nothing"):
            m.regions(line)

    def test_label_images(self, m, tmp_path):
        regions = m.regions(drawn(m))
        shown = regions.image(0.5)
        for name in ("r.tif", "r.nii.gz", "r.npy", "r.png"):
            path = tmp_path / name
            if name == "r.png":
                from PIL import Image

                Image.fromarray(np.nan_to_num(shown.data).astype(np.uint8)).save(path)
            else:
                shown.save(path)
            says_it = name in ("r.tif", "r.nii.gz")
            again = m.regions(path, **({} if says_it else {"pixel_size": 0.5}))
            assert again.names == ("1", "2")
            np.testing.assert_array_equal(np.nan_to_num(again.image(0.5).data), np.nan_to_num(shown.data))
        np.testing.assert_array_equal(m.regions(shown).labels, again.labels)
        assert dice(again.labels, regions.labels) > 0.97
        with pytest.raises(InputError, match=r"has 88 x \d+ pixels, the map at .* give the pixel size"):
            m.regions(np.ones((50, 88), int))
        with pytest.raises(InputError, match="whole numbers, and this has others"):
            m.regions(FlatImage(shown.data / 3, 0.5, shown.origin, ""))
        with pytest.raises(InputError, match="is 0 everywhere"):
            m.regions(0 * shown.data, pixel_size=0.5)

    def test_holes_and_overlaps(self, m, caplog):
        u, v = m.uv.mean(axis=0)
        ring = m.regions({"ring": [circle(u, v, 8.0), circle(u, v, 4.0)[::-1]]})
        assert ring.at([[u, v], [u + 6, v], [u + 9, v]]).tolist() == [0, 1, 0]
        both = m.regions([circle(u, v, 8.0), circle(u + 4, v, 8.0)])
        assert "lie in several regions; the last one drawn has them" in caplog.text
        assert both.at([[u - 7, v], [u, v], [u + 11, v]]).tolist() == [1, 2, 2]
        assert both.names == ("region 1", "region 2")

    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"a": [[0, 0], [1, 1]]}, "a: a polygon has .* at least three corners"),
            ({"a": [[0, 0], [1, 1], [np.nan, 3]]}, "a: corner 2 is not finite"),
            ({"a": [[900, 0], [901, 1], [900, 1]]}, "a lies beside the map, around u = 900"),
            ({}, "there is no region"),
            (3, "regions are int; give polygons"),
            ("rois.xcf", "regions are read from .svg, .json"),
        ],
    )
    def test_what_is_no_region(self, m, given, message):
        with pytest.raises(InputError, match=message):
            m.regions(given)


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

    def test_beyond_the_limit(self, m):
        points = np.array([[0.0, 0, 0], [np.nan, 0, 0], m.points[5] * (1 + 4 / np.linalg.norm(m.points[5]))])
        uv, distance = m.points_to_map(points)
        assert np.isnan(uv[:2]).all()
        assert np.isnan(distance[:2]).all()
        assert distance[2] == pytest.approx(4, abs=0.01)
        assert np.isnan(m.points_to_map(points, 3.9)[1]).all()
        for arguments, message in [
            ((np.zeros((2, 2)),), "points have shape"),
            ((np.zeros(3), -1), "not negative"),
            ((np.zeros(3), np.nan), "not negative"),
        ]:
            with pytest.raises(InputError, match=message):
                m.points_to_map(*arguments)
        with pytest.raises(InputError, match="space is 'MNI'; give 'surface' or 'scanner'"):
            m.points_to_map(np.zeros(3), space="MNI")

    def test_space(self, tmp_path):
        (points, faces), of = ball(3), header()
        flat = (
            voxflat.surface(write_freesurfer(tmp_path / "lh.white", points, faces, of))
            .disk(0, 25.0)
            .flatten(Voxflat(sources=20))
        )
        own, _ = flat.points_to_map(flat.points)
        scanner, distance = flat.points_to_map(to_scanner(points.astype(np.float64), of)[flat.ids], space="scanner")
        np.testing.assert_allclose(scanner, own, atol=1e-6)
        assert distance.max() < 1e-5
        assert np.linalg.norm(C_RAS) > 20

    def test_by_the_command_line(self, m, tmp_path):
        m.save(tmp_path / "m.npz")
        table = tmp_path / "electrodes.tsv"
        rows = [("E1", *m.points[3], "good"), ("E2", 0, 0, 0, "far"), ("E3", "n/a", "n/a", "n/a", "lost")]
        table.write_text("name\tx\ty\tz\tstatus\n" + "".join("\t".join(map(str, row)) + "\n" for row in rows))
        out = tmp_path / "uv.csv"
        result = CliRunner().invoke(cli.main, ["points", str(tmp_path / "m.npz"), str(table), "-o", str(out), "--json"])
        assert json.loads(result.output)["on_map"] == 1
        lines = out.read_text().splitlines()
        assert lines[0] == "name,x,y,z,status,u,v,distance"
        np.testing.assert_allclose([float(x) for x in lines[1].split(",")[5:]], [*m.uv[3], 0], atol=2e-6)
        assert lines[2].endswith("far,n/a,n/a,n/a")
        bare = tmp_path / "bare.txt"
        np.savetxt(bare, m.points[:4])
        result = CliRunner().invoke(cli.main, ["points", str(tmp_path / "m.npz"), str(bare), "-o", str(out)])
        assert result.exit_code == 0, result.output
        np.testing.assert_allclose(np.loadtxt(out, delimiter=",", skiprows=1)[:, 3:5], m.uv[:4], atol=2e-6)
        for text, message in [
            ("", "is empty"),
            ("x,y,z\n", "no point"),
            ("x,y,z\n1,2\n", "cells"),
            ("1,2,q\n3,4,5\n", "row 1: 'q' is no number"),
        ]:
            (tmp_path / "bad.csv").write_text(text)
            result = CliRunner().invoke(
                cli.main, ["points", str(tmp_path / "m.npz"), str(tmp_path / "bad.csv"), "-o", str(out)]
            )
            assert result.exit_code == 1
            assert message in result.output


@pytest.mark.slow
def test_regions_by_the_command_line(m, grid, tmp_path):
    m.save(tmp_path / "m.npz")
    write_volume(tmp_path / "t1.nii.gz", grid.data, grid.affine)
    polygons = {name: polygon.tolist() for name, polygon in drawn(m).items()}
    (tmp_path / "p.json").write_text(json.dumps(polygons))

    def run(*arguments):
        return CliRunner().invoke(cli.main, ["regions", str(tmp_path / "m.npz"), *map(str, arguments)])

    regions = m.regions(drawn(m))
    out = tmp_path / "o.annot"
    assert run("--polygons", tmp_path / "p.json", "-o", out).exit_code == 0
    np.testing.assert_array_equal(nib.freesurfer.read_annot(out)[0], regions.vertex_labels)
    out = tmp_path / "o.nii.gz"
    result = run("--polygons", tmp_path / "p.json", "-o", out, "--volume", tmp_path / "t1.nii.gz", "--json")
    assert json.loads(result.output)["regions"].keys() == {"V1", "V2"}
    np.testing.assert_array_equal(np.asarray(nib.load(out).dataobj), regions.volume(grid).data)
    assert {"m.npz", "p.json", "t1.nii.gz"} <= set(
        json.loads(nib.load(out).header.extensions[0].get_content())["files"]
    )
    for wrong in ((), ("--polygons", tmp_path / "p.json", "--layer", "x")):
        assert run(*wrong, "-o", out).exit_code == 2
    shutil.copy(tmp_path / "p.json", tmp_path / "bad.json")
    (tmp_path / "bad.json").write_text("[1]")
    assert run("--polygons", tmp_path / "bad.json", "-o", out).exit_code == 1
