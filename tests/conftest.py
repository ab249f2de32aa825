import gc
import os
import signal
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # pytest's processes share the cores already
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

gc.set_threshold(50_000, 20, 100)  # what tests leave goes by itself: to look for more took a twentieth of their time

settings.register_profile("without a clock", deadline=None)
settings.load_profile("without a clock")

# a shell's background jobs, and what they start, ignore Ctrl-C: tests that press it would wait for ever
signal.signal(signal.SIGINT, signal.default_int_handler)


LONGEST = ("test_demo.py", "test_lab.py", "test_fuzz.py")


def pytest_collection_modifyitems(items):
    """Put what takes longest first: begun at the end, it would keep one process busy while the others have nothing."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


def pytest_addoption(parser):
    parser.addoption("--pictures", type=Path, help="keep the pictures that tests of napari's workflow take here")
    parser.addoption("--sequences", type=int, help="try so many random sequences of actions in napari's window")
    parser.addoption("--folders", action="store_true", help="print at the end how long the tests of each folder took")


def pytest_terminal_summary(terminalreporter, config):
    if not config.getoption("folders"):
        return
    seconds, tests = Counter(), Counter()
    for report in (report for reports in terminalreporter.stats.values() for report in reports):
        if isinstance(report, pytest.TestReport):
            folder = Path(report.nodeid.split("::")[0]).parent
            seconds[folder] += report.duration
            tests[folder] += report.when == "call"
    terminalreporter.section("tests and seconds of each folder, all processes together")
    for folder, spent in seconds.most_common():
        terminalreporter.line(f"{folder!s:20} {tests[folder]:6} {spent:8.1f} s")
