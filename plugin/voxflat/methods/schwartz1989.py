"""What only the method "schwartz1989" knows: neighbourhoods and random starts (Schwartz, Shaw, Wolfson 1989)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from voxflat.arguments import Progress
from voxflat.errors import InputError
from voxflat.surfaces.surface import Surface

__all__ = ["Mapmaker", "doubts"]

_STARTS = 3  # as in the paper
_SAME_STRESS = 1.01  # starts that end in the same map differ by a smaller factor,
_NO_STRESS = 1e-9  # or by less than this: distances are right to 0.003 %
_MOST = 2**31  # more than any surface has


@dataclass(frozen=True)
class Mapmaker:
    """Which distances are kept, and from how many random starts descent begins.

    Parameters
    ----------
    neighbourhood : int, "all" or None
        Rings; None for as many as hold a tenth of the points.
    starts : int
        Random starts.
    """

    neighbourhood: int | str | None
    starts: int

    @classmethod
    def checked(cls, neighbourhood: object, starts: object) -> Mapmaker:
        """Return the options if they can be used."""
        rings: int | str | None = None
        if isinstance(neighbourhood, str) and neighbourhood == "all":
            rings = "all"
        elif neighbourhood is not None:
            rings = _whole(neighbourhood, "the neighbourhood", "a number of rings, 1 or more, or 'all'")
        wanted = "a number of random starts, 1 or more"
        return cls(rings, _STARTS if starts is None else _whole(starts, "starts", wanted))

    def rings(self, part: Surface, progress: Progress | None) -> int | None:
        """Return the rings of a neighbourhood; None for all pairs."""
        if isinstance(self.neighbourhood, str):
            return None
        return self.neighbourhood or part.core.schwartz1989_rings(progress)


def _whole(value: object, name: str, wanted: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value < _MOST:
        raise InputError(f"{name} is {value!r}; give {wanted}")
    return int(value)


def doubts(stresses: Sequence[float]) -> list[str]:
    """Return what the user should know of the stresses that random starts ended with."""
    least, *others = sorted(stresses)
    if not others or others[0] <= _SAME_STRESS * least + _NO_STRESS:
        return []
    return [
        f"the least stress of {len(stresses)} random starts, {least:.3g}, was reached by one of them only (then "
        f"{others[0]:.3g}): a better map may exist; give more starts, more sources or a larger neighbourhood"
    ]
