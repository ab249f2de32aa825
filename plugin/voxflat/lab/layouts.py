"""The layouts in which recon-all, sMRIPrep, fMRIPrep and the HCP pipelines leave the surfaces of a participant."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from voxflat.errors import InputError

HEMISPHERES = {"lh": ("L", "left"), "rh": ("R", "right")}
"""The BIDS letter and the side of each hemisphere, by its FreeSurfer name."""

SPACES = ("native", "fsLR")
"""The meshes of a participant: that of the reconstruction, and the 32k mesh of fs_LR, in the order of preference."""

_SURFACES = ("white", "pial", "midthickness")  # that can be flattened
_FIELDS = {
    "{start}": (r"sub-[A-Za-z0-9]+(_(ses|acq|ce|rec|run)-[A-Za-z0-9]+)*", "*"),  # of names of the anatomy
    "{run}": (r"sub-[A-Za-z0-9]+(_[a-z]+-[A-Za-z0-9]+)*?", "*"),  # of names of a run
    "{desc}": (r"(_desc-[A-Za-z0-9]+)?", ""),
    "{any}": (r"[^/]+", "*"),
}
"""Parts of patterns that differ between participants: the regular expression, and how messages show them."""


@dataclass(frozen=True)
class Layout:
    """The files of a participant, as one program names them.

    Patterns are relative to the directory of the participant, which is ``anat`` in BIDS derivatives. The first pattern
    of which a file exists is used.
    """

    program: str  # that writes the files
    space: str  # one of `SPACES`
    entities: str  # BIDS entities in the names of results: the mesh, unless it is the native one
    files: Mapping[str, tuple[str, ...]]  # patterns of white, pial, sphere, ..., by name
    values: tuple[str, ...]  # patterns of values at vertices; {name} is their name, such as thickness
    within: tuple[str, ...] = ("",)  # directories in which files of the user are searched
    labels: Mapping[str, int] | None = None  # of the hemispheres in the volume
    marks: tuple[str, ...] = ()  # directories that identify it
    warning: str = ""  # about all of its surfaces

    def __str__(self) -> str:
        return f"{self.program}, {self.space}"


def _bids(mesh: str, desc: str = "") -> dict[str, tuple[str, ...]]:
    """Return the patterns of surfaces of sMRIPrep; `mesh` contains the entities of their mesh."""
    start = "{start}_hemi-{letter}" + mesh
    return {
        name: (f"{start}_{name}.surf.gii", f"{start}_desc-preproc_{name}.surf.gii") for name in (*_SURFACES, "inflated")
    }


def _hcp(folder: str, mesh: str, of_atlas: str) -> dict[str, tuple[str, ...]]:
    """Return the patterns of surfaces of the HCP pipelines, whose values and spheres are in `of_atlas`."""
    found = {name: (f"{folder}/{{any}}.{{letter}}.{name}.{mesh}.surf.gii",) for name in (*_SURFACES, "inflated")}
    cortex = ("atlasroi", "roi") if mesh != "native" else ("roi",)
    volume = f"{folder.partition('/')[0]}/ribbon.nii.gz"
    return found | {
        "cortex": tuple(f"{of_atlas}/{{any}}.{{letter}}.{name}.{mesh}.shape.gii" for name in cortex),
        "volume": (volume,),
        "ribbon": (volume,),
        "bold": (
            "MNINonLinear/Results/{any}/{any}_Atlas_hp2000_clean.dtseries.nii",
            "MNINonLinear/Results/{any}/{any}_Atlas.dtseries.nii",
        ),
    }


_HCP_WITHIN = ("", "T1w", "MNINonLinear", "MNINonLinear/Results", "MNINonLinear/Native", "MNINonLinear/fsaverage_LR32k")
_RIBBON = {"lh": 2, "rh": 41}  # white matter in ribbon.nii.gz
_32K = "32k_fs_LR"
_IN_ATLAS = "MNINonLinear/fsaverage_LR32k"

FREESURFER = Layout(
    "recon-all",
    "native",
    "",
    {
        "white": ("surf/{hemi}.white",),
        "pial": ("surf/{hemi}.pial",),
        "inflated": ("surf/{hemi}.inflated",),
        "sphere": ("surf/{hemi}.sphere.reg",),
        "cortex": ("label/{hemi}.cortex.label",),
        "areas": ("label/{hemi}.aparc.annot",),
        "volume": ("mri/filled.mgz",),
        "ribbon": ("mri/ribbon.mgz",),
    },
    ("surf/{hemi}.{name}",),
    labels={"lh": 255, "rh": 127},
    marks=("surf", "mri"),
)
SMRIPREP = Layout(
    "sMRIPrep",
    "native",
    "",
    {
        **_bids(""),
        "white": (*_bids("")["white"], "{start}_hemi-{letter}_smoothwm.surf.gii"),
        "sphere": (
            "{start}_hemi-{letter}_space-fsaverage_desc-reg_sphere.surf.gii",
            "{start}_hemi-{letter}_space-fsLR_desc-msmsulc_sphere.surf.gii",
            "{start}_hemi-{letter}_space-fsLR_desc-reg_sphere.surf.gii",
            "{start}_hemi-{letter}_desc-reg_sphere.surf.gii",
        ),
        "cortex": ("{start}_hemi-{letter}_desc-cortex_mask.label.gii",),
        "volume": tuple(
            f"{{start}}_hemi-{{letter}}_label-WM{{desc}}_{kind}.{ending}"
            for kind in ("mask", "probseg")
            for ending in ("nii.gz", "nii")
        ),
        "ribbon": ("{start}_desc-ribbon_mask.nii.gz",),
        "bold": ("../func/{run}_hemi-{letter}_space-fsnative_bold.func.gii",),
    },
    (
        "{start}_hemi-{letter}_{name}.shape.gii",
        "{start}_hemi-{letter}_{name}.func.gii",
        "{start}_hemi-{letter}_desc-preproc_{name}.shape.gii",
    ),
    within=("", "../func"),
)
SMRIPREP_32K = Layout(
    "sMRIPrep",
    "fsLR",
    "_space-fsLR_den-32k",
    {
        **_bids("_space-fsLR_den-32k"),
        "native sphere": (
            "{start}_hemi-{letter}_space-fsLR_desc-msmsulc_sphere.surf.gii",
            "{start}_hemi-{letter}_space-fsLR_desc-reg_sphere.surf.gii",
        ),
        "grayordinates": tuple(
            f"{{start}}_space-fsLR_den-91k{desc}_{name}.dscalar.nii"
            for name in ("thickness", "sulc", "curv")
            for desc in ("", "_desc-preproc")
        ),
        "ribbon": ("{start}_desc-ribbon_mask.nii.gz",),
        "bold": ("../func/{run}_space-fsLR_den-91k_bold.dtseries.nii",),
    },
    (
        "{start}_space-fsLR_den-91k_{name}.dscalar.nii",
        "{start}_space-fsLR_den-91k_desc-preproc_{name}.dscalar.nii",
        "{start}_hemi-{letter}_space-fsLR_den-32k_{name}.shape.gii",
    ),
    within=("", "../func"),
)
HCP = Layout(
    "the HCP pipelines",
    "native",
    "",
    {
        **_hcp("T1w/Native", "native", "MNINonLinear/Native"),
        "sphere": tuple(
            f"MNINonLinear/Native/{{any}}.{{letter}}.sphere.{name}.native.surf.gii"
            for name in ("MSMSulc", "reg.reg_LR")
        ),
        "bold": (),
    },
    ("MNINonLinear/Native/{any}.{letter}.{name}.native.shape.gii",),
    _HCP_WITHIN,
    _RIBBON,
)


def _hcp_32k(folder: str, warning: str = "") -> Layout:
    sphere = f"{_IN_ATLAS}/{{any}}.{{letter}}.sphere.{_32K}.surf.gii"
    files = {**_hcp(folder, _32K, _IN_ATLAS), "sphere": (sphere,)}
    kinds = (f"{{letter}}.{{name}}.{_32K}.shape.gii", f"{{name}}.{_32K}.dscalar.nii")
    values = tuple(f"{_IN_ATLAS}/{{any}}.{kind}" for kind in kinds)
    mesh = "_space-fsLR_den-32k"
    return Layout("the HCP pipelines", "fsLR", mesh, files, values, _HCP_WITHIN, _RIBBON, warning=warning)


_WARPED = (
    "the surfaces in MNINonLinear are warped to MNI152, and so are the distances on the map. Add T1w/fsaverage_LR32k "
    "to the directory of the subject"
)

LAYOUTS = (FREESURFER, SMRIPREP, HCP, SMRIPREP_32K, _hcp_32k("T1w/fsaverage_LR32k"), _hcp_32k(_IN_ATLAS, _WARPED))
"""All layouts, in the order of preference: distances are measured on the native mesh if there is one."""


def layout_in(folder: Path, space: str | None = None) -> Layout | None:
    """Return the first layout of which a directory contains files that can be flattened, in a space or in any."""
    layouts = [layout for layout in LAYOUTS if space in (None, layout.space)]
    for layout in layouts:
        if any((folder / mark).is_dir() for mark in layout.marks) or _has(folder, layout, _SURFACES):
            return layout
    return next((layout for layout in layouts if _has(folder, layout, ("volume",))), None)


def _has(folder: Path, layout: Layout, names: Sequence[str]) -> bool:
    """Return whether a directory contains one of the files of a layout, of either hemisphere."""
    return any(Finder(folder, hemi, layout).has(name) for hemi in HEMISPHERES for name in names)


class Finder:
    """Find the files of a hemisphere in a directory by the patterns of a layout."""

    def __init__(self, folder: Path, hemi: str, layout: Layout) -> None:
        self.folder, self.hemi, self.layout = folder, hemi, layout
        self.letter = HEMISPHERES[hemi][0]
        self._names: dict[str, list[str]] = {}

    @cached_property
    def subject(self) -> str:
        """The label of the participant in names of files, such as sub-01."""
        names = (match for name in self._in("") if (match := re.match(r"sub-[A-Za-z0-9]+", name)))
        return next((match[0] for match in names), self.folder.name)

    def filled(self, text: str) -> str:
        """Return the name of a file of the user with its placeholders filled in."""
        hemi = self.hemi if self.layout is FREESURFER else self.letter
        return text.replace("{hemi}", hemi).replace("{subject}", self.subject)

    def has(self, name: str) -> bool:
        """Return whether there is a file of a name, or there are several."""
        return any(next(self._matching(pattern), None) is not None for pattern in self._patterns(name))

    def one(self, name: str) -> Path | None:
        """Return the file of a name, such as white or thickness; several of one pattern raise an InputError."""
        for pattern in self._patterns(name):
            found = list(self._matching(pattern))
            if len(found) > 1:
                names = ", ".join(path.name for path in found)
                several = f"{len(found)} files for {name} of hemisphere {self.letter} ({names})"
                raise InputError(f"{self.folder} has {several}. Keep only one of them{_or_pass(name)}")
            if found:
                return found[0]
        return None

    def all(self, name: str) -> list[Path]:
        """Return all files of a name that the layout defines."""
        if name not in self.layout.files:
            return []
        return [path for pattern in self._patterns(name) for path in self._matching(pattern)]

    def needed(self, name: str) -> Path:
        """Return the file of a name; raise an InputError if it is missing."""
        if (path := self.one(name)) is not None:
            return path
        end = f"Check that {self.layout.program} finished for {self.subject}"
        if name not in self.layout.files:
            raise InputError(f"{self.folder}: {self.layout} has no file for {name}. Pass other options")
        if self.layout is FREESURFER:
            raise InputError(f"{self.place(name)}: the file does not exist. {end}")
        places = " or ".join(map(self._shown, self._patterns(name)[:3:2]))
        raise InputError(f"{self.folder}: found no {places}. {end}")

    def place(self, name: str) -> str:
        """Return where the file of a name is expected."""
        return str(self.folder / self._shown(self._patterns(name)[0]))

    def measures(self) -> list[str]:
        """Return the names of the values at the vertices of this hemisphere, such as thickness."""
        found: list[str] = []
        for pattern in self.layout.values:
            folder, _, of_name = pattern.rpartition("/")
            named = re.compile(self._expression(of_name).replace(re.escape("{name}"), "(?P<name>[^/]+)"))
            found += [match["name"] for name in self._in(folder) if (match := named.fullmatch(name))]
        return found

    def _patterns(self, name: str) -> Sequence[str]:
        usual = [pattern.replace("{name}", name) for pattern in self.layout.values]
        return self.layout.files.get(name) or usual

    def _matching(self, pattern: str) -> Iterator[Path]:
        """Yield the files that match a pattern, sorted by name."""
        *above, of_name = pattern.split("/")
        named = re.compile(self._expression(of_name))
        for folder in self._folders(above):
            yield from (self.folder / folder / name for name in self._in(folder) if named.fullmatch(name))

    def _folders(self, above: Sequence[str]) -> list[str]:
        """Return the directories that match the directories of a pattern, relative to that of the participant."""
        found = [""]
        for part in above:
            if part == "{any}":
                below = (path for folder in found for path in sorted((self.folder / folder).glob("*")))
                found = [path.relative_to(self.folder).as_posix() for path in below if path.is_dir()]
            else:
                found = [f"{folder}/{part}" if folder else part for folder in found]
        return found

    def _expression(self, pattern: str) -> str:
        """Return the regular expression of a pattern."""
        text = re.escape(pattern.replace("{hemi}", self.hemi).replace("{letter}", self.letter))
        for name, (expression, _) in _FIELDS.items():
            text = text.replace(re.escape(name), expression)
        return text

    def _shown(self, pattern: str) -> str:
        """Return a pattern as messages show it."""
        text = pattern.replace("{hemi}", self.hemi).replace("{letter}", self.letter)
        for name, (_, shown) in _FIELDS.items():
            text = text.replace(name, shown)
        return text

    def _in(self, folder: str) -> list[str]:
        """Return the sorted names of the files in a directory."""
        if folder not in self._names:
            at = self.folder / folder
            self._names[folder] = sorted(path.name for path in at.iterdir() if path.is_file()) if at.is_dir() else []
        return self._names[folder]


def _or_pass(name: str) -> str:
    return ", or pass one of them with --overlay" if name == "bold" else ""
