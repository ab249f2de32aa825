"""Find the input files of hemispheres in FreeSurfer directories, sMRIPrep derivatives or segmentations."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import partial
from itertools import product
from pathlib import Path
from typing import ClassVar

from voxflat.arguments import log, shown
from voxflat.errors import InputError
from voxflat.io.meshes import named_structure
from voxflat.lab.results import MEASURES
from voxflat.surfaces.standard.template import SIDES

HEMISPHERES = {"lh": ("L", "left"), "rh": ("R", "right")}
"""The BIDS letter and the side of each hemisphere, by its FreeSurfer name."""

GEOMETRIES = ("midthickness", "white", "pial")
"""The surfaces on which distances can be measured."""

_NEEDED = {"midthickness": ("white", "pial"), "white": ("white",), "pial": ("pial",)}
_USUAL_OVERLAY = "thickness"
_KINDS_OF_CUTS = ("standard", "automatic")  # instead of a file
_CUTS_FILE = "the cuts file"
_LABELS = (".annot", ".label", ".label.gii", ".dlabel.nii")  # endings
_VOLUME_ENDINGS = (".nii.gz", ".nii", ".mgz", ".mgh")
_FILLED = {"lh": 255, "rh": 127}  # labels of mri/filled.mgz, the white matter of each hemisphere
_LISTED = 20  # most labels that a message lists
_NOBODY = re.compile(r"fsaverage|[lr]h\.EC_average|.*\.(long|base)\b")  # directories of recon-all that are not subjects


@dataclass(frozen=True)
class Parameters:
    """How to flatten each hemisphere."""

    cuts: str = "standard"  # or "automatic", or a file; {hemi} in its name stands for lh or rh, or L or R
    geometry: str = "midthickness"  # one of `GEOMETRIES`, on which distances are measured
    volume: bool = False  # whether to start from a white-matter volume instead of surfaces
    overlays: tuple[str, ...] = ()  # names, or files with {hemi} and {subject}; thickness by default
    seed: int = 0
    template: tuple[str, ...] | None = None  # flat maps of a template, one per hemisphere, to be measured as well
    template_sphere: tuple[str, ...] | None = None  # the registered spheres of their mesh

    def __post_init__(self) -> None:
        """Raise an InputError if overlays cannot be shown together, or at all; result files have their names."""
        if (self.template is None) != (self.template_sphere is None):
            raise InputError("a template needs its flat map and its sphere. Pass --template and --template-sphere")
        names: set[str] = set()
        for text in self.overlays:
            name = overlay_name(text)
            if name.lower() in names:
                raise InputError(f"two overlays have the name {name}. Rename one of the files ({text})")
            if name in MEASURES:
                raise InputError(f"the overlay {text} has the name of a measure, {name}. Rename the file")
            if text.lower().endswith(_LABELS):
                raise InputError(f"the overlay {text} contains labels. Draw them with voxflat figure MAP --parcels")
            names.add(name.lower())


@dataclass(frozen=True)
class Hemisphere:
    """A hemisphere and its input files."""

    hemi: str  # lh or rh
    files: dict[str, Path]  # white, pial, sphere, cortex or areas, volume, cuts
    overlays: dict[str, Path] = field(default_factory=dict)
    label: int | None = None  # label of the hemisphere in the volume

    @property
    def letter(self) -> str:
        """The BIDS letter: L or R."""
        return HEMISPHERES[self.hemi][0]


@dataclass(frozen=True)
class Participant:
    """A participant of a study, or one session of a participant."""

    label: str  # without sub-
    session: str | None  # without ses-
    folder: Path | None  # FreeSurfer directory of the subject, or anat of derivatives; None if there is none

    @property
    def name(self) -> str:
        """The prefix of file names: ``sub-01``, ``sub-01_ses-02``."""
        return f"sub-{self.label}" + (f"_ses-{self.session}" if self.session else "")


def found_in(folder: Path, hemi: str, parameters: Parameters) -> Hemisphere:
    """Find the files of a hemisphere in a FreeSurfer directory, or in derivatives such as ``sub-01/anat``."""
    if not folder.is_dir():
        raise InputError(f"{folder}: the directory does not exist. Pass an output directory of recon-all or sMRIPrep")
    find = _finder(folder, hemi)
    files: dict[str, Path | None] = {}
    if parameters.volume:
        files["volume"] = find.needed("volume")
    else:
        files |= {name: find.needed(name) for name in _NEEDED[parameters.geometry]}
        files |= {"sphere": find.one("sphere"), "cortex": find.one("cortex")}
        if files["cortex"] is None:
            files["areas"] = find.one("areas")
    if parameters.cuts not in _KINDS_OF_CUTS:
        files["cuts"] = _given(find, parameters.cuts, _CUTS_FILE)
    files["template"] = _of_side(parameters.template, hemi, "--template")
    files["template sphere"] = _of_side(parameters.template_sphere, hemi, "--template-sphere")
    overlays: dict[str, Path] = {}
    usual = find.one(_USUAL_OVERLAY) if not parameters.overlays and not parameters.volume else None
    if usual is not None:
        overlays[_USUAL_OVERLAY] = usual
    overlays |= {overlay_name(text): _overlay(find, text) for text in parameters.overlays}
    label = _FILLED[hemi] if isinstance(find, _FreeSurfer) and parameters.volume else None
    return Hemisphere(hemi, {name: path for name, path in files.items() if path is not None}, overlays, label)


def _of_side(names: Sequence[str] | None, hemi: str, option: str) -> Path | None:
    """Return the file of a template for a hemisphere."""
    if names is None:
        return None
    side = HEMISPHERES[hemi][1]
    found = [Path(name) for name in names if named_structure(name) == SIDES[side]]
    if len(found) != 1:
        remedy = "Pass one file per hemisphere, with lh., .L., hemi-L or _left in its name, or rh., .R., ..."
        raise InputError(f"{option} has {len(found)} files for the {side} hemisphere. {remedy}")
    if not found[0].is_file():
        raise InputError(f"{found[0]}: the file does not exist. Check {option}")
    return found[0]


def check_given(
    everybody: Sequence[Participant], hemis: Sequence[str], parameters: Parameters, source: Path | None = None
) -> None:
    """Raise an InputError if an overlay or the cuts file exists for nobody in the study in the directory `source`.

    If it is missing for some participants only, these fail, and the others are processed.
    """
    missing = _missing(everybody, hemis, parameters)
    if missing and source is not None:
        others = [person for sessions in _by_label(source)[0].values() for person in sessions]
        missing = {text: error for text, error in missing.items() if text in _missing(others, hemis, parameters)}
    for error in missing.values():
        raise error


def _missing(everybody: Sequence[Participant], hemis: Sequence[str], parameters: Parameters) -> dict[str, InputError]:
    """Return the overlays and the cuts file that exist for none of the participants, with the error for the first."""
    searches: dict[str, Callable[[_FreeSurfer | _Bids], Path]]
    searches = {text: partial(_overlay, text=text) for text in parameters.overlays}
    if parameters.cuts not in _KINDS_OF_CUTS:
        searches[parameters.cuts] = partial(_given, text=parameters.cuts, kind=_CUTS_FILE)
    existing: set[str] = set()
    errors: dict[str, InputError] = {}
    folders = [person.folder for person in everybody if person.folder and person.folder.is_dir()]
    for folder, hemi in product(folders, hemis):
        for text in [key for key in searches if key not in existing]:
            try:
                searches[text](_finder(folder, hemi))
                existing.add(text)
            except InputError as error:
                errors.setdefault(text, error)
    return {text: error for text, error in errors.items() if text not in existing}


def _finder(folder: Path, hemi: str) -> "_FreeSurfer | _Bids":
    """Return the object that finds the files of a hemisphere in a directory."""
    is_freesurfer = (folder / "surf").is_dir() or (folder / "mri").is_dir()
    return _FreeSurfer(folder, hemi) if is_freesurfer else _Bids(folder, hemi)


def _overlay(find: "_FreeSurfer | _Bids", text: str) -> Path:
    """Return the path to an overlay, given its name, such as thickness, or a file."""
    return find.one(text) or _given(find, text, "the overlay", find.place(text))


def _given(find: "_FreeSurfer | _Bids", text: str, kind: str, *places: str) -> Path:
    """Return the path to a file given by the user, with the placeholders filled in; `places` were searched before."""
    named = find.filled(text)
    for path in (find.folder / named, Path(named)):
        if path.is_file():
            return path
    searched = [*(places if "/" not in text else ()), str(find.folder / named), str(Path(named).absolute())]
    near = get_close_matches(re.sub(r"^[lr]h\.", "", text), find.measures()) if places else []
    hint = f"Did you mean {' or '.join(near)}? voxflat" if near else "Check the name; voxflat"
    raise InputError(f"{kind} {text} does not exist. {hint} searched for {', '.join(searched)}")


def overlay_name(overlay: str) -> str:
    """Return the name of an overlay, such as thickness for ``sub-01_hemi-L_thickness.shape.gii``."""
    name = Path(overlay).name.replace("{hemi}", "lh").replace("{subject}", "sub")
    name = re.sub(r"^[lr]h\.", "", name).split("_")[-1]
    name = re.sub(r"\.(nii|func|shape|label)?\.?(gz|gii|nii|mgz|mgh|npy|txt|annot)$", "", name)
    return re.sub(r"[^A-Za-z0-9]", "", name) or "overlay"


class _FreeSurfer:
    """Find files in a subject directory of recon-all."""

    _PLACES: ClassVar[dict[str, str]] = {
        "white": "surf/{hemi}.white",
        "pial": "surf/{hemi}.pial",
        "sphere": "surf/{hemi}.sphere.reg",
        "cortex": "label/{hemi}.cortex.label",
        "areas": "label/{hemi}.aparc.annot",
        "volume": "mri/filled.mgz",
    }

    def __init__(self, folder: Path, hemi: str) -> None:
        self.folder, self.hemi = folder, hemi

    def filled(self, text: str) -> str:
        return text.replace("{hemi}", self.hemi).replace("{subject}", self.folder.name)

    def place(self, name: str) -> str:
        """Return the path of a file by its name, such as thickness."""
        return str(self.folder / self.filled(self._PLACES.get(name, f"surf/{{hemi}}.{name}")))

    def measures(self) -> list[str]:
        """Return the names of the files in surf/ of this hemisphere, such as thickness."""
        start = f"{self.hemi}."
        return [path.name.removeprefix(start) for path in sorted(self.folder.glob(f"surf/{start}*"))]

    def one(self, name: str) -> Path | None:
        path = Path(self.place(name))
        return path if path.is_file() else None

    def needed(self, name: str) -> Path:
        if (path := self.one(name)) is not None:
            return path
        raise InputError(
            f"{self.place(name)}: the file does not exist. Check that recon-all finished for {self.folder.name}"
        )


class _Bids:
    """Find files in derivatives by their BIDS entities, as sMRIPrep and fMRIPrep name them."""

    # the first pattern that matches is used; patterns apply to the part of a name after hemi-L
    _PATTERNS: ClassVar[dict[str, tuple[str, ...]]] = {
        "white": (r"_white\.surf\.gii", r"_smoothwm\.surf\.gii"),
        "pial": (r"_pial\.surf\.gii",),
        "sphere": (
            r"_space-fsaverage_desc-reg_sphere\.surf\.gii",
            r"_space-fsLR_desc-(reg|msmsulc)_sphere\.surf\.gii",
            r"_desc-reg_sphere\.surf\.gii",
        ),
        "cortex": (r"_desc-cortex_mask\.label\.gii",),
        "areas": (),
        "volume": (r"_label-WM(_desc-[A-Za-z0-9]+)?_(mask|probseg)\.nii(\.gz)?",),
    }

    def __init__(self, folder: Path, hemi: str) -> None:
        self.folder, self.hemi = folder, hemi
        self.letter = HEMISPHERES[hemi][0]
        names = [path.name for path in sorted(folder.iterdir()) if path.is_file()] if folder.is_dir() else []
        subject = next((match[0] for name in names if (match := re.match(r"sub-[A-Za-z0-9]+", name))), folder.name)
        self.names, self.subject = names, subject

    def filled(self, text: str) -> str:
        return text.replace("{hemi}", self.letter).replace("{subject}", self.subject)

    def place(self, name: str) -> str:
        """Return the path of a file of values by its name, such as thickness."""
        return str(self.folder / f"*_hemi-{self.letter}_{name}.shape.gii (or .func.gii)")

    def measures(self) -> list[str]:
        """Return the names of the files of values of this hemisphere, such as thickness."""
        usual = rf".*_hemi-{self.letter}_([A-Za-z0-9]+)\.(shape|func)\.gii"
        return [match[1] for name in self.names if (match := re.fullmatch(usual, name))]

    def one(self, name: str) -> Path | None:
        usual = (rf"_{re.escape(name)}\.(shape|func)\.gii",)
        start = rf"sub-[A-Za-z0-9]+(_(ses|acq|rec|run)-[A-Za-z0-9]+)*_hemi-{self.letter}"
        for pattern in self._PATTERNS.get(name, usual):
            found = [file for file in self.names if re.fullmatch(start + pattern, file)]
            if len(found) > 1:
                several = f"{len(found)} files for {name} of hemisphere {self.letter} ({', '.join(found)})"
                raise InputError(f"{self.folder} has {several}. Keep only one of them")
            if found:
                return self.folder / found[0]
        return None

    def needed(self, name: str) -> Path:
        if (path := self.one(name)) is not None:
            return path
        ending = "label-WM_mask.nii.gz or ..._probseg.nii.gz" if name == "volume" else f"{name}.surf.gii"
        pattern = f"*_hemi-{self.letter}_{ending}"
        raise InputError(f"{self.folder}: found no {pattern}. Check that sMRIPrep finished for {self.subject}")


def participants(folder: Path, labels: Sequence[str] = ()) -> list[Participant]:
    """Find the participants of a study, or those with the given labels (with or without ``sub-``), sorted by name.

    `folder` is a FreeSurfer subjects directory, derivatives, or a BIDS dataset with either of them in ``derivatives``
    or ``sourcedata/freesurfer``. Participants without files have no folder. Labels that are not in the study raise an
    InputError.
    """
    if not folder.is_dir():
        problem = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {problem}. Pass the directory of a study or of FreeSurfer subjects")
    names = [checked_label(label) for label in labels]
    people, origins = _by_label(folder)
    for path in sorted(folder.glob("sub-*")):
        named = _label(path.name) if path.is_dir() and not _NOBODY.match(path.name) else None
        if named is not None:
            people.setdefault(named[0], [Participant(named[0], None, None)])
    if unknown := [label for label in names if label not in people]:
        listed = ", ".join(sorted(people)[:_LISTED]) + (" …" if len(people) > _LISTED else "")
        raise InputError(
            f"{folder}: no participant has the label {', '.join(unknown)}. Pass labels that exist: {listed}"
        )
    chosen = dict.fromkeys(names or people)
    _tell_origins([origins[label] for label in chosen if label in origins])
    return sorted((person for label in chosen for person in people[label]), key=lambda person: person.name)


def check_order(source: Path, out: Path) -> None:
    """Raise an InputError if the output directory contains participants that can be processed, and the input does not.

    Then the two are probably swapped.
    """
    if not _has_participants(source) and _has_participants(out):
        problem = "contains no such files" if source.is_dir() else "does not exist"
        remedy = "Pass the directory that contains them first, and the output directory second"
        raise InputError(f"{out} contains files of participants, but {source} {problem}. {remedy}")


def _has_participants(folder: Path) -> bool:
    try:
        return folder.is_dir() and bool(_by_label(folder)[0])
    except InputError:
        return False


def checked_label(label: str) -> str:
    """Return the label of a participant without the prefix sub-, after checking that it can be part of a file name."""
    bare = label.removeprefix("sub-")
    if not re.fullmatch(r"[A-Za-z0-9]+", bare):
        remedy = "Pass letters and digits, such as 01; separate several labels with spaces, without quotation marks"
        raise InputError(f"the participant label is {shown(label)}. {remedy}")
    return bare


def _by_label(folder: Path) -> tuple[dict[str, list[Participant]], dict[str, tuple[Path, ...]]]:
    """Return the participants (one per session), and the directories that contain their files, keyed by label.

    The first directory that contains files of a participant is used.
    """
    people: dict[str, list[Participant]] = {}
    origins: dict[str, tuple[Path, ...]] = {}
    for place in _places(folder):
        here: dict[str, list[Participant]] = {}
        for person in _in(place):
            for other in here.setdefault(person.label, []):
                if other.name == person.name:
                    raise InputError(f"{other.folder} and {person.folder} are both {person.name}. Rename one of them")
            here[person.label].append(person)
        for label, sessions in here.items():
            has_files = any(session.folder is not None and _has_files(session.folder) for session in sessions)
            if label not in people or (has_files and label not in origins):
                people[label] = sessions
            if has_files:
                origins[label] = (*origins.get(label, ()), place)
    if not origins and any((folder / name).is_dir() for name in ("surf", "mri")):
        remedy = f"Pass its parent directory, {folder.resolve().parent}, or use voxflat freesurfer {folder}"
        raise InputError(f"{folder} is a single subject, not a study. {remedy}")
    if not origins:
        places = "in this directory, in derivatives/ or in sourcedata/freesurfer/"
        files = "no participant has a FreeSurfer surf/ directory, anat/*.surf.gii files or a white-matter mask"
        raise InputError(f"{folder}: {files} {places}. Pass the directory that contains these files")
    return people, origins


def _tell_origins(origins: Sequence[tuple[Path, ...]]) -> None:
    """Print a note if several directories contain files of the participants."""
    counts = Counter(origins)
    for (first, *others), count in counts.items():
        if len(counts) > 1 or others:
            who = f"{count} participants are" if count > 1 else "1 participant is"
            instead = f", not from {' or '.join(map(str, others))}" if others else ""
            log.info("%s", f"{who} read from {first}{instead}")


def _has_files(folder: Path) -> bool:
    """Return whether a FreeSurfer directory, or a directory of derivatives, contains files that can be flattened."""
    return any((folder / name).is_dir() for name in ("surf", "mri")) or _has_input(folder)


def _has_input(anat: Path) -> bool:
    return anat.is_dir() and any(_is_input(file.name) for file in anat.iterdir())


def _places(folder: Path) -> Iterator[Path]:
    """Yield the directories that may contain participants."""
    below = folder / "derivatives"
    named = [below / name for name in ("smriprep", "fmriprep", "freesurfer")]
    others = sorted(path for path in below.glob("*") if path.is_dir() and path not in named)
    for place in (folder, *named, *others):
        yield place
        yield place / "sourcedata" / "freesurfer"


def _in(place: Path) -> Iterator[Participant]:
    """Yield the participants of a directory, if any of them has files that can be flattened."""
    folders = [path for path in sorted(place.glob("*")) if path.is_dir() and not _NOBODY.match(path.name)]
    if any((path / "surf").is_dir() or (path / "mri").is_dir() for path in folders):
        for path in folders:
            name = _label(path.name)
            if name is not None and (path.name.startswith("sub-") or (path / "surf").is_dir()):
                yield Participant(*name, path)
        return
    subjects = [path for path in folders if path.name.startswith("sub-")]
    anatomies = [anat for path in subjects for anat in (*path.glob("anat"), *path.glob("ses-*/anat"))]
    if any(map(_has_input, anatomies)):
        for path in subjects:
            label, anats = path.name.removeprefix("sub-"), sorted(path.glob("ses-*/anat"))
            anats = list(filter(_has_input, anats))
            for anat in anats:
                yield Participant(label, anat.parent.name.removeprefix("ses-"), anat)
            if not anats:
                yield Participant(label, None, path / "anat")


def _is_input(name: str) -> bool:
    """Return whether a file can be flattened: a white or pial surface, or white matter."""
    return name.endswith(("_white.surf.gii", "_smoothwm.surf.gii", "_pial.surf.gii")) or (
        "_label-WM_" in name and name.endswith(_VOLUME_ENDINGS)
    )


def _label(name: str) -> tuple[str, str | None] | None:
    """Return the label and session from a directory name, without characters that a BIDS label cannot have."""
    if match := re.fullmatch(r"sub-([A-Za-z0-9]+)(?:_ses-([A-Za-z0-9]+))?", name):
        return match[1], match[2]
    label = re.sub(r"[^A-Za-z0-9]", "", name.removeprefix("sub-"))
    return (label, None) if label else None
