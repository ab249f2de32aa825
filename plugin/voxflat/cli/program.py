"""The program `voxflat`. Exit status: 0 success, 1 failure, 2 wrong usage, 130 cancelled, 143 terminated."""

import click
import cloup

from voxflat._core import __version__
from voxflat.cli.console import Program

COMMANDS = {
    "bids": "Flatten all participants of a study (BIDS App).",
    "check": "Check whether a surface can be flattened.",
    "cite": "Print a paragraph for the methods section of a paper, with references.",
    "cut": "Cut a surface open for flattening.",
    "demo": "Flatten a hemisphere of the MNI152 template.",
    "figure": "Draw a figure of one or two flat maps.",
    "flatten": "Flatten a surface into a flat map.",
    "freesurfer": "Flatten a FreeSurfer subject and write a report.",
    "image": "Resample a volume, or the distortion, onto a flat map.",
    "info": "Print the versions and the machine for a bug report.",
    "measure": "Measure the distortion of flat maps made by any tool.",
    "movie": "Make a movie of a series on one or two flat maps.",
    "patches": "Flatten a surface in patches with certified distortion.",
    "path": "Find the shortest path through points of a surface.",
    "points": "Find the positions of points in space on a flat map.",
    "regions": "Convert regions drawn on a flat map to vertex or voxel labels.",
    "register": "Register a hemisphere to the fsaverage sphere.",
    "rows": "Measure geodesic distances and store them on disk.",
    "surface": "Extract the surface of a volume, or check and convert a mesh.",
    "texture": "Map a picture onto a surface as a texture.",
    "worst": "List the regions of highest area distortion.",
}
"""The commands with the first sentences of their help. A command's module has its name and is imported on use."""


@cloup.group(
    cls=Program,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog='Try "voxflat demo" first. For help on a command, run for example "voxflat flatten --help".',
)
@click.version_option(__version__, message="voxflat %(version)s")
def main() -> None:
    """Flatten curved surfaces, such as the cerebral cortex, while preserving geodesic distances."""


for _name, _summary in COMMANDS.items():
    main.add_command(click.Command(_name, help=_summary))
