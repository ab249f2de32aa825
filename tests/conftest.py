import os
import signal
from collections import Counter
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # pytest's processes share the cores already
    os.environ.setdefault(name, "1")
os.environ.setdefault("MPLBACKEND", "Agg")

import pytest  # noqa: E402

# a shell's background jobs, and what they start, ignore Ctrl-C: tests that press it would wait for ever
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption("--folders", action="store_true", help="print at the end how long the tests of each folder took")


def pytest_terminal_summary(terminalreporter, config):
    if not config.getoption("folders"):
        return
    seconds, tests = Counter(), Counter()
    for report in (report for reports in terminalreporter.stats.values() for report in reports):
        if hasattr(report, "when"):
            folder = Path(report.nodeid.split("::")[0]).parent
            seconds[folder] += report.duration
            tests[folder] += report.when == "call"
    terminalreporter.section("tests and seconds of each folder, all processes together")
    for folder, spent in seconds.most_common():
        terminalreporter.line(f"{folder!s:20} {tests[folder]:6} {spent:8.1f} s")


@pytest.fixture
def open_widget(make_napari_viewer):
    """A function that opens napari's window with layers and a widget of ours."""

    def opened(*layers, show=False, name="Flatten surface"):
        viewer = make_napari_viewer(show=show)
        for layer in layers:
            viewer.add_layer(layer)
        _, widget = viewer.window.add_plugin_dock_widget("voxflat", name)
        return viewer, widget

    return opened


@pytest.fixture
def endings(monkeypatch):
    """How the jobs of the plugin's widgets ended: None for a result, or the class of the error."""
    from voxflat._napari.job import Job, PatchesJob

    ended = []

    def watch(run):
        def watched(job, progress):
            try:
                layers = run(job, progress)
            except Exception as error:
                ended.append(type(error))
                raise
            ended.append(None)
            return layers

        return watched

    for job in (Job, PatchesJob):
        monkeypatch.setattr(job, "run", watch(job.run))
    return ended


@pytest.fixture
def messages():
    """What napari notified of."""
    from napari.utils.notifications import notification_manager

    notification_manager.records.clear()
    return notification_manager.records
