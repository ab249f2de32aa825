"""Place names inside their regions: choose the position and the font size of each name."""

import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from matplotlib.textpath import TextPath
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from voxflat.arguments import printable

_SIZES = (7.0, 6.0, 5.0, 4.5)  # points, largest first
_LINE = 1.25  # line height, in multiples of the font size
_POINT = 25.4 / 72  # mm
_LONGEST = 4000  # letters of a line that may fit on a page
_MARGIN = 0.3  # around a name, mm


@dataclass(frozen=True)
class PlacedName:
    """A name and its box in pixels. The box lies inside the region, so boxes of different regions do not overlap."""

    label: int  # label of the region
    text: str  # may have several lines
    row: float
    column: float
    height: int
    width: int
    size: float  # font size, points
    is_upright: bool = False  # rotated by 90°, read from bottom to top


def plain(text: str, most: int | None = None) -> str:
    """Return a text that Matplotlib draws as it is, at most `most` letters long: "$" does not start a formula."""
    text = text if most is None or len(text) <= most else f"{text[: most // 2]}…{text[len(text) - most // 2 :]}"
    return "\n".join(printable(line) for line in text.split("\n")).replace("$", r"\$")


def place_names(labels: NDArray[np.int64], names: dict[int, str], pixel: float) -> tuple[list[PlacedName], list[str]]:
    """Place names in their regions at the largest size that fits, and list those that do not fit; `pixel` is in mm."""
    placed, left_out = [], []
    for label, name in names.items():
        mask = labels == label
        if not mask.any():
            continue
        place = _place(mask, label, name, pixel)
        if place is None:
            left_out.append(name)
        else:
            placed.append(place)
    return placed, left_out


def text_size(text: str, size: float) -> tuple[float, float]:
    """Return the width and height of a text on paper, in mm; the font size is in points."""
    lines = text.split("\n")
    return max(map(_width, lines)) * size * _POINT, _LINE * size * _POINT * len(lines)


def _place(mask: NDArray[np.bool_], label: int, name: str, pixel: float) -> PlacedName | None:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = int(rows[0]), int(columns[0])
    part = np.pad(mask[top : rows[-1] + 1, left : columns[-1] + 1], 1)
    inside = distance_transform_edt(part)
    sums = np.pad(part.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    texts = dict.fromkeys([name, _broken(name, 2), _broken(name, 3)])
    for size, is_upright, text in product(_SIZES, (False, True), texts):
        width, height = (int(np.ceil((length + 2 * _MARGIN) / pixel)) for length in text_size(text, size))
        if is_upright:
            width, height = height, width
        if height > part.shape[0] or width > part.shape[1]:
            continue
        full = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
        row, column = (full == height * width).nonzero()
        if len(row) == 0:
            continue
        best = int(inside[row + height // 2, column + width // 2].argmax())
        middle = row[best] - 1 + top + (height - 1) / 2, column[best] - 1 + left + (width - 1) / 2
        return PlacedName(label, text, middle[0], middle[1], height, width, size, is_upright)
    return None


def _broken(name: str, lines: int) -> str:
    """Return a name broken into lines of similar length after separators or before capitals."""
    places = [match.end() for match in re.finditer(r"[\s_\-./]+|[a-z](?=[A-Z])", name) if match.end() < len(name)]
    if len(places) < lines - 1:
        return name
    parts, rest, start = [], places, 0
    for line in range(lines - 1, 0, -1):
        aim = start + (len(name) - start) / (line + 1)
        rest = [place for place in rest if place > start]
        if not rest:
            break
        end = min(rest, key=lambda place: abs(place - aim))
        parts.append(name[start:end].rstrip())
        start = end
    return "\n".join([*parts, name[start:]])


@lru_cache(maxsize=4096)
def _width(line: str) -> float:
    """Return the width of a line in multiples of the font size."""
    if len(line) > _LONGEST:
        return float(len(line))
    if not line.strip():  # of which Matplotlib 3.11 makes no path
        return 0.1
    path: Any = TextPath((0, 0), plain(line), size=100)
    return float(path.get_extents().width) / 100 + 0.1
