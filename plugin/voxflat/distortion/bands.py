"""Bands of distances, for which relative errors are also given: their usual ends, and the names of their figures."""

import re
from typing import Any, TypeAlias

import numpy as np

from voxflat.arguments import shown
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, key_in_unit, millimetres

Bands: TypeAlias = tuple[float, float, float, float]
"""The upper ends of four bands, ascending, in the unit of the surface."""

HUMAN: Bands = (5.0, 10.0, 15.0, 30.0)
"""The bands of human hemispheres in mm, and of files that do not tell any."""

_HUMAN_SIZES = (45.0, 500.0)  # mm, the square root of the area
_SHARES = (0.11 / 6, 0.11 / 3, 0.11 / 2, 0.11)  # of the square root of the area; those of a human hemisphere
_PLAIN = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])
_SHOWN = {"m": 1e3, "mm": 1.0, "µm": 1e-3, "nm": 1e-6}  # units in which bands are shown, in mm


def usual_bands(area: float, unit: str) -> Bands:
    """Return the bands for a surface of some area, which are the same lengths in each unit."""
    size = np.sqrt(area) * millimetres(unit)
    is_human = _HUMAN_SIZES[0] <= size <= _HUMAN_SIZES[1] or not size > 0
    ends = HUMAN if is_human else tuple(_plain(share * size) for share in _SHARES)
    first, second, third, fourth = (float(f"{end / millimetres(unit):.12g}") for end in ends)
    return first, second, third, fourth


def _plain(length: float) -> float:
    """Return the nearest length with a plain number."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * _PLAIN[np.abs(np.log(_PLAIN * power / length)).argmin()])


def checked_bands(bands: Any) -> Bands:
    """Check and return bands that a user passed."""
    try:
        first, second, third, fourth = (float(end) for end in bands)
    except (TypeError, ValueError):
        first = second = third = fourth = np.nan
    if not 0 < first < second < third < fourth < np.inf or isinstance(bands, str):
        remedy = "four ascending positive lengths in the unit of the surface, such as (5, 10, 15, 30)"
        raise InputError(f"bands is {shown(bands)}. Pass {remedy}")
    return first, second, third, fourth


def in_bands(text: str, bands: Bands, unit: str) -> str:
    """Replace the bands of human hemispheres in a text, such as "up to 10 mm", by others."""
    numbers, shown_unit = _numbers(bands, unit)
    return in_unit(_replaced(text, numbers), shown_unit)


def key_in_bands(name: str, bands: Bands, unit: str) -> str:
    """Return the name of a figure, such as ``relative_error_10mm``, with the bands of a surface."""
    if not name.startswith("relative_error_"):
        return name
    numbers, shown_unit = _numbers(bands, unit)
    return key_in_unit(_replaced(name, numbers), shown_unit)


def _numbers(bands: Bands, unit: str) -> tuple[dict[str, str], str]:
    """Return the number that stands for each band of human hemispheres, and the unit in which the bands are plain."""
    shown_unit, scale = unit, 1.0
    if unit != "unknown":
        second = bands[1] * millimetres(unit)
        shown_unit = next((name for name, size in _SHOWN.items() if second > 0.09 * size), "nm")
        scale = millimetres(unit) / _SHOWN[shown_unit]
    return {f"{human:g}": f"{scale * end:g}" for human, end in zip(HUMAN, bands, strict=True)}, shown_unit


def _replaced(text: str, numbers: dict[str, str]) -> str:
    return re.sub(r"(?<![\d.])(5|10|15|30)(?![\d.])", lambda match: numbers[match[0]], text)
