"""Images of all frames of a series: the class `FlatMovie`, which `FlatSeries.images` returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import Progress
from voxflat.errors import Cancelled
from voxflat.io.channels import LastKept, OnDemand, Timing
from voxflat.io.provenance import Record, files_of
from voxflat.io.reading import reading
from voxflat.maps.image_files import Pages, SavedPages
from voxflat.maps.raster import FlatImage, FlatStack
from voxflat.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class FlatMovie(Sequence[FlatStack], ReadOnly, SavedPages):
    """Images of all frames of a series, with the same pixels.

    ``movie[t]`` holds the channels and depths of frame t. Frames are read and sampled on demand.

    Parameters
    ----------
    frames : int
        Number of frames.
    read : callable
        Returns the `FlatStack` of a frame, given its number.
    check : callable
        Raises an error if the volume of a frame, given by its number, differs in form from that of the first frame.
    pixel_size : float
        Side length of a pixel, in mm (or the unit of the surfaces).
    name : str
        Title.
    channel_names : tuple of str
        Name of each channel; empty strings if the channels have none.
    layers, heights : tuple
        As in `FlatStack`.
    timing : Timing or None
        The times of the frames, if they are known.
    provenance : dict
        As in `FlatImage`.

    See Also
    --------
    FlatSeries.images : Make a movie.

    Examples
    --------
    >>> ball = voxflat.samples.ball()
    >>> movie = voxflat.flatten_series([ball, np.roll(ball, 1, axis=0)]).images([ball, ball], depth=[-1.0, 1.0])
    >>> movie
    <FlatMovie: 2 frames, 1 channel, 2 depths>
    """

    frames: int
    read: Callable[[int], FlatStack]
    check: Callable[[int], None]
    pixel_size: float
    name: str
    channel_names: tuple[str, ...]
    layers: tuple[str, ...] = ()
    heights: tuple[float, ...] = ()
    timing: Timing | None = None
    provenance: Record = field(default_factory=dict)

    _used = ("pixel_size",)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("read", "check"):
            object.__setattr__(self, name, OnDemand(getattr(self, name), self.frames))

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.frames

    def __repr__(self) -> str:
        channels, depths = len(self.channel_names), max(1, len(self.layers))
        counts = ((self.frames, "frame"), (channels, "channel"), (depths, "depth"))
        parts = [f"{count} {name}{'s' * (count != 1)}" for count, name in counts]
        return f"<FlatMovie: {', '.join(parts)}>"

    @overload
    def __getitem__(self, frame: int) -> FlatStack: ...

    @overload
    def __getitem__(self, frame: slice) -> list[FlatStack]: ...

    def __getitem__(self, frame: int | slice) -> FlatStack | list[FlatStack]:
        """Return the images of a frame."""
        if isinstance(frame, slice):
            return [self[n] for n in range(*frame.indices(len(self)))]
        if not -len(self) <= frame < len(self):
            raise IndexError(f"frame {frame} does not exist: frames are numbered from 0 to {len(self) - 1}")
        self.check(frame % len(self))
        return self.read(frame % len(self))

    @property
    def data(self) -> NDArray[np.number]:
        """All images as one array.

        The axes are (frame, channel, depth, row, column), without those for channels or depths if there is only one.
        """
        images = np.stack([stack.channels.read(n) for stack in self for n in range(len(stack))])
        return images.reshape(*self._pages.shape, *images.shape[1:])

    @property
    def _pages(self) -> Pages:
        """The images and their axes, as files describe them."""
        pages = [(channel, layer) for channel in self.channel_names for layer in self.layers or ("",)]
        parts = [(f"frame {frame}", *parts) for frame in range(len(self)) for parts in pages]
        names = tuple(", ".join(part for part in page if part) for page in parts)
        axes = (self.channel_names, self.layers, self.heights, self.frames)
        return Pages(_Images(len(self), len(pages), LastKept(self.read)), names, *axes, self.timing, self.name)

    def _checked(self, progress: Progress | None) -> Record:
        """Check the volumes of all frames; return the record with the files that were read."""
        with reading() as files:
            for frame in range(len(self)):
                self.check(frame)
                if progress is not None and progress("checking the volumes", frame + 1, len(self)) is False:
                    raise Cancelled("cancelled while checking the volumes")
        return {**self.provenance, "files": {**files_of(self.provenance), **files}}


@dataclass(frozen=True)
class _Images(Sequence[FlatImage]):
    """All images of a movie in the order of files."""

    frames: int
    each: int  # images of a frame
    read: Callable[[int], FlatStack]

    def __len__(self) -> int:
        return self.frames * self.each

    def __getitem__(self, number: Any) -> Any:
        frame, n = divmod(number, self.each)
        return self.read(frame)[n]


def joined(stack: FlatStack, further: FlatStack) -> FlatStack:
    """Return a stack with further channels, which are the same at all of its depths."""
    channels, count, layers = stack.channels, len(stack), stack.layers or ("",)
    names = [", ".join(part for part in (name, layer) if part) for name in further.names for layer in layers]

    def read(n: int) -> NDArray[Any]:
        return channels.read(n) if n < count else further.channels.read((n - count) // len(layers))

    return replace(stack, channels=replace(channels, names=(*channels.names, *names), read=read))
