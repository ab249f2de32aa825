"""Calls of the public API with right values, and with wrong values of every kind."""

import inspect
from pathlib import Path

import numpy as np
from fuzz_files import N, grid, odd_array, sheet

import voxflat
from voxflat import figures, io
from voxflat.io.volumes import write_volume

_LEFT_OUT = {"progress", "dask", "self"}
_PATHS = ["out", *(f"out.{ending}" for ending in ("npz", "vtp", "surf.gii", "png", "json", "nii.gz", "svg"))]
_PATHS += ["missing/out.npz"]

DRAWING = {"voxflat.figures.patch_3d", "voxflat.figures.atlas_3d"}  # a hundred times slower: they render in 3D
SELDOM = 20  # rounds over all calls per call of these

ODD = [None, True, 0, 1, -1, 3, 2**31, 2**64, -(2**63), 10**30, 0.5, -0.5, 1e-300, 1e19, 1e107, float("nan")]
ODD += [float("inf"), 1j, "", "x", "1", "../x", "a\0b", "\ud800", b"x", "x" * 300, [], (), {}, [[]], [1, [2, 3]]]
ODD += [[None], ["a"], {"a": 1}, {1, 2}, object(), int, range(3), np.float32(1), np.datetime64("2020-01-01")]
ODD += [np.zeros(0), np.zeros((0, 3)), np.zeros((3, 0)), np.full(3, np.nan), np.array("x"), np.array([None])]
ODD += [np.zeros(3), np.ma.masked_array([1.0, 2.0], [True, False]), np.arange(4), np.ones((2, 2, 2))]
ODD += [np.eye(4) * np.nan, Path("x")]


def calls(folder):
    """Return the functions and methods by name, and right values of their parameters by name."""
    surface = voxflat.surface(sheet())
    mesh = (grid().points, grid().faces)
    of_mesh = voxflat.surface(mesh)
    method = voxflat.methods.Voxflat(sources=9)
    flat_map, of_mesh_map = (voxflat.flatten(one, method=method) for one in (surface, of_mesh))
    atlas = surface.patches(bound=1.2)
    write_volume(folder / "v.nii", sheet(), np.eye(4))
    io.write_mesh(folder / "s.surf.gii", grid())
    flat_map.save(folder / "map.npz")
    atlas.save(folder / "atlas.npz")
    surface.geodesic(9, store=folder / "store")
    made = {"surface": surface, "of_mesh": of_mesh, "map": flat_map, "of_mesh_map": of_mesh_map}
    made |= {"atlas": atlas, "glued": atlas.glue(), "page": atlas.page()}
    made |= {"cut": voxflat.surface(of_mesh).cut(relax=False), "rows": surface.geodesic(9)}
    made |= {"image": flat_map.heat_map(), "images": flat_map.images(np.ones((*sheet().shape, 2)))}
    made |= {"regions": flat_map.regions({"a": flat_map.uv.mean(axis=0) + np.array([[-2, -2], [2, -2], [0, 2]])})}
    made |= {"textured": flat_map.textured(np.zeros((4, 4, 3), np.uint8))}
    made |= {"comparison": voxflat.compare(of_mesh, {"a": of_mesh_map}, sources=9), "distortion": flat_map.distortion}
    found = {}
    for module in (voxflat, io, figures):
        for name in module.__all__:
            one = getattr(module, name)
            if callable(one) and (module is io or not isinstance(one, type)):
                found[f"{module.__name__}.{name}"] = one
    for name, value in made.items():
        for method, one in inspect.getmembers(type(value), inspect.isfunction):
            if not method.startswith("_"):
                found[f"{name}.{method}"] = getattr(value, one.__name__)
    for name in ("with_core", "_with_provenance", "atomic_path", "index", "count", "has_triangles", "merged_in"):
        found = {label: one for label, one in found.items() if not label.endswith("." + name)}
    return found, _values(folder, made, mesh)


