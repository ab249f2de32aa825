"""The exceptions that voxflat raises on purpose."""


class VoxflatError(Exception):
    """Base of every exception that voxflat raises on purpose."""


class InputError(VoxflatError, ValueError):
    """Bad input; the message names the value and the remedy."""


class Cancelled(VoxflatError):  # noqa: N818  (nothing went wrong: the user asked for it)
    """The user stopped a computation before its end."""
