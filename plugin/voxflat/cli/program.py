"""Define the program `voxflat`.

The exit status is 0 for success, 1 for failure, 2 for wrong usage, 130 if cancelled, and 143 if terminated.
"""

import click
import cloup

from voxflat._core import __version__
from voxflat.cli.console import Program

COMMANDS = {
    "bench": ("bench", "Compare flat maps made by any tool on the surfaces of a public benchmark."),
    "bids": ("study", "Flatten all participants of a study (BIDS App)."),
    "check": ("surfaces", "Check whether a surface can be flattened."),
    "cite": ("about", "Print a paragraph for the methods section of a paper, with references."),
    "columns": ("layers", "Divide the grey matter of a segmentation into columns."),
    "cut": ("flatten", "Cut a surface open for flattening."),
    "demo": ("demo", "Flatten a hemisphere of the MNI152 template."),
    "distance-matrix": ("distances", "Measure the geodesic distances between all vertices or parcels."),
    "figure": ("drawing", "Draw a figure of one or two flat maps."),
    "flatten": ("flatten", "Flatten a surface into a flat map."),
    "freesurfer": ("study", "Flatten a FreeSurfer subject and write a report."),
    "group-map": ("flatten", "Flatten the surfaces of several people into one flat map."),
    "image": ("images", "Resample a volume onto a flat map, or show the distortion of the map."),
    "info": ("about", "Print version and system information for a bug report."),
    "layers": ("layers", "Divide the grey matter of a segmentation into layers."),
    "measure": ("distortion", "Measure the distortion of flat maps made by any tool."),
    "movie": ("drawing", "Make a movie of a time series on one or two flat maps."),
    "movie-map": ("flatten", "Flatten the surfaces of all frames of a movie into one flat map."),
    "paint": ("layers", "Transfer a flat volume to the voxels of the grey matter."),
    "patches": ("patches", "Flatten a surface in patches with certified distortion."),
    "path": ("distances", "Find the shortest path through points on a surface."),
    "points": ("places", "Find where points in space lie on a flat map."),
    "profile": ("layers", "Average a volume along cortical depth within regions."),
    "pycortex": ("pycortex", "Flatten a FreeSurfer subject for pycortex."),
    "regions": ("places", "Convert regions on a flat map to vertex or voxel labels, or measure them."),
    "register": ("surfaces", "Register a hemisphere to the fsaverage sphere."),
    "rows": ("distances", "Measure geodesic distances and store them on disk."),
    "smooth": ("surfaces", "Smooth values along a surface."),
    "standard-map": ("flatten", "Make the flat map of a standard mesh, fsaverage or fs_LR."),
    "surface": ("surfaces", "Extract the surface of a volume, or check and convert a mesh."),
    "texture": ("images", "Map a picture onto a surface as a texture."),
    "worst": ("distortion", "List the regions with the highest area distortion."),
}
"""Each command's module in `voxflat.cli.commands`, which is imported on use, and the first sentence of its help."""


@cloup.group(
    cls=Program,
    context_settings={"help_option_names": ["-h", "--help"], "show_default": True},
    epilog='Try "voxflat demo" first. For help on a command, run "voxflat COMMAND --help".',
)
@click.version_option(__version__, message="voxflat %(version)s")
def main() -> None:
    """Flatten curved surfaces, such as the cerebral cortex, while preserving geodesic distances."""


for _name, (_module, _summary) in COMMANDS.items():
    main.add_command(click.Command(_name, help=_summary))
    main.modules[_name] = _module
