"""The exceptions that voxflat raises on purpose."""

import importlib
from typing import Any


class VoxflatError(Exception):
    """Base of every exception that voxflat raises on purpose.

    Examples
    --------
    >>> try:
    ...     voxflat.surface("no_such_file.nii.gz")
    ... except (voxflat.VoxflatError, OSError) as error:
    ...     print(type(error).__name__)
    FileNotFoundError
    """

    @property
    def remedy(self) -> str:
        """What to do: the message from its last semicolon or colon on; empty if it says nothing of it."""
        text = str(self)
        at = max(text.rfind(mark) for mark in ("; ", ": "))
        return text[at + 2 :] if at >= 0 else ""


class InputError(VoxflatError, ValueError):
    """Bad input; the message names the value and the remedy.

    Examples
    --------
    >>> try:
    ...     voxflat.surface(voxflat.samples.ball(), label=7)
    ... except voxflat.InputError as error:
    ...     print(error)
    no voxel has label 7; the volume has labels 3
    """


class AreaBoundError(InputError):
    """No map was found whose areas keep within a bound.

    Parameters
    ----------
    message : str
        What was found, and what helps.
    best : FlatMap
        The map whose worst triangle is the best that was found.
    places : WorstPlaces
        Where its areas are beyond the bound, and the cuts that relieve these places.

    Examples
    --------
    >>> bounded = voxflat.methods.Voxflat(max_area=1.02)
    >>> try:
    ...     voxflat.surface(voxflat.samples.ball()).flatten(bounded)
    ... except voxflat.AreaBoundError as error:
    ...     print(error.best)
    <FlatMap: 678 points, 24 x 49 mm, relative error 4.1 %>
    """

    def __init__(self, message: str, best: Any, places: Any) -> None:
        super().__init__(message)
        self.best, self.places = best, places

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to other processes whole."""
        return type(self), (str(self), self.best, self.places)


class HemisphereError(InputError):
    """No hemisphere was found in the volume of a brain.

    Parameters
    ----------
    message : str
        The step that failed, and what helps.
    white : ndarray of bool, shape (X, Y, Z)
        What was taken for white matter.
    affine : ndarray, shape (4, 4)
        From its voxels to RAS+ in mm.
    template : ndarray of bool, shape (X, Y, Z), or None
        MNI152's white matter on the same grid, where it fits best; None if no alignment was tried.

    Examples
    --------
    >>> try:
    ...     voxflat.hemisphere(voxflat.samples.ball(), "left")
    ... except voxflat.HemisphereError as error:
    ...     error.figure().savefig("why.png")
    """

    def __init__(self, message: str, white: Any, affine: Any, template: Any = None) -> None:
        super().__init__(message)
        self.white, self.affine, self.template = white, affine, template

    def __reduce__(self) -> tuple[Any, ...]:
        """Go to other processes whole."""
        return type(self), (str(self), self.white, self.affine, self.template)

    def figure(self) -> Any:
        """Draw three sections through what was taken for white matter, with the template's outline.

        Returns
        -------
        matplotlib.figure.Figure
            Sagittal, coronal and axial sections through the middle of the white matter.

        Examples
        --------
        >>> error = voxflat.HemisphereError("too small", np.ones((4, 4, 4), bool), np.eye(4))
        >>> len(error.figure().axes)
        3
        """
        figures = importlib.import_module("voxflat.figures.sections")  # which stands above
        return figures.sections(self.white, self.affine, self.template)


class Cancelled(VoxflatError):  # noqa: N818  (nothing went wrong: the user asked for it)
    """The user stopped a computation before its end.

    Examples
    --------
    >>> try:
    ...     voxflat.flatten(voxflat.samples.hill(), progress=lambda stage, done, total: False)
    ... except voxflat.Cancelled:
    ...     print("stopped")
    stopped
    """


def told(error: BaseException) -> str:
    """Say on one line what went wrong, to users."""
    if isinstance(error, VoxflatError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "memory ran out; take a smaller patch or fewer sources"
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = f"{type(error).__name__}: {error} (not foreseen: please report it with the output of --debug)"
    return " ".join(text.split())
