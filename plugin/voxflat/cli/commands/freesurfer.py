"""The command `voxflat freesurfer`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import labs, options
from voxflat.cli.console import bars
from voxflat.cli.output import print_json
from voxflat.lab.study import freesurfer


@cloup.command(
    "freesurfer",
    cls=labs.Several,
    epilog="""\b
Examples:
  voxflat freesurfer $SUBJECTS_DIR/sub-01
  voxflat freesurfer sub-01 --hemi lh --overlay thickness curv
  voxflat freesurfer sub-01 --overlay {hemi}.zstat.mgz --cuts auto --json
""",
)
@cloup.argument("subject", metavar="SUBJECT_DIR", type=click.Path(path_type=Path))
@options.section(
    "Hemispheres",
    cloup.option(
        "--hemi", "hemis", type=click.Choice(["lh", "rh"]), multiple=True, default=("lh", "rh"), help="Which of them."
    ),
)
@labs.making
@options.section("Output", options.as_json)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def command(subject: Path, hemis: tuple[str, ...], as_json: bool, quiet: bool, **given: Any) -> int:
    """Flatten a subject of FreeSurfer: maps, measures and a report, into its own directory.

    Reads surf/?h.white, pial, sphere.reg, thickness and label/?h.cortex.label (or aparc.annot), each of which says
    what is missing. Writes surf/?h.voxflat.flat.patch.3d, .surf.gii, .npz (all of the map) and .json (figures, and what
    made it), surf/?h.voxflat.*.shape.gii (measures and overlays at the vertices), and voxflat.html, the report. What is
    up to date, by the checksums of what is read and the parameters, is not made again. The exit status is 1 if a
    hemisphere has no map.
    """
    parameters = labs.parameters_of(given)
    hemis = tuple(dict.fromkeys(hemis))

    with bars(quiet) as shown:
        tell = labs.teller(shown, is_told=not (as_json or quiet))
        outcomes = freesurfer(subject, hemis, parameters, tell=tell, progress=shown.progress, **given)
    report = subject / "voxflat.html"
    failed = [one for one in outcomes if one.state == "failed"]
    if as_json:
        print_json({"subject": str(subject), "report": str(report), "hemispheres": labs.as_list(outcomes)})
    elif len(failed) < len(outcomes) and not quiet:
        click.echo(f"report: {report}")
    return 1 if failed else 0
