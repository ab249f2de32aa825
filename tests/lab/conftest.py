"""FreeSurfer subjects with small hemispheres; one subject is flattened."""

import pytest
import studies
from command_line import succeed
from lab_runs import FEW, VERTICES


@pytest.fixture(scope="session")
def flattened(tmp_path_factory):
    """Return a subject flattened with two overlays, thickness and a volume of z, and the result of the command."""
    folder = tmp_path_factory.mktemp("subjects") / "sub-01"
    for hemi in ("lh", "rh"):
        studies.write_freesurfer(folder, hemi, studies.hemisphere(hemi, VERTICES), studies.C_RAS)
    studies.write_z(folder / "mri" / "z.mgz")
    return folder, succeed("freesurfer", folder, "--overlay", "mri/z.mgz", "thickness")


@pytest.fixture(scope="session")
def made(flattened):
    return flattened[0]


@pytest.fixture
def subject(tmp_path):
    """Return a subject that is not flattened and has only a left hemisphere."""
    folder = tmp_path / "sub-02"
    studies.write_freesurfer(folder, "lh", studies.hemisphere("lh", FEW), studies.C_RAS)
    return folder
