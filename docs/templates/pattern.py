"""Make the template of sulcal patterns for registration: `uv run docs/templates/pattern.py`.

The source is fsaverage5 (FreeSurfer's average of 40 subjects, Fischl et al. 1999), included in nilearn: the registered
sphere, and the white and pial surfaces. The pattern is computed midway between them, as for any subject
(`rust/core/src/sphere/pattern.rs`), and stored as integers on an icosphere of 10,242 vertices: depths at three scales,
positions on the smoothed surface (as differences between successive vertices, which compress better), and weights,
which are 0.1 where the white and pial surfaces touch, because the medial wall is not cortex.
"""

import gzip
import importlib.metadata
import json
from pathlib import Path

import nibabel
import nilearn
import numpy as np

from voxflat import _core
from voxflat.surfaces.standard.pattern import DEPTH_UNIT, PLACE_UNIT, SIDES, WEIGHT_UNIT, icosphere

DATA = Path(nilearn.__file__).parent / "datasets" / "data" / "fsaverage5"
OUT = Path(__file__).parents[2] / "plugin" / "voxflat" / "surfaces" / "standard" / "pattern.npz"
TOUCHING = 0.5  # mm
MEDIAL_WALL = 0.1


def surface(name):
    """Read the points and triangles of a surface of nilearn's fsaverage5."""
    image = nibabel.GiftiImage.from_bytes(gzip.decompress((DATA / f"{name}.gii.gz").read_bytes()))
    points, faces = (array.data for array in image.darrays[:2])
    return points.astype(np.float64), faces.astype(np.int64)


def template(side):
    """Return the arrays of a side by name."""
    (white, faces), (pial, _), (sphere, _) = (surface(f"{kind}_{side}") for kind in ("white", "pial", "sphere"))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    depths, places, _ = _core.Surface.from_triangles((white + pial) / 2, faces)[0].pattern()
    weights = np.where(np.linalg.norm(pial - white, axis=1) < TOUCHING, MEDIAL_WALL, 1.0)
    values = np.column_stack([depths.T, places, weights])
    face, share = _core.locate_on_sphere(sphere, faces, icosphere()[0])
    on_grid = np.einsum("nk,nkc->nc", share, values[faces[face]])
    depths = np.clip(np.rint(on_grid[:, :3].T / DEPTH_UNIT), -127, 127).astype(np.int8)
    places = np.diff(np.rint(on_grid[:, 3:6] / PLACE_UNIT).astype(np.int16), axis=0, prepend=np.int16(0))
    weights = np.rint(on_grid[:, 6] / WEIGHT_UNIT).astype(np.uint8)
    return {"depths": depths, "places": places.astype(np.int16), "weights": weights}


if __name__ == "__main__":
    arrays = {f"{side}_{name}": array for side in SIDES for name, array in template(side).items()}
    nilearn = importlib.metadata.version("nilearn")
    told = {"made by": "docs/templates/pattern.py", "of": f"fsaverage5, nilearn {nilearn}"}
    np.savez_compressed(OUT, provenance=np.array(json.dumps(told)), **arrays)
    print(OUT, OUT.stat().st_size, "bytes")
