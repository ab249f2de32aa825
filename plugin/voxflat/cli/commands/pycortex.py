"""The command `voxflat pycortex`, which stores a subject with flat maps in the filestore of pycortex."""

from pathlib import Path
from typing import Any

import cloup

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.output import report
from voxflat.lab.pycortex import to_pycortex


@options.command(
    "pycortex",
    "voxflat pycortex $SUBJECTS_DIR/sub-01",
    "voxflat pycortex $SUBJECTS_DIR/sub-01 --filestore ~/filestore --roi aparc --roi V1_exvivo",
    "voxflat pycortex S1 --overwrite",
)
@cloup.argument("subject", metavar="SUBJECT")
@options.section(
    "Subject in pycortex",
    options.value(
        "--filestore", "DIR", "Filestore of pycortex.  [default: from the configuration of pycortex]", type=Path
    ),
    options.value("--name", "NAME", "Name of the subject in the filestore.  [default: that of the directory]"),
    options.value(
        "--roi",
        "NAME|FILE",
        "Regions of interest for overlays.svg: an annotation or a label in label/, such as aparc or V1_exvivo, or a "
        "file (.annot, .label or .label.gii) in whose name {hemi} stands for lh or rh. Pass it once per file.  "
        "[default: aparc, if present]",
        "rois",
        multiple=True,
    ),
    options.flag("--no-rois", "Do not draw regions of interest."),
    options.flag("--overwrite", "Replace existing flat surfaces and overlays.svg, after copying them to a backup."),
)
@options.section(
    "Map",
    options.value(
        "--cuts", "standard|automatic|FILE", "How to cut the surfaces, as for voxflat freesurfer.", default="standard"
    ),
)
@options.section("Output", options.as_json)
@options.run(options.seed, options.threads, options.memory_limit, options.quiet)
def pycortex_command(subject: str, rois: tuple[str, ...], no_rois: bool, quiet: bool, **settings: Any) -> None:
    """Flatten a FreeSurfer subject for pycortex.

    SUBJECT is a FreeSurfer subject directory, made by recon-all, or the name of a subject that is already in the
    filestore. The result is a subject on which quickshow, webshow, make_static, add_roi and get_roi_verts work.
    FreeSurfer and pycortex are not needed.

    Existing files of the subject are kept. With --overwrite, the flat surfaces and overlays.svg are replaced after they
    were copied to voxflat-backup-1 in the subject's directory. Regions of interest that were drawn on the previous flat
    map are drawn on the new one.
    """
    if no_rois and rois:
        raise cloup.UsageError("--no-rois cannot be combined with --roi.")
    with bars(quiet) as bar:
        folder = to_pycortex(subject, rois=() if no_rois else rois or None, progress=bar.progress, **settings)
    report({"output": str(folder)}, f"subject: {folder}", quiet=quiet)
