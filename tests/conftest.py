import os
import signal
from pathlib import Path

from hypothesis import settings

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # the processes of pytest already share the cores
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

settings.register_profile("without a clock", deadline=None)
settings.load_profile("without a clock")

# background jobs of a shell and their children ignore Ctrl-C, so tests that send it would wait forever
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption("--pictures", type=Path, help="directory for the pictures of the napari workflow tests")
    parser.addoption("--sequences", type=int, help="number of random sequences of actions in the napari window")
