"""Divide the grey matter of a rim into columns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from voxflat import _core
from voxflat.arguments import Progress, checked_seed, is_number, is_whole, log, shown
from voxflat.errors import InputError
from voxflat.io.provenance import Record, Recorded
from voxflat.io.volumes import Volume
from voxflat.laminar.field import Field
from voxflat.laminar.labels import INNER, OUTER, Layered
from voxflat.maps.depth import vertex_areas
from voxflat.pipeline.surface import Surface
from voxflat.read_only import ReadOnly
from voxflat.surfaces.uncertainty import PLACED

_FAR = np.inf  # mm, no limit
_MOSTLY = 0.5  # of the voxels of a column


@dataclass(frozen=True, eq=False, repr=False)
class Columns(ReadOnly, Recorded):
    """Columns of the grey matter of a rim, made by `Rim.columns`.

    Columns are numbered from 1. Each reaches from the inner to the outer border, except where the labels of a border
    end, and its voxels are connected.

    Parameters
    ----------
    volume : Volume
        The column of each voxel of grey matter as int32; 0 elsewhere.
    vertex_columns : ndarray of int32, shape (V,)
        The column of each vertex of the middle surface, which is `Rim.surface`; 0 for none.
    centres : ndarray, shape (N, 3)
        The sources of the columns on the middle surface, in RAS+ mm.
    areas : ndarray, shape (N,)
        The area of each column on the middle surface, in mm².
    uncertain : ndarray, shape (N,)
        The share of the voxels of each column whose depth is uncertain.
    provenance : dict
        The record of how the columns were made.

    See Also
    --------
    Rim.columns : Make columns.

    Examples
    --------
    >>> voxflat.rim(voxflat.samples.rim()).columns(50)
    <Columns: 50 columns, median area 3.07 mm²>
    """

    volume: Volume
    vertex_columns: NDArray[np.int32]
    centres: NDArray[np.float64]
    areas: NDArray[np.float64]
    uncertain: NDArray[np.float64]
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Columns: {len(self)} columns, median area {float(np.median(self.areas)):.2f} mm²>"

    def __len__(self) -> int:
        """Return the number of columns."""
        return len(self.areas)


def columns_of(
    labels: Layered,
    values: Field,
    surface: Surface,
    count: object,
    area: object,
    seed: int,
    progress: Progress | None,
) -> Columns:
    """Divide the middle surface into geodesic Voronoi cells, and assign each voxel to the cell of its column."""
    areas = vertex_areas(surface.points, surface.faces)
    has_column = np.isfinite(values.halfway[:, 0])
    grey, halfway = labels.grey[has_column].astype(np.uint32), values.halfway[has_column]
    triangles, weights, _ = _core.NearestFinder(surface.points, surface.faces).find(halfway, _FAR)
    corners = surface.faces[triangles, weights.argmax(axis=1)]
    reached = np.unique(corners)  # a source among these has at least one voxel
    count = _count(count, area, len(reached), float(areas.sum()))
    sources, cells = surface.core.cells(reached.astype(np.uint32), count, checked_seed(seed), progress)
    connected = np.zeros(len(has_column), dtype=np.int32)
    connected[has_column], missed = _from_border_to_border(
        labels, values, surface, cells, grey, cells[corners], halfway, progress
    )
    if missed:
        log.warning(
            "%d of %d columns do not reach both borders, for example where the labels of a border end", missed, count
        )
    loose = int((connected[has_column] == 0).sum())
    if loose:
        log.warning(
            "%d of %d voxels of grey matter belong to no column, because none touches them", loose, len(connected)
        )
    sizes = np.bincount(connected, minlength=count + 1)[1:]
    uncertain = np.bincount(connected, values.uncertain > 0, count + 1)[1:] / sizes
    if mostly := int((uncertain > _MOSTLY).sum()):
        log.warning(
            "the depth of most voxels is uncertain in %d of %d columns; `uncertain` has the share of each",
            mostly,
            count,
        )
    return Columns(
        labels.in_volume(connected, 0),
        cells.astype(np.int32),
        surface.points[sources],
        np.asarray(np.bincount(cells, areas, count + 1)[1:], dtype=np.float64),
        uncertain,
    )


def _from_border_to_border(
    labels: Layered,
    values: Field,
    surface: Surface,
    cells: NDArray[np.uint32],
    grey: NDArray[np.uint32],
    columns: NDArray[np.uint32],
    halfway: NDArray[np.float64],
    progress: Progress | None,
) -> tuple[NDArray[np.uint32], int]:
    """Return the columns of voxels, made connected, and the number of those that do not reach both borders.

    Where columns narrow towards a border, other columns can contain all voxels there. A column that misses a border
    therefore takes the voxels on the straight lines from its part of the middle surface to that border.
    """
    has_column = np.isfinite(values.halfway[:, 0])
    beyond = ((1 - values.depth) * values.thickness)[has_column]  # to the outer border, which may have been placed
    is_placed = (values.uncertain[has_column] & PLACED > 0) & (beyond < np.linalg.norm(labels.volume.spacing))
    number = np.full(labels.labels.shape, -1, dtype=np.int32)
    number[tuple(grey.T)] = np.arange(len(grey))
    ends = []
    for label, places in ((INNER, surface.white_points), (OUTER, surface.pial_points)):
        assert places is not None
        touching = scipy.ndimage.binary_dilation(labels.labels == label, np.ones((3, 3, 3), dtype=np.bool_))
        is_touching = touching[tuple(grey.T)] | (is_placed if label == OUTER else False)
        ends.append((is_touching, places[surface.vertices] - surface.points))
    fewest = len(surface) + 1
    while True:
        columns = _core.connect_columns(grey, columns, halfway, progress)
        missing = [np.setdiff1d(cells[cells > 0], columns[is_touching]) for is_touching, _ in ends]
        missed = len(np.union1d(*missing))
        if missed == 0 or missed >= fewest:
            return columns, missed
        fewest, columns = missed, columns.copy()
        for of_end, (_, ways) in zip(missing, ends, strict=True):
            vertices = np.flatnonzero(np.isin(cells, of_end))
            steps = 2 * np.linalg.norm(ways[vertices], axis=1).max(initial=0) / labels.volume.spacing.min()
            for share in np.linspace(0, 1, int(steps) + 2):
                on_way = number[tuple(labels.voxels(surface.points[vertices] + share * ways[vertices]).T)]
                columns[on_way[on_way >= 0]] = cells[vertices[on_way >= 0]]


def check_number(count: object, area: object) -> None:
    """Check that either a number of columns or their area is given, and that it is positive."""
    if (count is None) == (area is None):
        raise InputError("pass either count, the number of columns, or area, their mean area in mm²")
    if area is not None and (not is_number(area) or not 0 < area < np.inf):
        raise InputError(f"area is {shown(area)}. Pass a positive number, in mm²")
    if area is None and (not is_whole(count) or count < 1):
        raise InputError(f"count is {shown(count)}. Pass a whole number of columns, at least 1")


def _count(count: Any, area: Any, points: int, total: float) -> int:
    """Return the number of columns for a number or an area."""
    check_number(count, area)
    text = f"{count} columns"
    if count is None:
        count = max(1, round(min(total / area, 1e9)))
        text = f"an area of {area:g} mm² gives {count} columns. They"
    if count > points:
        raise InputError(
            f"{text} exceed the {points} points of the middle surface that belong to voxels. Pass fewer or larger "
            "columns"
        )
    return int(count)
