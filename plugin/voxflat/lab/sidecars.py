"""The metadata of BIDS in the record of a hemisphere, which is the sidecar of its flat surface."""

from pathlib import Path
from typing import Any

from voxflat.lab.inputs import Hemisphere

SOURCE = "source"
"""The name of the input of a study in `DatasetLinks` and BIDS URIs."""

_DENSITIES = {"fsLR": "32,492 vertices per hemisphere (fs_LR 32k)"}
_REFERENCES = {"fsLR": "https://templateflow.s3.amazonaws.com/tpl-fsLR_den-32k_hemi-{}_sphere.surf.gii"}


def sidecar(hemisphere: Hemisphere) -> dict[str, Any]:
    """Return the fields that BIDS defines for derivatives, and the layout of the input."""
    space = hemisphere.layout.space
    fields: dict[str, Any] = {
        "Description": "Flat map of the cortex; its vertices are those of the surface that was flattened",
        "Layout": str(hemisphere.layout),
        "Sources": _uris([*hemisphere.files.values(), *hemisphere.overlays.values()], hemisphere.source),
    }
    if space in _REFERENCES:
        fields |= {"SpatialReference": _REFERENCES[space].format(hemisphere.letter), "Density": _DENSITIES[space]}
    return fields


def _uris(files: list[Path], source: Path | None) -> list[str]:
    """Return the BIDS URIs of the files in the input of the study."""
    if source is None:
        return []
    root, paths = source.resolve(), (path.resolve() for path in files)
    inside = [path.relative_to(root).as_posix() for path in paths if path.is_relative_to(root)]
    return [f"bids:{SOURCE}:{path}" for path in dict.fromkeys(inside)]
