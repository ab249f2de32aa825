"""Create a surface from a volume: repaired on request, with vertex positions finer than the grid."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_switch, log
from voxflat.errors import InputError
from voxflat.io.reading import check_room
from voxflat.io.sources import volume_of
from voxflat.io.volumes import Volume
from voxflat.surfaces.foreground import Foreground, PackedMask, Repair, in_c_order, poll_check, touching_labels
from voxflat.surfaces.manifold import SurfaceT
from voxflat.surfaces.noise import noise_in_handles, noise_in_parts

_MOST_REPAIRED = 0.01  # largest share of foreground voxels changed by default
_SHARE_BETWEEN = 0.5  # least share of border voxels with intermediate values

_A_SURFEL = 600  # bytes per face between foreground and background to create a surface; measured: 250 to 520


def of_volume(
    selected: Foreground,
    cls: type[SurfaceT],
    *,
    probability: object | None = None,
    sheet: bool | None = None,
    repair: str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> SurfaceT:
    """Create a surface from the foreground of a volume; see `voxflat.surface`."""
    sheet = None if sheet is None else checked_switch(sheet, "sheet")
    volume, mask = selected.volume, selected.mask
    check_room(_A_SURFEL * _surfels(mask, progress))
    if sheet is not False:
        _check_width(mask)
    changes: Repair | None = None
    level, placed_by = _level(volume, mask, selected.origin.threshold, probability, progress)
    warnings: list[str] = []
    touching = touching_labels(volume.data, mask, progress)
    _warn(noise_in_parts(mask, progress))
    if repair == "voxels" or (repair is None and not (_core.is_sheet(mask, progress) if sheet is None else sheet)):
        is_requested = repair == "voxels"
        mask, changes, warnings = _repaired(mask, volume, level, progress, is_requested=is_requested)
    core, voxels, details = _core.Surface.from_mask(mask, volume.affine.tolist(), level, sheet, threads, progress)
    origin = replace(selected.origin, is_sheet=details.pop("kind") == "sheet")
    details |= {} if changes is None else {"repair": changes._described()}
    details["placed_by"] = "a fit to the middle of the sheet" if origin.is_sheet else placed_by
    if details["conflicts"]:
        warnings.append(
            f"the sides of the voxel sheet conflict at {details['conflicts']} pairs of voxels: the sheet touches "
            "itself there, or has only one side, like a Möbius strip"
        )
    if not origin.is_sheet and (touched := _touched_sides(mask)):
        warnings.append(f"the foreground touches the border of the volume ({touched}); the surface is closed there")
    if touching:
        details["touching_labels"] = touching
        named = f"{', '.join(map(str, touching[:-1]))} and {touching[-1]}"
        warnings.append(
            f"labels {named} touch, so they form one surface. If they are different objects, choose one label"
        )
    packed = PackedMask(np.packbits(mask if repair == "voxels" else selected.mask), selected.origin, touching)
    return cls(core, voxels.astype(np.int64), origin, details, tuple(warnings), foreground=packed, repair=changes)


def _warn(warning: str | None) -> None:
    """Warn before the long work if the foreground looks like noise."""
    if warning:
        log.warning("%s", warning)


def _check_width(mask: NDArray[np.bool_]) -> None:
    """Raise an error for points and lines, whose voxels do not span a triangle."""
    count = np.count_nonzero(mask)
    if count > max(mask.shape):
        return
    voxels = np.argwhere(mask)
    if np.linalg.matrix_rank(voxels - voxels[0]) < 2:
        raise InputError(
            f"the foreground is a {'line' if count > 1 else 'point'} of {count} voxel(s), which has no surface. "
            "Choose a wider label or a lower threshold"
        )


def _touched_sides(mask: NDArray[np.bool_]) -> str:
    """Return the sides of the volume that the foreground touches, as text."""
    sides = [
        f"{'first' if end == 0 else 'last'} layer of axis {axis}"
        for axis in range(3)
        for end in (0, -1)
        if mask.take(end, axis).any()
    ]
    return ", ".join(sides)


def _level(
    volume: Volume,
    mask: NDArray[np.bool_],
    threshold: float | None,
    probability: object | None,
    progress: Progress | None,
) -> tuple[tuple[NDArray[np.float32], float] | None, str]:
    """Return the image with its value on the surface, or None, and a description of how vertices are placed."""
    if probability is not None:
        image = volume_of(probability).in_unit(volume.unit)
        if image.data.shape != mask.shape:
            shapes = f"shape {image.data.shape}, but the volume has shape {mask.shape}"
            raise InputError(f"the probability image has {shapes}. Resample the image")
        if image.is_placed and volume.is_placed and not np.allclose(image.affine, volume.affine, atol=1e-3):
            raise InputError("the affines of the probability image and of the volume differ. Resample the image")
        values = in_c_order(image.data, np.float32, progress)
        if not np.isfinite(values).all():
            raise InputError("the probability image has values that are not finite. Replace them with 0")
        level = 0.5 if threshold is None else float(threshold)
        return (values, level), f"the level {level:g} of {image.path.name if image.path else 'an image'}"
    if threshold is None or volume.data.dtype.kind != "f":
        return None, "a fit to the voxels"
    # in a mask stored as numbers, the level gives no positions finer than the grid
    values = in_c_order(volume.data, np.float32, progress)
    border = np.zeros_like(mask)
    for axis in range(3):
        poll_check(progress)
        is_between = np.diff(mask, axis=axis)
        np.moveaxis(border, axis, 0)[:-1] |= np.moveaxis(is_between, axis, 0)
        np.moveaxis(border, axis, 0)[1:] |= np.moveaxis(is_between, axis, 0)
    poll_check(progress)
    at_border = values[border]
    least, most = values.min(), values.max()
    between = np.mean((at_border > least) & (at_border < most)) if len(at_border) else 0.0
    if between < _SHARE_BETWEEN:
        return None, "a fit to the voxels"
    return (values, float(threshold)), f"the level {float(threshold):g} of the volume"


def _surfels(mask: NDArray[np.bool_], progress: Progress | None) -> int:
    """Return the number of faces between foreground and background."""
    count = 0
    for axis in range(3):
        poll_check(progress)
        count += int(np.count_nonzero(np.diff(mask, axis=axis)))
    return count + sum(int(np.count_nonzero(mask.take(end, axis))) for axis in range(3) for end in (0, -1))


def _repaired(
    mask: NDArray[np.bool_],
    volume: Volume,
    level: tuple[NDArray[np.float32], float] | None,
    progress: Progress | None,
    *,
    is_requested: bool,
) -> tuple[NDArray[np.bool_], Repair | None, list[str]]:
    """Return the foreground without handles, the repair and warnings.

    On request, its surface becomes a sphere. Otherwise only the handles of the largest component are closed or opened,
    if that changes few voxels.
    """
    solid, report = _core.repair(mask, volume.spacing.tolist(), _likely(level), progress)
    repair = Repair(**report)
    _warn(noise_in_handles(repair.handles))
    removed, added = len(repair.cut), len(repair.filled)
    share = (removed + added) / np.count_nonzero(mask)
    changes = f"{removed} voxels removed, {added} added ({100 * share:.2g} %)"
    warning = f"repaired {repair.handles} handle(s): {changes}"
    if is_requested:
        warnings = [warning] if removed or added else []
        if len(repair.dropped) or len(repair.cavities):
            warnings.append(
                f"removed {len(repair.dropped)} voxels of smaller components and added {len(repair.cavities)} "
                "voxels of enclosed cavities"
            )
        return solid, repair, warnings
    if not repair.handles:
        return mask, None, []
    if share > _MOST_REPAIRED:
        warning = (
            f"{repair.handles} handle(s) remain, because removing them would change many voxels ({changes}). Use "
            "repair='voxels' to remove them"
        )
        return mask, None, [warning]
    solid = mask.copy()
    solid[tuple(repair.cut.T)] = False
    solid[tuple(repair.filled.T)] = True
    repair = replace(repair, dropped=repair.dropped[:0], cavities=repair.cavities[:0])
    return solid, repair, [f"{warning}. Use repair='none' to keep them"]


def _likely(level: tuple[NDArray[np.float32], float] | None) -> NDArray[np.float32] | None:
    """Return the image as probabilities, if its values allow it."""
    return level[0] if level is not None and level[0].min() >= 0 and level[0].max() <= 1 else None
