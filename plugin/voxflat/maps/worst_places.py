"""The regions of highest distortion of a map, and the cuts that reduce it: results, tables and files."""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import is_whole
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit, key_in_unit
from voxflat.io.provenance import Record, as_text, saving
from voxflat.io.saved import Saved
from voxflat.io.tables import aligned
from voxflat.maps.flat_map import FlatMap
from voxflat.read_only import ReadOnly

WORST_ENDINGS = (".json", ".tsv")  # endings of the files that `WorstPlaces.save` writes

_GAIN = "gain: decrease of the relative distance error of a coarse preview map ({:.2f} %), in percentage points"
_MOST = 10.0  # limit of |log2 area change|, so that a triangle without area on the map does not dominate


@dataclass(frozen=True, eq=False)
class RelievingCut(ReadOnly):
    """A cut that reduces the distortion of a region of a map.

    `WorstPlaces.cuts` returns cuts in the form that `flatten` accepts.

    Parameters
    ----------
    ids : ndarray of int64, shape (k,) or (k, 3)
        Vertices or voxels along the cut, from the interior of the map to its border.
    points : ndarray of float64, shape (k, 3)
        Positions of these vertices on the surface, in mm.
    uv : ndarray of float64, shape (k, 2)
        Positions of these vertices on the map, in mm.
    length : float
        Length of the cut, in mm.
    gain : float
        Reduction of the relative distance error of a coarse preview map, as a fraction. Relaxation cuts are chosen by
        the same measure. It is negative if distances become worse, which can happen even if areas improve; NaN if there
        is no preview map.

    See Also
    --------
    worst_places : Find regions of highest distortion.

    Examples
    --------
    >>> voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01).places[0].cut
    <RelievingCut along 19 vertices, length 39.9, gain 2.60 %>
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    uv: NDArray[np.float64]
    length: float
    gain: float

    def __repr__(self) -> str:
        return f"<RelievingCut along {len(self.ids)} vertices, length {self.length:.1f}, gain {100 * self.gain:.2f} %>"


@dataclass(frozen=True, eq=False)
class WorstPlace(ReadOnly):
    """A connected region of a map whose area is stretched, or shrunk, by more than a given factor.

    Regions are ranked by `excess`.

    Parameters
    ----------
    number : int
        Rank of the region, from 1 for the worst.
    kind : {"stretched", "shrunk"}
        How its area changes.
    area : float
        Area of the region on the surface, in mm².
    share : float
        Area of the region as a fraction of the whole surface.
    excess : float
        Total distortion of the region, ``Σ A_surface |log2(A_flat / A_surface)|``, in mm².
    worst_ratio, median_ratio : float
        A_flat / A_surface of the triangle with the greatest change, and the area-weighted median, at the scale that
        preserves the total area.
    point : ndarray of float64, shape (3,)
        Centre of the region on the surface (one of its vertices), in mm.
    uv : ndarray of float64, shape (2,)
        The position of that vertex on the map, in mm.
    id : ndarray of int64, shape () or (3,)
        The number of that vertex, or its voxel.
    triangles : ndarray of int64, shape (k,)
        Triangles of the region, as row numbers of the map's triangles.
    parcel : str or None
        The parcel that contains the largest part of the region, if parcels were passed.
    cut : RelievingCut or None
        A cut that reduces the distortion of the region. None if cuts were not requested, or if no path connects the
        region to the border.
    unit : str
        Unit of length; "unknown" if it is not defined.

    See Also
    --------
    worst_places : Find regions of highest distortion.

    Examples
    --------
    >>> voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01).places[0].kind
    'shrunk'
    """

    number: int
    kind: str
    area: float
    share: float
    excess: float
    worst_ratio: float
    median_ratio: float
    point: NDArray[np.float64]
    uv: NDArray[np.float64]
    id: NDArray[np.int64]
    triangles: NDArray[np.int64]
    parcel: str | None = None
    cut: RelievingCut | None = None
    unit: str = "mm"

    def __repr__(self) -> str:
        return f"<WorstPlace {self.number}: {self.kind}, area {self.area:.1f}, worst ratio {self.worst_ratio:.2f}>"

    def figures(self) -> dict[str, object]:
        """Return the measures of the region, ready for JSON.

        Names include units, such as ``area_mm2``. Triangles are not included.

        Returns
        -------
        dict
            The figures by name.
        """
        figures: dict[str, Any] = {"number": self.number, "kind": self.kind, "area_mm2": self.area, "share": self.share}
        figures |= {"excess_mm2": self.excess, "worst_ratio": self.worst_ratio, "median_ratio": self.median_ratio}
        figures |= {f"{axis}_mm": float(value) for axis, value in zip("xyzuv", (*self.point, *self.uv), strict=True)}
        gain = None if self.cut is None or np.isnan(self.cut.gain) else self.cut.gain
        figures |= {"id": self.id.tolist(), "parcel": self.parcel}
        figures |= {"cut_length_mm": None if self.cut is None else self.cut.length, "cut_gain": gain}
        return {key_in_unit(name, self.unit): value for name, value in figures.items()}


@dataclass(frozen=True, eq=False)
class WorstPlaces(ReadOnly, Saved):
    """The regions of highest distortion of a map, worst first.

    `voxflat.worst_places` returns them.

    Parameters
    ----------
    flat_map : FlatMap
        The map.
    beyond : float
        Smallest factor by which areas in these regions change.
    places : tuple of WorstPlace
        The regions; fewer than requested if the map has fewer.
    found : int
        Total number of regions on the map.
    share : float
        Fraction of the surface that all regions cover, like `area_beyond_1_5` of `TriangleFigures` but for this factor.
    sketch_error : float
        Mean relative distance error of the coarse preview map to which `RelievingCut.gain` refers; NaN if there is
        none.
    provenance : dict
        Record of how the regions were found.

    See Also
    --------
    worst_places : Find regions of highest distortion.

    Examples
    --------
    >>> voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    <WorstPlaces: 1 of 2 regions where areas change by more than a factor of 1.01 (88.89 % of the surface)>
    """

    _kind = "regions"
    _endings = WORST_ENDINGS
    _formats = """
    ``.json`` holds the result of `figures` and `provenance`; ``.tsv`` has one row per region.
    """

    flat_map: FlatMap
    beyond: float
    places: tuple[WorstPlace, ...]
    found: int
    share: float
    sketch_error: float = np.nan
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<WorstPlaces: {len(self.places)} of {self._about}>"

    @property
    def _about(self) -> str:
        regions, share = f"{self.found} region{'s' * (self.found != 1)}", f"{100 * self.share:.2f} % of the surface"
        return f"{regions} where areas change by more than a factor of {self.beyond:g} ({share})"

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """The number of the region that contains each map triangle, shape (F,).

        Triangles outside all regions have 0.
        """
        numbers = np.zeros(len(self.flat_map.faces), dtype=np.int64)
        for place in self.places:
            numbers[place.triangles] = place.number
        return numbers

    @cached_property
    def logs(self) -> NDArray[np.float64]:
        """The change in area of each triangle, log2(A_flat / A_surface), shape (F,).

        It is relative to the scale that preserves the total area. Values are limited to ±10, because triangles may have
        no area on the map, and are NaN for triangles without area on the surface.
        """
        return area_changes(self.flat_map)[1]

    def cuts(self, *numbers: int) -> list[list[object]]:
        """Return the cuts of the map, and the cuts that reduce the distortion of regions.

        Pass the result to `flatten` as ``cuts``, with the same part of the surface.

        Parameters
        ----------
        *numbers : int
            Numbers of the regions; by default, all regions. Cuts that meet from different sides can divide the surface.

        Returns
        -------
        list of lists
            Paths of vertices or voxels.

        Raises
        ------
        InputError
            If there is no region with that number.
        """
        for number in numbers:
            if not is_whole(number) or not 1 <= number <= len(self.places):
                raise InputError(f"there is no region {number!r}. Pass a number from 1 to {len(self.places)}")
        chosen = (place.cut for place in self.places if not numbers or place.number in numbers)
        return [cut.ids.tolist() for cut in (*self.flat_map.cuts, *chosen) if cut is not None]

    def save_cuts(
        self, path: str | os.PathLike[str], *numbers: int, sidecar: bool = False, overwrite: bool = False
    ) -> None:
        """Save the cuts to a file that `flatten` accepts as ``cuts``.

        For a mesh, the file also lists the vertices that the map excludes.

        Parameters
        ----------
        path : path
            A JSON file, in the format of `CutSurface.save`.
        *numbers : int
            As in `cuts`.
        sidecar, overwrite : bool
            As in `FlatMap.save`.

        Raises
        ------
        InputError
            If there is no region with that number, or the path is an input file.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> worst.save_cuts("relieving_cuts.json")
        """
        content: dict[str, Any] = {"cuts": self.cuts(*numbers), "drop": []}
        if not self.flat_map.is_voxels:
            content["drop"] = np.setdiff1d(np.arange(self.flat_map.origin.mesh.vertices), self.flat_map.ids).tolist()
        content["provenance"] = self.provenance
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(path) as beside:
            beside.write_text(as_text(content) + "\n", encoding="utf-8", newline="\n")

    def figures(self) -> dict[str, object]:
        """Return the measures of all regions, ready for JSON.

        Triangles are not included.

        Returns
        -------
        dict
            The measures by name; ``places`` lists the measures of each region.
        """
        return {
            "beyond": self.beyond,
            "found": self.found,
            "share": self.share,
            "sketch_error": None if np.isnan(self.sketch_error) else self.sketch_error,
            "places": [place.figures() for place in self.places],
        }

    def table(self) -> str:
        """Return a table of the regions as text.

        There is one row per region.

        Returns
        -------
        str
            The table.
        """
        if not self.places:
            return self._about
        names = ["", "area, mm²", "share, %", "worst ratio", "median", "x, y, z, mm", "u, v, mm", "cut, mm", "gain"]
        rows = [[in_unit(name, self.flat_map.origin.named_unit) for name in names]]
        for place in self.places:
            cut = ["–", "–"]
            if place.cut is not None:
                cut = [f"{place.cut.length:.1f}", "–" if np.isnan(place.cut.gain) else f"{100 * place.cut.gain:+.2f}"]
            ratios = [f"{number:.2f}" for number in (100 * place.share, place.worst_ratio, place.median_ratio)]
            positions = [", ".join(f"{value:.1f}" for value in point) for point in (place.point, place.uv)]
            rows.append([f"{place.number} {place.kind}", f"{place.area:.1f}", *ratios, *positions, *cut])
        if any(place.parcel is not None for place in self.places):
            for row, parcel in zip(rows, ["parcel", *(place.parcel or "–" for place in self.places)], strict=True):
                row.append(parcel)
        gain = [] if np.isnan(self.sketch_error) else [_GAIN.format(100 * self.sketch_error)]
        return "\n".join([self._about, aligned(rows, left=(0, 9)), *gain])

    def _write(self, path: Path) -> None:
        if path.suffix.lower() == ".json":
            text = as_text({**self.figures(), "provenance": self.provenance})
        else:
            rows = [place.figures() for place in self.places]
            unit = self.flat_map.origin.named_unit
            columns = list(rows[0] if rows else replace(_NO_PLACE, unit=unit).figures())
            cells = [["n/a" if row[name] is None else _cell(row[name]) for name in columns] for row in rows]
            text = "\n".join("\t".join(row) for row in [columns, *cells])
        with atomic_path(path) as beside:
            beside.write_text(text + "\n", encoding="utf-8", newline="\n")


def _cell(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


_NO_PLACE = WorstPlace(
    0, "shrunk", 0.0, 0.0, 0.0, 1.0, 1.0, np.zeros(3), np.zeros(2), np.array(0), np.empty(0, dtype=np.int64)
)


def area_changes(flat_map: FlatMap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return triangle areas in mm² and log2 of their changes (NaN without area on the surface, −10 on the map)."""
    assert flat_map.distortion.triangles is not None
    a, b = (flat_map.points[flat_map.faces[:, corner]] - flat_map.points[flat_map.faces[:, 0]] for corner in (1, 2))
    areas = np.linalg.norm(np.cross(a, b), axis=1) / 2
    a, b = (flat_map.uv[flat_map.faces[:, corner]] - flat_map.uv[flat_map.faces[:, 0]] for corner in (1, 2))
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log2(flat / areas) + 2 * np.log2(flat_map.distortion.triangles.equal_area_scale)
    return areas, np.where(areas > 0, np.clip(logs, -_MOST, _MOST), np.nan)


class AreaBoundError(InputError):
    """Exception for a map whose area changes cannot be kept within ``Voxflat(max_area=...)``.

    It contains the best map that was found, and cuts that would reduce its area distortion.

    Parameters
    ----------
    message : str
        Description of the error and its remedy.
    best : FlatMap
        The best map that was found, which has the smallest maximum change of area.
    places : WorstPlaces
        The regions of this map that exceed the bound, with suggested cuts.

    See Also
    --------
    voxflat.worst_places : Find the regions of a map whose areas change most.
    voxflat.methods.Voxflat : The method that accepts the bound.

    Examples
    --------
    >>> bounded = voxflat.methods.Voxflat(max_area=1.02)
    >>> try:
    ...     voxflat.surface(voxflat.samples.ball()).flatten(bounded)
    ... except voxflat.AreaBoundError as error:
    ...     print(error.best)
    <FlatMap: 679 points, 46 x 36 mm, relative error 4.9 % of interior pairs, 5.3 % of all pairs at the best scale>
    """

    def __init__(self, message: str, best: FlatMap, places: WorstPlaces) -> None:
        super().__init__(message)
        self.best, self.places = best, places

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the exception with all its arguments."""
        return type(self), (str(self), self.best, self.places)
