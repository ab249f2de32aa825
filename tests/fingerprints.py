"""Record or compare all numeric results of voxflat, which a restructuring must not change.

    make fingerprints              # beside the merge base with main
    make fingerprints BASE=v0.1.0  # beside another commit

Both versions run on the same machine, because machines may round differently in NumPy, SciPy and the mathematical
library.

The cases use the public names, the command line, PyVista's accessor, and napari's jobs without a window. An array is
recorded as the first 16 digits of a SHA-256 of its shape and bytes (integers as int64), and a number as Python prints
it, which is exact. Text and None are not recorded.

A quantity with a new name and the same value is reported, but does not count as a difference.
"""

import argparse
import dataclasses
import hashlib
import importlib
import json
import logging
import os
import pkgutil
import sys
import tempfile
import time
import warnings
from functools import cache, partial
from itertools import chain
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
os.environ.setdefault("MPLBACKEND", "Agg")

import composed
import nibabel
import numpy as np
import pyvista
from command_line import succeed
from hard_shapes import sheet
from mesh_files import fsaverage5
from PIL import Image
from scipy.spatial.transform import Rotation

import voxflat
from voxflat.methods import Grossmann2002, Saucan2006, Schwartz1989, Voxflat, Zigelman2002

DATA = Path(__file__).resolve().parent / "data"
HOW = {"provenance", "memory_need_bytes", "napari", "sampling", "seed", "sources"}
HOW |= {"store", "versions", "warnings", "input"}
"""Metadata about how a map was made."""

CASES = {}


def case(function):
    """Register a function that returns named quantities."""
    CASES[function.__name__.replace("_", " ")] = function
    return function


