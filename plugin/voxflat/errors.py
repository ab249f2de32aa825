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
