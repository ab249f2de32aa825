"""The methods text states the facts of the maps and cites the papers of their methods."""

import json
import re
from dataclasses import asdict

import numpy as np
import pytest
from command_line import succeed
from refusals import refused

import voxflat
from voxflat.citation.methods_text import bibliography, citation_of, facts_of
from voxflat.methods import METHODS

PAPERS = {"voxflat": {"liu2008", "smith2015"}, "zigelman2002": {"zigelman2002", "kimmel1998"}}


def keys(bibtex):
    """Return the keys of BibTeX entries; check that each is balanced and has an author, a title and a year."""
    entries = re.findall(r"^@\w+\{(\w+),\n((?:  \w+ = \{.+\},\n)+)\}$", bibtex, re.MULTILINE)
    assert len(entries) == bibtex.count("@")
    assert bibtex.count("{") == bibtex.count("}")
    for _, body in entries:
        assert {"author", "title", "year"} <= set(re.findall(r"^  (\w+) =", body, re.MULTILINE))
    return [key for key, _ in entries]


@pytest.fixture(scope="module")
def hill():
    return voxflat.samples.hill().flatten()


@pytest.mark.parametrize("method", METHODS)
def test_each_method_cites_its_own_papers_and_states_the_facts_of_its_map(method):
    flat = voxflat.flatten(np.ones((9, 9, 1), int), method=method)
    citation = voxflat.cite(flat)
    assert set(keys(citation.bibtex)) == {"voxflat", *PAPERS.get(method, {method})}
    assert len(citation.references) == len(keys(citation.bibtex))
    figures, errors = flat.distortion.raw, flat.distortion.standard_error.raw
    error = f"{100 * figures.relative_error:.2f} % (standard error {100 * errors.relative_error:.2f} %)"
    used = {**flat.provenance["parameters"]["method"], **flat.metadata}
    options = [name for name in ("sources", "sampling", "bound", "scale", "link_lengths") if name in used]
    facts = [f"voxflat {voxflat.__version__}", error, "has 81 points", *(f"{name}={used[name]}" for name in options)]
    for fact in (*facts, f"from {flat.distortion.sources} random", f"seed={flat.metadata['seed']}", "was not cut"):
        assert fact in citation.text
    assert "undefined" not in citation.text


@pytest.mark.medium
def test_cuts_are_those_of_the_map_and_maps_made_alike_share_a_paragraph(hill):
    ball = voxflat.surface(voxflat.samples.ball()).flatten()
    cuts = ball.metadata["automatic_cuts"]
    told = f"along {len(cuts)} paths (total length {sum(cut['length'] for cut in cuts):.0f} mm)"
    assert told in voxflat.cite(ball).text
    assert voxflat.cite(ball, hill, hill).text.count("\n\n") == 1
    many = citation_of([facts_of(hill)] * 7).text
    assert many.startswith("Seven surfaces were")
    assert "to 3.61 % (standard error at most 0.06 %)" in many
    refused("a FlatMap", voxflat.cite, 3)


def test_the_command_prints_the_text_the_entries_or_json(hill, tmp_path):
    hill.save(tmp_path / "map.npz")
    citation = voxflat.cite(hill)
    assert succeed("cite", tmp_path / "map.npz").stdout == f"{citation}\n"
    assert succeed("cite", tmp_path / "map.npz", "--bibtex").stdout == f"{citation.bibtex}\n"
    told = json.loads(succeed("cite", tmp_path / "map.npz", "--json").stdout)
    assert told == {**asdict(citation), "references": list(citation.references)}
    assert set(keys(succeed("cite", "--bibtex").stdout)) == set(bibliography())
    assert citation.text in citation._repr_html_()