def main():
    """Compute the fingerprints, then write or compare them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="write the fingerprints to this file instead of stdout")
    parser.add_argument("--against", type=Path, metavar="FILE", help="compare with this file; fail on a difference")
    parser.add_argument("--threads", type=int, help="number of threads; one per core by default")
    parser.add_argument("--only", default="", metavar="TEXT", help="run only the cases whose name contains TEXT")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    print(f"voxflat: {Path(voxflat.__file__).parent}", file=sys.stderr)
    found = {}
    for name, function in CASES.items():
        if options.only in name:
            start = time.perf_counter()
            with tempfile.TemporaryDirectory() as place:
                found[name] = fingerprints(function, options.threads, Path(place))
            print(f"{time.perf_counter() - start:7.1f} s  {len(found[name]):4}  {name}", file=sys.stderr)
    print(f"{sum(map(len, found.values()))} quantities of {len(found)} cases", file=sys.stderr)
    if options.output is not None or options.against is None:
        text = json.dumps(found, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
        sys.stdout.write(text) if options.output is None else options.output.write_text(text, encoding="utf-8")
    if options.against is not None:
        before = json.loads(options.against.read_text(encoding="utf-8"))
        before.pop("made with", None)  # in records of older versions
        sys.exit(compare({name: of for name, of in before.items() if options.only in name}, found))


def fingerprints(function, threads, place):
    """Return the quantities of a case as text, or its error."""
    try:
        return dict(sorted(flat(function(threads, place)).items()))
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}".replace(str(place), "...")}


def compare(before, after):
    """Print the differences, and return whether there are any."""
    differs = 0
    for name in sorted(before.keys() | after.keys()):
        old, new = before.get(name, {}), after.get(name, {})
        gone = {key: value for key, value in old.items() if key not in new}
        come = {key: value for key, value in new.items() if key not in old}
        lines = [f"  {key}: {old[key]} -> {new[key]}" for key in old if key in new and old[key] != new[key]]
        for key, value in gone.items():
            other = next((other for other, found in come.items() if found == value), None)
            if other is None:
                lines.append(f"  {key}: {value} -> missing")
            else:
                del come[other]
                print(f"{name}: {key} is now called {other}", file=sys.stderr)
        for key in come:
            print(f"{name}: {key} is new", file=sys.stderr)
        if lines:
            print("\n".join([name, *lines]))
        differs += len(lines)
    print(f"{differs} quantities differ")
    return int(differs > 0)


# -------------------------------------------------------------------------------------------- quantities


def flat(value, name=""):
    """Return all numbers and arrays in a value as text, by dotted names."""
    if isinstance(value, bool | np.bool_):
        return {name: str(value)}
    if isinstance(value, int | float | np.number):
        return {name: repr(value.item() if isinstance(value, np.number) else value)}
    if isinstance(value, np.ndarray):
        return {name: digest(value)} if value.dtype.kind in "biuf" else {}
    if isinstance(value, list | tuple):
        try:
            array = np.asarray(value)
        except ValueError:  # lists of different lengths
            array = np.empty(0, dtype=object)
        if array.dtype.kind in "biuf":
            return {name: digest(array)}
        items = enumerate(value)
    elif isinstance(value, dict):
        items = value.items()
    elif dataclasses.is_dataclass(value):
        names = ["metadata" if field.name == "details" else field.name for field in dataclasses.fields(value)]
        items = ((name, getattr(value, name)) for name in names if name[0] != "_" and name != "record")
        items = ((key, of_the_map(item) if key == "metadata" else item) for key, item in items)
    else:
        return {}
    items = ((key, item) for key, item in items if key != "provenance")
    found = dict(chain.from_iterable(flat(item, f"{name}.{key}".strip(".")).items() for key, item in items))
    if name.endswith("standard_error"):  # many: recorded together
        return {name: digest(np.sort([float(number) for number in found.values()]))}
    return found


def of_the_map(metadata):
    return {key: value for key, value in metadata.items() if key not in HOW}


def digest(array):
    """Return a hash of the shape and the numbers of an array, with a single kind of NaN."""
    array = np.array(array, order="C")
    if array.dtype.kind in "biu":
        array = array.astype(np.int64)
    else:
        array[np.isnan(array)] = np.nan
    return hashlib.sha256(f"{array.dtype.str} {array.shape}".encode() + array.tobytes()).hexdigest()[:16]


def arrays_of(path):
    """Return the arrays of an .npz file or a GIFTI surface."""
    if path.suffix == ".gii":
        return {str(n): array.data for n, array in enumerate(nibabel.load(path).darrays)}
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def of_polydata(mesh):
    return {
        "points": np.asarray(mesh.points),
        "faces": mesh.regular_faces,
        "point data": {name: np.asarray(mesh.point_data[name]) for name in mesh.point_data},
        "cell data": {name: np.asarray(mesh.cell_data[name]) for name in mesh.cell_data},
    }


def taken(value, *names):
    """Return these attributes of a value, None where it lacks one, so that a renamed one is reported."""
    return {name: getattr(value, name, None) for name in names}


def of_surface(surface):
    names = ("points", "faces", "vertices", "ids", "thickness", "voxel_size")
    return taken(surface, *names) | {"metadata": of_the_map(surface.metadata)}


def of_atlas(atlas):
    """Return an atlas, its pieces and its page."""
    pieces = list(atlas)
    names = {"face_ids": "face_ids", "faces": "faces", "vertices": "vertex_ids", "uv": "uv"}
    joined = {key: np.concatenate([getattr(piece, name) for piece in pieces]) for key, name in names.items()}
    derived = taken(atlas, "normals", "isometric", "quasi_conformal", "areal")
    return {"atlas": atlas, "figures": atlas.figures(), "derived": derived, "pieces": joined, "page": of_page(atlas)}


def of_page(atlas, volume=None):
    """Return the page of an atlas, and the images drawn on it."""
    page = atlas.page()
    width, height = page.uv.max(axis=0)
    return {
        "places": page.uv,
        "gap": page.gap,
        "use": page.used_share,
        "raster": page.raster(),
        "locate": page.locate(),
        "look_up": page.look_up(lattice((0, 0), (width, height))),
        "heat_map": [page.heat_map(of=of).data for of in ("isometric", "quasi_conformal", "areal")],
        "numbers": page.label_image(),
        "textured": page.textured(page.heat_map(), colour_map="inferno"),
        **({} if volume is None else {"image": page.image(volume)}),
    }


def lattice(low, high):
    u, v = (np.linspace(low[k], high[k], 41) for k in range(2))
    return np.stack(np.meshgrid(u, v), axis=-1)


def of_map(flat_map, *volumes, **sampling):
    """Return a map, and the images and values drawn on it."""
    textured = flat_map.textured(picture())
    found = {
        "map": flat_map,
        "spacing": flat_map.spacing,
        "raster": flat_map.raster(),
        "heat_map": flat_map.heat_map(),
        "locate": flat_map.locate(1.5 * flat_map.spacing),
        "look_up": flat_map.look_up(lattice(flat_map.uv.min(axis=0), flat_map.uv.max(axis=0))),
        "texture": flat_map.texture(picture()[..., 0].astype(float)),
        "textured": textured,
        "colours": textured.colours,
        "images": [flat_map.image(volume, **sampling) for volume in volumes],
    }
    if flat_map.is_voxels:
        found["paint"] = flat_map.paint(flat_map.distortion.per_point)
    return found


# ------------------------------------------------------------------------------------------------ inputs


@cache
def picture():
    row, column = np.mgrid[:60, :90]
    return np.stack([3 * row, 2 * column, 40 + (row * column) % 97], axis=-1).astype(np.uint8)


@cache
def curled_sheet(length=56.0, width=34.0, turns=0.7):
    """Return a curled and rotated sheet of voxels, one voxel thick."""
    along, across = np.linspace(0, 1, int(24 * length)), np.linspace(0, width, int(24 * width))
    angle = 2 * np.pi * turns * along
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    points = (length / (2 * np.pi * turns) * normal)[:, None] + across[None, :, None] * [0, 0, 1]
    turn = Rotation.from_euler("xyz", [20, 35, 50], degrees=True)
    points, normals = turn.apply(points.reshape(-1, 3)), np.repeat(turn.apply(normal), len(across), axis=0)
    points -= points.min(axis=0) - 2
    voxels = np.floor(points).astype(int)
    apart = np.abs(((voxels + 0.5 - points) * normals).sum(axis=1))
    volume = np.zeros(voxels.max(axis=0) + 3, dtype=np.uint8)
    volume[tuple(voxels[apart <= np.abs(normals).max(axis=1) / 2].T)] = 1
    return volume


@cache
def blob():
    """Return a wavy solid with a tunnel and a handle."""
    x, y, z = np.indices((40, 36, 34)) - np.array([19.5, 17.5, 16.5])[:, None, None, None]
    radius = np.sqrt((x / 15) ** 2 + (y / 13) ** 2 + (z / 12) ** 2)
    solid = radius + 0.06 * np.sin(x / 2) * np.cos(y / 2.5) < 1
    solid &= np.hypot(x - 4, y + 3) > 1.5
    return (solid | (np.hypot(np.hypot(x + 3, z - 11) - 4, y) < 1.6)).astype(np.uint8)


@cache
def waves(shape):
    """Return a smooth image of floats that varies everywhere."""
    x, y, z = np.indices(shape)
    return (np.sin(x / 5) + np.cos(y / 7) + np.sin(z / 3 + x / 11)).astype(np.float32)


@cache
def cap():
    grid = np.linspace(-24, 24, 33), np.linspace(-18, 20, 27)
    return sheet(lambda u, v: (u, v, -0.012 * (u**2 + v**2) + np.sin(u / 4) * np.cos(v / 5)), grid)


@cache
def cylinder():
    grid = np.linspace(0, 1.6 * np.pi, 46), np.linspace(0, 30, 24)
    return sheet(lambda u, v: (12 * np.cos(u), 12 * np.sin(u), v + 0.3 * np.sin(3 * u)), grid)


@cache
def face():
    """Return a range image of the face of a bust, every fourth pixel."""
    depth = np.asarray(Image.open(DATA / "demosthenes_depth.png"))[::4, ::4].astype(float)
    return voxflat.range_image(np.where(depth > 0, depth, np.nan), 4.0)


@cache
def cortex(side="left"):
    """Return a hemisphere with its white and pial surfaces."""
    return voxflat.surface(fsaverage5(f"white_{side}"), pial=fsaverage5(f"pial_{side}"))


@cache
def patch_of_cortex(threads):
    return cortex().disk(4000, 30.0).flatten(threads=threads)


def command(*arguments, place, threads=None):
    """Run a voxflat command in a directory, and return its output."""
    home = Path.cwd()
    os.chdir(place)
    try:
        return succeed(*arguments, *(() if threads is None else ("--threads", threads))).stdout
    finally:
        os.chdir(home)


# -------------------------------------------------------------------------------------------------- maps


def layer():
    """Return a volume with a layer of grey matter, from LAYNII."""
    return nibabel.load(DATA / "laynii" / "occipital_midGM.nii.gz").slicer[24:84, 20:80, 28:88]


MARCHING = {"geodesic": "marching", "weighting": 0.2, "sampling": "curvature", "sources": 120, "seed": 3}
MARCHING |= {"affine": np.array([[0, -0.9, 0, 5], [1.1, 0, 0, -7], [0, 0, 1.3, 11], [0, 0, 0, 1]])}
EXACT = {"geodesic": "exact", "weighting": 1.0, "sampling": "random", "sources": 60, "seed": 7}
GROSSMANN = {"link_lengths": "euclidean", "sampling": "random", "sources": 300, "seed": 5, "radius": 17.0}
GROSSMANN |= {"method": "grossmann2002", "spacing": (0.8, 1.0, 1.3)}
ZIGELMAN = {"method": "zigelman2002", "sampling": "farthest", "sources": 150, "seed": 2}
SCHWARTZ = {"method": "schwartz1989", "neighbourhood": "all", "starts": 2, "sources": 0, "seed": 11}
CHAINS = {"method": Grossmann2002(sources=400), "rows": True}
MAPS = {
    "voxflat by marching": lambda: (curled_sheet(), MARCHING),
    "voxflat by exact distances": lambda: (cap(), EXACT, cap()[0][:, 2]),
    "grossmann2002 by chain codes": lambda: (curled_sheet(), CHAINS, curled_sheet(), waves(curled_sheet().shape)),
    "grossmann2002 of a patch": lambda: (blob(), GROSSMANN | {"seed_point": tuple(np.argwhere(blob())[0].tolist())}),
    "zigelman2002 from far sources": lambda: (cortex(), ZIGELMAN | {"seed_point": 4000, "radius": 25.0}),
    "schwartz1989 by all distances": lambda: (cortex(), SCHWARTZ | {"seed_point": 4000, "radius": 14.0}),
    "voxflat of grey matter": lambda: (layer(), {"label": 1, "seed_point": (29, 29, 29), "radius": 22.0}, layer()),
    "zigelman2002 by decimation": lambda: (cylinder(), {"method": Zigelman2002(sources=250), "rows": True}),
    "schwartz1989 in neighbourhoods": lambda: (cap(), {"method": Schwartz1989(starts=2), "rows": True}),
    "saucan2006 of a mesh": lambda: (cap(), {"method": Saucan2006(bound=1.4)}),
    "saucan2006 of voxels": lambda: (curled_sheet(), {"method": Saucan2006(bound=2.0), "seed": 1}),
}
"""Maps of one source: the source, options, and volumes or values that the map samples."""


def made(make, threads, place):
    source, options, *volumes = make()
    return of_map(composed.flatten(source, threads=threads, **options), *volumes)


CASES |= {name: partial(made, make) for name, make in MAPS.items()}


@case
def voxflat_of_a_sheet_of_voxels(threads, place):
    volume = curled_sheet()
    flat_map = voxflat.surface(volume, spacing=(0.7, 0.7, 0.7)).flatten(rows=True, threads=threads)
    colours = np.stack([waves(volume.shape) * 40 + 100] * 3, axis=-1).astype(np.uint8)
    return of_map(flat_map, volume, waves(volume.shape), colours, depth=0.6)


@case
def voxflat_from_given_sources(threads, place):
    method = Voxflat(sources=np.arange(0, 1100, 13))
    found = voxflat.flatten(cylinder(), method=method, rows=place / "rows", threads=threads)
    rows = voxflat.open_rows(place / "rows")
    rows.verify()
    return {**of_map(found), "stored": rows}


@case
def voxflat_of_a_repaired_solid(threads, place):
    whole = voxflat.surface(blob(), spacing=(1, 1, 1), repair="voxels", threads=threads)
    found = of_map(voxflat.flatten(whole, threads=threads), waves(blob().shape), depth=-0.5, pixel_size=0.7)
    return {**found, "surface": of_surface(whole), "changed": whole.changed_voxels()}


@case
def voxflat_of_a_solid_cut_open(threads, place):
    whole = voxflat.surface(blob(), probability=waves(blob().shape) * 0.02 + blob(), repair="cuts", threads=threads)
    opened = whole.cut(relax=15.0, threads=threads)
    part = {"seed_point": tuple(whole.ids[0].tolist()), "radius": 14.0}
    found = composed.flatten(whole, threads=threads, **part)
    cuts = [{"ids": cut.ids, "length": cut.length} for cut in opened.cuts]
    return {**of_map(found), "surface": of_surface(whole), "cut": of_surface(opened.surface), "cuts": cuts}


@case
def voxflat_of_a_hemisphere(threads, place):
    flat_map = cortex().drop("medial wall").flatten(Voxflat(sources=100), relax=False, threads=threads)
    return of_map(flat_map, fsaverage5("sulc_left"), pixel_size=1.0)


@case
def voxflat_along_given_cuts(threads, place):
    right = cortex("right")
    rim = voxflat.surface(right).geodesic([4000], threads=threads).rows[0]
    ends = [int(np.abs(rim - far).argmin()) for far in (12.0, 20.0, 28.0)]
    cuts = [voxflat.surface(right).path(ends[0], *ends[1:], geodesic="edges").ids]
    corners = voxflat.surface(right).find([100, 2000, 5000, 9000]).tolist()
    polygon = voxflat.surface(right).polygon(corners).geodesic(40, threads=threads)
    part = {"seed_point": 4000, "radius": 45.0, "cuts": cuts, "relax": True}
    flat_map = composed.flatten(right, sources=100, threads=threads, **part)
    return {**of_map(flat_map), "cuts": cuts, "polygon": polygon}


@case
def zigelman2002_on_a_grid(threads, place):
    found = of_map(voxflat.flatten(face(), method=Zigelman2002(sources=300, sampling="grid"), threads=threads))
    return {**found, "surface": of_surface(face())}


# ----------------------------------------------------------------------------- atlases, distances, evaluation


@case
def patches_of_a_skull(threads, place):
    atlas = voxflat.surface(DATA / "skull.ply").patches(threads=threads)
    atlas.save(place / "atlas.npz")
    loaded = voxflat.load_atlas(place / "atlas.npz")
    return {**of_atlas(atlas), "loaded": loaded, "shapes": atlas.layout(packing="shapes")}


@case
def patches_of_voxels(threads, place):
    found = {}
    for seeds, limit in (("curvature", {"count": 60}), ("flattest", {"bound": 1.3}), ("random", {"max_angle": 25.0})):
        atlas = composed.patches(blob(), seeds=seeds, seed=4, spacing=(1, 1, 1), threads=threads, **limit)
        found[seeds] = {"atlas": atlas, "figures": atlas.figures(), "page": of_page(atlas, waves(blob().shape))}
    return found


@case
def patches_glued(threads, place):
    atlas = voxflat.surface(DATA / "skull.ply").patches(max_angle=15.0, threads=threads).glue(1.6, threads=threads)
    atlas.save(place / "glued.npz")
    overlay = atlas.image(np.arange(5154.0) % 100, pixel_size=0.5 * atlas.page().pixel_size)
    loaded = voxflat.load_atlas(place / "glued.npz")
    return {**of_atlas(atlas), "seams": taken(atlas, "outline", "cuts"), "loaded": loaded, "image": overlay}


@case
def distances(threads, place):
    found = {
        name: voxflat.surface(cap()).geodesic(40, geodesic=name, sampling=sampling, seed=6, threads=threads)
        for name, sampling in (("graph", "farthest"), ("marching", "curvature"), ("exact", "random"))
    }
    found["chain"] = voxflat.surface(blob()).geodesic(30, geodesic="chain", threads=threads)
    curled = voxflat.surface(curled_sheet())
    found["sheet"] = curled.geodesic(curled.ids[::60], threads=threads)
    found["stored"] = cortex().drop("medial wall").geodesic(50, store=place / "rows", threads=threads)
    return found


@case
def paths(threads, place):
    found = {name: cortex().path(4000, 300, 8000, geodesic=name) for name in ("graph", "marching", "exact", "edges")}
    voxels = voxflat.surface(blob(), spacing=(1, 1, 1)).ids
    stops = [voxels[k].tolist() for k in (0, len(voxels) // 2, -1)]
    found["chain"] = voxflat.surface(blob()).path(*stops, geodesic="chain")
    found["chain euclidean"] = voxflat.surface(blob()).path(*stops, geodesic="chain", link_lengths="euclidean")
    return found


@case
def judgements(threads, place):
    """Evaluate a map beside the one that fsaverage5 includes, and maps of voxels."""
    ours = patch_of_cortex(threads)
    maps = {"ours": ours, "shipped": fsaverage5("flat_left")}
    how = {"sources": 40, "seed": 8, "threads": threads}
    voxels = voxflat.surface(curled_sheet(), spacing=(1, 1, 1)).flatten(Voxflat(sources=50), threads=threads)
    return {
        "together": voxflat.compare(cortex(), maps, **how),
        "alone": voxflat.measure(cortex(), ours, reference="graph", **how),
        "voxels": voxflat.measure(voxflat.surface(curled_sheet(), spacing=(1, 1, 1)), voxels, **how),
    }


@case
def checks(threads, place):
    return {
        "solid": voxflat.check(blob(), spacing=(1, 1, 1)),
        "sheet": voxflat.check(curled_sheet(), spacing=(1, 1, 1)),
        "part": voxflat.check(cortex(), part=lambda s: s.disk(4000, 30.0)),
        "skull": voxflat.check(DATA / "skull.ply"),
    }


# ---------------------------------------------------------------------------------------- other interfaces


@case
def saved_and_loaded(threads, place):
    flat_map = patch_of_cortex(threads)
    for name in ("map.npz", "map.surf.gii", "map.patch.flat"):
        flat_map.save(place / name)
    pyvista_mesh = {}
    for name in ("map.vtp", "map.ply", "map.obj"):
        flat_map.save(place / name)
        mesh = pyvista.read(place / name)
        pyvista_mesh[name] = {"points": np.asarray(mesh.points), "faces": mesh.regular_faces}
    return {
        **of_map(voxflat.load(place / "map.npz"), fsaverage5("sulc_left")),
        "npz": arrays_of(place / "map.npz"),
        "gii": arrays_of(place / "map.surf.gii"),
        "patch": np.frombuffer((place / "map.patch.flat").read_bytes(), dtype=np.uint8),
        "meshes": pyvista_mesh,
    }


@case
def command_line_of_a_volume(threads, place):
    """Follow the README: flatten the white matter of the MNI152 template, and draw T1 and the distortion on the map."""
    from nilearn import datasets

    nibabel.save(datasets.load_mni152_wm_template(resolution=1), place / "wm.nii")
    nibabel.save(datasets.load_mni152_template(resolution=1), place / "t1.nii")
    how = ("--threshold", "0.5", "--repair", "voxels", "--seed-point", "136,112,127", "--radius", "45")
    making = ("flatten", "wm.nii", *how, "--json", "--quiet", "-o", "map.npz")
    told = command(*making, place=place, threads=threads)
    command("image", "map.npz", "--volume", "t1.nii", "--depth", "2", "-o", "t1.png", place=place)
    command("image", "map.npz", "--volume", "t1.nii", "--pixel-size", "0.8", "-o", "t1.npy", place=place)
    command("image", "map.npz", "--heat-map", "-o", "distortion.png", place=place)
    return {
        "npz": arrays_of(place / "map.npz"),
        "json": of_the_map(json.loads(told)),
        **{name: np.asarray(Image.open(place / name)) for name in ("t1.png", "distortion.png")},
        "t1.npy": np.load(place / "t1.npy"),
    }


@case
def command_line_of_meshes(threads, place):
    white, pial, flat = (fsaverage5(f"{kind}_left") for kind in ("white", "pial", "flat"))
    making = (white, "--pial", pial)
    patch, there = ("--seed-point", "4000", "--radius", "50"), {"place": place, "threads": threads}
    command("cut", *making, *patch, "--relax-length", "50", "-o", "cuts.json", **there)
    how = (*patch, "--cuts", "cuts.json", "--sources", "150")
    command("flatten", *making, *how, "-o", "lh.flat.surf.gii", **there)
    judging = ["measure", *making, "lh.flat.surf.gii", flat, "--sources", "30", "--reference", "graph", "--json"]
    judged = command(*judging, "--heat-maps", "maps.png", **there)
    traced = command("path", *making, "4000", "300", "--geodesic", "exact", "--json", place=place)
    command("rows", white, "--sources", "30", "--store", "rows", "--geodesic", "marching", **there)
    return {
        "cuts": json.loads((place / "cuts.json").read_text()),
        "map": arrays_of(place / "lh.flat.surf.gii"),
        "judged": json.loads(judged),
        "pictures": np.asarray(Image.open(place / "maps.png")),
        "path": json.loads(traced),
        "rows": voxflat.open_rows(place / "rows"),
    }


@case
def command_line_of_patches(threads, place):
    np.save(place / "blob.npy", blob())
    np.save(place / "waves.npy", waves(blob().shape))
    how = ("--repair", "voxels", "--spacing", "1,1,1", "--max-angle", "20", "--glue", "1.7", "--json")
    told = command("patches", "blob.npy", *how, "-o", "glued.npz", place=place, threads=threads)
    command("image", "glued.npz", "--heat-map", "-o", "c.npy", place=place)
    command("image", "glued.npz", "--volume", "waves.npy", "-o", "waves.tif", place=place)
    checked = command("check", "blob.npy", "--spacing", "1,1,1", "--json", place=place)
    command("surface", "blob.npy", "--repair", "voxels", "-o", "blob.surf.gii", place=place)
    answer = json.loads(told)
    return {
        "npz": arrays_of(place / "glued.npz"),
        "json": {**answer, "metadata": of_the_map(answer["metadata"])},
        "heat_map": np.load(place / "c.npy"),
        "image": np.asarray(Image.open(place / "waves.tif")),
        "check": json.loads(checked),
        "surface": arrays_of(place / "blob.surf.gii"),
    }


@case
def pyvista_accessor(threads, place):
    image = pyvista.ImageData(dimensions=blob().shape, spacing=(1.0, 0.9, 1.1), origin=(3, -4, 5))
    image.point_data["labels"] = blob().ravel(order="F")
    image.point_data["waves"] = waves(blob().shape).ravel(order="F")
    image.set_active_scalars("labels")
    points, faces = cap()
    mesh = pyvista.PolyData.from_regular_faces(points, faces)
    mesh.point_data["height"] = points[:, 2]
    mesh.point_data["middle"] = (np.hypot(*points[:, :2].T) < 16).astype(np.uint8)
    corner = image.voxflat.voxel_at(image.points[np.flatnonzero(image.point_data["labels"])[0]])
    solid = image.voxflat.flatten("labels", seed_point=corner, radius=8.0, threads=threads)
    return {
        "solid": of_polydata(image.voxflat.to_polydata(solid)),
        "solid in space": of_polydata(image.voxflat.to_surface_polydata(solid)),
        "image": solid.image(image.voxflat.volume("waves")),
        "mesh": of_polydata(mesh.voxflat(keep="middle", method=Voxflat(sources=80), threads=threads)),
        "page": of_polydata(mesh.voxflat.patches(8.0, glue=1.3, threads=threads)),
    }


@case
def napari_jobs(threads, place):
    """Run the jobs of the widgets' buttons without a window, with one thread per core."""
    from napari.layers import Labels, Surface

    import voxflat._napari

    plugin = {}
    for module in pkgutil.walk_packages(voxflat._napari.__path__, "voxflat._napari."):
        plugin |= vars(importlib.import_module(module.name))
    labels = Labels(curled_sheet(), scale=(0.8, 0.8, 0.9), translate=(4, 5, 6), name="sheet")
    points, faces = cap()
    surface = Surface((points, faces, points[:, 2]), name="cap")
    volume, mesh = plugin["LayerVolume"].of(labels), plugin["LayerMesh"].of(surface)
    jobs = {
        "volume": plugin["Job"](surface=volume, label=1, options={"sources": 90}),
        "mesh": plugin["Job"](surface=mesh, method="zigelman2002", options={"sources": 100}),
        "patches": plugin["PatchesJob"](surface=mesh, limit={"max_angle": 9.0}, glue=1.3),
    }
    results = {}
    for name, job in jobs.items():
        done = job.run(lambda *_: True)
        found = next(value for value in vars(done).values() if dataclasses.is_dataclass(value))
        results[name] = {"map": found, "layers": [data for data, _, _ in done.layers]}
    return results


if __name__ == "__main__":
    main()
