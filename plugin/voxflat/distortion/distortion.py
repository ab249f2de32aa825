"""The distortion of a flat map, with all figures, and tables of one or several maps."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.distortion.bands import HUMAN, Bands, in_bands, key_in_bands
from voxflat.distortion.figures import Figures, StandardErrors, TriangleFigures, json_ready
from voxflat.io.grid import in_unit
from voxflat.io.notebook import page
from voxflat.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class Distortion(ReadOnly):
    """The distortion of a flat map, measured from random reference sources to all points.

    δ are geodesic distances on the surface, and d are distances in the map.

    Parameters
    ----------
    raw : Figures
        Measures at scale 1, that is, of the unscaled map.
    best_scale : Figures
        Measures at the scale with the smallest mean relative error.
    pearson_r : float
        Correlation of flat and geodesic distances.
    mean_geodesic : float
        Mean geodesic distance of the pairs, in mm (Grossmann et al. 2002: δ̄).
    standard_error : StandardErrors
        Standard errors of these measures.
    sources : int
        Number of reference sources.
    pairs : int
        Number of pairs.
    reference : {"exact", "graph", "chain"}
        How the reference distances were measured, as in `Surface.geodesic`.
    per_point : ndarray, shape (N,)
        Mean of ``|d − δ|/δ`` over the pairs of each point, at scale 1, as in the heat map.
    scatter : ndarray, shape (K, 2)
        A sample of pairs (δ, d) in mm.
    triangles : TriangleFigures or None
        Distortion of the triangles, if the surface has triangles.
    topology : dict or None
        Topology of the surface as cut by the map, if determined: ``components``, ``euler``, ``loops`` of the boundary
        and ``handles``.
    voxel_size : float or None
        Geometric mean of the three voxel spacings, in mm; None for meshes.
    unit : str
        Unit of length; "unknown" if it is not defined.
    interior : Figures or None
        Measures of interior pairs, whose shortest path does not pass the boundary between its ends, at the scale with
        the smallest mean relative error of these pairs: 0 for the flattened sheet of any outline. None for distances by
        chain codes.
    interior_share : float
        Share of interior pairs; NaN for distances by chain codes.
    bands : tuple of float
        Upper ends of the four distance bands of the measures, in the unit of the surface.
    lower_bound : float
        Mean relative error over all pairs, including bent ones, that no map of the surface with the same cuts can be
        below, at any scale; NaN unless `measure` was called with ``lower_bound``.

    See Also
    --------
    measure : Measure the distortion of any map.

    Examples
    --------
    >>> distortion = voxflat.samples.hill().flatten().distortion
    >>> round(distortion.raw.relative_error, 3)
    0.036
    """

    raw: Figures
    best_scale: Figures
    pearson_r: float
    mean_geodesic: float
    standard_error: StandardErrors
    sources: int
    pairs: int
    reference: str
    per_point: NDArray[np.float64]
    scatter: NDArray[np.float64]
    triangles: TriangleFigures | None = None
    topology: dict[str, int] | None = None
    voxel_size: float | None = None
    unit: str = "mm"
    interior: Figures | None = None
    interior_share: float = np.nan
    bands: Bands = HUMAN
    lower_bound: float = np.nan

    def __repr__(self) -> str:
        return (
            f"<Distortion: relative error {self._summary()}, {self.sources} sources, {self.pairs} pairs, "
            f"{self.reference} distances>"
        )

    def _summary(self) -> str:
        """Return the mean relative errors of interior pairs and of all pairs at their best scales, and the bound."""
        error = f"{100 * self.best_scale.relative_error:.1f} %"
        if self.interior is not None and not np.isnan(self.interior.relative_error):
            error = f"{100 * self.interior.relative_error:.1f} % of interior pairs, {error} of all pairs"
        bound = f"; no map can be better than {100 * self.lower_bound:.1f} % of all pairs"
        return f"{error} at the best scale" + ("" if np.isnan(self.lower_bound) else bound)

    @classmethod
    def _of(
        cls, distances: dict[str, Any], triangles: dict[str, Any] | None, reference: str, **more: Any
    ) -> "Distortion":
        """Return the measures that the compiled core has computed."""
        errors = dict(distances["standard_error"])
        for scales in (distances, errors):
            scales |= {name: Figures(**scales[name]) for name in ("raw", "best_scale")}
        distances["standard_error"] = StandardErrors(**errors)
        is_marked = not np.isnan(distances.setdefault("interior_share", np.nan))  # unknown in files of earlier versions
        distances["interior"] = Figures(**distances["interior"]) if is_marked else None
        of_triangles = None if triangles is None else TriangleFigures(**triangles)
        return cls(**distances, triangles=of_triangles, reference=reference, **more)

    def figures(self) -> dict[str, object]:
        """Return the distortion measures without the arrays, ready for JSON.

        Undefined measures are None. Names include the ends of the bands with their unit, such as
        ``relative_error_10mm`` or ``relative_error_40um``.

        Returns
        -------
        dict
            The measures by name; ``standard_error`` has the same keys.
        """
        return dict(_in_bands(self._described(), self.bands, self.unit))

    def _described(self) -> dict[str, Any]:
        """Return the measures for a file, keyed by field name, whatever the bands."""
        return dict(json_ready(_without_arrays(asdict(self))))

    def _repr_html_(self) -> str:
        """Return the table of the measures, for Jupyter."""
        return page(self, self.table())

    def in_words(self) -> str:
        """Describe the errors of distances and areas in one sentence, at the best scale, and the bound if it is known.

        Returns
        -------
        str
            The sentence.

        Examples
        --------
        >>> print(voxflat.samples.hill().flatten().distortion.in_words())
        Distances are off by 3.6 % on average (3.6 % of interior pairs), and 0 % of the area by more than 1.5 times.
        """
        near, parts = self.best_scale.relative_error_10mm, []
        if not np.isnan(near):
            parts.append(in_bands(f"{100 * near:.1f} % up to 10 mm", self.bands, self.unit))
        if self.interior is not None and self.interior_share < 1 and not np.isnan(self.interior.relative_error):
            parts.append(f"{100 * self.interior.relative_error:.1f} % of interior pairs")
        words = f"Distances are off by {100 * self.best_scale.relative_error:.1f} % on average"
        if parts:
            words += f" ({'; '.join(parts)})"
        beyond = np.nan if self.triangles is None else self.triangles.area_beyond_1_5
        words += "." if np.isnan(beyond) else f", and {100 * beyond:.0f} % of the area by more than 1.5 times."
        if not np.isnan(self.lower_bound):
            words += f" No map along the same cuts can be better than {100 * self.lower_bound:.1f} %."
        return words

    def table(self) -> str:
        """Return a table of the measures as text.

        Undefined measures are shown as dashes.

        Returns
        -------
        str
            The table.
        """
        errors = self.standard_error
        columns: list[tuple[Figures, Figures | None]] = [(self.raw, errors.raw), (self.best_scale, errors.best_scale)]
        heads = ["raw", f"at scale {_number(self.best_scale.scale, 3)}"]
        if self.interior is not None:
            columns.append((self.interior, None))
            heads.append(f"interior, at {_number(self.interior.scale, 3)}")
        rows = [["", *heads], *_distance_rows([self], columns, self.voxel_size), *_other_rows([self])]
        return _aligned([self], rows)


def _in_bands(figures: Any, bands: Bands, unit: str) -> Any:
    """Return figures with the bands in their names."""
    if not isinstance(figures, dict):
        return figures
    return {key_in_bands(name, bands, unit): _in_bands(value, bands, unit) for name, value in figures.items()}


def _without_arrays(values: dict[str, Any]) -> dict[str, Any]:
    """Remove the arrays from nested dictionaries."""
    plain = {key: value for key, value in values.items() if not isinstance(value, np.ndarray)}
    return {key: _without_arrays(value) if isinstance(value, dict) else value for key, value in plain.items()}


_FIRST = 26  # width of the first column

_DISTANCES = (
    ("relative error, %", "relative_error", 100.0, 2),
    ("  pairs up to 5 mm", "relative_error_0_5mm", 100.0, 2),
    ("  5 to 15 mm", "relative_error_5_15mm", 100.0, 2),
    ("  15 to 30 mm", "relative_error_15_30mm", 100.0, 2),
    ("  up to 10 mm", "relative_error_10mm", 100.0, 2),
    ("  up to 30 mm", "relative_error_30mm", 100.0, 2),
    ("absolute error, mm", "absolute_error", 1.0, 2),
    ("stress-1", "stress_1", 1.0, 4),
    ("Sammon stress", "sammon_stress", 1.0, 4),
)
_TRIANGLES = (
    ("area, log2: median", "areal_median", 1.0, 4),
    ("  95 %", "areal_p95", 1.0, 4),
    ("scale that keeps area", "equal_area_scale", 1.0, 4),
    ("  area, log2: median", "equal_area_median", 1.0, 4),
    ("  95 %", "equal_area_p95", 1.0, 4),
    ("  % beyond 1.25 times", "area_beyond_1_25", 100.0, 2),
    ("  % beyond 1.5 times", "area_beyond_1_5", 100.0, 2),
    ("  % beyond twice", "area_beyond_2", 100.0, 2),
    ("edges, %", "edge", 100.0, 2),
    ("angles, degrees", "angle", 1.0, 2),
    ("quasi-conformal", "quasi_conformal", 1.0, 3),
    ("isometric", "isometric", 1.0, 3),
    ("symmetric Dirichlet", "symmetric_dirichlet", 1.0, 3),
    ("flipped triangles", "flipped", 1.0, 0),
    ("  of the area, %", "flipped_share", 100.0, 3),
    ("without area", "collapsed", 1.0, 0),
    ("covering another", "covering", 1.0, 0),
    ("boundary crossings", "crossings", 1.0, 0),
)
_TOPOLOGY = {
    "components": "components",
    "Euler characteristic": "euler",
    "boundary loops": "loops",
    "handles": "handles",
}
_REFERENCES = {
    "exact": "exact distances over the triangles",
    "graph": "distances by straight links over the triangles",
    "chain": "distances by chain codes over the voxels",
}


def table_of_several(maps: Mapping[str, Distortion]) -> str:
    """Return a table of several maps, with one column per map."""
    several = list(maps.values())
    sizes = {map_.voxel_size for map_ in several}
    voxel_size = sizes.pop() if len(sizes) == 1 else None
    rows = [
        ["", *maps],
        ["RAW"],
        *_distance_rows(several, [(map_.raw, map_.standard_error.raw) for map_ in several], voxel_size),
        ["AT THE BEST SCALE", *(_number(map_.best_scale.scale, 4) for map_ in several)],
        *_distance_rows(several, [(map_.best_scale, map_.standard_error.best_scale) for map_ in several], voxel_size),
        ["INTERIOR PAIRS", *(_number(map_.interior and map_.interior.scale, 4) for map_ in several)],
        *_distance_rows(several, [(map_.interior, None) for map_ in several], voxel_size),
        ["OTHER FIGURES"],
        *_other_rows(several),
    ]
    return _aligned(several, rows)


def _distance_rows(
    maps: Sequence[Distortion], columns: Sequence[tuple[Figures | None, Figures | None]], voxel_size: float | None
) -> list[list[str]]:
    """Return the rows of columns of measures and their standard errors."""
    rows, unit = [], _unit_of(maps)
    for name, key, factor, digits in _DISTANCES:
        pairs = [tuple(factor * getattr(of, key, np.nan) for of in column) for column in columns]
        title = in_bands(name, maps[0].bands, unit) if key.startswith("relative_error_") else in_unit(name, unit)
        is_length = key == "absolute_error"
        rows.append([title, *(_with_error(value, error, digits, is_length=is_length) for value, error in pairs)])
        if is_length and voxel_size is not None:
            voxels = (_with_error(value / voxel_size, error / voxel_size, 2) for value, error in pairs)
            rows.append(["  voxels", *voxels])
    return rows


def _unit_of(maps: Sequence[Distortion]) -> str:
    units = {map_.unit for map_ in maps}
    return units.pop() if len(units) == 1 else "unknown"


def _other_rows(maps: Sequence[Distortion]) -> list[list[str]]:
    rows = [
        ["correlation", *(_with_error(map_.pearson_r, map_.standard_error.pearson_r, 4) for map_ in maps)],
        [
            in_unit("mean geodesic, mm", _unit_of(maps)),
            *(_with_error(m.mean_geodesic, m.standard_error.mean_geodesic, 2, is_length=True) for m in maps),
        ],
        ["points", *(str(len(map_.per_point)) for map_ in maps)],
        ["pairs", *(str(map_.pairs) for map_ in maps)],
    ]
    if not all(np.isnan(map_.lower_bound) for map_ in maps):
        rows.insert(0, ["no map can be better than, %", *(_number(100 * map_.lower_bound, 2) for map_ in maps)])
    if any(map_.triangles is not None for map_ in maps):
        for name, key, factor, digits in _TRIANGLES:
            values = [None if map_.triangles is None else factor * getattr(map_.triangles, key) for map_ in maps]
            rows.append([name, *(_number(value, digits) for value in values)])
    if any(map_.topology is not None for map_ in maps):
        for name, key in _TOPOLOGY.items():
            rows.append([name, *(_number(None if map_.topology is None else map_.topology[key], 0) for map_ in maps)])
    return rows


def _number(value: Any, digits: int) -> str:
    """Format a number, or return a dash if it is undefined."""
    return "–" if value is None or np.isnan(value) else f"{value:.{digits}f}"


def _with_error(value: float, error: float, digits: int, *, is_length: bool = False) -> str:
    if is_length and 0 < abs(value) < 1:  # in a large unit
        digits = max(digits, 2 - int(np.floor(np.log10(abs(value)))))
    return _number(value, digits) + ("" if np.isnan(error) else f" ± {_number(error, digits)}")


def _aligned(maps: Sequence[Distortion], rows: list[list[str]]) -> str:
    """Return rows with right-aligned columns, under a line that describes the measures."""
    width = 2 + max(len(cell) for row in rows for cell in row[1:])
    sources = ", ".join(sorted({str(map_.sources) for map_ in maps}))
    references = "; ".join(sorted({_REFERENCES[map_.reference] for map_ in maps}))
    about = f"from {sources} random sources, ± standard error; {references}"
    lines = [row[0].ljust(_FIRST) + "".join(cell.rjust(width) for cell in row[1:]) for row in rows]
    return "\n".join([about, *(line.rstrip() for line in lines)])
