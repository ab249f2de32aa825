"""Flatten a subject for pycortex: the functions `to_pycortex` and `autoflatten_subject`."""

import argparse
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray

from voxflat.arguments import Progress, checked_path, checked_switch, log, shown
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.meshes import named_structure, read_mesh
from voxflat.lab.freshness import request, state
from voxflat.lab.inputs import Hemisphere, Parameters, found_in
from voxflat.lab.layouts import FREESURFER, HEMISPHERES
from voxflat.lab.pycortex_files import (
    SURFACES,
    StoredSubject,
    filestore_of,
    gifti_of,
    subject_name,
    surfaces_of,
    write_values,
    write_volumes,
)
from voxflat.lab.pycortex_overlays import Drawing, FlatSurface, Roi, read_overlays
from voxflat.lab.results import Results, read_record
from voxflat.lab.subject import NO_CORTEX, make
from voxflat.maps.flat_map import FlatMap, load_saved
from voxflat.maps.parcels import parcels_of

_USUAL_ROIS = "aparc"
_ENDINGS = ("", ".annot", ".label")  # tried after the name of a file in label/


def to_pycortex(
    subject: str | os.PathLike[str],
    filestore: str | os.PathLike[str] | None = None,
    *,
    name: str | None = None,
    rois: Sequence[str | os.PathLike[str]] | None = None,
    cuts: str = "standard",
    overwrite: bool = False,
    seed: int = 0,
    threads: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Flatten a subject, and store it in the filestore of pycortex.

    FreeSurfer and pycortex are not needed. The subject has the layout and coordinates of
    ``cortex.freesurfer.import_subj`` and ``import_flat``. Existing files of a subject are kept, apart from flat
    surfaces and ``overlays.svg``, which are replaced only with `overwrite`, after they were copied to
    ``voxflat-backup-1`` in the subject's directory. The complete maps are those of ``voxflat freesurfer``; maps that
    are up to date are not computed again.

    Parameters
    ----------
    subject : path or str
        A FreeSurfer subject directory, made by recon-all, or the name of a subject in the filestore.
    filestore : path, optional
        The filestore. The default is that of a running pycortex, or that of its configuration file.
    name : str, optional
        Name of the subject in the filestore. The default is the name of the directory.
    rois : sequence of str or path, optional
        Regions of interest for ``overlays.svg``: names of annotations or labels of the subject, such as "aparc" or
        "V1_exvivo", or files (``.annot``, ``.label``, ``.label.gii``), in which ``{hemi}`` stands for lh or rh. The
        default is "aparc", if it exists. For a subject in the filestore, the regions that are drawn in its
        ``overlays.svg`` are drawn on the new map as well.
    cuts : str
        "standard", "automatic" or a file, as for ``voxflat freesurfer``.
    overwrite : bool
        Whether to replace flat surfaces.
    seed, threads, memory_limit, progress : optional
        As in `Surface.flatten`.

    Returns
    -------
    pathlib.Path
        The directory of the subject in the filestore.

    Raises
    ------
    InputError
        If the subject does not exist or is incomplete, or flat surfaces exist and `overwrite` is False.

    See Also
    --------
    to_nilearn : Convert maps to meshes of nilearn.

    Examples
    --------
    >>> voxflat.to_pycortex("subjects/sub-01", "filestore")  # doctest: +SKIP
    PosixPath('filestore/sub-01')
    """
    store, parameters = filestore_of(filestore), Parameters(cuts=str(cuts), seed=seed)
    folder = _recon_all(subject)
    stored = _stored(subject, folder, store, name)
    if not checked_switch(overwrite, "overwrite") and stored.flat_files:
        text = f"{stored.flat_files[0]} exists. To replace the flat map, pass overwrite=True; the files are kept aside"
        raise InputError(text)
    common = {"threads": threads, "memory_limit": memory_limit, "progress": progress}
    files = {hemi: _roi_files(folder, hemi, rois) for hemi in HEMISPHERES}
    surfaces = {} if folder is None else {hemi: surfaces_of(folder, hemi) for hemi in HEMISPHERES}
    for hemi, meshes in surfaces.items():
        _check_stored(stored, hemi, len(meshes["wm"].points))
    maps, flats = {}, {}
    for hemi in HEMISPHERES:
        results = _flattened(folder, stored, hemi, parameters, common)
        maps[hemi], flats[hemi] = load_saved(results.map), _flat_surface(results)
    drawing = Drawing(flats)
    regions = _drawn_before(stored, flats) | _rois(files, maps)
    outlines = {roi: drawing.outlines(region) for roi, region in regions.items()}
    _check(drawing, regions, outlines)
    _write(stored, folder, surfaces, flats, drawing.svg(regions, outlines))
    return stored.folder


def autoflatten_subject(
    freesurfer_subject: str,
    pycortex_subject: str | None = None,
    freesurfer_subject_dir: str | os.PathLike[str] | None = None,
    autoflatten_args: Sequence[str] | None = None,
    import_flatmaps: bool = True,
) -> dict[str, str]:
    """Flatten a FreeSurfer subject in place of ``cortex.freesurfer.autoflatten_subject``.

    The arguments and the result are those of pycortex 1.4, which calls this function at the end of ``import_subj``.

    Parameters
    ----------
    freesurfer_subject : str
        Name of the subject in the FreeSurfer subjects directory.
    pycortex_subject : str, optional
        Name of the subject in the filestore. The default is the FreeSurfer name.
    freesurfer_subject_dir : path, optional
        FreeSurfer subjects directory. The default is the environment variable ``SUBJECTS_DIR``.
    autoflatten_args : sequence of str, optional
        ``["--cuts", "automatic"]`` selects the cuts, as in `to_pycortex`.
    import_flatmaps : bool
        Whether to store the flat surfaces in the filestore. Existing ones are replaced, after they were kept aside.

    Returns
    -------
    dict of str
        The flat patch of each hemisphere, "lh" and "rh".

    Raises
    ------
    InputError
        If the subject does not exist or is incomplete, or an argument is unknown.

    See Also
    --------
    to_pycortex : Flatten a subject, and store it in the filestore of pycortex.

    Examples
    --------
    >>> import cortex  # doctest: +SKIP
    >>> cortex.freesurfer.autoflatten_subject = voxflat.autoflatten_subject  # doctest: +SKIP
    """
    subjects = freesurfer_subject_dir
    if subjects is None and not (subjects := os.environ.get("SUBJECTS_DIR")):
        raise InputError("the FreeSurfer subjects directory is unknown. Set SUBJECTS_DIR")
    folder = checked_path(subjects, "freesurfer_subject_dir") / checked_path(freesurfer_subject, "freesurfer_subject")
    cuts = _cuts_in(() if autoflatten_args is None else autoflatten_args)
    if checked_switch(import_flatmaps, "import_flatmaps"):
        to_pycortex(folder, name=pycortex_subject, cuts=cuts, overwrite=True)
    stored = StoredSubject(folder)  # not used, because there is a FreeSurfer directory
    patches = {}
    for hemi in HEMISPHERES:
        patches[hemi] = str(_flattened(folder, stored, hemi, Parameters(cuts=cuts), {}).patch)
    return patches


def _cuts_in(arguments: Sequence[str]) -> str:
    """Return the cuts that arguments in the style of a command line select."""
    if not isinstance(arguments, list | tuple) or not all(isinstance(argument, str) for argument in arguments):
        raise InputError(f"the arguments for flattening are {shown(arguments)}. Pass a list of strings")
    parser = argparse.ArgumentParser(add_help=False, exit_on_error=False, allow_abbrev=False)
    parser.add_argument("--cuts", default=Parameters.cuts)
    try:
        known, others = parser.parse_known_args(list(arguments))
    except argparse.ArgumentError as error:
        raise InputError(f"the arguments for flattening are incomplete ({error}). Pass --cuts and its value") from None
    if others:
        raise InputError(f"the arguments for flattening contain {shown(others[0])}. Pass only --cuts and its value")
    return str(known.cuts)


def _recon_all(subject: str | os.PathLike[str]) -> Path | None:
    """Return the FreeSurfer directory that was passed, or None for the name of a subject in the filestore."""
    path = checked_path(subject, "subject")
    return path.absolute() if (path / "surf").is_dir() else None


def _stored(subject: str | os.PathLike[str], folder: Path | None, store: Path, name: str | None) -> StoredSubject:
    """Return the subject in the filestore, which exists if there is no FreeSurfer directory."""
    if folder is not None:
        return StoredSubject(store / subject_name(folder.name if name is None else name))
    text = os.fspath(subject)
    if name is not None:
        raise InputError(f"name is {shown(name)}, but {text} is not a FreeSurfer subject directory. Omit name")
    stored = StoredSubject(store / text)
    if Path(text).name != text or not (stored.folder / "surfaces").is_dir():
        problem = f"{text} is neither a FreeSurfer subject directory (it has no surf/) nor a subject in {store}"
        raise InputError(f"{problem}. Pass the output directory of recon-all, or the name of a subject")
    for hemi in HEMISPHERES:
        for surface in ("wm", "pia"):
            if not (path := stored.surface(surface, hemi)).is_file():
                raise InputError(f"{path}: the file does not exist. Import the subject into pycortex again")
    return stored


def _check_stored(stored: StoredSubject, hemi: str, count: int) -> None:
    """Raise an error if the filestore has another surface of this name."""
    for surface in SURFACES:
        path = stored.surface(surface, hemi)
        if path.is_file() and (there := len(read_mesh(path).points)) != count:
            problem = f"{path} has {there} vertices, but the surface of recon-all has {count}"
            raise InputError(f"{problem}. Pass another name, or delete the subject from the filestore")


def _flattened(
    folder: Path | None, stored: StoredSubject, hemi: str, parameters: Parameters, common: Mapping[str, Any]
) -> Results:
    """Flatten a hemisphere unless its map is up to date, and return the files of the map."""
    if folder is None:
        results = Results(stored.folder / "voxflat", f"{hemi}.voxflat", of_freesurfer=True)
        files = {of: stored.surface(name, hemi) for name, of in SURFACES.items() if name != "inflated"}
        hemisphere = Hemisphere(hemi, files, layout=FREESURFER)
    else:
        results = Results.in_freesurfer(folder, hemi)
        with suppress(InputError, OSError):  # the map does not depend on the overlays, so those of earlier runs stay
            overlays = read_record(results.record)["parameters"]["overlays"]
            parameters = replace(parameters, overlays=tuple(overlays))
        hemisphere = found_in(folder, hemi, parameters)
    if state(results, request(hemisphere, parameters))[0] != "done":
        record = make(hemisphere, parameters, results, **common)
        for warning in record["warnings"]:
            log.warning("%s: %s", HEMISPHERES[hemi][1], warning)
    return results


def _flat_surface(results: Results) -> FlatSurface:
    """Return the flat surface with the middle of its bounding box at the origin, where all other vertices lie."""
    mesh = read_mesh(results.surface)
    on_map = np.unique(mesh.faces)
    uv = mesh.points[:, :2].copy()
    uv[on_map] -= (uv[on_map].min(axis=0) + uv[on_map].max(axis=0)) / 2
    return FlatSurface(uv.astype(np.float32), mesh.faces)


# ------------------------------------------------------------------------------ regions of interest


def _roi_files(folder: Path | None, hemi: str, rois: Sequence[str | os.PathLike[str]] | None) -> list[Path]:
    """Return the files of regions for a hemisphere."""
    if isinstance(rois, str | os.PathLike):
        raise InputError(f"rois is {shown(rois)}. Pass a list of names or files")
    if rois is None:
        usual = None if folder is None else folder / "label" / f"{hemi}.{_USUAL_ROIS}.annot"
        return [usual] if usual is not None and usual.is_file() else []
    return [_roi_file(folder, hemi, os.fspath(roi)) for roi in rois]


def _roi_file(folder: Path | None, hemi: str, text: str) -> Path:
    named = text.replace("{hemi}", hemi)
    places = [Path(named)]
    if folder is not None:
        places = [folder / "label" / f"{hemi}.{named}{ending}" for ending in _ENDINGS] + [folder / named, *places]
    for path in places:
        if path.is_file():
            if "{hemi}" not in text and named_structure(named) is not None:
                raise InputError(f"the region {text} is a file of one hemisphere. Write {{hemi}} instead of lh or rh")
            return path
    searched = ", ".join(map(str, places))
    raise InputError(f"the region {text} does not exist. Check its name; voxflat searched for {searched}")


def _rois(files: Mapping[str, list[Path]], maps: Mapping[str, FlatMap]) -> dict[str, Roi]:
    """Return the regions in files, by name; both hemispheres of a region have the same name."""
    regions: dict[str, Roi] = {}
    origins: dict[tuple[str, str], Path] = {}
    for hemi, flat_map in maps.items():
        for path in files[hemi]:
            parcels = parcels_of(flat_map, path)
            for label, name in parcels.names.items():
                if name.lower() in NO_CORTEX:
                    continue
                if (other := origins.setdefault((hemi, name), path)) != path:
                    raise InputError(f"{path} and {other} both have a region {name}. Pass one of them")
                mask = np.zeros(flat_map.origin.mesh.vertices, dtype=np.bool_)
                mask[flat_map.ids[parcels.labels == label]] = True
                region = regions.setdefault(name, Roi({}, parcels.colours[label]))
                region.masks[hemi] = mask
    return regions


def _drawn_before(stored: StoredSubject, flats: Mapping[str, FlatSurface]) -> dict[str, Roi]:
    """Return the regions that are drawn on the previous flat map, as ``cortex.utils.get_roi_verts`` returns them."""
    paths = [stored.surface("flat", hemi) for hemi in flats]
    if not stored.overlays.is_file() or not all(path.is_file() for path in paths):
        return {}
    shapes, layers = read_overlays(stored.overlays)
    if layers:
        log.warning("the layers %s of overlays.svg are not transferred to the new map", ", ".join(layers))
    meshes = {hemi: read_mesh(path) for hemi, path in zip(flats, paths, strict=True)}
    before = {hemi: FlatSurface(mesh.points[:, :2].astype(np.float32), mesh.faces) for hemi, mesh in meshes.items()}
    regions = {}
    drawing = Drawing(before)
    faces = {hemi: read_mesh(stored.surface("wm", hemi)).faces for hemi in before}
    for name, loops in shapes.items():
        masks = {hemi: drawing.inside(hemi, loops) for hemi in before}
        grown = {hemi: _with_neighbours(mask, faces[hemi], before[hemi]) for hemi, mask in masks.items()}
        regions[name] = Roi({hemi: mask for hemi, mask in grown.items() if mask.any()})
    return regions


def _with_neighbours(mask: NDArray[np.bool_], faces: NDArray[np.int64], flat: FlatSurface) -> NDArray[np.bool_]:
    """Add neighbours that the flat map leaves out, such as those along its cuts."""
    grown = mask.copy()
    grown[faces[mask[faces].any(axis=1)]] = True
    return np.asarray(mask | (grown & ~flat.is_on_map))


def _check(drawing: Drawing, regions: Mapping[str, Roi], outlines: Mapping[str, Any]) -> None:
    """Warn of regions in which pycortex will not find the same vertices."""
    for name, region in regions.items():
        wrong = 0
        for hemi, mask in region.masks.items():
            found = drawing.inside(hemi, map(Polygon, outlines[name].get(hemi, [])))
            wrong += int(np.count_nonzero((mask & drawing.flats[hemi].is_on_map) != found))
        if wrong:
            log.warning("pycortex will find or miss %d other vertices in the region %s", wrong, name)


# ------------------------------------------------------------------------------ writing


def _write(
    stored: StoredSubject,
    folder: Path | None,
    surfaces: Mapping[str, Mapping[str, Any]],
    flats: Mapping[str, FlatSurface],
    svg: bytes,
) -> None:
    """Write all files of a subject that do not exist, keep its flat map aside, and write the new one."""
    stored.make_folders()
    for hemi, meshes in surfaces.items():
        for name, mesh in meshes.items():
            if not (path := stored.surface(name, hemi)).exists():
                _write_bytes(path, gifti_of(mesh.points, mesh.faces, hemi))
    if folder is not None:
        counts = {hemi: len(meshes["wm"].points) for hemi, meshes in surfaces.items()}
        if missing := [*write_volumes(folder, stored), *write_values(folder, stored, counts)]:
            log.warning("%s lacks %s, so pycortex lacks the corresponding data", folder.name, ", ".join(missing))
    backup = stored.keep_aside()
    if backup is not None:
        log.info("the previous flat map is in %s", backup)
    for hemi, flat in flats.items():
        points = np.column_stack([flat.uv, np.zeros(len(flat.uv))])
        _write_bytes(stored.surface("flat", hemi), gifti_of(points, flat.faces, hemi))
    _write_bytes(stored.overlays, svg)
    stored.clear()


def _write_bytes(path: Path, data: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
