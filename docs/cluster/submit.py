"""Flatten a study with a Slurm job array, by submitit: one job for each participant with missing or outdated maps.

    python submit.py study maps --hours 2 --memory 4 --hemi L

Options unknown to this script are passed to voxflat. Jobs share no files. If jobs fail or are killed, repeat the same
command.
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
    """Submit the jobs, wait for them, and list the failed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("maps", type=Path)
    parser.add_argument("--hours", type=float, default=1.0, help="time limit per job, hours")
    parser.add_argument("--memory", type=float, default=4.0, help="memory per job, GB")
    parser.add_argument("--cores", type=int, default=2, help="number of cores per job")
    parser.add_argument("--at-once", type=int, default=100, help="maximal number of running jobs")
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
    subprocess.run([*VOXFLAT, study, maps, "group"], check=False)  # its status counts the failed participants
    sys.exit(f"failed: {' '.join(failed)}" if failed else 0)


def to_do(participant: list[object]) -> list[str]:
    """Return the labels of the participants with missing or outdated maps."""
    plan = subprocess.run([*participant, "--dry-run"], check=True, stdout=subprocess.PIPE)
    hemispheres = [json.loads(line) for line in plan.stdout.splitlines()]
    return sorted({one["participant"].split("_")[0] for one in hemispheres if one["state"] != "done"})


def run(command: list[object]) -> None:
    """Run a command on a node."""
    subprocess.run([str(word) for word in command], check=True)


if __name__ == "__main__":
    main()
