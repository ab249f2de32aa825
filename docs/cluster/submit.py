"""A study as an array of jobs on Slurm, by submitit: a job a participant, those alone that have something to be done.

    python submit.py study maps --hours 2 --memory 4 --hemi L

What the script has no option for is voxflat's. Jobs share no file but their participant's. What fails, or is killed,
is made by the same call again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import submitit

VOXFLAT = [sys.executable, "-m", "voxflat.cli", "bids"]


def main() -> None:
    """Submit the jobs, wait for them, and say who failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("maps", type=Path)
    parser.add_argument("--hours", type=float, default=1.0, help="of a job, at most")
    parser.add_argument("--memory", type=float, default=4.0, help="of a job, GB")
    parser.add_argument("--cores", type=int, default=2, help="of a job")
    parser.add_argument("--at-once", type=int, default=100, help="jobs that run, at most")
    parser.add_argument("--here", action="store_true", help="run the jobs on this machine, without Slurm")
    options, further = parser.parse_known_args()

    study, maps = options.study.resolve(), options.maps.resolve()
    executor = submitit.AutoExecutor(folder=f"{maps}.jobs", cluster="local" if options.here else None)
    executor.update_parameters(name="voxflat", timeout_min=int(60 * options.hours), mem_gb=options.memory)
    executor.update_parameters(cpus_per_task=options.cores, slurm_array_parallelism=options.at_once)
    participant = [*VOXFLAT, study, maps, "participant", *further]
    labels = to_do(participant)
    commands = [[*participant, "--threads", options.cores, "--participant-label", label] for label in labels]
    failed = [label for label, job in zip(labels, executor.map_array(run, commands), strict=True) if job.exception()]
    subprocess.run([*VOXFLAT, study, maps, "group"], check=True)
    sys.exit(f"failed: {' '.join(failed)}" if failed else 0)


def to_do(participant: list[object]) -> list[str]:
    """Return the labels of those who have something to be done."""
    plan = subprocess.run([*participant, "--dry-run"], check=True, stdout=subprocess.PIPE)
    hemispheres = [json.loads(line) for line in plan.stdout.splitlines()]
    return sorted({one["participant"].split("_")[0] for one in hemispheres if one["state"] != "done"})


def run(command: list[object]) -> None:
    """Run a command on a node."""
    subprocess.run([str(word) for word in command], check=True)


if __name__ == "__main__":
    main()
