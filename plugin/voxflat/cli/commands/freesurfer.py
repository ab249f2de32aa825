"""The command `voxflat freesurfer`."""

from pathlib import Path
from typing import Any

import click
import cloup

from voxflat.cli import options, study_options
from voxflat.cli.console import bars
from voxflat.cli.output import print_json
from voxflat.lab.study import freesurfer


@cloup.command(
    "freesurfer",
    cls=study_options.MultipleValuesCommand,
    epilog="""\b
Examples:
  voxflat freesurfer $SUBJECTS_DIR/sub-01
  voxflat freesurfer sub-01 --hemi lh --overlay thickness curv
  voxflat freesurfer sub-01 --overlay {hemi}.zstat.mgz --cuts automatic --json
""",
)
@cloup.argument("subject", metavar="SUBJECT_DIR", type=click.Path(path_type=Path))
@options.section(
    "Hemispheres",
    options.choice("--hemi", ["lh", "rh"], "Hemispheres to process.", "hemis", multiple=True, default=("lh", "rh")),
)
@study_options.map_options
@options.section("Output", options.as_json)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def command(subject: Path, hemis: tuple[str, ...], as_json: bool, quiet: bool, **given: Any) -> int:
    """Flatten a FreeSurfer subject and write a report.

    voxflat reads surf/?h.white, pial, sphere.reg, thickness and label/?h.cortex.label (or aparc.annot), and reports
    missing files. It writes the map as surf/?h.voxflat.flat.patch.3d, .surf.gii, .npz (complete) and .json (distortion
    and provenance), measures and overlays at the vertices as surf/?h.voxflat.*.shape.gii, and the report voxflat.html.
    Results are skipped if they are up to date according to the checksums of the inputs and the parameters. The exit
    status is 1 if a hemisphere could not be flattened.
    """
    parameters = study_options.parameters_of(given)
    hemis = tuple(dict.fromkeys(hemis))

    with bars(quiet) as shown:
        tell = study_options.outcome_printer(shown, verbose=not (as_json or quiet))
        outcomes = freesurfer(subject, hemis, parameters, tell=tell, progress=shown.progress, **given)
    report = subject / "voxflat.html"
    failed = [one for one in outcomes if one.state == "failed"]
    if as_json:
        print_json({"subject": str(subject), "report": str(report), "hemispheres": study_options.as_list(outcomes)})
    elif len(failed) < len(outcomes) and not quiet:
        click.echo(f"report: {report}")
    return 1 if failed else 0
