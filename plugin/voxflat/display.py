"""Draw results and convert them to objects of other packages.

The functions that do this lie above the results. The package provides them by name when it is imported, so that no
module imports another one above it.
"""

from collections.abc import Callable
from typing import Any

_LOADERS: dict[str, Callable[[], Callable[..., Any]]] = {}


def provide(**loaders: Callable[[], Callable[..., Any]]) -> None:
    """Provide functions, each of which is imported on first use."""
    _LOADERS.update(loaders)


def shown_by(name: str, *of: object, **options: object) -> Any:
    """Call the function with this name: a figure for `plot` and Jupyter, or an object of another package."""
    return _LOADERS[name]()(*of, **options)
