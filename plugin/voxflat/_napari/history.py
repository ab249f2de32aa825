"""The states of a drawing, with undo and redo."""

from typing import Generic, TypeVar

State = TypeVar("State")


class History(Generic[State]):
    """The present state of a drawing, and the states before and after it."""

    def __init__(self, first: State) -> None:
        self._done, self._undone = [first], list[State]()

    @property
    def now(self) -> State:
        return self._done[-1]

    @property
    def can_undo(self) -> bool:
        return len(self._done) > 1

    @property
    def can_redo(self) -> bool:
        return bool(self._undone)

    def do(self, state: State) -> None:
        self._done.append(state)
        self._undone.clear()

    def undo(self) -> None:
        if self.can_undo:
            self._undone.append(self._done.pop())

    def redo(self) -> None:
        if self._undone:
            self._done.append(self._undone.pop())

    def cancel(self) -> None:
        """Undo a step that failed, which cannot be redone."""
        if self.can_undo:
            self._done.pop()
