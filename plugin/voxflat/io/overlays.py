"""Read values at the points of a surface, and regions of a surface, from files."""

import io
import os
import textwrap
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, checked_text
from voxflat.errors import InputError
from voxflat.io import formats, patches, readers
from voxflat.io.channels import Channels, are_points, is_cifti, opened, points_of_nibabel
from voxflat.io.files import REMEDY, check_regular, contents, naming
from voxflat.io.formats import freesurfer, gifti
from voxflat.io.meshes import READERS, parsed
from voxflat.io.partners import check_file_side
from voxflat.io.reading import check_room
from voxflat.io.volumes import VOLUME_ENDINGS

_WHOLE = 1e-3  # tolerance of whole numbers in masks, which files may store scaled


def read_overlay(path: str | os.PathLike[str], points: int, *, structure: str | None = None) -> NDArray[np.number]:
    """Read values at the points of a surface.

    The ending of the name determines the format. FreeSurfer files such as ``lh.curv`` do not need an ending.

    Parameters
    ----------
    path : path
        GIFTI (``.func.gii``, ``.shape.gii``, ``.label.gii``), CIFTI (``.dscalar.nii``, ``.dtseries.nii``,
        ``.dlabel.nii``), FreeSurfer (``lh.curv``, ``lh.sulc``, ``lh.thickness``, ...; ``.annot``, whose labels are
        numbers from 0, or −1 for unlabelled points; ``.label``, 1 in the region and 0 elsewhere; ``.mgh``, ``.mgz``),
        NIfTI of shape (N, 1, 1) or (N, 1, 1, K), ``.npy``, or ``.txt`` with one line per point.
    points : int
        Number of points of the surface.
    structure : str, optional
        Structure of the surface in GIFTI notation, such as "CortexLeft". It selects a part of a CIFTI file. Points
        that the file does not list are NaN, or 0 in ``.dlabel.nii`` files. A file of the other hemisphere is refused.

    Returns
    -------
    ndarray, shape (points,), or (points, K) for K maps
        The values, with the data type of the file.

    Raises
    ------
    InputError
        The file is damaged, belongs to the other hemisphere, has a different number of values, or has more maps than
        fit into memory.

    See Also
    --------
    read_region : Read a region of a surface.

    Examples
    --------
    >>> np.save("height.npy", np.arange(4.0))
    >>> voxflat.io.read_overlay("height.npy", points=4)
    array([0., 1., 2., 3.])
    """
    path = checked_path(path)
    check_file_side(path, structure)
    with naming(path, REMEDY):
        channels = _channels(path, points, structure)
        first = channels.read(0)
        if len(channels) == 1:
            return first
        check_room(2 * len(channels) * first.nbytes)
        return np.column_stack([first, *(channels.read(n) for n in range(1, len(channels)))])


def read_channels(path: str | os.PathLike[str], points: int, *, structure: str | None = None) -> Channels:
    """Read values as `read_overlay` does, but read the maps in NIfTI and CIFTI files on demand."""
    path = checked_path(path)
    check_file_side(path, structure)
    with naming(path, REMEDY):
        return _channels(path, points, structure).of_file(path)


def _channels(path: Path, points: int, structure: str | None) -> Channels:
    if not path.name.lower().endswith((".nii", ".nii.gz")):
        return Channels.of_array(*_values(path, contents(path), points))
    check_regular(path)
    path.open("rb").close()  # the system's own error is more helpful
    channels = points_of_nibabel(path, points, structure)
    if channels is None:
        raise InputError("contains values in voxels, not at points. Pass a file with one value per point")
    return channels.mapped(lambda values: _fitting(values, points))


