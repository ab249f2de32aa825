"""``blocks.voxflat``: voxflat operations on each block of a MultiBlock."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

import pyvista as pv

from voxflat._pyvista.accessor import VoxflatAccessor
from voxflat.errors import InputError

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from voxflat._pyvista.options import FlattenOptions, MeasureOptions

Given = ParamSpec("Given")
Result = TypeVar("Result")


def _of_each(verb: Callable[Concatenate[Any, Given], object]) -> Callable[Concatenate[Any, Given], pv.MultiBlock]:
    """Return a method that applies an operation to each block, with the signature and parameters of the operation."""

    def of_blocks(self: BlocksAccessor, /, *args: Given.args, **options: Given.kwargs) -> pv.MultiBlock:
        return self._made(lambda accessor, _: getattr(accessor, verb.__name__)(*args, **options))

    _describe(of_blocks, verb, "pv.MultiBlock", _BLOCKS)
    return of_blocks


def _by_name(verb: Callable[Concatenate[Any, Given], Result]) -> Callable[Concatenate[Any, Given], dict[str, Result]]:
    """Return a method that applies an operation to each block and returns a dictionary; see `_of_each`."""

    def of_blocks(self: BlocksAccessor, /, *args: Given.args, **options: Given.kwargs) -> dict[str, Result]:
        return self._named(lambda accessor: getattr(accessor, verb.__name__)(*args, **options))

    _describe(of_blocks, verb, f"dict[str, {inspect.signature(verb).return_annotation}]", _DICTIONARY)
    return of_blocks


_BLOCKS = """Returns
-------
pyvista.MultiBlock
    The results, with the names of their blocks. Empty blocks stay empty.
"""
_DICTIONARY = """Returns
-------
dict
    The results, keyed by block name. The key of a nested block is a path such as ``"brain/left"``.

Raises
------
InputError
    If two blocks have the same name.
