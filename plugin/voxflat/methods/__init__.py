"""Methods that flatten a surface; each is a class with its own options.

Pass an object of such a class wherever a method name is accepted: ``surface.flatten(Zigelman2002(sources=400))``.
"""

from voxflat.arguments import shown
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.grossmann2002 import Grossmann2002
from voxflat.methods.method import FlattenSettings, Method
from voxflat.methods.saucan2006 import Saucan2006
from voxflat.methods.schwartz1989 import Schwartz1989
from voxflat.methods.voxflat import Voxflat
from voxflat.methods.zigelman2002 import Zigelman2002
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold

__all__ = ["METHODS", "Grossmann2002", "Method", "Saucan2006", "Schwartz1989", "Voxflat", "Zigelman2002", "method_of"]


def __dir__() -> list[str]:
    return sorted(__all__)


_METHODS: tuple[type[Method], ...] = (Voxflat, Grossmann2002, Zigelman2002, Schwartz1989, Saucan2006)
METHODS = {method.name: method for method in _METHODS}  # the default first


def method_of(method: str | Method) -> Method:
    """Return a method object, with its default options if it is given by name.

    Functions that take ``method`` use it to turn a name into an object.

    Parameters
    ----------
    method : str or Method
        A name in `METHODS`, or a method object, which is returned unchanged.

    Returns
    -------
    Method
        The method with its options.

    Raises
    ------
    InputError
        If there is no method with that name.

    See Also
    --------
    Surface.flatten : Flatten a surface with a method.

    Examples
    --------
    >>> voxflat.methods.method_of("zigelman2002").sources
    625
    """
    if isinstance(method, Method):
        return method
    if not isinstance(method, str) or method not in METHODS:
        names = ", ".join(map(repr, METHODS))
        raise InputError(f"method is {shown(method)}. Pass {names}, or an object from voxflat.methods")
    return METHODS[method]()


def flattened(surface: Manifold | CutManifold[Manifold], method: str | Method, settings: FlattenSettings) -> FlatMap:
    """Flatten a surface, which may already be cut; see `voxflat.Surface.flatten`."""
    chosen = method_of(method)
    chosen._check(settings)
    chart = surface.chart if isinstance(surface, CutManifold) else None
    if chart is not None and chart.tube is not None and not chosen._takes_tubes:
        raise InputError(f"the method {chosen.name!r} cannot make a periodic map. Use the method 'voxflat'")
    return chosen._flatten(surface, settings)
