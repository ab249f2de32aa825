"""Parcels: labels carried to a map, borders between them, and pixels on the same side of them."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from command_line import succeed
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused
from triangle_meshes import square

import voxflat
from voxflat.io.label_tables import LabelTable
from voxflat.maps.lines import _crossings, borders, chains, outline
from voxflat.maps.parcels import parcels_of
from voxflat.methods import Voxflat


def uneven(n=24, seed=0):
    """Return places (N, 2) in a square of n mm, out of order, and triangles."""
    points, faces = square(n - 1)
    return points[:, :2] + np.random.default_rng(seed).uniform(-0.25, 0.25, (n * n, 2)), faces


def three(uv):
    """Return labels of three regions around the middle."""
    away = uv - uv.mean(axis=0)
    return np.floor((np.arctan2(away[:, 1], away[:, 0]) + np.pi) / (2 * np.pi / 3)).clip(0, 2).astype(np.int64)


def to_segments(points, lines):
    """Return the distance of points to the nearest of lines' segments."""
    ends = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    share = ((points[:, None] - start) * along).sum(-1) / (along**2).sum(-1)
    return np.linalg.norm(points[:, None] - start - share.clip(0, 1)[..., None] * along, axis=-1).min(axis=1)


class TestLines:
    def test_chains_join_each_link_once(self):
        links = np.array([[0, 1], [2, 1], [2, 3], [4, 5], [5, 6], [6, 4], [3, 7], [3, 8]])
        lines = chains(links)
        found = sorted(tuple(sorted(pair)) for line in lines for pair in pairwise(line))
        assert found == sorted(tuple(sorted(pair)) for pair in links.tolist())
        assert sorted(map(len, lines)) == [2, 2, 4, 4]  # two from the junction, one to it, a closed one

    @given(
        st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)).filter(lambda ends: ends[0] < ends[1]), unique=True)
    )
    def test_chains_end_where_not_two_links_meet(self, links):
        lines = chains(np.array(links, dtype=np.int64).reshape(-1, 2))
        meet = Counter(end for link in links for end in link)
        assert Counter(tuple(sorted(pair)) for line in lines for pair in pairwise(line.tolist())) == Counter(links)
        for line in lines:
            assert all(meet[point] == 2 for point in line[1:-1].tolist())
            assert line[0] == line[-1] or meet[line[0]] != 2 != meet[line[-1]]

    def test_the_outline_is_one_closed_line_around_the_map(self):
        uv, faces = uneven()
        (line,) = outline(uv, faces)
        np.testing.assert_array_equal(line[0], line[-1])
        assert len(line) == 4 * 23 + 1

    def test_borders_lie_within_half_an_edge_of_where_labels_change(self):
        uv, faces = uneven()
        labels = three(uv)
        lines = borders(uv, faces, labels)
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        edges = edges[labels[edges[:, 0]] != labels[edges[:, 1]]]
        middles, half = uv[edges].mean(axis=1), np.linalg.norm(uv[edges[:, 0]] - uv[edges[:, 1]], axis=1) / 2
        assert (to_segments(middles, lines) <= half).all()
        near = np.linalg.norm(np.concatenate(lines)[:, None] - middles, axis=-1)
        assert (near.min(axis=1) <= half[near.argmin(axis=1)] + 1e-9).all()

    def test_borders_are_smoother_than_the_edges_middles(self):
        uv, faces = uneven(seed=1)
        lines = borders(uv, faces, (uv[:, 0] > 11.3).astype(np.int64))
        assert len(lines) == 1
        length = np.linalg.norm(np.diff(lines[0], axis=0), axis=1).sum()
        straight = np.linalg.norm(lines[0][0] - lines[0][-1])
        assert length < 1.02 * straight  # a straight border
        assert np.abs(lines[0][:, 0] - 11.3).max() < 0.8

    @pytest.mark.parametrize("seed", range(3))
    def test_each_point_of_a_border_is_as_near_to_its_neighbours_as_its_edge_allows(self, seed):
        uv, faces = uneven(seed=seed)
        uv *= [3, 1]
        inside = np.hypot(uv[:, 0] / 3 - 11.5, uv[:, 1] - 11.5) < 7.3
        edges, share, links, _ = _crossings(uv, faces, inside.astype(np.int64))
        tried = np.linspace(0.1, 0.9, 801)
        along = uv[edges[:, :1]] + tried[:, None] * (uv[edges[:, 1:]] - uv[edges[:, :1]])
        places = uv[edges[:, 0]] + share[:, None] * (uv[edges[:, 1]] - uv[edges[:, 0]])
        for n in range(len(edges)):
            beside = places[np.concatenate([links[links[:, 0] == n, 1], links[links[:, 1] == n, 0]])]
            best = tried[((along[n, :, None] - beside) ** 2).sum(axis=(1, 2)).argmin()]
            assert share[n] == pytest.approx(best if len(beside) == 2 else 0.5, abs=0.02)

    def test_three_regions_meet_at_a_point(self):
        uv, faces = uneven()
        lines = borders(uv, faces, three(uv))
        ends = np.array([end for line in lines for end in (line[0], line[-1])])
        shared = [np.linalg.norm(ends - end, axis=1) < 1e-9 for end in ends]
        assert max(same.sum() for same in shared) == 3

    def test_a_single_label_has_no_border(self):
        uv, faces = uneven()
        assert borders(uv, faces, np.zeros(len(uv), np.int64)) == []


