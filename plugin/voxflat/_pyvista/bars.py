"""Progress bars for ``progress_bar=True``, like those of PyVista filters."""

from collections.abc import Iterator
from contextlib import contextmanager

from voxflat.arguments import Progress


@contextmanager
def shown(is_shown: bool, progress: Progress | None) -> Iterator[Progress | None]:
    """Show a progress bar for each stage, and call the caller's progress function."""
    if not is_shown:
        yield progress
        return
    from tqdm.auto import tqdm

    bar = tqdm(total=1)

    def told(stage: str, done: int, total: int) -> bool | None:
        if bar.desc.removesuffix(": ") != stage:
            bar.reset(total)
            bar.set_description(stage)
        bar.total, bar.n = total, done
        bar.refresh()
        return None if progress is None else progress(stage, done, total)

    try:
        yield told
    finally:
        bar.close()
