"""Find the participants of a study, and the input files of their hemispheres."""

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from itertools import product
from pathlib import Path

from voxflat.arguments import log, shown
from voxflat.errors import InputError
from voxflat.io.label_tables import LABEL_ENDINGS
from voxflat.io.meshes import named_structure
from voxflat.lab.layouts import FREESURFER, HEMISPHERES, SMRIPREP, Finder, Layout, layout_in
from voxflat.lab.results import MEASURES
from voxflat.surfaces.standard.template import SIDES

GEOMETRIES = ("midthickness", "white", "pial")
"""The surfaces on which distances can be measured."""

_NEEDED = {"midthickness": ("white", "pial"), "white": ("white",), "pial": ("pial",)}
_CORTEX = ("cortex", "grayordinates", "areas")  # definitions of the cortex; the first one that exists is used
_USUAL_OVERLAY = "thickness"
_KINDS_OF_CUTS = ("standard", "automatic")  # instead of a file
_CUTS_FILE = "the cuts file"
_OF_HCP = ("T1w", "MNINonLinear")  # directories of a subject of the HCP pipelines
_REMEDIES = {
    "native": "Omit --space",
    "fsLR": "Run fMRIPrep with --cifti-output, or omit --space to read the native surfaces",
}
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
            if text.lower().endswith(LABEL_ENDINGS):
                raise InputError(f"the overlay {text} contains labels. Draw them with voxflat figure MAP --parcels")
            names.add(name.lower())


@dataclass(frozen=True)
class Hemisphere:
    """A hemisphere and its input files."""

    hemi: str  # lh or rh
    files: dict[str, Path]  # white, pial, sphere, cortex or areas, volume, cuts
    overlays: dict[str, Path] = field(default_factory=dict)
    label: int | None = None  # label of the hemisphere in the volume
    layout: Layout = SMRIPREP  # of the files
    source: Path | None = None  # directory of the study

    @property
    def letter(self) -> str:
        """The BIDS letter: L or R."""
        return HEMISPHERES[self.hemi][0]


@dataclass(frozen=True)
class Participant:
    """A participant of a study, or one session of a participant."""

    label: str  # without sub-
    session: str | None  # without ses-
    folder: Path | None  # directory of the subject, or anat of derivatives; None if there is none
    layout: Layout | None = None  # of the files that are read; None if there are none
    source: Path | None = None  # directory of the study

    @property
    def name(self) -> str:
        """The prefix of file names: ``sub-01``, ``sub-01_ses-02``."""
        return f"sub-{self.label}" + (f"_ses-{self.session}" if self.session else "")


def found_in(folder: Path, hemi: str, parameters: Parameters, layout: Layout | None = None) -> Hemisphere:
    """Find the files of a hemisphere in the directory of a participant, by default in its preferred layout."""
    if not folder.is_dir():
        raise InputError(f"{folder}: the directory does not exist. Pass an output directory of recon-all or sMRIPrep")
    find = Finder(folder, hemi, layout or layout_in(folder) or SMRIPREP)
    files: dict[str, Path | None] = {}
    if parameters.volume:
        files["volume"] = find.needed("volume")
    else:
        files |= _surfaces(find, parameters.geometry)
        files |= _registration(find, next(iter(files)))
        cortex = (name for name in _CORTEX if name in find.layout.files)
        files |= next(({name: path} for name in cortex if (path := find.one(name)) is not None), {})
    if parameters.cuts not in _KINDS_OF_CUTS:
        files["cuts"] = _given(find, parameters.cuts, _CUTS_FILE)
    files["template"] = _of_side(parameters.template, hemi, "--template")
    files["template sphere"] = _of_side(parameters.template_sphere, hemi, "--template-sphere")
    overlays: dict[str, Path] = {}
    usual = find.one(_USUAL_OVERLAY) if not parameters.overlays and not parameters.volume else None
    if usual is not None:
        overlays[_USUAL_OVERLAY] = usual
    overlays |= {overlay_name(text): _overlay(find, text) for text in parameters.overlays}
    labels = find.layout.labels if parameters.volume else None
    label = labels[hemi] if labels else None
    there = {name: path for name, path in files.items() if path is not None}
    return Hemisphere(hemi, there, overlays, label, find.layout)


def _surfaces(find: Finder, geometry: str) -> dict[str, Path]:
    """Return the surfaces between which distances are measured; a midthickness surface if the others are missing."""
    if geometry == "midthickness" and not find.has("white") and (path := find.one("midthickness")) is not None:
        return {"midthickness": path}
    return {name: find.needed(name) for name in _NEEDED[geometry]}


