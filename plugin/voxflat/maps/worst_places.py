"""The worst places of a map, as they are told and saved, and the cuts that relieve them."""

import os
import re
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import checked_path, is_whole
from voxflat.errors import InputError
from voxflat.io.files import atomic_path
from voxflat.io.grid import in_unit
from voxflat.io.provenance import Record, Recorded, as_text, saving
from voxflat.maps.flat_map import FlatMap

WORST_ENDINGS = (".json", ".tsv")  # endings of the files that `WorstPlaces.save` writes

_MOST = 10.0  # of |log2| of a triangle's areas that is counted: one that has none on the map would be all there is


@dataclass(frozen=True, eq=False)
class RelievingCut:
    """A cut that relieves a place of a map.

    Parameters
    ----------
    ids : ndarray of int64, shape (k,) or (k, 3)
        The vertices along it, or their voxels, from inside the map to its border.
    points : ndarray of float64, shape (k, 3)
        Where they are on the surface, mm.
    uv : ndarray of float64, shape (k, 2)
        Where they are on the map, mm.
    length : float
        mm.
    gain : float
        By how much less a sketch of the map gets distances wrong with it, as a fraction: what relaxation cuts are
        judged by. Negative where distances get worse, which a cut that mends areas may cost; NaN where there is no
        sketch.

    Examples
    --------
    >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    >>> worst.places[0].cut
    <RelievingCut along 19 vertices, length 38.5, gain -0.97 %>
    """

    ids: NDArray[np.int64]
    points: NDArray[np.float64]
    uv: NDArray[np.float64]
    length: float
    gain: float

    def __repr__(self) -> str:
        return f"<RelievingCut along {len(self.ids)} vertices, length {self.length:.1f}, gain {100 * self.gain:.2f} %>"


