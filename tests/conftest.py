import os
import signal
from pathlib import Path

from hypothesis import settings

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # pytest's processes share the cores already
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

settings.register_profile("without a clock", deadline=None)
settings.load_profile("without a clock")

# a shell's background jobs, and what they start, ignore Ctrl-C: tests that press it would wait for ever
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption("--pictures", type=Path, help="keep the pictures that tests of napari's workflow take here")
    parser.addoption("--sequences", type=int, help="try so many random sequences of actions in napari's window")
