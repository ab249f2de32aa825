"""Read files that contain several maps or volumes (GIFTI, CIFTI, MGH, NIfTI), one at a time."""

from __future__ import annotations

import math
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import shown
from voxflat.errors import InputError
from voxflat.io.files import OF_DAMAGE, REMEDY, naming, nibabel_image
from voxflat.io.grid import Affine, check_affine, in_millimetres
from voxflat.io.readers import check_length
from voxflat.io.reading import check_room, record_file

_NIFTI_OR_MGH = (".nii", ".nii.gz", ".mgh", ".mgz")
_BLOCK = 64  # frames read at once if a file stores them point by point
_LARGEST_LABEL = 2**31 - 1
_SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}

_Key = TypeVar("_Key")
_Result = TypeVar("_Result")


class LastKept(Generic[_Key, _Result]):
    """A function that keeps its last result, so that memory holds a single one."""

    def __init__(self, function: Callable[[_Key], _Result]) -> None:
        self._function = function
        self._kept: dict[_Key, _Result] = {}

    def __call__(self, key: _Key) -> _Result:
        """Return the result for a key."""
        if key not in self._kept:
            self._kept.clear()
            self._kept[key] = self._function(key)
        return self._kept[key]


class OnDemand(Generic[_Result]):
    """Results by number, from 0, that a function computes on demand; pickles and deep copies hold the results."""

    def __init__(self, function: Callable[[int], _Result], count: int) -> None:
        self._function, self._count = function, count

    def __call__(self, number: int) -> _Result:
        """Return the result with a number."""
        return self._function(number)

    def __reduce__(self) -> tuple[object, ...]:
        """Replace the function, which may refer to open files, by a list of all results."""
        results: list[_Result] = []
        for number in range(self._count):
            results.append(self(number))
            check_room((self._count - number - 1) * getattr(results[-1], "nbytes", 0), "copy fewer images")
        return getattr, (results, "__getitem__")


