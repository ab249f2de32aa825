"""Borders of Connectome Workbench as regions and as parcels, compared with wb_command itself."""

import nibabel as nib
import numpy as np
import pytest
from command_line import succeed
from mesh_files import icosphere, needs_workbench, workbench
from refusals import refused

import voxflat
from voxflat.io import Mesh, write_mesh
from voxflat.io.formats.border import read_borders
from voxflat.maps.enclosed import Enclosing
from voxflat.methods import Voxflat

NAMES, COLOURS = ("V1", "hole in MT", "MT", "V2"), [(255, 0, 0), (10, 20, 30), (0, 200, 60), (250, 0, 250)]


def v3(*borders, head='Version="3" Structure="CORTEX_LEFT" SurfaceNumberOfVertices="642"'):
    """Return a file with borders, each given by its name, whether it is closed, and its points: corners, weights."""
    parts = []
    for name, is_closed, points in borders:
        rows = ["\n".join(" ".join(map(str, point[n])) for point in points) for n in (0, 1)]
        part = (
            f'<BorderPart Closed="{is_closed}"><Vertices>{rows[0]}</Vertices><Weights>{rows[1]}</Weights></BorderPart>'
        )
        parts.append(f'<Border Name="{name}" Red="1" Green="0.2" Blue="0">{part}</Border>')
    return f"<BorderFile {head}><Class Name='a' Red='0' Green='0' Blue='0'>{''.join(parts)}</Class></BorderFile>"


@pytest.fixture(scope="module")
def sphere(tmp_path_factory):
    """Return the folder of a sphere of 642 vertices, with labels: caps, one of which has a hole that is a region."""
    folder = tmp_path_factory.mktemp("sphere")
    write_mesh(folder / "lh.ball.surf.gii", Mesh(*icosphere(50.0, 3), structure="CortexLeft"))
    surface = voxflat.surface(folder / "lh.ball.surf.gii")
    heights = surface.points / 50
    labels = np.zeros(surface.count, dtype=np.int32)
    labels[heights[:, 0] > 0.55] = 3
    labels[heights[:, 0] > 0.9] = 2
    labels[heights[:, 1] > 0.8] = 1
    labels[heights[:, 2] < -0.85] = 4
    table = nib.gifti.GiftiLabelTable()
    for key, (name, colour) in enumerate(zip(("???", *NAMES), [(0, 0, 0), *COLOURS], strict=True)):
        label = nib.gifti.GiftiLabel(key, *(channel / 255 for channel in colour), 1.0)
        label.label = name
        table.labels.append(label)
    array = nib.gifti.GiftiDataArray(labels, "NIFTI_INTENT_LABEL")
    meta = nib.gifti.GiftiMetaData({"AnatomicalStructurePrimary": "CortexLeft"})
    nib.save(nib.gifti.GiftiImage(meta=meta, darrays=[array], labeltable=table), folder / "lh.areas.label.gii")
    return folder, surface, labels


@pytest.fixture(scope="module")
def flat(sphere):
    """Return the map of the sphere without the cap at the bottom, cut open along a path."""
    _, surface, labels = sphere
    return surface.drop(labels == 4).flatten(Voxflat(sources=60))


@pytest.fixture(scope="module")
def of_workbench(sphere):
    folder, *_ = sphere
    workbench("-label-to-border", "lh.ball.surf.gii", "lh.areas.label.gii", "lh.areas.border", folder=folder)
    workbench("-file-convert", "-border-version-convert", "lh.areas.border", 1, "lh.old.border", folder=folder)
    return folder / "lh.areas.border"


def enclosing(surface):
    return Enclosing(surface.ids[surface.faces.astype(np.int64)], surface.points, surface.count)


@needs_workbench
@pytest.mark.medium
@pytest.mark.parametrize("version", ["lh.areas.border", "lh.old.border"])
def test_borders_of_labels_enclose_exactly_their_vertices(sphere, of_workbench, version):
    _, surface, labels = sphere
    borders = {border.name: border for border in read_borders(of_workbench.with_name(version).read_bytes(), 642)}
    assert set(borders) == set(NAMES)
    for key, name in enumerate(NAMES, 1):
        assert np.array_equal(enclosing(surface).inside(borders[name]), labels == key)


@needs_workbench
@pytest.mark.slow
def test_regions_of_a_map_with_a_cut_and_without_a_part(sphere, flat, of_workbench, tmp_path):
    """The border around the dropped cap lies outside the map, so it encloses nothing there."""
    _, _, labels = sphere
    regions = flat.regions(of_workbench)
    found = {name: key for name, key in zip(regions.names, regions.keys, strict=True)}
    for key, (name, colour) in enumerate(zip(NAMES[:3], COLOURS, strict=False), 1):
        assert np.array_equal(regions.vertex_labels == found[name], labels == key)
        assert regions.colours[regions.names.index(name)].tolist() == list(colour)
    again = flat.regions(sphere[0] / "lh.areas.label.gii")
    assert sorted(again.names) == sorted(regions.names)
    flat.save(tmp_path / "map.npz")
    told = succeed("regions", tmp_path / "map.npz", "--labels", of_workbench, "-o", tmp_path / "lh.a.annot").stdout
    assert f"MT: {np.count_nonzero(flat.regions(of_workbench).labels == found['MT'])} points of the map" in told
    succeed("figure", tmp_path / "map.npz", "--parcels", of_workbench, "-o", tmp_path / "a.png")
    worst = voxflat.worst_places(flat, beyond=1.01, cuts=False, parcels=of_workbench)
    assert {place.parcel for place in worst.places} & {*NAMES, None}


