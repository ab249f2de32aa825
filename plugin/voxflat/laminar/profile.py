"""Compute profiles: the mean and standard deviation of a volume along cortical depth, within regions."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import NDArray

from voxflat import display
from voxflat.arguments import checked_choice
from voxflat.errors import InputError
from voxflat.io.channels import distinct_names
from voxflat.io.notebook import page
from voxflat.io.provenance import Record
from voxflat.io.saved import Saved
from voxflat.io.tables import aligned, cell_of, write_table
from voxflat.laminar.painting import on_map
from voxflat.maps.colours import all_whole
from voxflat.maps.missing import NAN_POLICIES, is_defined
from voxflat.maps.regions import Regions
from voxflat.maps.sampling import Coverage, Sampling, SharedWeights, are_centres, sample
from voxflat.maps.sources import VolumeSource
from voxflat.maps.surface_points import SurfacePoints
from voxflat.maps.volume_place import warn_of_extent
from voxflat.read_only import ReadOnly

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PROFILE_ENDINGS = (".tsv", ".csv")  # of the files of `Profile.save`

_GREY = "grey matter"
_INTERPOLATIONS = ("linear", "nearest")
_LARGEST_LABEL = 2**31 - 1


@dataclass(frozen=True, eq=False)
class Profile(ReadOnly, Saved):
    """Mean and standard deviation of a volume in layers of grey matter, for one or several regions.

    `Rim.profile` returns it. Arrays have shape (R, L) for R regions and L layers, or (R, L, C) if the volume has
    several channels.

    Parameters
    ----------
    keys : tuple of int
        Label of each region.
    names : tuple of str
        Name of each region.
    depths : ndarray of float64, shape (L,)
        Depth at the centre of each layer, from 0 at the inner border (white matter) to 1 at the outer border
        (cerebrospinal fluid).
    mean : ndarray of float64, shape (R, L) or (R, L, C)
        Mean over the voxels; NaN in layers without voxels.
    sd : ndarray of float64, shape (R, L) or (R, L, C)
        Standard deviation between the voxels, with the denominator n - 1; NaN in layers with fewer than two voxels.
    voxels : ndarray of int64, shape (R, L) or (R, L, C)
        Number of voxels with a value.
    missing : ndarray of int64, shape (R,) or (R, C)
        Number of voxels of each region at which the volume has no finite value.
    layering : {"equivolume", "equidistant"}
        Whether layers have equal volumes or equal thicknesses.
    channels : tuple of str
        Names or numbers of the channels; empty for a single one.
    name : str
        File name of the volume; empty if it is not a file.
    provenance : dict
        The record of how the profile was made.

    See Also
    --------
    Rim.profile : Compute a profile.

    Examples
    --------
    >>> rim = voxflat.rim(voxflat.samples.rim())
    >>> rim.profile(rim.thickness(), count=10)
    <Profile: 10 equivolume layers, region grey matter, 5680 voxels>
    """

    _kind = "a profile"
    _endings = PROFILE_ENDINGS
    _formats = """
    ``.tsv`` and ``.csv`` are tables with the columns region, layer (from 1 at the inner border), depth, mean, sd,
    voxels and, if there are several, channel. Undefined values are written as ``n/a``.
    """

    keys: tuple[int, ...]
    names: tuple[str, ...]
    depths: NDArray[np.float64]
    mean: NDArray[np.float64]
    sd: NDArray[np.float64]
    voxels: NDArray[np.int64]
    missing: NDArray[np.int64]
    layering: str
    channels: tuple[str, ...] = ()
    name: str = ""
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        count = len(self.names)
        regions = f"region {self.names[0]}" if count == 1 else f"{count} regions"
        channels = f", {len(self.channels)} channels" if self.channels else ""
        voxels = self.voxels.sum(axis=(0, 1)).max()
        return f"<Profile: {len(self.depths)} {self.layering} layers, {regions}{channels}, {voxels} voxels>"

    def _repr_html_(self) -> str:
        """Return a table of the values, for Jupyter."""
        return page(self, self.table())

    def _rows(self) -> Iterator[tuple[str, int, float, float, float, int, str]]:
        """Yield region, layer, depth, mean, sd, voxels and channel for each value."""
        for place in np.ndindex(self.mean.shape):
            region, layer, *channel = place
            values = float(self.depths[layer]), float(self.mean[place]), float(self.sd[place]), int(self.voxels[place])
            yield (self.names[region], layer + 1, *values, self.channels[channel[0]] if channel else "")

    @property
    def _columns(self) -> list[str]:
        return ["region", "layer", "depth", "mean", "sd", "voxels", *(["channel"] if self.channels else [])]

    def table(self) -> str:
        """Return a table of the values as text.

        There is one row per region, layer and channel. Undefined values are shown as dashes.

        Returns
        -------
        str
            The table.

        Examples
        --------
        >>> rim = voxflat.rim(voxflat.samples.rim())
        >>> print(rim.profile(rim.depth(), count=2).table())
        region       layer  depth    mean      sd  voxels
        grey matter      1   0.25  0.2504  0.1449    2920
        grey matter      2   0.75  0.7433  0.1391    2760
        """
        rows = []
        for region, layer, depth, mean, sd, voxels, channel in self._rows():
            numbers = ("–" if np.isnan(value) else f"{value:.4g}" for value in (mean, sd))
            rows.append([region, str(layer), f"{depth:.4g}", *numbers, str(voxels), *([channel] if channel else [])])
        return aligned([self._columns, *rows])

    def _write(self, path: Path) -> None:
        rows = (
            [region, str(layer), f"{depth:.6g}", *(cell_of(value, ".8g") for value in (mean, sd)), str(voxels)]
            + ([channel] if channel else [])
            for region, layer, depth, mean, sd, voxels, channel in self._rows()
        )
        write_table(path, [self._columns, *rows])

    @overload
    def plot(self, *, label: str | None = None, ax: None = None) -> "Figure": ...

    @overload
    def plot(self, *, label: str | None = None, ax: "Axes") -> "Axes": ...

    def plot(self, *, label: str | None = None, ax: "Axes | None" = None) -> "Figure | Axes":
        """Draw the profile with matplotlib.

        It accepts the options of `voxflat.figures.profile`.

        Parameters
        ----------
        label : str, optional
            Label of the vertical axis, with the unit.
        ax : matplotlib.axes.Axes, optional
            Axes to draw in; by default, a new figure is created.

        Returns
        -------
        matplotlib.axes.Axes or matplotlib.figure.Figure
            `ax`, or the new figure.

        Raises
        ------
        InputError
            As in `voxflat.figures.profile`.
        """
        figure = display.views.profile(self, label=label, ax=ax)
        return figure if ax is None else ax


@dataclass(frozen=True, eq=False)
class Layers:
    """Store the layers of voxels."""

    of: NDArray[np.int16]  # (G,), from 0 at the inner border
    count: int
    layering: str


@dataclass(frozen=True, eq=False)
class Groups:
    """Store the regions of voxels."""

    keys: tuple[int, ...]
    names: tuple[str, ...]
    of: NDArray[np.int64]  # (G,), numbers from 0; -1 outside all regions


def groups_of(regions: object, voxels: SurfacePoints, halfway: NDArray[np.float64]) -> Groups:
    """Return the regions of voxels of grey matter; `halfway` are points of the middle surface on their columns."""
    if regions is None:
        return Groups((1,), (_GREY,), np.zeros(len(voxels.points), dtype=np.int64))
    if isinstance(regions, Regions):
        return _drawn(regions, voxels, halfway)
    labels = _labels(regions, voxels)
    keys = np.unique(labels[labels != 0])
    if len(keys) == 0:
        raise InputError("the regions contain no voxel of grey matter. Check that the affines match")
    group = np.where(labels != 0, np.searchsorted(keys, labels), -1)
    return Groups(tuple(keys.tolist()), tuple(map(str, keys.tolist())), group)


def _labels(regions: object, voxels: SurfacePoints) -> NDArray[np.int64]:
    """Return the labels of voxels in a mask or a volume of labels, shape (G,)."""
    source = VolumeSource.of(voxels, regions)
    if len(source.channels) > 1:
        raise InputError(f"the regions consist of {len(source.channels)} volumes. Pass a single volume of labels")
    volume = source.volume(0)
    warn_of_extent(voxels, volume)
    if volume.data.ndim != 3:
        raise InputError(f"the regions have shape {volume.data.shape}, as for colours. Pass a volume of labels")
    labels = np.nan_to_num(sample(volume, voxels.points, "nearest"), nan=0.0)
    if not all_whole(labels):
        value = labels[labels != np.round(labels)][0]
        raise InputError(f"the regions contain the value {value:g}, which is not a label. Pass a mask or whole numbers")
    if labels.min() < 0 or labels.max() > _LARGEST_LABEL:
        reason = f"the labels of regions range from {labels.min():g} to {labels.max():g}"
        raise InputError(f"{reason}. Use numbers from 1 to {_LARGEST_LABEL}")
    return np.asarray(labels.astype(np.int64))


def _drawn(regions: Regions, voxels: SurfacePoints, halfway: NDArray[np.float64]) -> Groups:
    """Return the regions on a map that contain the columns of voxels."""
    uv, is_on = on_map(regions.of, halfway, voxels.affine, voxels.origin.space)
    if not is_on.any():
        raise InputError(
            "no column of grey matter lies on the map of the regions. Draw regions on a map of rim.surface"
        )
    region = np.full(len(halfway), -1)
    keys = regions.at(uv)
    order = np.argsort(regions.keys)
    ranks = np.searchsorted(regions.keys, keys, sorter=order)
    region[is_on] = np.where(keys == 0, -1, order[ranks % len(order)])
    for name, count in zip(regions.names, np.bincount(region[region >= 0], minlength=len(regions)), strict=True):
        if count == 0:
            raise InputError(f"the region {name} contains no voxel of grey matter. Draw a larger region")
    return Groups(regions.keys, regions.names, region)


def profile_of(
    volume: object,
    voxels: SurfacePoints,
    groups: Groups,
    layers: Layers,
    channel: int | str | None,
    interpolation: str | None,
    nan_policy: str,
) -> Profile:
    """Return the profile of a volume."""
    checked_choice(nan_policy, "nan_policy", NAN_POLICIES)
    if interpolation is not None:
        checked_choice(interpolation, "interpolation", _INTERPOLATIONS)
    inside = groups.of >= 0
    group, bins = groups.of[inside], groups.of[inside] * layers.count + layers.of[inside]
    source, points = VolumeSource.of(voxels, volume), voxels.points[inside]
    weights, sampling = SharedWeights([points]), None
    numbers = range(len(source.channels)) if channel is None else [source.number(channel)]
    parts = []
    for number in numbers:
        frame = source.volume(number)
        if sampling is None:
            warn_of_extent(voxels, frame)
            # the nearest voxel ignores NaN in the voxels around
            sampling = Sampling(interpolation="nearest" if are_centres(frame, points) else interpolation)
        values = weights.sample(frame, sampling, Coverage())
        if values.ndim != 1:
            raise InputError("the volume contains colours, which have no mean. Pass a volume with one value per voxel")
        parts.append(_statistics(values, bins, group, (len(groups.keys), layers.count), nan_policy))
    mean, sd, counts, missing = (np.stack(part, axis=-1) for part in zip(*parts, strict=True))
    if not counts.any():
        raise InputError("the volume has no finite values in the grey matter of the regions. Check its affine")
    names = distinct_names(source.channels.names) if len(parts) > 1 else ()
    if not names:
        mean, sd, counts, missing = mean[..., 0], sd[..., 0], counts[..., 0], missing[..., 0]
    depths = (np.arange(layers.count) + 0.5) / layers.count
    title = "" if source.path is None else source.path.name
    return Profile(groups.keys, groups.names, depths, mean, sd, counts, missing, layers.layering, names, title)


def _statistics(
    values: NDArray[np.float64],
    bins: NDArray[np.int64],
    group: NDArray[np.int64],
    shape: tuple[int, int],
    nan_policy: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Return mean, standard deviation and number of voxels of each layer, and the number of voxels left out."""
    has_value = np.isfinite(values)
    bins_of_values, values = bins[has_value], values[has_value]
    size = shape[0] * shape[1]
    counts = np.bincount(bins_of_values, minlength=size)
    total = np.bincount(bins, minlength=size)
    mean = np.bincount(bins_of_values, values, size) / np.where(counts > 0, counts, np.nan)
    squares = np.bincount(bins_of_values, (values - mean[bins_of_values]) ** 2, size)
    sd = np.sqrt(squares / np.where(counts > 1, counts - 1, np.nan))
    mean[~is_defined(counts, total, nan_policy)] = sd[~is_defined(counts, total, nan_policy)] = np.nan
    missing = np.bincount(group[~has_value], minlength=shape[0])
    return mean.reshape(shape), sd.reshape(shape), counts.reshape(shape), missing
