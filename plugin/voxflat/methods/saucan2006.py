"""The method "saucan2006": a map that is glued of certified patches (Appleboim, Saucan, Zeevi 2006)."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from voxflat.arguments import is_number, shown
from voxflat.atlases.glued import Seams, measured
from voxflat.errors import InputError
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import map_over_triangles
from voxflat.methods.method import How, OverTriangles
from voxflat.surfaces.cutting import Cutout, Where, cut_open
from voxflat.surfaces.manifold import Manifold


@dataclass(frozen=True, kw_only=True)
class Saucan2006(OverTriangles):
    """Flatten in certified patches that are glued to one piece.

    The surface falls into patches within 10° of their planes, onto which they are projected: no length changes by more
    than a factor 1 + tan 10°. Seams between them are closed as long as every triangle keeps max(σ₁, 1/σ₂) ≤ C, where
    σ₁ ≥ σ₂ are its stretches in the two principal directions; the surface is cut where no triangle could keep that.
    `Surface.patches` gives the patches themselves, of surfaces of any topology. No distances are measured.

    Parameters
    ----------
    bound : float
        The greatest factor C by which lengths may change, above 1 and up to 10. Where patches cannot be glued to one
        piece that is an error.

    References
    ----------
    E. Appleboim, E. Saucan, Y. Y. Zeevi: On Sampling and Flattening of Folded Surfaces, with Applications to Medical
    Imaging. 2006.

    Examples
    --------
    >>> import numpy as np
    >>> import voxflat
    >>> from voxflat.methods import Saucan2006
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Saucan2006(bound=1.3))
    >>> flat_map.metadata["patches"]
    1
    """

    name: ClassVar[str] = "saucan2006"
    summary: ClassVar[str] = "glued of certified patches"
    takes_rows: ClassVar[bool] = False

    bound: float = 1.5

    def __post_init__(self) -> None:
        """Check the options."""
        if not (is_number(self.bound) and 1 < self.bound <= 10):
            raise InputError(
                f"bound is {shown(self.bound)}; give a number above 1, up to 10: how much lengths may change at most"
            )

    def _cut(self, surface: Manifold, where: Where, how: How) -> Cutout:
        """Cut a surface open to a disk; no further unless that is asked for, since gluing cuts where it must."""
        where = replace(where, relax=False) if where.relax is None else where
        return cut_open(surface, where, how.threads, how.progress)

    def _map(self, cut: Cutout, how: How) -> FlatMap:
        """Flatten a disk in patches that are glued to one piece, and cut it open where seams remain."""
        need = how.check_memory(cut.part.core.saucan2006_memory_need(how.workers), "take a smaller patch")
        bound = float(self.bound)
        result = cut.part.core.saucan2006(bound, how.seed, how.threads, how.progress)
        part, seams = cut.part._with_core(result["surface"]), Seams(**result["seams"])
        faces = part.faces[: len(cut.faces)]  # holes that were closed come last
        cut = replace(cut, part=part, faces=faces, metadata={**cut.metadata, "points": len(np.unique(part.vertices))})
        told = {
            "bound": bound,
            "patches": result["patches"],
            "seams": seams.figures(),
            "before": {"certified_c": result["certified"], "c": result["before"]},
            "measured": measured(result["stretch"], part.points[part.faces]),
        }
        doubts = [f"{seams.cuts:.0f} mm of seams between patches stay cut"] if seams.cuts > 0 else []
        return map_over_triangles(self.name, cut, how, result, need, None, told, doubts)