def drawn(surface, corners):
    """Return the points of a closed line through the triangles nearest to directions on the sphere."""
    centres = surface.points[surface.faces].mean(axis=1)
    directions = np.asarray(corners) / np.linalg.norm(corners, axis=1, keepdims=True)
    return [(surface.faces[np.argmax(centres @ one)].tolist(), (0.3, 0.4, 0.3)) for one in directions]


@needs_workbench
@pytest.mark.medium
@pytest.mark.parametrize("step", [5, 15, 30])
def test_a_line_whose_points_are_far_apart_encloses_what_workbench_does(sphere, tmp_path, step):
    folder, surface, _ = sphere
    angles = np.radians(np.arange(0, 360, step))
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.full(len(angles), 0.7)])
    (tmp_path / "a.border").write_text(v3(("ring", "True", drawn(surface, circle))))
    (border,) = read_borders((tmp_path / "a.border").read_bytes(), 642)
    assert border.colour == (255, 51, 0)
    found = enclosing(surface).inside(border)
    rois = []
    for more in ([], ["-include-border"]):  # the vertices nearest to the line count in neither case, or in both
        words = ["-border-to-rois", folder / "lh.ball.surf.gii", "a.border", "roi.func.gii", *more]
        workbench(*words, folder=tmp_path)
        rois.append(nib.load(tmp_path / "roi.func.gii").agg_data() > 0)
    assert np.count_nonzero(rois[0]) > 60
    assert found[rois[0]].all()
    assert rois[1][found].all()


def test_open_borders_and_damaged_files_are_refused(sphere, flat, tmp_path):
    _, surface, _ = sphere
    points = drawn(surface, [[1, 0, 0.1], [0, 1, 0.2], [-1, 0, 0.3]])
    files = {
        "open": v3(("CS", "False", points)),
        "xml": "<BorderFile",
        "other": "<GIFTI/>",
        "old": v3(("a", "True", points), head='Version="2"'),
        "size": v3(("a", "True", points), head='Version="3" SurfaceNumberOfVertices="9"'),
        "rows": v3(("a", "True", [((1, 2), (1, 0))])),
        "far": v3(("a", "True", [((1, 2, 999), (1, 0, 0))] * 3)),
        "weights": v3(("a", "True", [((1, 2, 3), (0, 0, 0))] * 3)),
        "none": v3(),
        "side": v3(("a", "True", points), head='Version="3" Structure="CORTEX_RIGHT"'),
    }
    told = {
        "open": "only open borders",
        "xml": "is not a border file",
        "other": "contains 'GIFTI'",
        "old": "has version '2'",
        "size": "a surface with 9 vertices, but this surface has 642",
        "rows": "numbers, not three per point",
        "far": "uses vertex 999, but the surface has vertices 0 to 641",
        "weights": "has weights that are not",
        "none": "contains no borders",
        "side": "right hemisphere",
    }
    for name, text in files.items():
        path = tmp_path / f"{name}.border"
        path.write_text(text)
        refused(told[name], flat.regions, path)


def test_an_open_border_beside_a_closed_one_is_omitted_with_a_warning(sphere, flat, tmp_path, caplog):
    _, surface, _ = sphere
    angles = np.radians(np.arange(0, 360, 10))
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.full(36, 2.0)])
    points = drawn(surface, circle)
    path = tmp_path / "lh.two.border"
    path.write_text(v3(("ring", "True", points), ("CS", "False", points[:9])))
    regions = flat.regions(path)
    assert regions.names == ("ring",)
    assert "open borders enclose no region and are omitted: CS" in caplog.text
    expected = surface.points[:, 2] > 50 * 2 / np.hypot(1, 2)
    assert np.count_nonzero((regions.vertex_labels > 0) != expected) < 0.2 * np.count_nonzero(expected)


def test_regions_of_maps_whose_positions_are_unknown(sphere, flat):
    """Then steps between triangles count instead of lengths."""
    _, surface, _ = sphere
    angles = np.radians(np.arange(0, 360, 10))
    points = drawn(surface, np.column_stack([np.cos(angles), np.sin(angles), np.full(36, 1.0)]))
    (border,) = read_borders(v3(("ring", "True", points)).encode(), 642)
    faces = surface.ids[surface.faces.astype(np.int64)]
    found = [Enclosing(faces, places, 642).inside(border) for places in (surface.points, None)]
    assert np.count_nonzero(found[0] != found[1]) < 0.1 * np.count_nonzero(found[0])
