"""Make the flat map, the measures and the record of one hemisphere."""

import logging
import os
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Note, log
from voxflat.errors import InputError
from voxflat.evaluation.measure import measure
from voxflat.io.files import REMEDY, atomic_path, contents, naming
from voxflat.io.formats.freesurfer import read_annot
from voxflat.io.formats.gifti import value_bytes
from voxflat.io.meshes import Mesh, is_mesh_name, read_mesh
from voxflat.io.overlays import read_overlay
from voxflat.io.provenance import portable
from voxflat.io.reading import hash_of
from voxflat.lab.freshness import request, write_json
from voxflat.lab.inputs import Hemisphere, Parameters
from voxflat.lab.overlays import overlay_values
from voxflat.lab.results import Results, read_record, sealed
from voxflat.lab.sidecars import sidecar
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.summary import Summary, summary_of
from voxflat.pipeline.group_map import resampled
from voxflat.pipeline.shapes import Shape
from voxflat.pipeline.surface import Surface, surface
from voxflat.surfaces.cut_sides import one_point_a_vertex

_ON_SURFACE = 0.5  # mm; vertices that were resampled lie on the surface, up to rounding
_PROBABLE = 0.5  # threshold on the probability of white matter
NO_CORTEX = ("unknown", "corpuscallosum", "medial_wall", "???", "medialwall")
"""Labels of aparc.annot outside the cortex."""


def make(hemisphere: Hemisphere, parameters: Parameters, results: Results, **common: Any) -> dict[str, Any]:
    """Flatten a hemisphere, write the results, and return the record; `common`: threads, memory_limit, progress."""
    seconds: dict[str, float] = {}
    with _collecting_warnings() as logged:
        with _timed(seconds, "reading and checksums"):
            asked = request(hemisphere, parameters)
            whole = _surface(hemisphere, parameters, common)
            part, cortex = _part(hemisphere, parameters, whole)
        with _timed(seconds, "flattening and measuring"):
            cuts = str(hemisphere.files.get("cuts", parameters.cuts))
            sphere = registered_sphere(hemisphere.files, parameters.geometry)
            flat_map = part.flatten(cuts=cuts, sphere=sphere, seed=parameters.seed, **common)
        with _timed(seconds, "measuring the template's map"):
            of_template = _of_template(hemisphere, whole, sphere, common)
        with _timed(seconds, "overlays"):
            values = {**_measures(flat_map), **overlay_values(flat_map, hemisphere)}
    with _timed(seconds, "writing"), _collecting_warnings() as of_files:
        written = _write(flat_map, values, results)
    warnings = flat_map.warnings
    notes = [str(warning) for warning in warnings if isinstance(warning, Note)]
    record = {
        **({} if results.of_freesurfer else sidecar(hemisphere)),
        **asked,
        "hemi": hemisphere.letter,
        "overlays": list(hemisphere.overlays),
        "outputs": {path.name: hash_of(path) for path in written},
        **_description(whole, flat_map, cortex, of_template),
        "warnings": [text for text in dict.fromkeys((*warnings, *logged)) if text not in notes],
        "notes": [*notes, *of_files],
        "seconds": seconds,
    }
    write_json(results.record, sealed(record))
    results.failure.unlink(missing_ok=True)
    return record


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[step] = round(time.perf_counter() - start, 2)


@contextmanager
def _collecting_warnings() -> Iterator[list[str]]:
    """Collect warnings instead of logging them; they are printed from the record, with the name of the hemisphere."""
    warnings: list[str] = []

    def take(record: logging.LogRecord) -> bool:
        is_warning = record.levelno >= logging.WARNING
        if is_warning:
            warnings.append(record.getMessage())
        return not is_warning

    log.addFilter(take)
    try:
        yield warnings
    except Exception:
        log.removeFilter(take)
        for warning in warnings:  # there will be no record
            log.warning("%s", warning)
        raise
    finally:
        log.removeFilter(take)