@pytest.fixture(scope="module")
def flat_map():
    uv, faces = uneven(30, seed=2)
    points = np.column_stack([uv, 0.1 * np.sin(uv[:, 0])])
    return voxflat.flatten((points, faces), method=Voxflat(sources=40), relax=False)


class TestParcels:
    @pytest.mark.medium
    def test_pixels_lie_on_the_side_of_their_corner(self, flat_map):
        labels = np.zeros(30 * 30, np.int64)
        middle = flat_map.points[:, :2].mean(axis=0)
        labels[flat_map.ids] = 1 + three(flat_map.points[:, :2] - middle)
        found = parcels_of(flat_map, labels)
        raster = flat_map.raster(0.2)
        shown = found.raster(raster)
        at = np.argwhere(raster.inside)
        places = np.array(raster.origin) + at[:, ::-1] * raster.pixel_size * [1, -1]
        near = to_segments(places, found.borders) < 0.1  # half a pixel: either side is right
        point = raster.nearest[raster.inside]
        # away from borders by more than an edge the nearest point says it; and each point's own place has its label
        far = to_segments(places, found.borders) > 1.5
        assert (shown[raster.inside][far] == found.labels[point[far]]).all()
        for start, step in zip(places[::37][~near[::37]], shown[raster.inside][::37][~near[::37]], strict=True):
            assert step in found.labels[np.linalg.norm(flat_map.uv - start, axis=1).argsort()[:4]]
        assert (shown[~raster.inside] == -1).all()
        row, column = (np.rint((flat_map.uv - raster.origin) / raster.pixel_size * [1, -1])).astype(int).T[::-1]
        on_map = (row >= 0) & (row < shown.shape[0]) & (column >= 0) & (column < shown.shape[1])
        of_points = shown[row[on_map], column[on_map]]  # the outline runs through some of their pixels
        assert (of_points == found.labels[on_map])[of_points >= 0].all()

    def test_names_and_colours_are_the_tables(self, flat_map):
        labels = np.repeat([0, 4, 7], 300)
        found = parcels_of(flat_map, labels, table=LabelTable({0: "Unknown", 4: "four"}, {4: (1, 2, 3)}))
        assert found.names == {4: "four", 7: "7"}
        assert found.colours[4] == (1, 2, 3)
        pixels = found.coloured(np.array([[-1, 4], [7, 4]]))
        assert pixels[0].tolist() == [[0, 0, 0, 0], [1, 2, 3, 255]]
        assert pixels[1, 0, 3] == 255

    def test_what_are_no_labels_is_refused(self, flat_map):
        refused("whole numbers", parcels_of, flat_map, np.linspace(0, 1, 900))
        refused("900 vertices", parcels_of, flat_map, np.zeros(7, np.int64))
        away = voxflat.io.Volume(np.ones((4, 4, 4), np.uint8), np.eye(4) + np.eye(4, k=3) * 500)
        refused("does not overlap the map", parcels_of, flat_map, away)
        small = np.diag([0.1, 0.1, 9.0, 1.0])
        small[:3, 3] = 5.4, 5.4, -4.0  # between the vertices
        between = voxflat.io.Volume(np.ones((1, 1, 1), np.uint8), small)
        refused("there are no labels on the surface", parcels_of, flat_map, between)

    def test_labels_of_a_volume_are_those_of_the_nearest_voxel(self, flat_map):
        data = np.zeros((40, 40, 5), np.int16)
        data[:12], data[12:] = 3, 8
        affine = np.eye(4)
        affine[:3, 3] = -2
        found = parcels_of(flat_map, voxflat.io.Volume(data, affine))
        x = flat_map.points[:, 0]
        clear = np.abs(x - 9.5) > 0.01
        assert (found.labels[clear] == np.where(x < 9.5, 3, 8)[clear]).all()


