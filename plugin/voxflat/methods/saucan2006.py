"""The method "saucan2006": one map glued from certified patches (Appleboim, Saucan, Zeevi 2006)."""

from dataclasses import dataclass, replace
from typing import ClassVar

from voxflat.arguments import is_number, shown
from voxflat.atlases.glued import Seams, measured
from voxflat.errors import InputError
from voxflat.io.grid import in_unit, rounded
from voxflat.maps.flat_map import FlatMap
from voxflat.methods.common import bands_of, map_over_triangles
from voxflat.methods.method import FlattenSettings, OverTriangles
from voxflat.surfaces.cutting import CutManifold
from voxflat.surfaces.manifold import Manifold


@dataclass(frozen=True, kw_only=True)
class Saucan2006(OverTriangles):
    r"""Flatten the surface in certified patches, and glue them into one map.

    As in [1]_, the surface is divided into patches, each of which is projected orthogonally onto a plane. No triangle
    of a patch is inclined by more than :math:`\theta = 10°` to its plane, so no length changes by more than a factor of

    .. math:: 1 + \tan\theta \approx 1.176 .

    Gluing extends the published method. Neighbouring patches are moved so that their common edges meet, and a seam is
    closed as long as every triangle satisfies

    .. math:: \max(\sigma_1, 1/\sigma_2) \le C,

    where :math:`\sigma_1 \ge \sigma_2` are its principal stretches and :math:`C` is `bound`. Where closing a seam would
    violate this bound, the surface stays cut. No distances are measured.

    Parameters
    ----------
    bound : float
        Maximum factor :math:`C` by which lengths may change, above 1 and up to 10; by default 1.5. If the patches
        cannot be glued into one piece within this bound, flattening raises an error.

    See Also
    --------
    Surface.patches : Return the patches themselves, for surfaces of any topology.
    FlatAtlas.glue : Glue patches; several pieces may remain.
    Surface.flatten : Flatten a surface with a method.

    References
    ----------
    .. [1] E. Appleboim, E. Saucan, Y. Y. Zeevi: On Sampling and Flattening of Folded Surfaces, with Applications to
       Medical Imaging. 2006.

    Examples
    --------
    >>> from voxflat.methods import Saucan2006
    >>> depth = voxflat.range_image(np.zeros((9, 9)), 1.0)
    >>> flat_map = depth.flatten(Saucan2006(bound=1.3))
    >>> flat_map.metadata["patches"]
    1
    """

    name: ClassVar[str] = "saucan2006"
    summary: ClassVar[str] = "glues certified patches"
    _takes_rows: ClassVar[bool] = False

    bound: float = 1.5

    def __post_init__(self) -> None:
        """Check the options."""
        if not (is_number(self.bound) and 1 < self.bound <= 10):
            raise InputError(
                f"bound is {shown(self.bound)}. Pass the largest factor by which lengths may change, from above 1 to 10"
            )

    def _cut(self, surface: Manifold, settings: FlattenSettings) -> CutManifold[Manifold]:
        """Cut a surface open to a disk; add relaxation cuts only on request, because gluing cuts where needed."""
        settings = replace(settings, relax=False) if settings.relax is None else settings
        return super()._cut(surface, settings)

    def _map(self, cut: CutManifold[Manifold], settings: FlattenSettings) -> FlatMap:
        """Flatten a disk in patches glued into one piece, and cut it open along the remaining seams."""
        need = settings.check_memory(
            cut.surface.core.saucan2006_memory_need(settings.workers), "flatten a smaller patch"
        )
        bound = float(self.bound)
        result = cut.surface.core.saucan2006(
            bound, settings.seed, bands_of(cut.surface), settings.threads, settings.progress
        )
        part, seams = cut.surface._with_core(result["surface"]), Seams(**result["seams"])
        faces = part.faces[: len(cut.faces)]  # triangles that close holes come last
        cut = replace(cut, surface=part, faces=faces)
        details = {
            "bound": bound,
            "patches": result["patches"],
            "seams": seams.figures(),
            "before": {"certified_c": result["certified"], "c": result["before"]},
            "measured": measured(result["stretch"], part.points[part.faces]),
        }
        length = in_unit(f"{rounded(seams.cuts)} mm", cut.whole.origin.named_unit)
        warnings = [f"{length} of the seams between patches remain cut"] if seams.cuts > 0 else []
        return map_over_triangles(self.name, cut, settings, result, need, None, details, warnings)