@dataclass(frozen=True, eq=False)
class WorstPlace:
    """A connected part of a map whose area is stretched, or shrunk, beyond a factor.

    Parameters
    ----------
    number : int
        From 1, the worst, on.
    kind : {"stretched", "shrunk"}
        What happens to its area.
    area : float
        Its area on the surface, mm².
    share : float
        Of the whole surface's.
    excess : float
        How much distortion it holds, by which places are ranked: Σ A_surface |log2(A_flat / A_surface)|, mm².
    worst_ratio, median_ratio : float
        A_flat / A_surface of the triangle where it is farthest from 1, and the median by area, at the scale that keeps
        the area of the whole.
    point : ndarray of float64, shape (3,)
        Its centre on the surface, mm: one of its vertices.
    uv : ndarray of float64, shape (2,)
        That on the map, mm.
    id : ndarray of int64, shape () or (3,)
        The number of that vertex, or its voxel.
    triangles : ndarray of int64, shape (k,)
        Numbers of the map's triangles.
    parcel : str or None
        The parcel that holds most of it, where parcels were given.
    cut : RelievingCut or None
        Which cut relieves it; None where none was asked for, or no way leads from it to the border.
    unit : str
        Of lengths; "unknown" if nothing tells it.

    Examples
    --------
    >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    >>> worst.places[0].kind
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
        return f"<WorstPlace {self.number}: {self.kind}, area {self.area:.1f}, changed {self.worst_ratio:.2f} at worst>"

    def figures(self) -> dict[str, Any]:
        """Return it ready for JSON, without its triangles, with units in the names, such as ``area_mm2``.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> sorted(worst.places[0].figures())[:2]
        ['area_mm2', 'cut_gain']
        """
        at = {f"{axis}_mm": float(value) for axis, value in zip("xyzuv", (*self.point, *self.uv), strict=True)}
        told: dict[str, Any] = {
            "number": self.number,
            "kind": self.kind,
            "area_mm2": self.area,
            "share": self.share,
            "excess_mm2": self.excess,
            "worst_ratio": self.worst_ratio,
            "median_ratio": self.median_ratio,
            **at,
            "id": self.id.tolist(),
            "parcel": self.parcel,
        }
        gain = None if self.cut is None or np.isnan(self.cut.gain) else self.cut.gain
        told |= {"cut_length_mm": None if self.cut is None else self.cut.length, "cut_gain": gain}
        suffix = "" if self.unit == "unknown" else "_" + self.unit.replace("µ", "u")
        return {re.sub("_mm(2?)$", rf"{suffix}\1" if suffix else "", name): value for name, value in told.items()}


@dataclass(frozen=True, eq=False)
class WorstPlaces(Recorded):
    """The worst places of a map, the worst first.

    Parameters
    ----------
    flat_map : FlatMap
        The map.
    beyond : float
        The factor beyond which areas change there.
    places : tuple of WorstPlace
        Fewer than were asked for, or none, where there are no more.
    found : int
        How many there are.
    share : float
        The share of the surface in all of them: as `area_beyond_1_5` of `TriangleFigures`, at this factor.
    sketch_error : float
        The mean relative error of distances in a sketch of the map, to which `RelievingCut.gain` refers; NaN where
        there is none.
    provenance : dict
        What made it.

    Examples
    --------
    >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
    >>> worst
    <WorstPlaces: 1 of 2 where areas change beyond 1.01 times, 87.69 % of the surface>
    """

    flat_map: FlatMap
    beyond: float
    places: tuple[WorstPlace, ...]
    found: int
    share: float
    sketch_error: float = np.nan
    provenance: Record = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"<WorstPlaces: {len(self.places)} of {self.found} where areas change by more than {self.beyond:g} times, "
            f"{100 * self.share:.2f} % of the surface>"
        )

    @cached_property
    def numbers(self) -> NDArray[np.int64]:
        """The number of the place that each triangle of the map belongs to, shape (F,); 0 for none."""
        numbers = np.zeros(len(self.flat_map.faces), dtype=np.int64)
        for place in self.places:
            numbers[place.triangles] = place.number
        return numbers

    @cached_property
    def logs(self) -> NDArray[np.float64]:
        """Of each triangle log2(A_flat / A_surface), at the scale that keeps the area of the whole, shape (F,).

        At most 10 either way, as of triangles without area on the map; NaN without area on the surface.
        """
        return area_changes(self.flat_map)[1]

    def cuts(self, *numbers: int) -> list[list[Any]]:
        """Return cuts that `flatten` takes as ``cuts``: those that the map has, and those that relieve places.

        Parameters
        ----------
        *numbers : int
            Of the places; by default all. Cuts that run into each other from different sides may part the surface.

        Returns
        -------
        list of lists
            Vertices one after another, or voxels. Give `flatten` the region again that the map was made of.

        Raises
        ------
        InputError
            If there is no place of that number.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> len(worst.cuts())
        1
        """
        metadata = self.flat_map.metadata
        known = [*(metadata.get("cuts") or []), *(cut["ids"] for cut in metadata.get("automatic_cuts", []))]
        return [list(path) for path in known] + [one.ids.tolist() for one in self._chosen(numbers)]

    def _chosen(self, numbers: tuple[int, ...]) -> list[RelievingCut]:
        for number in numbers:
            if not is_whole(number) or not 1 <= number <= len(self.places):
                raise InputError(f"There is no place {number!r}. Pass a number from 1 to {len(self.places)}.")
        wanted = numbers or range(1, len(self.places) + 1)
        return [place.cut for place in self.places if place.number in wanted and place.cut is not None]

    def save_cuts(
        self, path: str | os.PathLike[str], *numbers: int, sidecar: bool = False, overwrite: bool = False
    ) -> None:
        """Write `cuts` to a file that ``cuts`` of `flatten` takes, of a mesh with the vertices that the map has not.

        Parameters
        ----------
        path : path
            A JSON file, as `CutSurface.save` writes it.
        *numbers : int
            As in `cuts`.
        sidecar, overwrite
            As in `FlatMap.save`.

        Raises
        ------
        InputError
            If there is no place of that number, or it is a file that was read.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> worst.save_cuts("relieving_cuts.json")
        """
        content: dict[str, Any] = {"cuts": self.cuts(*numbers), "drop": []}
        if not self.flat_map.is_voxels:
            content["drop"] = np.setdiff1d(np.arange(self.flat_map.metadata["vertices"]), self.flat_map.ids).tolist()
        content["provenance"] = self.provenance
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(path) as beside:
            beside.write_text(as_text(content) + "\n", encoding="utf-8")

    def figures(self) -> dict[str, Any]:
        """Return all of it, without arrays of triangles, ready for JSON.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> sorted(worst.figures())[:2]
        ['beyond', 'found']
        """
        return {
            "beyond": self.beyond,
            "found": self.found,
            "share": self.share,
            "sketch_error": None if np.isnan(self.sketch_error) else self.sketch_error,
            "places": [place.figures() for place in self.places],
        }

    def table(self) -> str:
        """Return the places as a table of text.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> print(worst.table().splitlines()[0])
        2 places where areas change beyond 1.01 times, 87.69 % of the surface
        """
        share = f"{100 * self.share:.2f} % of the surface"
        about = f"{self.found} places where areas change by more than {self.beyond:g} times, {share}"
        if not self.places:
            return about
        names = ["", "area, mm²", "% of all", "area times", "median", "x, y, z, mm", "u, v, mm", "cut, mm", "gain, %"]
        rows = [[in_unit(name, self.flat_map.metadata) for name in names]]
        rows += [_row(place) for place in self.places]
        if any(place.parcel is not None for place in self.places):
            for row, parcel in zip(rows, ["parcel", *(place.parcel or "–" for place in self.places)], strict=True):
                row.append(parcel)
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(
                cell.ljust(width) if column in (0, 9) else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            for row in rows
        ]
        told = (
            []
            if np.isnan(self.sketch_error)
            else [f"gain: reduction of the distance error of a coarse preview map, {100 * self.sketch_error:.2f} %"]
        )
        return "\n".join([about, *(line.rstrip() for line in lines), *told])

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Write the places to a file.

        Parameters
        ----------
        path : path
            ``.json``, as `figures` has them, with `provenance`; or ``.tsv``, a row each.
        sidecar, overwrite
            As in `FlatMap.save`.

        Raises
        ------
        InputError
            If the path has another ending, or is a file that was read.
        OSError
            If it cannot be written.

        Examples
        --------
        >>> worst = voxflat.worst_places(voxflat.samples.hill().flatten(), 1, beyond=1.01)
        >>> worst.save("worst.tsv")
        """
        name = checked_path(path).name.lower()
        if not name.endswith(WORST_ENDINGS):
            raise InputError(f"Cannot save places as {checked_path(path).name}. Use a name that ends in .json or .tsv.")
        if name.endswith(".json"):
            text = as_text({**self.figures(), "provenance": self.provenance})
        else:
            rows = [place.figures() for place in self.places]
            unit = self.flat_map.metadata.get("unit", "mm")
            columns = list(rows[0] if rows else replace(_NO_PLACE, unit=unit).figures())
            cells = [["n/a" if row[name] is None else _cell(row[name]) for name in columns] for row in rows]
            text = "\n".join("\t".join(row) for row in [columns, *cells])
        with saving(path, self.provenance, sidecar=sidecar, overwrite=overwrite), atomic_path(path) as beside:
            beside.write_text(text + "\n", encoding="utf-8")


