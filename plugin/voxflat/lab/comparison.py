"""Compare hemispheres: find outliers, and average maps with standard cuts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat._core import __version__
from voxflat.lab.results import Results
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.raster import FlatImage
from voxflat.wording import many

_PIXEL = 1.0  # mm
LEAST = 5  # smallest number of maps for which outliers are reported
_FAR = 3.5  # threshold on modified z scores (Iglewicz, Hoaglin 1993)
_DRAWS = 2000  # number of simulated groups
_NORMAL = 0.6745  # median absolute deviation of a normal distribution with standard deviation 1


@dataclass(frozen=True)
class Row:
    """A row of the table, which describes one hemisphere."""

    name: str
    session: str  # _ses-02, or empty
    letter: str  # L or R
    page: str  # file of the report
    record: dict[str, Any] | None  # record of its results; None if there are none
    reason: str = ""  # reason why there are no results
    changed: tuple[str, ...] = ()  # inputs that changed since the results were made
    outliers: Mapping[str, str] = field(default_factory=dict)  # measures in which it is an outlier: high or low
    results: Results | None = None  # its files

    @property
    def hemisphere(self) -> str:
        """Its name in messages, such as sub-01_ses-02 L."""
        return f"{self.name}{self.session} {self.letter}".rstrip()


def counted(rows: Sequence[Row]) -> str:
    """Return the numbers of maps and of hemispheres or participants without one, as text."""
    there = [row for row in rows if row.record is not None]
    people = many(len({row.name for row in there}), "participant")
    left, right = (sum(row.letter == letter for row in there) or "no" for letter in ("L", "R"))
    text = f"{left} left and {right} right hemispheres of {people}"
    kinds = [("hemisphere" if row.letter else "participant") for row in rows if row.record is None]
    lacking = " and ".join(many(kinds.count(kind), kind) for kind in dict.fromkeys(sorted(kinds)))
    return text + (f"; without a map: {lacking}" if lacking else "")


@dataclass(frozen=True, eq=False)
class Mean:
    """Mean and standard deviation (N - 1) of standard maps; NaN where fewer than half, or than two, have a value."""

    name: str
    letter: str
    mean: FlatImage
    deviation: FlatImage
    count: FlatImage  # number of maps with a value there


class Sums:
    """Running mean and sum of squared deviations of maps, pixel by pixel, on a common grid (Welford 1962).

    The grid covers all maps: `low` and `high` are their smallest and largest (u, v), in mm.
    """

    def __init__(self, low: Sequence[float], high: Sequence[float]) -> None:
        (left, bottom), (right, upper) = np.floor(low), np.ceil(high)
        self.maps = 0
        u, v = np.arange(left, right + _PIXEL, _PIXEL), np.arange(upper, bottom - _PIXEL, -_PIXEL)
        self.places = np.stack(np.meshgrid(u, v), axis=-1)
        shape = self.places.shape[:2]
        self.count, self.mean, self.squares = np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape)

    def add(self, flat_map: FlatMap, values: NDArray[np.float64]) -> None:
        """Add the values of a map at its points, of shape (N,)."""
        places = flat_map.look_up(self.places)
        sampled = np.full(places.face_ids.shape, np.nan)
        inside = places.face_ids >= 0
        corners = values[flat_map.faces[places.face_ids[inside]]]
        sampled[inside] = np.einsum("pc,pc->p", places.weights[inside], corners)
        is_there = np.isfinite(sampled)
        self.maps += 1
        self.count += is_there
        step = np.where(is_there, sampled - self.mean, 0.0)
        self.mean += step / np.maximum(self.count, 1)
        self.squares += step * np.where(is_there, sampled - self.mean, 0.0)

    def result(self, name: str, letter: str) -> Mean:
        """Return the mean and the standard deviation."""
        enough = self.count >= max(2, (self.maps + 1) // 2)
        mean = np.where(enough, self.mean, np.nan)
        deviation = np.where(enough, np.sqrt(self.squares / np.maximum(self.count - 1, 1)), np.nan)
        origin = (float(self.places[0, 0, 0]), float(self.places[0, 0, 1]))
        record = {"voxflat": __version__, "function": "group", "parameters": {"of": name, "maps": self.maps}}
        options: dict[str, Any] = {"labels": False, "provenance": record}
        of_mean = FlatImage(mean, _PIXEL, origin, f"mean of {name}", **options)
        of_deviation = FlatImage(deviation, _PIXEL, origin, f"standard deviation of {name}", **options)
        of_count = FlatImage(self.count, _PIXEL, origin, f"number of maps with a value of {name}", **options)
        return Mean(name, letter, of_mean, of_deviation, of_count)


def outliers(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of outliers (modified z score above 3.5), without NaN and values in groups of fewer than five."""
    defined = values[np.isfinite(values)]
    if len(defined) < LEAST:
        return np.zeros(len(values), dtype=np.bool_)
    apart = np.abs(values - np.median(defined))
    usual = float(np.median(apart[np.isfinite(apart)]))
    return np.asarray(_NORMAL * np.nan_to_num(apart) > _FAR * usual) & (np.nan_to_num(apart) > 0)


@lru_cache
def outliers_by_chance(count: int) -> float:
    """Return the mean number of outliers among `count` values from a normal distribution, by simulation."""
    draws = np.random.default_rng(0).standard_normal((_DRAWS, count))
    return sum(int(outliers(values).sum()) for values in draws) / _DRAWS