def holds_volume(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a volume according to its ending, and not values at points with the same ending."""
    name = checked_path(path).name.lower()
    if not name.endswith(VOLUME_ENDINGS):
        return False
    if name.endswith(".npy"):
        try:
            check_regular(Path(path))
            return readers.dimensions(Path(path)) not in (1, 2)
        except OSError:
            raise
        except Exception:  # its reader reports errors
            return True
    image, _ = opened(Path(path))
    return image is None or not (is_cifti(image) or are_points(image.shape))


def read_region(
    path: str | os.PathLike[str], points: int, *, name: str | None = None, structure: str | None = None
) -> NDArray[np.bool_]:
    """Return which points of a surface belong to a region that is stored in a file.

    The region can be stored as a label, an annotation, a patch, a part of the surface, or as values.

    Parameters
    ----------
    path : path
        A FreeSurfer ``.label``, ``.annot`` (with `name`) or patch file; a surface whose faces use only points of the
        region; or a file for `read_overlay` with whole numbers, such as a mask, in which the points of the region have
        values other than 0 and NaN.
    points : int
        Number of points of the surface.
    name : str, optional
        A label of an ``.annot``, ``.label.gii`` or ``.dlabel.nii`` file, such as ``"Medial_wall"``.
    structure : str, optional
        Structure of the surface, as in `read_overlay`.

    Returns
    -------
    ndarray of bool, shape (points,)
        True for the points of the region.

    Raises
    ------
    InputError
        The file is damaged, belongs to another surface, or does not contain a label with that name.

    See Also
    --------
    read_overlay : Read values at the points of a surface.

    Examples
    --------
    >>> np.save("region.npy", np.array([True, False, True, False]))
    >>> voxflat.io.read_region("region.npy", 4)
    array([ True, False,  True, False])
    """
    name = None if name is None else checked_text(name, "name of a label")
    path = checked_path(path)
    check_file_side(path, structure)
    with naming(path, REMEDY):
        data = contents(path)
        kind = formats.by_content(data) or formats.by_name(path)
        image = gifti.load(data) if kind == formats.GIFTI else None
        if path.name.lower().endswith(".annot"):
            labels, names = freesurfer.read_annot(path, data)
            return _named(_fitting(labels, points), dict(enumerate(names)), name)
        if image is not None and name is not None:
            return _named(_fitting(gifti.values(image), points), gifti.label_names(image), name)
        if name is not None and path.name.lower().endswith(".dlabel.nii"):
            named: dict[int, str] = {n: text for n, (text, _) in opened(path)[0].header.get_axis(0).label[0].items()}
            channels = _channels(path, points, structure)
            if len(channels) > 1:
                raise InputError(f"has {len(channels)} maps. Pass a file with one map")
            return _named(_fitting(channels.read(0), points), named, name)
        if name is not None:
            raise InputError(f"contains no named labels. Omit the name {name!r}")
        if kind == formats.PATCH:
            return _mask(patches.parse_patch(path, data).vertex_ids, points)
        if kind == "FreeSurfer label" or path.name.lower().endswith(".label"):
            return freesurfer.read_label(data, points)
        if kind in READERS and (image is None or gifti._has_triangles(image)):
            mesh = parsed(path, data)
            _fitting(mesh.points[:, 0], points)
            return _mask(np.unique(mesh.faces), points)
        return region_of(_channels(path, points, structure), points)


def region_of(channels: Channels, points: int) -> NDArray[np.bool_]:
    """Return a mask (points,) of the points where the only map of the channels is neither 0 nor NaN."""
    if len(channels) > 1:
        raise InputError(f"has {len(channels)} maps. Pass a file with one map")
    return as_mask(_fitting(channels.read(0), points))


def as_mask(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where values are neither 0 nor NaN; raise an error for measurements such as a thickness."""
    numbers = np.nan_to_num(values) if values.dtype.kind == "f" else values
    if numbers.dtype.kind == "f" and (broken := np.abs(numbers - np.round(numbers)) > _WHOLE).any():
        problem = f"contains fractional values (such as {numbers[broken][0]:.4g}), so it is not a region"
        raise InputError(f"{problem}. Pass labels, or a mask that is 1 in the region and 0 elsewhere")
    return np.asarray(numbers != 0)


def _values(path: Path, data: bytes, points: int) -> tuple[NDArray[Any], tuple[str, ...] | None]:
    """Return the values in a file, and the names of its maps if they have names."""
    name, kind = path.name.lower(), formats.by_content(data) or formats.by_name(path)
    if name.endswith(".npy") or kind == "a NumPy array":
        if kind != "a NumPy array":
            raise InputError("is not a NumPy array. Write it again with numpy.save")
        return _fitting(readers.read_array(path), points), None
    if name.endswith(".txt"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # empty file: reported below
            values = np.loadtxt(io.StringIO(data.decode()))
        return _fitting(values, points), None
    if name.endswith((".mgh", ".mgz")):
        return _fitting(freesurfer.read_mgh(data), points), None
    if name.endswith(".annot"):
        return _fitting(freesurfer.read_annot(path, data)[0], points), None
    if kind == "FreeSurfer label" or name.endswith(".label"):
        return freesurfer.read_label(data, points).astype(np.uint8), None
    if kind == formats.GIFTI:
        image = gifti.load(data)
        return _fitting(gifti.values(image), points), gifti.map_names(image)
    is_cut_short = kind == formats.FREESURFER and data[2] == 0xFF  # a file of values, not labels
    if kind not in (None, formats.MORPH) and not is_cut_short:
        raise InputError(f"does not contain values at points: its content is {kind}. Pass another file")
    return _fitting(freesurfer.read_morph(path, data), points), None


def _fitting(values: NDArray[Any], points: int) -> NDArray[Any]:
    """Check that there is one value, or one row of values, per point."""
    if values.ndim not in (1, 2) or values.dtype.kind not in "biuf":
        raise InputError(f"values have data type {values.dtype} and shape {values.shape}. Pass an (N,) or (N, K) array")
    if len(values) != points:
        raise InputError(f"has {len(values)} values, but the surface has {points} points. Pass one value per point")
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))


def _mask(chosen: NDArray[np.int64], points: int) -> NDArray[np.bool_]:
    """Return a mask of the selected points."""
    if chosen.max() >= points:
        raise InputError(f"refers to point {chosen.max()}, but the surface has points 0 to {points - 1}")
    mask = np.zeros(points, dtype=bool)
    mask[chosen] = True
    return mask


def _named(labels: NDArray[Any], names: dict[int, str], name: str | None) -> NDArray[np.bool_]:
    """Return a mask of the points whose label has a given name."""
    keys = [key for key, label in names.items() if label == name]
    if not keys:
        listing = textwrap.shorten(", ".join(names.values()), 300, placeholder=" ...")
        if name is None:
            raise InputError(f"contains the labels {listing}. Pass the name of one of them, or a file with one region")
        raise InputError(f"{name!r} is not one of its labels. Choose one of {listing}")
    if labels.ndim > 1:
        raise InputError(f"has {labels.shape[1]} maps. Pass a file with one map")
    return np.isin(labels, keys)
