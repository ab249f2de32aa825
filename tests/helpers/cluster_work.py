"""Tasks of cluster workers in tests, which the workers import."""

import time
from importlib.metadata import PackageNotFoundError
from pathlib import Path


def tell(item, *, threads, progress):
    return item


def wait(item, *, threads, progress):
    """Work until the task is cancelled, then leave a file."""
    Path(item, "begun").touch()
    while progress("waiting", 0, 1):
        time.sleep(0.01)
    Path(item, "stopped").touch()


def no_package(name):
    """Raise the error of importlib.metadata.version for a missing package."""
    raise PackageNotFoundError(name)