def distinct_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of channels; those without a name, or with that of another channel, are called by number."""
    counts = Counter(names)
    return tuple(name if name and counts[name] == 1 else str(n) for n, name in enumerate(names))


@dataclass(frozen=True)
class Timing:
    """Store the times of the frames of a series, in seconds."""

    step: float  # interval between frames
    start: float = 0.0  # time of the first frame

    @classmethod
    def told(cls, step: object, start: object = 0.0) -> Timing | None:
        """Return the times that a header defines, in seconds, or None if they are not valid."""
        values = np.array([step, start], dtype=np.float64)
        if not (np.isfinite(values).all() and values[0] > 0):
            return None
        step, start = (float(f"{value:.7g}") for value in values)  # round single precision: 0.72, not 0.7200000286
        return cls(step, start)


@dataclass(frozen=True, eq=False)
class Channels:
    """Store one or more arrays of the same shape that are read on demand."""

    names: tuple[str, ...]  # one per channel; empty strings if the file does not name them
    read: Callable[[int], NDArray[Any]]  # the argument is the number of a channel, from 0
    timing: Timing | None = None  # if the channels are frames of a series with known times
    called: str = "map"  # what messages call a channel

    def __post_init__(self) -> None:
        object.__setattr__(self, "read", OnDemand(self.read, len(self.names)))

    def __len__(self) -> int:
        """Return the number of channels."""
        return len(self.names)

    def listed(self) -> str:
        """Return the names, shortened for use in messages."""
        if not any(self.names):
            return f"0 to {len(self) - 1}"
        named = zip(self.names, distinct_names(self.names), strict=True)
        listed = (own if own == name or not name else f"{own}: {name}" for name, own in named)
        return textwrap.shorten(", ".join(listed), 300, placeholder=" ...")

    def find(self, channel: int | str | None) -> int:
        """Find a channel by its name or number (from 0, or negative from the end); None selects the only channel."""
        count = len(self)
        if channel is None:
            if count > 1:
                several = f"has {count} {self.called}s ({self.listed()})"
                raise InputError(f"{several}. Choose one by its name or number (channel)")
            return 0
        if isinstance(channel, bool | np.bool_) or not isinstance(channel, str | int | np.integer):
            raise InputError(f"channel is {shown(channel)}. Pass the name or the number of a channel")
        if count == 1 and channel not in (0, -1, "0", "-1", self.names[0]):
            raise InputError(f"has only one {self.called}, but channel is {shown(channel)}. Omit channel")
        if isinstance(channel, str):
            numbers = [n for n, name in enumerate(self.names) if name == channel]
            if len(numbers) == 1:
                return numbers[0]
            if len(numbers) > 1:
                several = f"has {len(numbers)} {self.called}s named {channel!r} (numbers {numbers})"
                raise InputError(f"{several}. Choose one by its number")
            if not re.fullmatch(r"-?[0-9]+", channel):
                raise InputError(f"has no {self.called} {channel!r}. Choose one of {self.listed()}")
            channel = int(channel)
        if not -count <= channel < count:
            named = f" ({self.listed()})" if any(self.names) else ""
            raise InputError(f"has no {self.called} {channel}. Pass a number from 0 to {count - 1}{named}")
        return int(channel) % count

    def mapped(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Channels:
        """Return the same channels, with a function that is applied to each channel when it is read."""
        return replace(self, read=lambda n: change(self.read(n)))

    def of_file(self, path: Path | None) -> Channels:
        """Return the same channels with errors that name the file, because it is read long after it is opened."""
        if path is None:
            return self

        def read(n: int) -> NDArray[Any]:
            with naming(path, REMEDY):
                return self.read(n)

        return replace(self, read=read)

    @classmethod
    def of_array(cls, values: NDArray[Any], names: Sequence[str] | None = None) -> Channels:
        """Return the columns of values at points, (N,) or (N, K), as channels."""
        columns = values[:, None] if values.ndim == 1 else values
        return cls(tuple(names or [""] * columns.shape[1]), lambda n: columns[:, n])


def series_of(obj: object) -> tuple[Channels, Affine] | None:
    """Return a NIfTI or MGH series of volumes (I, J, K, T) and its affine to RAS+ mm, or None for other input."""
    image, path = opened(obj)
    if image is None or is_cifti(image):
        return None
    shape = _shape(image)
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    is_colour = len(shape) == 4 and shape[3] in (3, 4) and image.get_data_dtype() == np.uint8
    if len(shape) != 4 or is_colour or image.get_data_dtype().kind not in "iuf" or min(shape) < 1:
        return None
    _check_complete(path, image, 2 * math.prod(shape[:3]))
    unit = image.header.get_xyzt_units()[0] if hasattr(image.header, "get_xyzt_units") else "mm"
    affine = in_millimetres(check_affine(image.affine), unit)
    rest, stored = (0,) * (len(image.shape) - 4), _kept_open(image)

    def frame(n: int) -> NDArray[Any]:
        index = (..., n, *rest)
        return np.asarray(stored[index])

    return Channels(("",) * shape[3], frame, _timing(image.header)).of_file(path), affine


def points_of_nibabel(obj: object, points: int, structure: str | None) -> Channels | None:
    """Return values at points from NIfTI, MGH or CIFTI (NaN or 0 outside a CIFTI structure), or None for volumes."""
    image, path = opened(obj)
    if image is None:
        return None
    if is_cifti(image):
        _check_complete(path, image, 2 * math.prod(_shape(image)[1:]) * min(_BLOCK, image.shape[0]))
        return _cifti(image, points, structure)
    shape = _shape(image)
    if not are_points(shape):
        return None
    if max(shape[:3]) != points:
        raise InputError(f"has {max(shape[:3])} values, but the surface has {points} points. Pass one value per point")
    further = [n for n in shape[3:] if n != 1]
    if len(further) > 1 or image.get_data_dtype().kind not in "iuf":
        raise InputError(f"has shape {shape} and type {image.get_data_dtype()}. Pass numbers of shape (N, 1, 1, T)")
    _check_complete(path, image, 2 * points)
    count = further[0] if further else 1
    split, stored = shape.index(count, 3) if further else 0, _kept_open(image)

    def read(n: int) -> NDArray[Any]:
        place = tuple(slice(None) if axis < 3 else n if axis == split else 0 for axis in range(len(shape)))
        return np.asarray(stored[place]).ravel()

    return Channels(("",) * count, read, _timing(image.header) if split == 3 else None)


def opened(obj: object) -> tuple[Any, Path | None]:
    """Return the nibabel image of an object or file, with its data on disk, and the file, or None for other input."""
    if hasattr(obj, "dataobj") and hasattr(obj, "get_data_dtype") and hasattr(obj, "shape"):
        return obj, None
    if not isinstance(obj, str | Path) or not str(obj).lower().endswith(_NIFTI_OR_MGH) or not Path(obj).is_file():
        return None, None
    try:
        return nibabel_image(obj, keep_file_open=True), Path(obj)
    except OSError as error:
        if error.errno not in OF_DAMAGE:
            raise
        return None, None
    except Exception:  # the reader of volumes reports errors, such as a missing nibabel
        return None, None


def _kept_open(image: Any) -> Any:
    """Return the data of an image; a gzipped file stays open, or each frame would decompress all frames before it."""
    proxy = image.dataobj
    name = getattr(proxy, "file_like", None)
    if type(proxy).__name__ != "ArrayProxy" or not str(name).lower().endswith((".gz", ".mgz")):
        return proxy
    layout = (proxy.shape, proxy.dtype, proxy.offset, proxy.slope, proxy.inter)
    return type(proxy)(name, layout, keep_file_open=True)


def are_points(shape: tuple[int, ...]) -> bool:
    """Return whether an image has the shape of values at points, (N, 1, 1) in any order, or of a series of them."""
    return len(shape) >= 3 and sorted(shape[:3])[:2] == [1, 1] and max(shape[:3]) > 1 and min(shape) > 0


def is_cifti(image: Any) -> bool:
    """Return whether an image is a CIFTI image."""
    return type(image).__name__ == "Cifti2Image"


def _shape(image: Any) -> tuple[int, ...]:
    """Return a shape as Python integers, because products of the 32-bit integers in MGH headers overflow."""
    return tuple(int(length) for length in image.shape)


def _timing(header: Any) -> Timing | None:
    """Return the times of the frames along the fourth axis, or None if the header does not define a unit of time."""
    if not hasattr(header, "get_xyzt_units"):  # MGH stores ms
        return Timing.told(float(header["tr"]) / 1000) if "tr" in header else None
    second = _SECONDS.get(header.get_xyzt_units()[1])
    if second is None or len(header.get_zooms()) < 4:
        return None
    return Timing.told(float(header.get_zooms()[3]) * second, float(header["toffset"]) * second)


def _check_complete(path: Path | None, image: Any, values: int) -> None:
    """Check that a file is complete and that its values fit into memory, before nibabel reads it."""
    proxy = image.dataobj
    if path is not None and hasattr(proxy, "offset"):
        check_length(path, proxy.offset + math.prod(_shape(proxy)) * proxy.dtype.itemsize)
        check_room(8 * values)
        record_file(path)


def _cifti(image: Any, points: int, structure: str | None) -> Channels:
    """Return the maps that a CIFTI file contains for one structure."""
    axes = [image.header.get_axis(n) for n in range(image.ndim)]
    if len(axes) != 2 or type(axes[1]).__name__ != "BrainModelAxis":
        kinds = ", ".join(type(axis).__name__ for axis in axes)
        raise InputError(f"has the axes {kinds}. Pass a .dscalar.nii, .dtseries.nii or .dlabel.nii file with vertices")
    models = {name: (part, model) for name, part, model in axes[1].iter_structures() if name in axes[1].nvertices}
    name = _structure(models, axes[1].nvertices, points, structure)
    part, model = models[name]
    if axes[1].nvertices[name] != points:
        count = axes[1].nvertices[name]
        raise InputError(f"has {count} vertices for {_short(name)}, but the surface has {points} points")
    maps, kind, timing = axes[0], type(axes[0]).__name__, None
    names = ("",) * len(maps)
    if kind in ("ScalarAxis", "LabelAxis"):
        names = tuple(str(name) for name in maps.name)
    elif kind == "SeriesAxis":
        names = tuple(f"{maps.start + n * maps.step:g} {maps.unit.lower()}" for n in range(maps.size))
        timing = Timing.told(maps.step, maps.start) if maps.unit == "SECOND" else None
    start, stop = part.start or 0, part.stop or image.shape[1]
    stored = _kept_open(image)
    block: LastKept[int, NDArray[Any]] = LastKept(lambda first: np.asarray(stored[first : first + _BLOCK, start:stop]))

    def read(n: int) -> NDArray[Any]:
        values = block(n - n % _BLOCK)[n % _BLOCK]
        if kind == "LabelAxis":
            labels = np.zeros(points, dtype=np.int64)
            labels[model.vertex] = _whole(values)
            return labels
        dense = np.full(points, np.nan)
        with np.errstate(invalid="ignore"):  # treat a signalling NaN as NaN
            dense[model.vertex] = values
        return dense

    return Channels(names, read, timing)


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    """Return labels as whole numbers, even if a file stores them as scaled fractions."""
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        is_label = (np.abs(values) <= _LARGEST_LABEL) & (np.abs(values - np.round(values)) <= 1e-3)
    if not is_label.all():
        raise InputError(f"label {values[~is_label][0]} is not a whole number. Save the values as .dscalar.nii instead")
    return np.asarray(np.round(values), dtype=np.int64)


def _structure(models: dict[str, Any], sizes: dict[str, int], points: int, structure: str | None) -> str:
    """Return the structure of a CIFTI file that corresponds to a surface."""
    if not models:
        raise InputError("contains only values in voxels. Pass a file with values at vertices")
    if structure is not None:
        model = cifti_structure(structure)
        if model not in models:
            raise InputError(f"contains {', '.join(map(_short, models))}, but the surface belongs to {_short(model)}")
        return model
    fitting = [name for name in models if sizes[name] == points]
    if len(fitting) != 1:
        listing = f"{', '.join(map(_short, fitting or models))}, {'each' if fitting else 'none'} with {points} vertices"
        remedy = "Define AnatomicalStructurePrimary in the surface's GIFTI file, or begin its name with lh. or rh."
        raise InputError(f"contains {listing}, and the hemisphere of the surface is unknown. {remedy}")
    return fitting[0]


def cifti_structure(structure: str) -> str:
    """Return the name in CIFTI files of a structure in GIFTI notation, such as "CortexLeft"."""
    return "CIFTI_STRUCTURE_" + re.sub(r"(?<!^)(?=[A-Z])", "_", structure).upper()


def _short(name: str) -> str:
    return name.removeprefix("CIFTI_STRUCTURE_")