def _surface(hemisphere: Hemisphere, parameters: Parameters, common: dict[str, Any]) -> Surface:
    """Return the surface on which distances are measured."""
    files = hemisphere.files
    if hemisphere.layout.warning and not parameters.volume:
        log.warning("%s", hemisphere.layout.warning)
    if parameters.volume:
        threshold = _PROBABLE if "_probseg." in files["volume"].name else None
        return surface(files["volume"], label=hemisphere.label, threshold=threshold, repair="voxels", **common)
    for name in ("white", "pial", "midthickness", "sphere"):
        if name in files and not is_mesh_name(files[name]):
            size = files[name].stat().st_size
            raise InputError(f"{files[name]} is not a surface ({size} bytes). Run recon-all or sMRIPrep again")
    if parameters.geometry == "midthickness" and "white" in files:
        return surface(files["white"], pial=files["pial"], **common)
    return surface(files[parameters.geometry], **common)


def _part(hemisphere: Hemisphere, parameters: Parameters, whole: Surface) -> tuple[Surface, str]:
    """Return the part to flatten, the cortex, and what defines it; warn if this is not the cortex label."""
    part, basis = whole, "the complete surface" if parameters.cuts == "automatic" else "the cuts file"
    if "cortex" in hemisphere.files:
        return whole.keep(hemisphere.files["cortex"]), "the cortex label"
    if "grayordinates" in hemisphere.files:
        values = read_overlay(hemisphere.files["grayordinates"], whole.count, structure=whole.origin.structure)
        return whole.keep(np.isfinite(values)), "the grayordinates of the CIFTI files"
    if "areas" in hemisphere.files:
        part = whole.drop(_beside_cortex(hemisphere.files["areas"], whole.count))
        basis = "the parcellation (aparc.annot)"
    elif parameters.cuts == "standard":
        basis = "the medial wall of the template"
    elif whole.thickness is not None and parameters.cuts == "automatic":
        part, basis = whole.drop("medial wall"), "the thickness of the cortex"
    if not parameters.volume:
        files = "?h.cortex.label, *_desc-cortex_mask.label.gii or *.atlasroi.32k_fs_LR.shape.gii"
        remedy = "Add the label, or check that this definition is accurate enough"
        log.warning("%s", f"found no cortex label ({files}), so the cortex is defined by {basis}. {remedy}")
    return part, basis


def _beside_cortex(annotation: Path, count: int) -> NDArray[np.bool_]:
    """Return a mask of the vertices that a parcellation of the cortex excludes."""
    with naming(annotation, REMEDY):
        labels, names = read_annot(annotation, contents(annotation))
    if len(labels) != count:
        raise InputError(f"{annotation} has {len(labels)} labels for {count} vertices. Pass the files of one subject")
    others = [n for n, name in enumerate(names) if name.lower() in NO_CORTEX]
    is_beside = (labels < 0) | np.isin(labels, others)
    if is_beside.all():
        raise InputError(f"{annotation}: no vertex has a cortical label. Check the annotation")
    return np.asarray(is_beside)


def _measures(flat_map: FlatMap) -> dict[str, NDArray[np.float64]]:
    """Return the measures at every point of the map."""
    triangles = flat_map.distortion.triangles
    areas = None if triangles is None else triangles.areal
    measures = {"distanceerror": flat_map.distortion.per_point, "areachange": areas}
    measures |= {"curvature": flat_map.curvature, "sulcaldepth": flat_map.sulcal_depth}
    return {name: values for name, values in measures.items() if values is not None}


def _write(flat_map: FlatMap, values: dict[str, NDArray[np.number]], results: Results) -> list[Path]:
    """Write the map and the values of its points, and return the files."""
    results.folder.mkdir(parents=True, exist_ok=True)
    before = _written_before(results)
    results.record.unlink(missing_ok=True)  # from here on it no longer describes the files
    written = [results.map, results.surface]
    if results.of_freesurfer and not flat_map.is_voxels:
        written.append(results.patch)
    for path in written:
        flat_map.save(path)
    structure = flat_map.origin.structure
    rows = None if flat_map.is_voxels else one_point_a_vertex(flat_map.ids, flat_map.faces)
    for name, of_points in values.items():
        at_vertices = of_points
        if rows is not None:  # one value per vertex, as in the flat surface
            at_vertices = np.full(flat_map.origin.mesh.vertices, np.nan)
            at_vertices[flat_map.ids[rows]] = of_points[rows]
        with atomic_path(results.values(name)) as temporary:
            temporary.write_bytes(value_bytes({name: at_vertices}, structure, flat_map.provenance))
        written.append(results.values(name))
    for path in before - set(written):  # overlays of the previous run that are not requested any more
        path.unlink(missing_ok=True)
    return written