@pytest.mark.medium
def test_label_files_are_parcels_with_the_names_of_the_files(tmp_path):
    flat = voxflat.samples.hill().flatten()
    regions = {"lh.V1.label": [3, 4, 5], "lh.V2.label": [40, 41]}
    for name, vertices in regions.items():
        rows = "".join(f"{vertex} 0 0 0 0\n" for vertex in vertices)
        (tmp_path / name).write_text(f"#!ascii label\n{len(vertices)}\n{rows}", "utf-8")
    paths = [tmp_path / name for name in regions]
    found = parcels_of(flat, paths)
    assert found.names == {1: "V1", 2: "V2"}
    for number, vertices in enumerate(regions.values(), 1):
        assert sorted(flat.ids[found.labels == number]) == vertices
    assert parcels_of(flat, paths[1]).names == {1: "V2"}
    refused("lh.V1.label: its region V1 shares points with V1", parcels_of, flat, [paths[0], paths[0]])
    refused("a table does not apply", parcels_of, flat, paths, table=LabelTable({1: "a"}))
    voxflat.figures.flat_map(flat, parcels=paths)


@pytest.mark.medium
def test_label_files_are_drawn_by_the_command_line(tmp_path):
    voxflat.samples.hill().flatten().save(tmp_path / "map.npz")
    for name, vertex in (("lh.V1.label", 100), ("lh.V2.label", 200)):
        (tmp_path / name).write_text(f"#!ascii label\n1\n{vertex} 0 0 0 0\n", "utf-8")
    parcels = [part for name in ("lh.V1.label", "lh.V2.label") for part in ("--parcels", tmp_path / name)]
    succeed("figure", tmp_path / "map.npz", *parcels, "-o", tmp_path / "figure.png")
    assert (tmp_path / "figure.png").exists()


def test_a_label_file_is_an_overlay_and_one_of_the_other_hemisphere_is_refused(tmp_path):
    hill = voxflat.samples.hill()
    flat = voxflat.flatten(voxflat.io.Mesh(hill.points, hill.faces, structure="CortexLeft"))
    for name in ("lh.V1.label", "rh.V1.label"):
        (tmp_path / name).write_text("#!ascii label\n2\n100 0 0 0 0\n101 0 0 0 0\n", "utf-8")
    expected = np.isin(np.arange(441), [100, 101])
    np.testing.assert_array_equal(voxflat.io.read_overlay(tmp_path / "lh.V1.label", 441), expected)
    image = flat.image(tmp_path / "lh.V1.label", 1.0)
    np.testing.assert_array_equal(image.data, flat.image(expected.astype(np.uint8), 1.0).data)
    refused("belongs to the right hemisphere", flat.image, tmp_path / "rh.V1.label")
    refused("belongs to the right hemisphere", parcels_of, flat, [tmp_path / "lh.V1.label", tmp_path / "rh.V1.label"])
