"""Run `voxflat bids` with Nipype, through an interface that is made from the Boutiques descriptor.

    python nipype_workflow.py study maps --plugin MultiProc --hemi left

Options unknown to this script are passed to voxflat. Each participant with missing or outdated maps has a node. A
failed node leaves a crash file, and the other participants are still compared. In your own workflow, use:

    flat = Node(VoxflatBids(source="study", out="maps", level="participant", threads=2), "flat", n_procs=2)
    flat.iterables = ("labels", ["01", "02"])
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from nipype import Node, Workflow, config
from nipype.interfaces.base import (
    CommandLine,
    CommandLineInputSpec,
    Directory,
    File,
    InputMultiObject,
    TraitedSpec,
    traits,
)

DESCRIPTOR = json.loads(Path(__file__).with_name("voxflat.boutiques.json").read_text())
FOLDERS = {"source": Directory(exists=True, resolve=True), "out": Directory(resolve=True)}  # nodes run elsewhere


def trait(one: dict[str, Any], position: int) -> Any:
    """Return the Nipype trait of an input of the descriptor."""
    flag = one.get("command-line-flag")
    how = {"mandatory": not one["optional"], "desc": one.get("description", one["name"])}
    how |= {"argstr": "%s", "position": position} if flag is None else {"argstr": f"{flag} %s"}
    if one["type"] == "Flag":
        return traits.Bool(**how | {"argstr": flag})
    kind = FOLDERS.get(one["id"], traits.Int() if one.get("integer") else traits.Str())
    if "value-choices" in one:
        kind = traits.Enum(*one["value-choices"])
    return InputMultiObject(kind, **how) if one.get("list") else kind(**how)


INPUTS = {one["id"]: trait(one, at) for at, one in enumerate(DESCRIPTOR["inputs"])}
Inputs = type("Inputs", (CommandLineInputSpec,), {"__module__": __name__, **INPUTS})


class Outputs(TraitedSpec):
    """Outputs of the interface."""

    maps = Directory(exists=True, desc=DESCRIPTOR["output-files"][0]["description"])
    surfaces = traits.List(File(exists=True), desc="The flat surfaces of the selected participants.")
    pages = traits.List(File(exists=True), desc="Their reports, or the report of the study at the group level.")


class VoxflatBids(CommandLine):
    """Flatten the participants of a study, or write the report of the study.

    The interface always runs, because Nipype compares only the name of a folder, whereas voxflat compares the checksums
    of all files.
    """

    _cmd = DESCRIPTOR["command-line"].partition(" [")[0]
    _always_run = True
    input_spec = Inputs
    output_spec = Outputs

    def _format_arg(self, name: str, spec: Any, value: Any) -> str | None:
        """Quote values, because Nipype passes the command line to a shell."""
        if name == "args" or isinstance(value, bool):
            return super()._format_arg(name, spec, value)
        values = value if isinstance(value, list) else [value]
        return " ".join(spec.argstr % shlex.quote(str(one)) for one in values)

    def _list_outputs(self) -> dict[str, Any]:
        out, given = Path(self.inputs.out), self.inputs
        if not out.is_dir():  # after a dry run
            return {}
        names = [f"sub-{label.removeprefix('sub-')}" for label in given.labels or ["*"]]
        pages = [f"{name}{more}.html" for name in names for more in ("", "_ses-*")]
        surfaces = [f"{name}/**/*_flat.surf.gii" for name in names]
        found = {"surfaces": surfaces, "pages": pages if given.level == "participant" else ["group.html"]}
        files = {name: {str(path) for one in globs for path in out.glob(one)} for name, globs in found.items()}
        return {"maps": str(out), **{name: sorted(some) for name, some in files.items()}}


def main() -> None:
    """Run the workflow, compare all participants, and list the failed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study")
    parser.add_argument("maps")
    parser.add_argument("--plugin", default="Linear", help="Nipype plugin: Linear, MultiProc, SLURM, ...")
    parser.add_argument("--cores", type=int, default=2, help="number of cores per node")
    options, further = parser.parse_known_args()

    jobs = f"{Path(options.maps).resolve()}.jobs"
    config.update_config({"execution": {"stop_on_first_crash": "false", "crashdump_dir": jobs}})
    how = {"source": options.study, "out": options.maps}
    participant = {**how, "level": "participant", "args": shlex.join(further)}
    if labels := to_do(participant):
        node = Node(VoxflatBids(**participant, threads=options.cores), "flat", n_procs=options.cores)
        node.iterables = ("labels", labels)
        workflow = Workflow("voxflat", base_dir=jobs)
        workflow.add_nodes([node])
        with suppress(RuntimeError):  # crash files contain the reason
            workflow.run(plugin=options.plugin)
    print(said(VoxflatBids(**how, level="group"), may_lack_maps=True), end="")
    failed = to_do(participant)
    sys.exit(f"failed: {' '.join(failed)}" if failed else 0)


def to_do(participant: dict[str, Any]) -> list[str]:
    """Return the labels of the participants with missing or outdated maps."""
    plan = said(VoxflatBids(**participant, dry_run=True))
    hemispheres = [json.loads(line) for line in plan.splitlines()]
    return sorted({one["participant"].split("_")[0] for one in hemispheres if one["state"] != "done"})


def said(task: VoxflatBids, *, may_lack_maps: bool = False) -> str:
    """Run a task without a node, and return its output."""
    task.terminal_output = "allatonce"
    done = task.run().runtime
    if done.returncode and not (may_lack_maps and done.stdout):
        sys.exit(done.stderr)
    return str(done.stdout)


if __name__ == "__main__":
    main()
