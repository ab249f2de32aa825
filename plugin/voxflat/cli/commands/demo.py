"""The command `voxflat demo`."""

from pathlib import Path

from voxflat.cli import options
from voxflat.cli.console import bars
from voxflat.cli.options import OUT
from voxflat.cli.output import is_json, print_json
from voxflat.errors import InputError
from voxflat.io.files import installing


@options.command("demo")
@options.section(
    "Output",
    options.value(
        "-o", "DIR", "Directory for the results, created if needed.", "--output", type=OUT, default=Path("voxflat-demo")
    ),
    options.as_json,
)
@options.run()
def demo_command(output: Path) -> None:
    """Flatten a hemisphere of the MNI152 template.

    The demo extracts the left hemisphere from the MNI152 white-matter template bundled with nilearn, so it does not
    download anything. The map, a summary of its distortion, and pictures are written to DIR.
    """
    try:
        from voxflat.demo import run

        with bars() as bar:
            flat_map = run(output, progress=bar.progress, tell=(lambda _: None) if is_json() else bar.tell)
    except ImportError as error:
        if error.name and error.name.startswith("voxflat"):
            raise
        raise InputError(f"the demo requires {error.name}. Run {installing('nilearn', 'pyvista')}") from error
    if is_json():
        print_json({"output": str(output), **flat_map.description()})
