"""The documentation site: `make docs` builds it."""

import os
import sys
import urllib.request
from pathlib import Path

from sphinx_click.ext import _format_option as format_option

import voxflat
from voxflat.cli.program import main as program

HERE = Path(__file__).parent
GENERATED = HERE / "_generated"
sys.path.insert(0, str(HERE))

project = "voxflat"
author = "The voxflat developers"
copyright = "2026, the voxflat developers"
version = release = voxflat.__version__
root_doc = "index"
exclude_patterns = ["benchmarks", "cluster", "joss", "paper", "templates", "tutorials", "gallery", "pictures", "_build"]
templates_path = ["_templates"]
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "numpydoc",
    "myst_parser",
    "sphinx_click",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]

# Pages in Markdown
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Docstrings: a page for each class and function; tests/documents/test_examples.py checks what methods may leave out
numpydoc_validation_checks = {"all", "ES01", "EX01", "SA01"}
numpydoc_show_class_members = False
OTHERS = "object BaseException Exception Sequence ValueError VTKPythonAlgorithmBase"
OTHERS += " vtkPythonAlgorithm vtkAlgorithm vtkObject vtkObjectBase"
autodoc_default_options = {
    "members": True,
    "inherited-members": OTHERS.replace(" ", ","),
    "exclude-members": "RequestData,RequestDataObject",  # VTK calls these
}
autodoc_typehints = "none"  # the docstrings name the types
autosummary_generate = True

# Scripts that run while the site is built
sphinx_gallery_conf = {
    "examples_dirs": ["tutorials", "gallery"],
    "gallery_dirs": ["_generated/tutorials", "_generated/gallery"],
    "filename_pattern": "/plot_",
    "abort_on_example_error": True,
    "image_scrapers": ("matplotlib", "scrapers.results"),
    "capture_repr": ("_repr_html_",),
    "download_all_examples": False,
    "within_subsection_order": "FileNameSortKey",
    "remove_config_comments": True,
    "show_memory": False,
    "plot_gallery": os.environ.get("VOXFLAT_DOCS_RUN", "1") == "1",
}

smartquotes = False  # would change the dashes of options

default_role = "py:obj"  # `name` in a docstring links to the name

html_theme = "pydata_sphinx_theme"
html_title = "voxflat"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_logo = html_favicon = "_static/logo.svg"
html_theme_options = {
    "navbar_align": "left",
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": [], "get-started": []}
html_show_sourcelink = False
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def _reachable(projects):
    """Return the inventories of other projects that can be downloaded, so that the site also builds offline."""
    found = {}
    for name, url in projects.items():
        try:
            urllib.request.urlopen(f"{url}objects.inv", timeout=5).close()
        except OSError:
            continue
        found[name] = (url, None)
    return found


intersphinx_mapping = _reachable(
    {
        "python": "https://docs.python.org/3/",
        "numpy": "https://numpy.org/doc/stable/",
        "nibabel": "https://nipy.org/nibabel/",
        "nilearn": "https://nilearn.github.io/stable/",
        "napari": "https://napari.org/stable/",
        "pyvista": "https://docs.pyvista.org/",
    }
)


def _write_commands():
    """Write a page for each command of the program."""
    folder = GENERATED / "cli"
    folder.mkdir(parents=True, exist_ok=True)
    for name, module in program.modules.items():
        page = f".. click:: voxflat.cli.commands.{module}:{name.replace('-', '_')}_command\n   :prog: voxflat {name}\n"
        page += "   :nested: full\n"  # with the commands of a group
        path = folder / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != page:
            path.write_text(page, encoding="utf-8")


def _in_sections(app, context, lines):
    """Group the options of a command under the headings of `--help`."""
    lines.clear()
    for section in (*context.command.option_groups, context.command.get_default_option_group(context)):
        shown = [option for option in section.options if not option.hidden]
        if shown:
            options = (line for one in shown for line in (*format_option(context, one), ""))
            lines += [f".. rubric:: {section.title}", "", *options]


def _found_by_its_end(app, env, node, shown):
    """Link a name such as `Surface.cut` in a docstring to the public object whose name ends with it."""
    python, target = env.get_domain("py"), node.get("reftarget", "")
    ends = [name for name in python.objects if name.endswith(f".{target}") or name == f"voxflat.{target}"]
    best = min(ends, key=lambda name: (name.count("."), name), default=None)
    if node.get("refdomain") != "py" or best is None:
        return None
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", best, node, shown)


def setup(app):
    """Register the functions above with Sphinx."""
    app.connect("missing-reference", _found_by_its_end)
    _write_commands()
    app.connect("sphinx-click-process-options", _in_sections)