def _values(folder, made, mesh):
    volume, points = sheet(), made["of_mesh_map"].uv
    any_surface = [made["surface"], made["of_mesh"], volume, mesh, folder / "v.nii", folder / "s.surf.gii"]
    picture = np.zeros((5, 4, 3), np.uint8)
    values = {"surface": any_surface, "source": any_surface, "obj": [volume, folder / "v.nii"]}
    values |= {"method": ["voxflat", "grossmann2002", "zigelman2002", "schwartz1989", "saucan2006"], "label": [1]}
    values |= {"threshold": [0.5], "spacing": [(1, 1, 2), 1.0], "affine": [np.eye(4), np.diag([1, 1, 2, 1])]}
    values |= {"seed_point": [(3, 3, 2), 9], "radius": [4.0, 12.0]}
    values |= {"cuts": ["automatic", [[0, 1, 2]], [[(0, 3, 2), (1, 3, 2)]]], "relax": [False, True, 0.1]}
    values |= {"adapt": [10.0], "sources": [9, 20, [0, 5, 60], [(0, 0, 2), (7, 7, 2), (0, 7, 2)]]}
    values |= {"sampling": ["farthest", "random"], "geodesic": ["graph", "exact", "fast-marching"]}
    values |= {"link_lengths": ["euclidean"], "bound": [1.5], "seed": [0, 7], "threads": [1, 2]}
    values |= {"memory_limit": [10**8, 10**9], "store": [folder / "new"], "repair": ["none", "smallest"]}
    values |= {"sheet": [True, False], "max_angle": [30.0], "count": [2], "seeds": ["curvature", "farthest"]}
    values |= {"flat": [made["map"], made["of_mesh_map"], points, folder / "map.npz"]}
    values |= {"maps": [{"a": made["map"]}, {"a": made["of_mesh_map"], "b": points}], "reference": ["exact", "graph"]}
    values |= {"depth": [0.0, 1.0, np.zeros((9, 9)) + np.arange(9), [0.0, 1.0]], "mask": [np.ones((9, 9), bool)]}
    values |= {"volume": [volume, np.ones(N), folder / "v.nii", np.ones((*volume.shape, 2))], "pixel_size": [1.0, 0.5]}
    values |= {"channel": [0, "a"], "interpolation": ["linear", "nearest"], "period": [3.0], "time_step": [1.0]}
    values |= {"fraction": [0.5], "layering": ["equivolume", "equidistant"], "places": [points[:3], [[0.0, 0.0]]]}
    values |= {"points": [np.zeros((3, 3)), N, grid().points], "faces": [grid().faces], "vertices": [np.arange(9)]}
    values |= {"n": [N], "values": [np.ones(N), np.ones((N, 2))], "picture": [picture, np.zeros((5, 4))]}
    values |= {"texel_size": [1.0], "rois": [{"a": points[:4]}, np.ones(np.shape(made["image"].data), np.uint8)]}
    values |= {"mesh": [grid()], "data": [volume], "ids": [[0, 1], [(0, 0, 2)], 3], "place": [(0, 0, 2)]}
    values |= {"atlas": [made["atlas"], made["glued"]], "flat_map": [made["map"], made["of_mesh_map"]]}
    values |= {"overwrite": [True], "sidecar": [True, False], "tolerance": [16.0]}
    files = [folder / name for name in ("map.npz", "atlas.npz", "store", "v.nii", "s.surf.gii")]
    values["path"] = [*_PATHS, *files, *(folder / name for name in ("lh.white", "p.patch.flat"))]
    return values


def arguments(one, values, chance):
    """Choose the arguments of a function; `values` contains right ones by parameter."""
    given = {}
    for name, parameter in inspect.signature(one).parameters.items():
        if name in _LEFT_OUT or parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            continue
        is_needed = parameter.default is parameter.empty
        if not is_needed and chance.random() > 0.2:
            continue
        right = values.get(name)
        if right and chance.random() < (0.75 if is_needed else 0.5):
            given[name] = chance.choice(right)
        elif right and chance.random() < 0.5:
            given[name] = _spoiled(chance.choice(right), chance)
        else:
            given[name] = chance.choice(ODD)
        if isinstance(given[name], Path) and name == "path" and chance.random() < 0.2:
            given[name] = str(given[name])
    return given


def _spoiled(value, chance):
    """Return a value similar to a right one, but wrong somewhere."""
    if isinstance(value, np.ndarray):
        return odd_array(value, chance)
    if isinstance(value, dict):
        return {key: _spoiled(one, chance) for key, one in value.items()}
    if isinstance(value, tuple | list) and len(value):
        at = chance.randrange(len(value))
        return type(value)([*value[:at], _spoiled(value[at], chance), *value[at + 1 :]])
    if isinstance(value, bool):
        return chance.choice((None, 0, 1, "yes", np.bool_(value)))
    if isinstance(value, int | float):
        return chance.choice((-value, value * 1e9, value + 0.5, str(value), [value], np.float64(value), 10**25, None))
    return chance.choice(ODD)


def told(label, given):
    """Return a call as text."""
    shown = ", ".join(f"{name}={' '.join(repr(value).split())[:90]}" for name, value in given.items())
    return f"{label}({shown})".encode("ascii", "backslashreplace").decode()
