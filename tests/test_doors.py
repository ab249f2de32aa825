"""Every option of flattening gives the same map or is refused in Python, on the command line, in PyVista, VTK, napari.

The table of doors and cases is generated: the options come from the signatures, and their values, valid or not, from
the types and the words that the docstrings list.
"""

import gzip
import inspect
import json
import re
from dataclasses import fields
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import get_args, get_type_hints

import composed
import numpy as np
import pytest
import pyvista as pv
import trimesh
import yaml
from command_line import run as command
from doors import (
    SIZE,
    SOURCES,
    CommandLine,
    Filter,
    Napari,
    Outcome,
    Python,
    PyVista,
    dataset,
    filtered,
    mesh,
    of_array,
    tried,
)
from volume_files import itk, itk_image, nib

import voxflat
from voxflat.io import formats
from voxflat.io.patches import FLAT_PATCH_ENDINGS
from voxflat.io.readers import READERS
from voxflat.maps.flat_map import MAP_ENDINGS
from voxflat.methods import METHODS
from voxflat.pipeline.surface import Surface, surface

pytestmark = pytest.mark.slow

RUN = {"rows", "threads", "memory_limit", "progress"}
NUMBERS = {bool: [True, False], int: [5, 0, -1], float: [1.5, 0.0, -1.0, float("nan")], str: ["nonsense"]}
MASK = np.zeros((SIZE,) * 3, dtype=np.uint8)
MASK[2:-4, 3:-3] = 1
INNER = np.setdiff1d(np.arange(SIZE**2), np.concatenate([np.arange(SIZE * 3), np.arange(0, SIZE**2, SIZE)]))
MIDDLE = SIZE**2 // 2 + SIZE // 2
LINE = MIDDLE + np.arange(SIZE // 2)  # from the middle to the border
CORNERS = np.array([2 * SIZE + 2, 2 * SIZE + SIZE - 3, (SIZE - 3) * SIZE + SIZE - 3, (SIZE - 3) * SIZE + 2])
WRONG = {"beyond": np.array([0, 10**6]), "negative": np.array([-1, 3])}
PLACES = {
    "keep": ([INNER, *WRONG.values()], [MASK, MASK[1:], 0 * MASK]),
    "drop": ([LINE, *WRONG.values()], [1 - MASK, MASK[1:]]),
    "seed_point": ([MIDDLE, 10**6, -1], [(5, 5, 5), (0, 0, 10**6)]),
    "polygon": ([CORNERS, CORNERS[:2], *WRONG.values()], []),
    "cuts": (["automatic", "standard", "nonsense", [LINE], [INNER[::7]], [WRONG["beyond"]]], ["automatic", "standard"]),
    "pial": ([mesh(0.5), mesh(-40.0)], [mesh(0.5)]),
    "sphere": ([mesh(0.5)], [mesh(0.5)]),
    "start": ([mesh(0.5)], []),
    "probability": ([MASK], [MASK[1:], MASK.astype(np.float32)]),
    "spacing": ([(1.0, 2.0, 3.0)], [(1.0, 2.0, 3.0), (0.0, 1.0, 1.0), (1.0, 1.0)]),
    "label": ([3], [3, [3], [3, 9]]),
    "threshold": ([0.5], [0.5]),
}
NEEDED = {"seed_point": {"radius": 6.0}, "radius": {"seed_point": MIDDLE}}
ELSEWHERE = {
    CommandLine: {"affine"},
    PyVista: {"spacing", "affine", "probability", "pial", "repair"},
    Filter: {"spacing", "affine", "probability", "pial", "repair", "unit", "polygon", "sphere", "adapt", "mirror"},
    Napari: {"spacing", "affine", "probability", "repair", "unit", "drop", "sphere", "adapt", "start", "max_area"},
}
"""The options that a door does not offer; each of the others is tried."""


def words(of, name):
    """Return the words that a docstring lists for a parameter."""
    line = re.search(rf"^\s*(?:\w+, )*{name}(?:, \w+)* : (.*)$", inspect.getdoc(of), re.MULTILINE)
    return re.findall(r'"([^"]+)"', line[1]) if line else []


def suggested(of, name, hint):
    """Return the values that the type and the docstring of a parameter suggest."""
    kinds = [hint, *get_args(hint)]
    return [*words(of, name), *(value for kind in kinds if not get_args(kind) for value in NUMBERS.get(kind, []))]


def parameters():
    """Yield all options of flattening, with the suggested values and the options that they need."""
    for of in (surface, Surface.flatten, Surface.disk, Surface.cut):
        hints = get_type_hints(of)
        for name in inspect.signature(of).parameters:
            if name in hints and name not in {"source", "method", *RUN}:
                yield name, suggested(of, name, hints[name]), NEEDED.get(name, {})
    for name in PLACES:
        yield name, [], NEEDED.get(name, {})
    for kind in METHODS.values():
        hints = get_type_hints(kind)
        for one in fields(kind):
            yield one.name, suggested(kind, one.name, hints[one.name]), {"method": kind.name}


def cases(name):
    """Return all sources and options with which an option is tried."""
    found = {}
    for option, values, needed in parameters():
        if option != name:
            continue
        of_mesh, of_volume = PLACES.get(name, ([], []))
        on_volume = needed.get("method") == "grossmann2002" or not needed.get("method", needed)
        kinds = [("mesh", [*values, *of_mesh])]
        if on_volume:
            kinds += [(kind, [*values, *of_volume]) for kind in ("labels", "intensities")[: 1 + (name == "threshold")]]
        for source, own in kinds:
            for value in own:
                given = {**needed, name: value}
                found[source, repr(given)] = source, given
    return list(found.values())


NAMES = sorted({name for name, _, _ in parameters()})


@cache
def in_python():
    return {(name, number): Python()(*case) for name in NAMES for number, case in enumerate(cases(name))}


def compare(door, name):
    """Return the differences between a door and Python for all values of an option, one line each."""
    found, tried = [], 0
    for number, (source, given) in enumerate(cases(name)):
        one = door(source, given)
        if one is None:  # the form has no such value
            continue
        tried += 1
        expected = in_python()[name, number]
        if not one.same(expected):
            found.append(f"{source}, {given}: {one}, but in Python {expected}")
        elif one.refusal is not None and "\n" in one.refusal:
            found.append(f"{source}, {given}: the refusal has several lines")
    return found, tried


def offered(door):
    """Return whether a door offers what it is said to offer, and nothing else."""
    return sorted(set(NAMES) - door.takes)


@pytest.mark.parametrize("name", NAMES)
def test_options_of_the_command_line(name, tmp_path):
    door = CommandLine(tmp_path)
    assert offered(door) == sorted(ELSEWHERE[CommandLine])
    if name in door.takes:
        found, tried = compare(door, name)
        assert found == []
        assert tried


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", [PyVista, Filter])
def test_options_of_datasets(kind, name):
    door = kind()
    assert offered(door) == sorted(ELSEWHERE[kind])
    if name in door.takes:
        found, tried = compare(door, name)
        assert found == []
        assert tried


def test_options_of_the_window(make_napari_viewer, qtbot):
    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    door = Napari(viewer, widget, qtbot)
    assert offered(door) == sorted(ELSEWHERE[Napari])
    results = {name: compare(door, name) for name in NAMES if name in door.takes}
    assert [line for found, _ in results.values() for line in found] == []
    assert all(tried for _, tried in results.values()), results


# ------------------------------------------------------------------------------ other work


def patches(source, folder, given):
    """Return the patch of each triangle."""
    command = CommandLine(folder, "patches")
    file = folder / "atlas.npz"
    read = lambda _: of_array(voxflat.load_atlas(file).patch_ids)  # noqa: E731
    yield tried(lambda: composed.patches(SOURCES[source], **given).patch_ids)
    if given.keys() <= command.takes:
        yield command.run(source, [], given, ["-o", file], read)
    if given.keys() <= {"label", "threshold", *inspect.signature(Surface.patches).parameters}:
        yield tried(lambda: dataset(source).voxflat.patches(**given)["patch"])
    if given.keys() <= set(voxflat.vtk.SurfacePatches.options()):
        page = filtered(lambda: voxflat.vtk.SurfacePatches(**given), source)
        yield page if isinstance(page, Outcome) else of_array(page["patch"])


def distances(source, folder, given):
    """Return the distances from a number of sources, or from the nearest of several points."""
    sources = given.pop("sources", [MIDDLE] if source == "mesh" else 3)
    rows = tried(lambda: np.asarray(composed.geodesic(SOURCES[source], sources, **given)))
    if isinstance(sources, int):
        yield rows
        store = folder / "rows"
        command = CommandLine(folder, "rows")
        read = lambda _: of_array(np.asarray(voxflat.open_rows(store)))  # noqa: E731
        yield command.run(source, [], given, ["--store", store, "--sources", sources], read)
        return
    yield rows if rows.refusal is not None else of_array(rows.uv.min(axis=0))
    if source == "mesh" and given.keys() <= {"geodesic"}:
        method = {"method": given["geodesic"]} if "geodesic" in given else {}
        yield tried(lambda: dataset(source).voxflat.geodesic(sources, **method)["geodesic_distance"])
        measured = filtered(lambda: voxflat.vtk.SurfaceGeodesic(sources=sources, **method), source)
        yield measured if isinstance(measured, Outcome) else of_array(measured["geodesic_distance"])


def paths(source, folder, given):
    """Return the points of a path."""
    stops = given.pop("stops", [0, MIDDLE] if source == "mesh" else [(2, 2, 5), (5, 5, 5)])
    words = [",".join(map(str, one)) if isinstance(one, tuple) else str(one) for one in stops]
    yield tried(lambda: composed.path(SOURCES[source], *stops, **given).points)
    command = CommandLine(folder, "path")
    yield command.run(source, words, given, ["--json"], lambda text: of_array(json.loads(text)["points"]))
    if source == "mesh" and len(stops) > 1 and given.keys() <= {"geodesic"}:
        method = {"method": given.get("geodesic", "graph")}
        yield tried(lambda: dataset(source).voxflat.path(*stops, **method).points)


def measures(source, folder, given):
    """Return the measures of a projection of the mesh, or of a map of the labels."""
    surface_of = voxflat.surface(SOURCES[source])
    file = folder / "flat.npz"
    surface_of.flatten(voxflat.methods.Zigelman2002(sources=9)).save(file)
    names = ("relative_error", "stress_1")
    pick = lambda figures: [figures["raw"][name] for name in names]  # noqa: E731
    yield tried(lambda: pick(voxflat.measure(surface_of, file, **given).figures()))
    command = CommandLine(folder, "measure")
    yield command.run(source, [file], given, ["--json"], lambda text: of_array(pick(json.loads(text))))
    if given.keys() <= {"sources", "reference", "seed"}:
        yield tried(lambda: pick(_told(dataset(source).voxflat.measure(file, **given))))


def _told(measured):
    return json.loads(measured.field_data["voxflat"][0])["distortion"]


WORK = {
    "patches": (patches, Surface.patches, {"label": [3, 5], "threshold": [0.5]}),
    "distances": (distances, Surface.geodesic, {"sources": [[MIDDLE], [0, MIDDLE], 3, 0, [10**6], [-1]]}),
    "paths": (paths, Surface.path, {"stops": [[0, LINE[-1]], [0], [0, 10**6], [0, 0]]}),
    "measures": (measures, voxflat.measure, {}),
}


@pytest.mark.parametrize("source", ["mesh", "labels"])
@pytest.mark.parametrize("work", WORK)
def test_options_of_other_work(work, source, tmp_path):
    run, of, more = WORK[work]
    tried_with, found = [{}], []
    hints = get_type_hints(of)
    for name in inspect.signature(of).parameters:
        if name in hints and name not in {"surface", "flat", "stops", "store", "dask", *RUN}:
            tried_with += [{name: value} for value in suggested(of, name, hints[name])]
    tried_with += [
        {name: value} for name, values in more.items() for value in values if source == "mesh" or name != "stops"
    ]
    for number, given in enumerate(tried_with):
        folder = tmp_path / str(number)
        folder.mkdir()
        own, *others = run(source, folder, dict(given))
        found += [f"{given}: {one}, but in Python {own}" for one in others if not one.same(own)]
    assert found == []


# ------------------------------------------------------------------------------ files


MESHES = [f"s{ending}" for ending in formats.ENDINGS] + ["lh.white"]
VOLUMES = [f"s{ending}" for ending in READERS if ending != ".img"]  # which is half of a pair
OF_PYVISTA = (".vtk", ".vtp", ".ply", ".stl", ".obj")


def written(path):
    """Write the mesh or the labels by another package."""
    of, labels = mesh(), SOURCES["labels"]
    if path.name in VOLUMES:
        affine = np.array([[-2.0, 0, 0, 9], [0, 2, 0, -7], [0, 0, 2, 5], [0, 0, 0, 1]])
        if path.suffix in (".npy", ".npz"):
            (np.save if path.suffix == ".npy" else np.savez)(path, labels)
        elif path.suffix in (".nrrd", ".nhdr", ".mha", ".mhd"):
            itk.imwrite(itk_image(labels, np.diag([1.0, -1, 1]), (2.0, 2.0, 2.0), (-9.0, 7.0, 5.0)), str(path))
        else:
            kind = (
                nib.MGHImage if path.suffix in (".mgh", ".mgz") else nib.Nifti1Pair if path.suffix == ".hdr" else None
            )
            nib.save((kind or nib.Nifti1Image)(labels, affine), path)
    elif path.suffix in (".stl", ".off", ".glb"):
        trimesh.Trimesh(of.points, of.faces, process=False).export(path)
    elif path.suffix in OF_PYVISTA:
        pv.PolyData.from_regular_faces(of.points, of.faces).save(path)
    elif path.suffix == ".asc":
        rows = [f"{x:.9g} {y:.9g} {z:.9g} 0" for x, y, z in of.points] + [f"{a} {b} {c} 0" for a, b, c in of.faces]
        path.write_text("\n".join(["#!ascii version of s", f"{len(of.points)} {len(of.faces)}", *rows]) + "\n")
    elif path.name == "lh.white":
        nib.freesurfer.write_geometry(path, of.points, of.faces, volume_info=None)
    else:
        arrays = [of.points.astype(np.float32), of.faces.astype(np.int32)]
        codes = ("NIFTI_INTENT_POINTSET", "NIFTI_INTENT_TRIANGLE")
        parts = [nib.gifti.GiftiDataArray(one, intent=code) for one, code in zip(arrays, codes, strict=True)]
        data = nib.gifti.GiftiImage(darrays=parts).to_bytes()
        path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def same_shape(one, other):
    """Return whether two maps are the same up to the rounding of the places in a file or in a window."""
    assert one is not None
    assert (one.refusal, other.refusal) == (None, None), (str(one), str(other))
    return one.uv.shape == other.uv.shape and np.allclose(one.uv, other.uv, atol=1e-3)


@pytest.mark.parametrize("name", [*MESHES, *VOLUMES])
def test_files_of_every_format(name, tmp_path):
    path = written(tmp_path / name)
    own = Python()(path, {})
    assert own.refusal is None
    assert CommandLine(tmp_path)(path, {}).same(own)
    if path.suffix in OF_PYVISTA:
        assert same_shape(PyVista()(path, {}), own)


def test_files_in_the_window(make_napari_viewer, qtbot, tmp_path):
    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    door = Napari(viewer, widget, qtbot)
    manifest = yaml.safe_load((Path(voxflat.__file__).parent / "napari.yaml").read_text())
    patterns = [one for reader in manifest["contributions"]["readers"] for one in reader["filename_patterns"]]
    read = [name for name in [*MESHES, *VOLUMES] if any(fnmatch(name, one) for one in patterns if "npz" not in one)]
    found = {name: (door(path := written(tmp_path / name), {}), Python()(path, {})) for name in read}
    assert [name for name, (one, own) in found.items() if not same_shape(one, own)] == []
    assert len(found) > 12


def content(path):
    """Return what a file holds besides the record of how it was made: its bytes or, for archives, its arrays."""
    if path.suffix in (".npz", ".voxflat"):
        with np.load(path) as found:
            return {name: found[name].tobytes() for name in found.files if found[name].dtype.kind in "iufb"}
    return re.sub(rb"(?s)<MetaData>.*?</MetaData>", b"", path.read_bytes())


@pytest.mark.parametrize("source", ["mesh", "labels"])
def test_files_of_maps_written_by_every_door(source, make_napari_viewer, qtbot, tmp_path):
    viewer = make_napari_viewer()
    _, widget = viewer.window.add_plugin_dock_widget("voxflat", "Flatten surface")
    door = Napari(viewer, widget, qtbot)
    assert door(source, {}).refusal is None
    (layer, *_) = [layer for layer in viewer.layers if layer.metadata.get("voxflat") is not None]
    CommandLine(tmp_path)(source, {})
    surface_file = tmp_path / ("mesh.vtp" if source == "mesh" else "labels.npy")
    flat_map = voxflat.flatten(SOURCES[source])
    for ending in MAP_ENDINGS:
        files = {name: tmp_path / f"{name}{ending}" for name in ("python", "command", "napari")}
        viewer.layers.selection = {layer}
        if source == "labels" and ending in FLAT_PATCH_ENDINGS:  # which hold numbers of vertices
            with pytest.raises(voxflat.InputError, match="patch files hold vertex numbers"):
                flat_map.save(files["python"])
            assert command("flatten", surface_file, "-o", files["command"]).exit_code == 1
            with pytest.raises(voxflat.VoxflatError, match="patch files hold vertex numbers"):
                viewer.layers.save(str(files["napari"]), selected=True, plugin="voxflat")
            assert not any(path.exists() for path in files.values())
            continue
        flat_map.save(files["python"])
        assert command("flatten", surface_file, "-o", files["command"]).exit_code == 0
        assert viewer.layers.save(str(files["napari"]), selected=True, plugin="voxflat") == [str(files["napari"])]
        held = {name: content(path) for name, path in files.items()}
        assert held["python"] == held["command"], ending
        assert held["python"] == held["napari"], ending


def test_the_table_is_complete():
    outcomes = in_python().values()
    maps = sum(one.refusal is None for one in outcomes)
    assert maps > 60
    assert len(outcomes) - maps > 60
    assert SOURCES.keys() == {source for name in NAMES for source, _ in cases(name)}
