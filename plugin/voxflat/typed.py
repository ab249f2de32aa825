"""For mypy: what ``mesh.voxflat`` is. PyVista's accessors are found at run time, so that mypy takes them for ``Any``.

[tool.mypy]
plugins = ["voxflat.typed"]
"""

from __future__ import annotations

from collections.abc import Callable

from mypy.nodes import MypyFile, TypeInfo
from mypy.plugin import AttributeContext, Plugin
from mypy.types import Instance, Type

_ACCESSORS = (("voxflat._pyvista.accessor", "VoxflatAccessor"), ("voxflat._pyvista.blocks", "BlocksAccessor"))
_AS_IMPORTED = 10  # mypy's priority of what is imported at the top


class VoxflatPlugin(Plugin):
    """Gives the accessor its type."""

    def get_additional_deps(self, file: MypyFile) -> list[tuple[int, str, int]]:
        """Let mypy read the accessors' modules together with PyVista's own."""
        if file.fullname != "pyvista":
            return []
        return [(_AS_IMPORTED, module, -1) for module, _ in _ACCESSORS]

    def get_attribute_hook(self, fullname: str) -> Callable[[AttributeContext], Type] | None:
        """Return what tells the type of an attribute, if it is ours."""
        return _accessor if fullname.startswith("pyvista.") and fullname.endswith(".voxflat") else None


def _accessor(context: AttributeContext) -> Type:
    """Return the accessor's type; where mypy has not read it, what it takes the attribute for."""
    of = context.type.type if isinstance(context.type, Instance) else None
    is_blocks = of is not None and any(base.name == "MultiBlock" for base in of.mro)
    module, name = _ACCESSORS[is_blocks]
    read: dict[str, MypyFile] = context.api.modules  # type: ignore[attr-defined]
    found = read[module].names.get(name) if module in read else None
    return Instance(found.node, []) if found and isinstance(found.node, TypeInfo) else context.default_attr_type


def plugin(_version: str) -> type[Plugin]:
    """Return the plugin; called by mypy.

    Parameters
    ----------
    _version : str
        Of mypy.

    Returns
    -------
    type
    """
    return VoxflatPlugin
