"""The method `save` of results: the ending of a file name chooses the format."""

import inspect
import os
import textwrap
from pathlib import Path
from typing import Any, ClassVar

from voxflat.errors import InputError
from voxflat.io.provenance import Recorded, saving


class Saved(Recorded):
    """Base class of results that are saved to a file; each class lists its formats and writes them."""

    _kind: ClassVar[str]
    """The result as messages name it, such as "a map"."""

    _endings: ClassVar[tuple[str, ...]] = ()
    """All endings of file names, or none if the writer checks them."""

    _formats: ClassVar[str]
    """What the formats hold, for the documentation of `save`."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Give the class a method `save` that documents its formats."""
        super().__init_subclass__(**options)
        if "_formats" not in vars(cls):
            return

        def save(self: Saved, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
            Saved.save(self, path, sidecar=sidecar, overwrite=overwrite)

        text = inspect.getdoc(Saved.save) or ""
        formats = textwrap.indent(inspect.cleandoc(cls._formats), "    ")
        text = text.replace("the result to", f"{cls._kind} to").replace("    A file name.", formats)
        save.__doc__ = f"{text}\n"  # as numpydoc expects
        save.__module__, save.__qualname__ = cls.__module__, f"{cls.__qualname__}.save"
        setattr(cls, "save", save)  # noqa: B010 - a method that is assigned is an error for type checkers

    def save(self, path: str | os.PathLike[str], *, sidecar: bool = False, overwrite: bool = False) -> None:
        """Save the result to a file.

        The ending of the file name determines the format. The file is written either completely or not at all.

        Parameters
        ----------
        path : path
            A file name.
        sidecar : bool
            Also write `provenance` to ``<path>.json``.
        overwrite : bool
            Replace an existing file that voxflat did not write.

        Raises
        ------
        InputError
            If the ending is not supported, the format cannot hold the values, or the path is an input file.
        OSError
            If the file cannot be written.
        """
        result: Any = self
        with saving(path, result.provenance, sidecar=sidecar, overwrite=overwrite) as checked:
            if self._endings and not checked.name.lower().endswith(self._endings):
                *first, last = self._endings
                remedy = f"Use a name that ends in {', '.join(first)} or {last}"
                raise InputError(f"cannot save {self._kind} as {checked.name}{self._why_not(checked)}. {remedy}")
            self._write(checked)

    def _why_not(self, path: Path) -> str:
        """Return why a name cannot be used, for the message."""
        return ""

    def _write(self, path: Path) -> None:
        """Write the file; the name has one of the endings."""
        raise NotImplementedError