def _row(place: WorstPlace) -> list[str]:
    cut = ["–", "–"]
    if place.cut is not None:
        cut = [f"{place.cut.length:.1f}", "–" if np.isnan(place.cut.gain) else f"{100 * place.cut.gain:+.2f}"]
    return [
        f"{place.number} {place.kind}",
        f"{place.area:.1f}",
        f"{100 * place.share:.2f}",
        f"{place.worst_ratio:.2f}",
        f"{place.median_ratio:.2f}",
        *(", ".join(f"{value:.1f}" for value in at) for at in (place.point, place.uv)),
        *cut,
    ]


def _cell(value: object) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


_NO_PLACE = WorstPlace(
    0, "shrunk", 0.0, 0.0, 0.0, 1.0, 1.0, np.zeros(3), np.zeros(2), np.array(0), np.empty(0, dtype=np.int64)
)


def area_changes(flat_map: FlatMap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each triangle's area, mm², and log2 of its change at the whole's scale; NaN without area, −10 if lost."""
    assert flat_map.distortion.triangles is not None
    a, b = (flat_map.points[flat_map.faces[:, corner]] - flat_map.points[flat_map.faces[:, 0]] for corner in (1, 2))
    areas = np.linalg.norm(np.cross(a, b), axis=1) / 2
    a, b = (flat_map.uv[flat_map.faces[:, corner]] - flat_map.uv[flat_map.faces[:, 0]] for corner in (1, 2))
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log2(flat / areas) + 2 * np.log2(flat_map.distortion.triangles.equal_area_scale)
    return areas, np.where(areas > 0, np.clip(logs, -_MOST, _MOST), np.nan)