def _registration(find: Finder, surface: str) -> dict[str, Path | None]:
    """Return the registered sphere, or the files from which that of a resampled surface can be computed."""
    native = find.one("native sphere") if "native sphere" in find.layout.files else None
    of_surface = Finder(find.folder, find.hemi, SMRIPREP).one(surface) if native else None
    if of_surface is not None:
        return {"native sphere": native, f"native {surface}": of_surface}
    return {"sphere": find.one("sphere") if "sphere" in find.layout.files else None}


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
        spaces = {person.layout.space for person in everybody if person.layout is not None}
        space = spaces.pop() if len(spaces) == 1 else None
        others = [person for sessions in _by_label(source, space)[0].values() for person in sessions]
        missing = {text: error for text, error in missing.items() if text in _missing(others, hemis, parameters)}
    for error in missing.values():
        raise error


def _missing(everybody: Sequence[Participant], hemis: Sequence[str], parameters: Parameters) -> dict[str, InputError]:
    """Return the overlays and the cuts file that exist for none of the participants, with the error for the first."""
    searches: dict[str, Callable[[Finder], Path]]
    searches = {text: partial(_overlay, text=text) for text in parameters.overlays}
    if parameters.cuts not in _KINDS_OF_CUTS:
        searches[parameters.cuts] = partial(_given, text=parameters.cuts, kind=_CUTS_FILE)
    existing: set[str] = set()
    errors: dict[str, InputError] = {}
    people = [person for person in everybody if person.folder and person.folder.is_dir()]
    for person, hemi in product(people, hemis):
        assert person.folder is not None
        for text in [key for key in searches if key not in existing]:
            try:
                searches[text](Finder(person.folder, hemi, person.layout or SMRIPREP))
                existing.add(text)
            except InputError as error:
                errors.setdefault(text, error)
    return {text: error for text, error in errors.items() if text not in existing}


def _overlay(find: Finder, text: str) -> Path:
    """Return the path to an overlay, given its name, such as thickness, or a file."""
    return find.one(text) or _given(find, text, "the overlay", find.place(text))


def _given(find: Finder, text: str, kind: str, *places: str) -> Path:
    """Return the path to a file given by the user, with the placeholders filled in; `places` were searched before."""
    named = find.filled(text)
    paths = [find.folder / folder / named for folder in find.layout.within] + [Path(named)]
    for path in paths:
        if path.is_file():
            return path
    searched = [*(places if "/" not in text else ()), *map(str, paths[:-1]), str(paths[-1].absolute())]
    near = get_close_matches(re.sub(r"^[lr]h\.", "", text), find.measures()) if places else []
    hint = f"Did you mean {' or '.join(near)}? voxflat" if near else "Check the name; voxflat"
    raise InputError(f"{kind} {text} does not exist. {hint} searched for {', '.join(searched)}")


def overlay_name(overlay: str) -> str:
    """Return the name of an overlay, such as thickness for ``sub-01_hemi-L_thickness.shape.gii``."""
    name = Path(overlay).name.replace("{hemi}", "lh").replace("{subject}", "sub")
    if match := re.fullmatch(r"[^.]+\.(?:(?:lh|[LR])\.)?(.+)\.(?:native|\d+k_fs_LR)\..+", name):  # of the HCP pipelines
        return re.sub(r"[^A-Za-z0-9]", "", match[1]) or "overlay"
    name = re.sub(r"^[lr]h\.", "", name).split("_")[-1]
    name = re.sub(r"\.(nii|func|shape|label|dscalar|dtseries)?\.?(gz|gii|nii|mgz|mgh|npy|txt|annot)$", "", name)
    return re.sub(r"[^A-Za-z0-9]", "", name) or "overlay"


def participants(folder: Path, labels: Sequence[str] = (), space: str | None = None) -> list[Participant]:
    """Find the participants of a study, or those with the given labels (with or without ``sub-``), sorted by name.

    `folder` is a FreeSurfer subjects directory, derivatives, a study folder of the HCP pipelines, or a BIDS dataset
    with one of them in ``derivatives`` or ``sourcedata/freesurfer``. Of several layouts of a participant, the first one
    of `LAYOUTS` in `space`, one of `SPACES`, is read. Participants without files have no folder. Labels that are not in
    the study raise an InputError.
    """
    if not folder.is_dir():
        problem = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {problem}. Pass the directory of a study or of FreeSurfer subjects")
    names = [checked_label(label) for label in labels]
    people, origins = _by_label(folder, space)
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
    found = (replace(person, source=folder) for label in chosen for person in people[label])
    return sorted(found, key=lambda person: person.name)


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


