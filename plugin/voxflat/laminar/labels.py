"""Read a rim: the grey matter and its inner and outer borders in one label volume, or in several masks."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat.arguments import is_whole, log, named_side, shown
from voxflat.errors import InputError
from voxflat.io.sources import as_volume
from voxflat.io.volumes import Volume
from voxflat.surfaces.foreground import check_scalar, keep_mask, labels_in

_CUBE = np.ones((3, 3, 3), dtype=np.bool_)

INNER, GREY, OUTER = 1, 2, 3
"""Labels of a `Layered` volume; 0 is unknown."""

_LAYNII = {"inner": 2, "outer": 1, "grey": 3}
_RIBBON = {"left": {"inner": 2, "outer": None, "grey": 3}, "right": {"inner": 41, "outer": None, "grey": 42}}
_ROUNDED = 0.01  # largest difference of a label from a whole number
_PAD = 6  # voxels around the labels, in which they are extended; fits of surfaces reach 4 of them


@dataclass(frozen=True, eq=False)
class Layered:
    """Store the labels of a rim in a box around it."""

    labels: NDArray[np.uint8]  # as given, with 0 where unknown
    extended: NDArray[np.uint8]  # each voxel has the label of the nearest labelled voxel
    first: NDArray[np.int64]  # voxel of the volume at the first corner of the box; negative outside the volume
    affine: NDArray[np.float64]  # from voxels of the box to RAS+ mm
    volume: Volume

    @property
    def grey(self) -> NDArray[np.int64]:
        """Voxels of grey matter in the box, (G, 3)."""
        return np.argwhere(self.labels == GREY)

    def places(self, voxels: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the centres of voxels of the box in RAS+ mm."""
        return moved(voxels, self.affine)

    def voxels(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the voxels of the box that contain points."""
        indices = np.rint(moved(points, np.linalg.inv(self.affine))).astype(np.int64)
        return np.asarray(indices.clip(0, np.array(self.labels.shape) - 1))

    def in_volume(self, values: NDArray[Any], outside: float) -> Volume:
        """Return a volume with a value, or a vector, for each voxel of grey matter."""
        data = np.full((*self.volume.data.shape, *values.shape[1:]), outside, dtype=values.dtype)
        data[tuple((self.grey + self.first).T)] = values
        return replace(self.volume, data=data, path=None, is_vectors=values.ndim == 2)


def moved(points: NDArray[Any], affine: NDArray[Any]) -> NDArray[np.float64]:
    """Return points moved by an affine matrix; four times as fast as a product of matrices."""
    moved = points[:, :1] * affine[:3, 0] + affine[:3, 3]
    for axis in (1, 2):
        moved += points[:, axis, None] * affine[:3, axis]
    return np.asarray(moved)


def layered(volume: Volume, parts: dict[str, object], hemisphere: str | None) -> Layered:
    """Return the labels of a rim; `parts` are the labels or masks of "inner", "outer" and "grey", or None."""
    check_scalar(volume.data)
    volume = _whole(volume)
    present = labels_in(volume.data) or {}
    codes = _codes(parts, present, hemisphere)
    where = {name: _selected(volume, name, code, present) for name, code in codes.items()}
    _check_overlap(where)
    labels = np.zeros(volume.data.shape, dtype=np.uint8)
    labels[where["inner"]] = INNER
    if codes["outer"] is None:
        labels[~where["inner"]] = OUTER
    else:
        labels[where["outer"]] = OUTER
    labels[where["grey"]] = GREY
    box = scipy.ndimage.find_objects(where["grey"].astype(np.uint8))[0]
    low, high = np.array([part.start for part in box]) - _PAD, np.array([part.stop for part in box]) + _PAD
    inside = tuple(map(slice, np.maximum(low, 0), np.minimum(high, labels.shape)))
    beyond = np.stack([np.maximum(-low, 0), np.maximum(high - labels.shape, 0)], axis=1)
    near = np.pad(labels[inside], beyond)
    affine = volume.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ low
    layers = Layered(near, _joined(_extended(labels[inside], beyond, volume)), low, affine, volume)
    _check_borders(layers, codes)
    return layers


def _extended(labels: NDArray[np.uint8], beyond: NDArray[np.int64], volume: Volume) -> NDArray[np.uint8]:
    """Return labels with voxels added `beyond` both ends of each axis; unknown ones take the nearest label."""
    if labels.all():  # the nearest voxel of a box is that of its border
        return np.pad(labels, beyond, mode="edge")
    labels = np.pad(labels, beyond)
    nearest = scipy.ndimage.distance_transform_edt(
        labels == 0, sampling=volume.spacing, return_distances=False, return_indices=True
    )
    return np.asarray(labels[tuple(nearest)])


def grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask with the 26 neighbours of its voxels."""
    for axis in range(mask.ndim):
        after, before = _along(axis, np.s_[1:]), _along(axis, np.s_[:-1])
        wider = mask.copy()
        wider[before] |= mask[after]
        wider[after] |= mask[before]
        mask = wider
    return mask


def reached(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """Return a mask with the voxels that are reached in a number of steps to one of the six direct neighbours."""
    for _ in range(steps):
        wider = mask.copy()
        for axis in range(mask.ndim):
            after, before = _along(axis, np.s_[1:]), _along(axis, np.s_[:-1])
            wider[before] |= mask[after]
            wider[after] |= mask[before]
        mask = wider
    return mask


def _along(axis: int, part: slice) -> tuple[slice, ...]:
    """Return the index of a part of an array along one axis."""
    return (np.s_[:],) * axis + (part,)


def _joined(labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Join parts of a border that do not touch the grey matter, such as ventricles, to the other border around them."""
    near = grown(labels == GREY)
    joined: NDArray[np.uint8] = labels.copy()
    for label, other in ((INNER, OUTER), (OUTER, INNER)):
        parts, count = scipy.ndimage.label(labels == label)
        is_loose = np.ones(count + 1, dtype=np.bool_)
        is_loose[parts[near]] = is_loose[0] = False
        if is_loose.any() and not is_loose[1:].all():
            joined[is_loose[parts]] = other
    return joined


def loose(layers: Layered) -> NDArray[np.bool_]:
    """Return which voxels of grey matter belong to parts that do not touch both borders."""
    parts, count = scipy.ndimage.label(layers.labels == GREY, _CUBE)
    is_tied = np.ones(count + 1, dtype=np.bool_)
    for label in (INNER, OUTER):
        beside = np.zeros(count + 1, dtype=np.bool_)
        beside[parts[grown(layers.labels == label)]] = True
        is_tied &= beside
    return np.asarray(~is_tied[parts[layers.labels == GREY]])


def _whole(volume: Volume) -> Volume:
    """Return a volume whose labels are whole numbers; values such as 2.9999 are rounded, with a warning."""
    data = volume.data
    if data.dtype.kind != "f":
        return volume
    if not np.isfinite(data).all():
        raise InputError("the rim contains NaN or infinite values. Replace them by 0")
    rounded = np.rint(data)
    difference = float(np.abs(data - rounded).max())
    if difference > _ROUNDED:
        value = data.flat[int(np.abs(data - rounded).argmax())]
        raise InputError(
            f"the rim contains the value {value:g}, which is not a label. Resample the rim with nearest-neighbour "
            "interpolation"
        )
    if difference > 0:
        log.warning("the labels of the rim differ from whole numbers by up to %.2g and were rounded", difference)
    return replace(volume, data=rounded.astype(np.int32))


def _codes(parts: dict[str, object], present: dict[int, int], hemisphere: str | None) -> dict[str, object]:
    """Return the labels or masks of the parts: as given, or those of LayNii or the FreeSurfer ribbon."""
    if hemisphere is not None:
        hemisphere = named_side(hemisphere, "hemisphere")
    if all(part is None for part in parts.values()):
        if hemisphere is not None:
            if _LAYNII["outer"] in present:
                raise InputError(
                    "hemisphere applies to FreeSurfer's ribbon, but this rim has the label 1. Omit hemisphere"
                )
            return dict(_RIBBON[hemisphere])
        if 42 in present and 41 in present:
            raise InputError(
                "the volume has the labels 41 and 42 of FreeSurfer's ribbon. Pass hemisphere='left' or 'right'"
            )
        return dict(_LAYNII)
    if hemisphere is not None:
        raise InputError(
            "hemisphere selects the labels of FreeSurfer's ribbon. Pass hemisphere alone, or pass inner, outer and grey"
        )
    for name in ("inner", "grey"):
        if parts[name] is None:
            raise InputError(f"{name} is missing. Pass inner and grey together, each a label or a mask")
    return parts


def _selected(volume: Volume, name: str, code: object, present: dict[int, int]) -> NDArray[np.bool_]:
    """Return the voxels of a part, given by a label or a mask."""
    if code is None:
        return np.zeros(volume.data.shape, dtype=np.bool_)
    if not is_whole(code):
        if isinstance(code, bool | float):
            raise InputError(f"{name} is {shown(code)}. Pass a label (a whole number) or a mask")
        mask = as_volume(code)
        is_selected = keep_mask(mask, volume, f"mask of the {_NAMES[name]}")
        values = np.unique(mask.data[is_selected])
        if len(values) > 1:
            raise InputError(
                f"the mask of the {_NAMES[name]} has several values ({values[0]:g} to {values[-1]:g}). Pass a mask "
                "with one value other than 0"
            )
        return is_selected
    is_code = np.asarray(volume.data == code)
    if not is_code.any():
        labels = ", ".join(map(str, sorted(present)[:10])) or "none"
        remedy = "Pass the labels as inner, outer and grey"
        for side, ribbon in _RIBBON.items():
            if {ribbon["inner"], ribbon["grey"]} <= present.keys() and 1 not in present:
                remedy += f", or hemisphere={side!r} for FreeSurfer's ribbon"
        raise InputError(
            f"the rim has no voxel with the label {code} ({_NAMES[name]}); its labels are {labels}. {remedy}"
        )
    return is_code


def _check_overlap(where: dict[str, NDArray[np.bool_]]) -> None:
    """Warn of voxels that belong to several parts; refuse a part that lies in another one."""
    for first, second in (("grey", "outer"), ("grey", "inner"), ("outer", "inner")):
        both = int((where[first] & where[second]).sum())
        if both and both == where[second].sum():
            raise InputError(f"the {_NAMES[second]} lies within the {_NAMES[first]}. Pass separate labels or masks")
        if both:
            log.warning(
                "%s voxels are %s and %s; they were assigned to the former", both, _NAMES[first], _NAMES[second]
            )


def _told(code: object) -> str:
    """Return the label in parentheses, or nothing for masks."""
    return f" (label {code})" if is_whole(code) else ""


_NAMES = {"inner": "inner border", "outer": "outer border", "grey": "grey matter"}


def _check_borders(layers: Layered, codes: dict[str, object]) -> None:
    """Check that the grey matter touches both borders, and that the inner border does not enclose the outer one."""
    near = grown(layers.labels == GREY)
    for name, label in (("inner", INNER), ("outer", OUTER)):
        if not (near & (layers.labels == label)).any():
            raise InputError(
                f"no voxel of the grey matter touches the {_NAMES[name]}{_told(codes[name])}. Check the labels"
            )
    ends = np.ones(layers.labels.shape, dtype=np.bool_)
    ends[1:-1, 1:-1, 1:-1] = False
    outermost = set(np.unique(layers.extended[ends]).tolist())
    if INNER in outermost and OUTER not in outermost:
        raise InputError(
            "the inner border encloses the outer border. Swap the labels that are passed as inner and outer"
        )
