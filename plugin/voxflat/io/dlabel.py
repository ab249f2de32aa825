"""Write CIFTI files (https://www.nitrc.org/projects/cifti) with labels at the vertices of a surface."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from voxflat.arguments import printable
from voxflat.errors import InputError
from voxflat.io.channels import cifti_structure
from voxflat.io.files import require
from voxflat.io.provenance import Record, as_text, portable


def write_dlabel(
    path: Path,
    labels: NDArray[np.int64],
    keys: Sequence[int],
    names: Sequence[str],
    colours: NDArray[np.uint8],
    structure: str | None,
    record: Record,
) -> None:
    """Write labels at all vertices of a hemisphere (0 for no label), with their names and colours."""
    if structure is None:
        remedy = "Begin the name of the surface with lh. or rh., or save as .label.gii"
        raise InputError(f"CIFTI files store the hemisphere, which is not known. {remedy}")
    nib: Any = require("nibabel")
    axes = nib.cifti2.cifti2_axes
    table = {0: ("???", (0.0, 0.0, 0.0, 0.0))}
    for key, name, colour in zip(keys, names, colours.tolist(), strict=True):
        table[int(key)] = (printable(name), (*(channel / 255 for channel in colour), 1.0))
    maps = axes.LabelAxis(["regions"], [table])
    vertices = axes.BrainModelAxis.from_surface(np.arange(len(labels)), len(labels), cifti_structure(structure))
    header = nib.Cifti2Header.from_axes((maps, vertices))
    header.matrix.metadata = nib.cifti2.Cifti2MetaData({"voxflat": as_text(portable(record))})
    image = nib.Cifti2Image(labels[None].astype(np.float32), header)
    image.nifti_header.set_intent("NIFTI_INTENT_CONNECTIVITY_DENSE_LABELS")
    image.to_filename(path)
