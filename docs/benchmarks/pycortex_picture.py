"""Draw the flat map of fsaverage5 with pycortex itself, for the how-to page (requires `pip install pycortex`).

    python docs/benchmarks/pycortex_picture.py docs/pictures/pycortex.png

writes fsaverage5 in the layout of recon-all, stores it with `voxflat.to_pycortex`, and saves what `cortex.quickshow`
shows.
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np
import studies

import voxflat

mpl.use("agg")


def picture(folder, out):
    """Store the subject, and draw its thickness."""
    import cortex  # after Matplotlib's backend is set

    for hemi in studies.SIDES:
        studies.write_freesurfer(folder / "fsaverage5", hemi, studies.hemisphere(hemi))
    voxflat.to_pycortex(folder / "fsaverage5", folder / "filestore")
    cortex.db.filestore = cortex.database.default_filestore = str(folder / "filestore")
    cortex.db.reload_subjects()
    thickness = np.concatenate([studies.hemisphere(hemi)["thickness"] for hemi in studies.SIDES])
    data = cortex.Vertex(thickness, "fsaverage5", cmap="viridis", vmin=1.5, vmax=4)
    cortex.quickshow(data, with_curvature=True, with_rois=False, with_labels=False).savefig(out, dpi=60)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    with tempfile.TemporaryDirectory() as folder:
        picture(Path(folder), parser.parse_args().out)


if __name__ == "__main__":
    main()
