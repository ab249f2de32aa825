"""Run ``voxflat freesurfer`` and ``voxflat bids`` on a subject and a study made from data included in nilearn.

    python docs/benchmarks/study.py demo-lab

writes ``demo-lab/subjects/fs5`` (fsaverage5 in the layout of recon-all) and ``demo-lab/study`` (three warped variants
of it: one has a different c_ras, and one lacks its right pial surface), and runs each command twice.
"""

import argparse
import shutil
import subprocess
import sys
import time
from pathlib import Path

import studies

VARIANTS = {"sub-01": (0.0, 0.0, 0.0), "sub-02": studies.C_RAS, "sub-03": (0.0, 0.0, 0.0)}
BROKEN = "sub-03"


def build(folder):
    """Write the subject and the study."""
    subject, study = folder / "subjects" / "fs5", folder / "study"
    for hemi in studies.SIDES:
        of = studies.hemisphere(hemi)
        studies.write_freesurfer(subject, hemi, of)
        for seed, (name, c_ras) in enumerate(VARIANTS.items(), 1):
            one = studies.warped(of, seed)
            studies.write_freesurfer(study / "sourcedata" / "freesurfer" / name, hemi, one, c_ras)
    studies.write_z(subject / "mri" / "z.mgz")
    (study / "sourcedata" / "freesurfer" / BROKEN / "surf" / "rh.pial").unlink()
    return subject, study


def run(*arguments, status=0):
    """Run voxflat twice: the second run finds everything up to date."""
    command = [sys.executable, "-m", "voxflat.cli", *map(str, arguments)]
    for _ in range(2):
        print("$ voxflat", *arguments, flush=True)
        start = time.perf_counter()
        done = subprocess.run(command, check=False)
        print(f"  status {done.returncode}, {time.perf_counter() - start:.1f} s\n", flush=True)
        if done.returncode != status:
            sys.exit(f"the exit status is {done.returncode}, not {status}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    shutil.rmtree(folder, ignore_errors=True)
    start = time.perf_counter()
    subject, study = build(folder)
    out = folder / "maps"
    run("freesurfer", subject, "--overlay", "thickness", "mri/z.mgz")
    run("bids", study, out, "participant", status=1)
    run("bids", study, out, "group")
    for page in (subject / "voxflat.html", out / "sub-02.html", out / "group.html"):
        print(f"{page}: {page.stat().st_size / 1e6:.2f} MB")
    print(f"{time.perf_counter() - start:.0f} s in total")


if __name__ == "__main__":
    main()
