"""The exceptions that voxflat raises on purpose."""


class VoxflatError(Exception):
    """Base of every exception that voxflat raises on purpose."""

    @property
    def remedy(self) -> str:
        """What to do: the message from its last semicolon or colon on; empty if it says nothing of it."""
        text = str(self)
        at = max(text.rfind(mark) for mark in ("; ", ": "))
        return text[at + 2 :] if at >= 0 else ""


class InputError(VoxflatError, ValueError):
    """Bad input; the message names the value and the remedy."""


class Cancelled(VoxflatError):  # noqa: N818  (nothing went wrong: the user asked for it)
    """The user stopped a computation before its end."""


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
