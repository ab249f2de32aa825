"""Citations of voxflat, with facts from maps, prose from methods_text.txt and references from references.bib."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

from voxflat._core import __version__
from voxflat.arguments import checked_instance
from voxflat.io.grid import in_unit, rounded
from voxflat.maps.flat_map import FlatMap
from voxflat.maps.summary import summary_of

Facts = dict[str, Any]
"""What the methods text states of a map: ``how`` it was made, and numbers. Maps of equal ``how`` share a paragraph."""

_LISTED = 4  # maps whose errors are listed one by one
_SCALES = ("raw", "best_scale")
_PLACE = (("journal", ". ", ""), ("volume", ", ", ""), ("number", "(", ")"), ("pages", ", ", ""))


@dataclass(frozen=True)
class Citation:
    """A paragraph for the methods section of a paper, with its references.

    Conversion to `str` returns the paragraph followed by the list of references.

    Parameters
    ----------
    text : str
        The paragraph. Maps that were made in different ways are described in separate paragraphs.
    references : tuple of str
        The references that the paragraph cites, one per entry.
    bibtex : str
        The same references as BibTeX entries.

    See Also
    --------
    cite : Create a citation.

    Examples
    --------
    >>> citation = voxflat.cite(voxflat.samples.hill().flatten())
    >>> citation.text[:51]
    'The surface was flattened into the plane with voxfl'
    """

    text: str
    references: tuple[str, ...]
    bibtex: str

    def __repr__(self) -> str:
        return f"<Citation: {len(self.text.split())} words, {len(self.references)} references>"

    def __str__(self) -> str:
        return "\n".join([self.text, "", "References", *(f"- {reference}" for reference in self.references)])

    def _repr_html_(self) -> str:
        """Return the paragraph, the references and the BibTeX entries, for Jupyter."""
        listed = "".join(f"<li>{escape(reference)}</li>" for reference in self.references)
        return f"<p>{escape(self.text)}</p><ul>{listed}</ul><pre>{escape(self.bibtex)}</pre>"


def cite(*maps: FlatMap) -> Citation:
    """Return a paragraph for the methods section of a paper, with its references.

    The paragraph states the version of voxflat, the method with its options, the cuts, and the distance errors. All
    facts come from the fields and the provenance of the maps.

    Parameters
    ----------
    *maps : FlatMap
        The maps that the paper shows. Without maps, the paragraph is general and cites all references.

    Returns
    -------
    Citation
        The paragraph, its references, and their BibTeX entries.

    Raises
    ------
    InputError
        If one of the maps is not a `FlatMap`.

    See Also
    --------
    voxflat.FlatMap.provenance : The record from which the facts are taken.

    Examples
    --------
    >>> citation = voxflat.cite(voxflat.samples.hill().flatten())
    >>> print(citation.bibtex.splitlines()[0])
    @software{voxflat,
    """
    for flat_map in maps:
        checked_instance(flat_map, FlatMap, "flat map", "a FlatMap")
    return citation_of([facts_of(flat_map) for flat_map in maps])


def facts_of(flat_map: FlatMap) -> Facts:
    """Return the facts about a map that the methods text states."""
    summary = summary_of(flat_map)
    record: dict[str, Any] = flat_map.provenance
    parameters: dict[str, Any] = record.get("parameters", {})
    figures: dict[str, Any] | None = flat_map.distortion.figures() if flat_map.has_surface else None
    used = {**parameters.get("method", {}), "method": None}
    used |= {"relax": parameters.get("relax"), "adapt": parameters.get("adapt"), "seed": flat_map.seed}
    used |= {"sources": count} if (count := len(flat_map.sources)) else {}  # fewer than requested on small surfaces
    given = {name: "given" if isinstance(value, dict | list) else value for name, value in used.items()}
    automatic = [cut for cut in flat_map.cuts if cut.is_automatic]
    how = {
        "method": flat_map.method,
        "cuts_by": flat_map.cuts_by,
        "cut_names": [cut.name for cut in flat_map.cuts if not cut.is_automatic],
        "kind": "voxels" if flat_map.is_voxels else "mesh",
        "measured_on": flat_map.origin.measured_on,
        "version": record.get("voxflat", __version__),
        "options": ", ".join(f"{name}={value}" for name, value in given.items() if value is not None),
        "is_range_image": not flat_map.is_voxels and flat_map.origin.mesh.grid is not None,
        "cuts": len(flat_map.cuts) - len(automatic),
        "space": summary.space,
        "by_folds": summary.is_by_folds,
        "reference": figures and figures["reference"],  # None for a map without its surface
    }
    facts: Facts = {
        "how": how,
        "paths": len(automatic),
        "length": in_unit(f"{rounded(sum(cut.length or 0.0 for cut in automatic))} mm", flat_map.origin.named_unit),
        "points": summary.points,
    }
    if figures is None:
        return facts
    triangles = figures["triangles"] or {}
    return {
        **facts,
        "sources": figures["sources"],
        "scale": f"{figures['best_scale']['scale'] or float('nan'):.3f}",
        "flipped": triangles.get("flipped"),
        "covering": triangles.get("covering"),
        **{name: [of[name]["relative_error"] for of in (figures, figures["standard_error"])] for name in _SCALES},
    }


def citation_of(facts: Sequence[Facts]) -> Citation:
    """Return the citation of maps whose facts are known."""
    from jinja2 import Environment, StrictUndefined  # slow to import

    alike: dict[str, list[Facts]] = {}
    for fact in facts:
        alike.setdefault(json.dumps(fact["how"]), []).append(fact)
    entries, cited = bibliography(), dict.fromkeys(["voxflat"])
    versions = dict.fromkeys(fact["how"]["version"] for fact in facts) or [__version__]
    entries["voxflat"]["version"] = ", ".join(versions)

    def cite(key: str) -> str:
        cited[key] = None
        return _named(entries[key])

    environment = Environment(trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined)
    template = environment.from_string(_read("methods_text.txt"))
    tools = {"cite": cite, "span": _span, "errors": _errors, "version": __version__}
    paragraphs = re.split(r"\n\n+", template.render(groups=list(alike.values()), **tools).strip())
    text = "\n\n".join(" ".join(paragraph.split()).replace(" .", ".") for paragraph in paragraphs)
    bibtex = "\n\n".join(_bibtex(key, entries[key]) for key in cited)
    return Citation(text, tuple(_reference(entries[key]) for key in cited), bibtex)


def _span(maps: Sequence[Facts], name: str) -> str:
    """Return the smallest and the greatest of several numbers; some are strings that begin with a number."""
    spans = {float(str(one[name]).split()[0]): f"{one[name]:,}" if name == "points" else str(one[name]) for one in maps}
    return spans[min(spans)] if len(spans) == 1 else f"{spans[min(spans)]} to {spans[max(spans)]}"


def _errors(maps: Sequence[Facts], scale: str) -> str:
    """Return the relative errors of maps with their standard errors, one by one, or as a range for many maps."""
    if len(maps) <= _LISTED:
        pairs = (map(_percent, one[scale]) for one in maps)
        *others, last = (f"{value} (standard error {error})" for value, error in pairs)
        return f"{', '.join(others)} and {last}" if others else last
    values, errors = ([one[scale][part] for one in maps if one[scale][part] is not None] for part in (0, 1))
    ends = _percent(min(values, default=None)), _percent(max(values, default=None))
    return f"{' to '.join(ends)} (standard error at most {_percent(max(errors, default=None))})"


def _percent(value: float | None) -> str:
    return "undefined" if value is None else f"{100 * value:.2f} %"


# ------------------------------------------------------------------------------------- references


def bibliography() -> dict[str, dict[str, str]]:
    """Return the fields of each reference by its BibTeX key, with the entry's type as ``type``."""
    entries = re.findall(r"^@(\w+)\{(\w+),\n(.*?)^\}", _read("references.bib"), re.MULTILINE | re.DOTALL)
    field = re.compile(r"^ +(\w+) = \{(.*)\},$", re.MULTILINE)
    return {key: {"type": kind, **dict(field.findall(body))} for kind, key, body in entries}


def _read(name: str) -> str:
    return files("voxflat.citation").joinpath(name).read_text(encoding="utf-8")


def _bibtex(key: str, entry: dict[str, str]) -> str:
    fields = "".join(f"  {name} = {{{value}}},\n" for name, value in entry.items() if name != "type")
    return f"@{entry['type']}{{{key},\n{fields}}}"


def _authors(entry: dict[str, str]) -> list[str]:
    return entry["author"].strip("{}").split(" and ")


def _named(entry: dict[str, str]) -> str:
    """Return the name of an entry in a sentence, such as "Kimmel and Sethian (1998)"."""
    names = [author.split(",")[0] for author in _authors(entry)]
    return f"{names[0]} et al. ({entry['year']})" if len(names) > 2 else f"{' and '.join(names)} ({entry['year']})"


def _reference(entry: dict[str, str]) -> str:
    version = f" (version {entry['version']})" if "version" in entry else ""
    place = "".join(f"{before}{entry[name]}{after}" for name, before, after in _PLACE if name in entry)
    doi = f" doi:{entry['doi']}" if "doi" in entry else ""
    return f"{', '.join(_authors(entry))} ({entry['year']}). {entry['title']}{version}{place}.{doi}".replace("--", "–")
