"""Define the exceptions that voxflat raises deliberately."""

from typing import TYPE_CHECKING

from voxflat import display

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


class VoxflatError(Exception):
    """Base class of all exceptions that voxflat raises deliberately.

    Catch it together with `OSError` to handle all expected failures.

    See Also
    --------
    InputError : The input or an argument cannot be used.
    Cancelled : The user stopped a computation.

    Examples
    --------
    >>> try:
    ...     voxflat.surface("no_such_file.nii.gz")
    ... except (voxflat.VoxflatError, OSError) as error:
    ...     print(type(error).__name__)
    FileNotFoundError
    """


class InputError(VoxflatError, ValueError):
    """Exception for an input or an argument that cannot be used.

    The message contains the value and the file, if any, and explains how to fix the error.

    See Also
    --------
    AreaBoundError : No map keeps the area changes within a bound.
    HemisphereError : No hemisphere was found in a volume.

    Examples
    --------
    >>> try:
    ...     voxflat.surface(voxflat.samples.ball(), label=7)
    ... except voxflat.InputError as error:
    ...     print(error)
    no voxel has label 7; the volume has labels 3
    """


class HemisphereError(InputError):
    """Exception for a volume in which no cerebral hemisphere was found.

    It contains the voxels that were identified as white matter, which `figure` shows.

    Parameters
    ----------
    message : str
        Description of the step that failed and the remedy.
    white : ndarray of bool, shape (X, Y, Z)
        The voxels that were identified as white matter.
    affine : ndarray, shape (4, 4)
        The affine from voxel indices to RAS+ coordinates in mm.
    template : ndarray of bool, shape (X, Y, Z), or None
        The white matter of the MNI152 template, aligned and on the same grid, or None if no alignment was attempted.

    See Also
    --------
    voxflat.hemisphere : Extract a hemisphere from a brain volume.

    Examples
    --------
    >>> try:
    ...     voxflat.hemisphere(voxflat.samples.ball(), "left")
    ... except voxflat.HemisphereError as error:
    ...     error.figure().savefig("why.png")
    """

    def __init__(
        self,
        message: str,
        white: "NDArray[np.bool_]",
        affine: "NDArray[np.float64]",
        template: "NDArray[np.bool_] | None" = None,
    ) -> None:
        super().__init__(message)
        self.white, self.affine, self.template = white, affine, template

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the exception with all its arguments."""
        return type(self), (str(self), self.white, self.affine, self.template)

    def figure(self) -> "Figure":
        """Draw three sections through the voxels that were identified as white matter.

        The outline of the template is drawn over the sections if an alignment was attempted.

        Returns
        -------
        matplotlib.figure.Figure
            Sagittal, coronal and axial sections through the middle of the white matter.
        """
        return display.views.sections(self.white, self.affine, self.template)


class Cancelled(VoxflatError):  # noqa: N818  (it is not an error: the user asked for it)
    """Exception for a computation that the user stopped.

    It is raised after a progress function returned False.

    See Also
    --------
    voxflat.flatten : Flatten a surface; its parameter `progress` accepts the function.

    Examples
    --------
    >>> try:
    ...     voxflat.flatten(voxflat.samples.hill(), progress=lambda stage, done, total: False)
    ... except voxflat.Cancelled:
    ...     print("stopped")
    stopped
    """


def user_message(error: BaseException) -> str:
    """Return a user-facing message for an exception, on one line."""
    if isinstance(error, VoxflatError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = "The computation ran out of memory. Use a smaller patch or fewer sources."
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = f"{type(error).__name__}: {error} (unexpected error: please report it with the output of --debug)"
    return " ".join(text.split())