"""


def _describe(method: Any, verb: Callable[..., object], kind: str, returned: str) -> None:
    text = inspect.getdoc(verb) or ""
    parameters = text[text.index("Parameters\n") : text.index("Returns\n")]
    method.__doc__ = f"Apply `VoxflatAccessor.{verb.__name__}` to each block.\n\n{parameters}{returned}"
    method.__signature__ = inspect.signature(verb).replace(return_annotation=kind)
    method.__name__, method.__qualname__ = verb.__name__, f"BlocksAccessor.{verb.__name__}"


class BlocksAccessor:
    """Flatten each block of a MultiBlock.

    PyVista makes this accessor available as ``blocks.voxflat``. Operations on a single surface or point, such as
    ``plot`` and ``geodesic``, are available on each block: ``blocks["left"].voxflat.plot()``. The methods raise
    `InputError` and `Cancelled` like those of `VoxflatAccessor`; the message names the block.

    Parameters
    ----------
    blocks : pyvista.MultiBlock
        The datasets, which may be nested.

    See Also
    --------
    VoxflatAccessor : The accessor for a single dataset.

    Examples
    --------
    >>> import pyvista as pv
    >>> blocks = pv.MultiBlock({"ball": pv.Icosphere(nsub=1), "hills": pv.ParametricEnneper(u_res=9, v_res=9)})
    >>> flat = blocks.voxflat()
    >>> flat.keys()
    ['ball', 'hills']
    >>> worst = flat["ball"]["distance_error"].max()
    """

    def __init__(self, blocks: pv.MultiBlock) -> None:
        self._blocks = blocks

    def __call__(
        self, scalars: str | None = None, *, progress_bar: bool = False, **options: Unpack[FlattenOptions]
    ) -> pv.MultiBlock:
        """Flatten each block into the plane z = 0.

        The parameters are the same as for `VoxflatAccessor`. The result contains a map for each block under the same
        name; empty blocks remain empty.
        """
        return self._made(lambda accessor, _: accessor(scalars, progress_bar=progress_bar, **options))

    flatten = _by_name(VoxflatAccessor.flatten)
    check = _by_name(VoxflatAccessor.check)
    surface = _of_each(VoxflatAccessor.surface)
    patches = _of_each(VoxflatAccessor.patches)
    cut = _of_each(VoxflatAccessor.cut)

    def measure(
        self, flat: pv.MultiBlock, scalars: str | None = None, **options: Unpack[MeasureOptions]
    ) -> pv.MultiBlock:
        """Measure the distortion of a map of each block.

        Empty blocks stay empty.

        Parameters
        ----------
        flat : pyvista.MultiBlock
            The maps, in the same order as the blocks.
        scalars : str, optional
            Name of the image array to use. By default, the active array or the only array of each block.
        **options : dict
            As in `VoxflatAccessor.measure`.

        Returns
        -------
        pyvista.MultiBlock
            The map of each block, with its measures.

        Raises
        ------
        InputError
            If the numbers of maps and blocks differ.

        Examples
        --------
        >>> both = pv.MultiBlock({"left": pv.Plane(), "right": pv.Plane(center=(2, 0, 0))})
        >>> both.voxflat.measure(both.voxflat()).keys()
        ['left', 'right']
        """
        return self._made(lambda of, one: of.measure(one, scalars, **options), flat)

    if not TYPE_CHECKING:  # type checkers should report that these operations are missing

        def __getattr__(self, name: str) -> object:
            """Raise an error that explains why an operation needs a single block."""
            if name.startswith(("_", "to_")) or not hasattr(VoxflatAccessor, name):
                raise AttributeError(f"'{type(self).__name__}' object has no attribute {name!r}")
            first = next(iter(self._blocks.keys()), "name")
            remedy = f"Call it on one block: blocks[{first!r}].voxflat.{name}(...)"
            raise AttributeError(f"{name} applies to a single dataset. {remedy}")

    def _made(self, verb: Callable[[Any, Any], object], beside: pv.MultiBlock | None = None) -> pv.MultiBlock:
        """Apply an operation to each block, and to the block at the same position in another MultiBlock."""
        if beside is not None and not (isinstance(beside, pv.MultiBlock) and len(beside) == len(self._blocks)):
            kind = f"{len(beside)} blocks" if isinstance(beside, pv.MultiBlock) else type(beside).__name__
            raise InputError(
                f"got {kind} for the maps. Pass a MultiBlock with one map for each of the {len(self._blocks)} blocks"
            )
        applied = pv.MultiBlock()
        for name, block, other in zip(self._blocks.keys(), self._blocks, beside or self._blocks, strict=True):
            applied.append(None if block is None else _applied(name, block, verb, other), name)
        return applied

    def _named(self, verb: Callable[[Any], Any]) -> dict[str, Any]:
        """Apply an operation to each block; return the results by name."""
        results: dict[str, Any] = {}
        for name, block in zip(self._blocks.keys(), self._blocks, strict=True):
            if block is None:
                continue
            result = _applied(name, block, verb)
            inner = {f"{name}/{key}": value for key, value in result.items()} if isinstance(result, dict) else None
            for key, value in (inner or {name: result}).items():
                if key in results:
                    raise InputError(f"two blocks have the name {key!r}. Rename one with blocks.set_block_name(1, ...)")
                results[key] = value
        return results


def _applied(name: str, block: object, verb: Callable[..., Any], *beside: object) -> Any:
    """Apply an operation to a block; errors name the block."""
    if not isinstance(block, pv.DataSet | pv.MultiBlock):
        raise InputError(f"block {name!r} has type {type(block).__name__}, which has no surface. Remove the block")
    try:
        return verb(BlocksAccessor(block) if isinstance(block, pv.MultiBlock) else VoxflatAccessor(block), *beside)
    except InputError as error:
        raise InputError(f"block {name!r}: {error}") from None
