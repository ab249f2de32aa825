"""A threshold within the noise: a warning comes before the long work, which shows its progress and can be cancelled."""

import logging
import re

import numpy as np
import pytest

import voxflat

pytestmark = pytest.mark.slow


def volume():
    """Return noise of standard deviation 1, with a ball of radius 20 voxels that is brighter by 8."""
    x = np.indices((72, 72, 72)) - 36
    return np.random.default_rng(0).normal(0, 1, x.shape[1:]) + 8 * (np.sum(x**2, axis=0) < 400)


@pytest.mark.parametrize(("threshold", "told"), [(1.0, r"\d{5} parts, of which the largest .*\d %"), (0.0, r"\d{5} h")])
def test_noise_is_told_before_the_surface_is_sought(caplog, threshold, told):
    events, placed = [], []

    def progress(stage, done, total):
        events.append((stage, len(caplog.records)))
        placed.extend([done / total] * (stage == "placing the vertices"))
        return len(set(placed)) < 3

    with caplog.at_level(logging.WARNING, "voxflat"), pytest.raises(voxflat.Cancelled):
        voxflat.surface(volume(), threshold=threshold, progress=progress)
    (warning,) = [record.getMessage() for record in caplog.records]
    assert re.match(
        rf"the foreground has {told}.* may contain noise, whose surface takes long\. Check the label", warning
    )
    assert {told for stage, told in events if stage == "placing the vertices"} == {1}  # the warning came before
    assert 0 <= placed[0] < placed[-1] < 1  # several steps, until it was cancelled


def test_an_object_above_the_noise_is_not_doubted(caplog):
    voxflat.surface(volume(), threshold=5.0)
    assert "noise" not in caplog.text