def _by_label(
    folder: Path, space: str | None = None
) -> tuple[dict[str, list[Participant]], dict[str, tuple[Path, ...]]]:
    """Return the participants (one per session), and the directories that contain their files, keyed by label.

    The first directory that contains files of a participant is used.
    """
    people: dict[str, list[Participant]] = {}
    origins: dict[str, tuple[Path, ...]] = {}
    for place in _places(folder):
        here: dict[str, list[Participant]] = {}
        for person in _in(place, space):
            for other in here.setdefault(person.label, []):
                if other.name == person.name:
                    raise InputError(f"{other.folder} and {person.folder} are both {person.name}. Rename one of them")
            here[person.label].append(person)
        for label, sessions in here.items():
            has_files = any(session.layout is not None for session in sessions)
            if label not in people or (has_files and label not in origins):
                people[label] = sessions
            if has_files:
                origins[label] = (*origins.get(label, ()), place)
    if not origins and any((folder / name).is_dir() for name in (*FREESURFER.marks, *_OF_HCP)):
        is_freesurfer = any((folder / mark).is_dir() for mark in FREESURFER.marks)
        instead = f", or use voxflat freesurfer {folder}" if is_freesurfer else ""
        remedy = f"Pass its parent directory, {folder.resolve().parent}{instead}"
        raise InputError(f"{folder} is a single subject, not a study. {remedy}")
    if not origins and space is not None and any(person.layout for place in _places(folder) for person in _in(place)):
        raise InputError(f"{folder}: no participant has surfaces in the space {space}. {_REMEDIES[space]}")
    if not origins:
        places = "in this directory, in derivatives/ or in sourcedata/freesurfer/"
        files = "no participant has a FreeSurfer surf/ directory, anat/*.surf.gii files, T1w/Native or fsaverage_LR32k "
        files += "directories of the HCP pipelines, or a white-matter mask"
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


def _places(folder: Path) -> Iterator[Path]:
    """Yield the directories that may contain participants."""
    below = folder / "derivatives"
    named = [below / name for name in ("smriprep", "fmriprep", "freesurfer")]
    others = sorted(path for path in below.glob("*") if path.is_dir() and path not in named)
    for place in (folder, *named, *others):
        yield place
        yield place / "sourcedata" / "freesurfer"


def _in(place: Path, space: str | None = None) -> Iterator[Participant]:
    """Yield the participants of a directory, if any of them has files that can be flattened."""
    folders = [path for path in sorted(place.glob("*")) if path.is_dir() and not _NOBODY.match(path.name)]
    if any((path / mark).is_dir() for path in folders for mark in FREESURFER.marks):
        folders = [path for path in folders if path.name.startswith("sub-") or (path / "surf").is_dir()]
        yield from _named(folders, space)
        return
    subjects = [path for path in folders if path.name.startswith("sub-")]
    anatomies = [anat for path in subjects for anat in (*path.glob("anat"), *path.glob("ses-*/anat"))]
    layouts = {anat: layout_in(anat, space) for anat in anatomies}
    if any(layouts.values()):
        for path in subjects:
            label, anats = path.name.removeprefix("sub-"), sorted(path.glob("ses-*/anat"))
            anats = [anat for anat in anats if layouts.get(anat)]
            for anat in anats:
                yield Participant(label, anat.parent.name.removeprefix("ses-"), anat, layouts[anat])
            if not anats:
                yield Participant(label, None, path / "anat", layouts.get(path / "anat"))
        return
    yield from _named([path for path in folders if any((path / name).is_dir() for name in _OF_HCP)], space)


def _named(folders: Sequence[Path], space: str | None) -> Iterator[Participant]:
    """Yield the participants whose directories have their names."""
    for path in folders:
        if (name := _label(path.name)) is not None:
            yield Participant(*name, path, layout_in(path, space))


def _label(name: str) -> tuple[str, str | None] | None:
    """Return the label and session from a directory name, without characters that a BIDS label cannot have."""
    if match := re.fullmatch(r"sub-([A-Za-z0-9]+)(?:_ses-([A-Za-z0-9]+))?", name):
        return match[1], match[2]
    label = re.sub(r"[^A-Za-z0-9]", "", name.removeprefix("sub-"))
    return (label, None) if label else None
