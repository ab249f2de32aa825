"""What a volume holds, and whether its surface can be flattened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from voxflat._errors import InputError
from voxflat._foreground import foreground, labels_in
from voxflat._prepare import Progress, check_scalar, prepare
from voxflat.io import as_volume

__all__ = ["Check", "advise", "check"]


@dataclass(frozen=True)
class Check:
    """What was read, and whether its surface can be flattened.

    Parameters
    ----------
    path : str or None
        The file.
    shape : tuple of 3 ints
        Voxels along each axis.
    dtype : str
        Type of the values.
    spacing : tuple of 3 floats
        Voxel size, mm.
    orientation : str
        Directions of the axes, such as "RAS".
    affine : list of 4 lists of 4 floats
        From voxel indices to RAS+ mm.
    labels : dict of int to int, or None
        Labels and their numbers of voxels; None for intensities.
    range : tuple of 2 floats
        Smallest and largest value.
    foreground : int or None
        Number of foreground voxels; None if label or threshold are still to be chosen.
    surface_voxels : int or None
        Number of surface voxels.
    components : tuple of int
        Numbers of surface voxels of the components, largest first; the first one (or the patch) is used.
    used : int or None
        Number of surface voxels that would be flattened.
    euler_characteristic : int or None
        χ of what would be flattened: 1 is a disk, 2 a closed sphere; every handle, hole and touching bank takes one
        away.
    cavities : int or None
        Enclosed cavities of what would be flattened.
    closed : bool or None
        Whether it is a closed surface.
    can_flatten : bool
        The verdict.
    advice : tuple of str
        What to do.
    """

    path: str | None
    shape: tuple[int, ...]
    dtype: str
    spacing: tuple[float, ...]
    orientation: str
    affine: list[list[float]]
    labels: dict[int, int] | None
    range: tuple[float, float]
    foreground: int | None
    surface_voxels: int | None
    components: tuple[int, ...]
    used: int | None
    euler_characteristic: int | None
    cavities: int | None
    closed: bool | None
    can_flatten: bool
    advice: tuple[str, ...]

    def table(self) -> str:
        """Return the findings as a table of text."""
        labels = "intensities" if self.labels is None else _shortened([f"{k} ({n})" for k, n in self.labels.items()])
        rows = [
            ("input", self.path or "array"),
            ("shape", " x ".join(str(n) for n in self.shape) + f", {self.dtype}"),
            ("spacing", " x ".join(f"{h:g}" for h in self.spacing) + " mm"),
            ("orientation", self.orientation),
            ("values", f"{self.range[0]:g} to {self.range[1]:g}"),
            ("labels (voxels)", labels),
        ]
        if self.foreground is not None:
            rows += [
                ("foreground", f"{self.foreground} voxels"),
                ("surface", f"{self.surface_voxels} voxels"),
                ("components", f"{len(self.components)}: {_shortened([str(n) for n in self.components], 5)}"),
                ("used", f"{self.used} voxels"),
                ("Euler characteristic", f"{self.euler_characteristic} (disk: 1, closed sphere: 2)"),
                ("closed", "yes" if self.closed else "no"),
            ]
        rows.append(("can be flattened", "yes" if self.can_flatten else "no"))
        text = [f"{name:22}{value}" for name, value in rows]
        return "\n".join(text + [f"- {advice}" for advice in self.advice])


def check(
    surface: object,
    *,
    label: int | None = None,
    threshold: float | None = None,
    spacing: Sequence[float] | None = None,
    affine: ArrayLike | None = None,
    keep: object | None = None,
    seed_point: Sequence[int] | None = None,
    radius: float | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Check:
    """Say what a volume holds and whether its surface can be flattened.

    Parameters
    ----------
    surface, label, threshold, spacing, affine, keep, seed_point, radius, memory_limit, progress
        As in `flatten`.

    Returns
    -------
    Check

    Raises
    ------
    InputError
        If the volume cannot be read, or a label, threshold or patch was given that does not fit.
    """
    volume = as_volume(surface, spacing=spacing, affine=affine)
    check_scalar(volume)
    what_is_there: dict[str, Any] = {
        "path": None if volume.path is None else str(volume.path),
        "shape": volume.data.shape,
        "dtype": str(volume.data.dtype),
        "spacing": tuple(float(h) for h in volume.spacing),
        "orientation": volume.orientation,
        "affine": volume.affine.tolist(),
        "labels": labels_in(volume.data),
        "range": (float(volume.data.min()), float(volume.data.max())),
    }
    nothing: dict[str, Any] = dict.fromkeys(
        ("foreground", "surface_voxels", "used", "euler_characteristic", "cavities", "closed")
    )
    if label is None and threshold is None:
        try:
            foreground(volume.data)
        except InputError as error:
            return Check(**what_is_there, **nothing, components=(), can_flatten=False, advice=(str(error),))
    prepared = prepare(
        volume, label, threshold, None, None, keep, seed_point, radius, "chain-code", memory_limit, progress
    )
    sizes = tuple(prepared.whole.component_sizes())
    topology = prepared.part.topology(progress)
    has_patch = keep is not None or seed_point is not None
    return Check(
        **what_is_there,
        foreground=prepared.foreground,
        surface_voxels=len(prepared.whole),
        components=sizes,
        used=len(prepared.part),
        **topology,
        can_flatten=not topology["closed"] and len(prepared.part) >= 3,
        advice=(*prepared.remarks, *advise(sizes, topology, len(prepared.part), has_patch)),
    )


def advise(sizes: tuple[int, ...], topology: dict[str, Any], used: int, has_patch: bool) -> list[str]:
    advice = []
    if len(sizes) > 1 and not has_patch:
        advice.append(f"{len(sizes)} components: the largest, {used} of {sum(sizes)} surface voxels, is used")
    if used < 3:
        advice.append(f"only {used} surface voxels: take a larger label or patch")
    if topology["closed"]:
        advice.append(
            "closed surface: cut out a patch with a seed point and a radius in mm, or with a mask of what to keep"
        )
    elif topology["euler_characteristic"] != 1:
        advice.append(
            f"Euler characteristic {topology['euler_characteristic']} instead of a disk's 1: the patch has holes, "
            "handles, or banks that touch, across which distances jump. A smaller patch or a finer volume helps"
        )
    return advice


def _shortened(items: list[str], most: int = 12) -> str:
    return ", ".join(items[:most]) + (f" and {len(items) - most} more" if len(items) > most else "")