def _written_before(results: Results) -> set[Path]:
    """Return the files of the previous run."""
    try:
        names = read_record(results.record)["outputs"]
    except (InputError, OSError):
        return set()
    return {results.folder / name for name in names if Path(name).name == name and name.startswith(results.prefix)}


def registered_sphere(files: Mapping[str, Path], geometry: str) -> Path | Mesh | None:
    """Return the registered sphere of a hemisphere.

    The vertices of a surface that was resampled to another mesh lie on the native surface, and so have positions on the
    native sphere.
    """
    if "native sphere" not in files:
        return files.get("sphere")
    name = next(name for name in (geometry, "white", "midthickness") if f"native {name}" in files)
    resampled, native, sphere = map(read_mesh, (files[name], files[f"native {name}"], files["native sphere"]))
    if len(native.points) != len(sphere.points):
        counts = f"{len(sphere.points)} vertices, but {files[f'native {name}']} has {len(native.points)}"
        raise InputError(f"{files['native sphere']} has {counts}. Pass the files of one participant")
    corners, weights, away = Shape(native.points, native.faces.astype(np.uint32)).nearest(resampled.points)
    if np.median(away) > _ON_SURFACE:
        far = f"{np.median(away):.1f} mm from {files[f'native {name}']}"
        raise InputError(f"the vertices of {files[name]} are {far}. Pass surfaces of the same participant")
    points = np.einsum("pcx,pc->px", sphere.points[corners], weights)
    radius = np.linalg.norm(sphere.points, axis=1).mean()
    points *= radius / np.linalg.norm(points, axis=1)[:, None]
    return replace(resampled, points=points, path=sphere.path, space=sphere.space)


def _of_template(
    hemisphere: Hemisphere, whole: Surface, sphere: Path | Mesh | None, common: dict[str, Any]
) -> dict[str, Any]:
    """Return the distortion of a template's map for the hemisphere, resampled to the mesh of the template."""
    files = hemisphere.files
    if "template" not in files:
        return {}
    if sphere is None:
        raise InputError("--template requires a registered sphere, but the hemisphere has none. Omit --template")
    limits = {name: common.get(name) for name in ("threads", "progress")}
    (person,) = resampled([whole], [sphere], files["template sphere"], limits)
    return {"template": measure(person, files["template"], reference="graph", **common).figures()}


def _description(whole: Surface, flat_map: FlatMap, cortex: str, of_template: dict[str, Any]) -> dict[str, Any]:
    """Return the description of the surface and the map for the record; `cortex` is its definition."""
    topology = whole.core.topology()
    details: dict[str, Any] = flat_map.details
    first = topology["components"][0]
    width, height = np.ptp(flat_map.uv, axis=0).tolist()
    return {
        "surface": {
            "vertices": len(whole),
            "triangles": len(whole.faces),
            "components": len(topology["components"]),
            "euler": int(first["euler"]),
            "boundaries": len(topology["loops"]),
            "handles_cut": len(details.get("handles_cut", [])),
            "voxels_changed": int(np.count_nonzero(whole.changed_voxels())) if whole.is_voxels else 0,
            "mended": {of: len(places) for of, places in details.get("mended", {}).items() if np.ndim(places)},
            "measured_on": flat_map.origin.measured_on or "the surface itself",
            "space": flat_map.space.name,
            "cortex": cortex,
        },
        "map": {
            "points": details["points"],
            "width": width,
            "height": height,
            "low": flat_map.uv.min(axis=0).tolist(),
            "high": flat_map.uv.max(axis=0).tolist(),
            "frame": flat_map.frame,
            "registration": _registration(summary_of(flat_map)),
            "cuts_by": os.path.basename(str(flat_map.cuts_by)),
            "cut_names": [cut.name for cut in flat_map.cuts if cut.name],
            "automatic_cuts": sum(cut.is_automatic for cut in flat_map.cuts),
        },
        "figures": {**flat_map.distortion.figures(), **of_template},
        "versions": {**details["versions"], "system": platform.system()},
        "provenance": portable(flat_map.provenance),
    }


def _registration(summary: Summary) -> str | None:
    """Return what aligns a hemisphere with the template."""
    if summary.space is None:
        return None
    return "by its folds" if summary.is_by_folds else f"by a sphere in {summary.space} space"
