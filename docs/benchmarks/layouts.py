"""Run ``voxflat bids`` on eight people in each layout of fMRIPrep and the HCP pipelines, and open all results.

    python docs/benchmarks/layouts.py demo-layouts [--templates DIR]

writes ``demo-layouts/fmriprep`` and ``demo-layouts/hcp``: warped variants of fsaverage5 on their native mesh, and on
another mesh. With ``--templates``, this is the 32k mesh of fs_LR, to which ``wb_command`` resamples them; without, its
place is taken by the first 2,562 vertices of fsaverage5. DIR contains these files of the HCP pipelines
(global/templates), also for R: ``L.sphere.32k_fs_LR.surf.gii``,
``fs_LR-deformed_to-fsaverage.L.sphere.32k_fs_LR.surf.gii`` and ``L.atlasroi.32k_fs_LR.shape.gii``.

Each run is killed in the middle and repeated, and the people who were then due are compared with an uninterrupted run.
Every file is opened by nibabel, nilearn and ``wb_command``, which also draws the scenes.
"""

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import nibabel as nib
import numpy as np
import studies
from nilearn.surface import load_surf_data, load_surf_mesh

PEOPLE = range(1, 9)
COARSE = 2562
LAYOUTS = {
    "fmriprep native": ("fmriprep", "native"),
    "fmriprep fsLR": ("fmriprep", "fsLR"),
    "hcp T1w/Native": ("hcp", "native"),
    "hcp MNINonLinear/fsaverage_LR32k": ("mni", "fsLR"),
}
SURFACES = ("white", "pial")


def workbench(*words):
    """Run wb_command, and return its output."""
    return subprocess.run(["wb_command", *map(str, words)], check=True, capture_output=True, text=True).stdout


def on_32k(of, hemi, templates, folder):
    """Return a person on the mesh of fs_LR, and the native sphere in the space of fs_LR."""
    letter = studies.SIDES[hemi][1]
    sphere = folder / "sphere.surf.gii"
    studies.write_surface(sphere, hemi, of["sphere"], of["faces"])
    deformed = templates / f"fs_LR-deformed_to-fsaverage.{letter}.sphere.32k_fs_LR.surf.gii"
    own = templates / f"{letter}.sphere.32k_fs_LR.surf.gii"
    made = {}
    for name in SURFACES:
        native, resampled = folder / "native.surf.gii", folder / "resampled.surf.gii"
        studies.write_surface(native, hemi, of[name], of["faces"])
        workbench("-surface-resample", native, sphere, deformed, "BARYCENTRIC", resampled)
        made[name], made["faces"] = nib.load(resampled).agg_data()
    for name in ("thickness", "curv"):
        native, resampled = folder / "native.shape.gii", folder / "resampled.shape.gii"
        studies.write_values(native, hemi, of[name])
        workbench("-metric-resample", native, sphere, deformed, "BARYCENTRIC", resampled)
        made[name] = nib.load(resampled).agg_data()
    registered = folder / "registered.surf.gii"
    workbench("-surface-sphere-project-unproject", sphere, deformed, own, registered)
    cortex = nib.load(templates / f"{letter}.atlasroi.32k_fs_LR.shape.gii").agg_data() > 0
    return {**made, "sphere": nib.load(own).agg_data("pointset"), "cortex": cortex}, nib.load(registered).agg_data()[0]


def build(folder, templates):
    """Write the people in all layouts."""
    for n in PEOPLE:
        for hemi, (_, letter) in studies.SIDES.items():
            native = studies.warped(studies.hemisphere(hemi), n)
            resampled, sphere = studies.warped(studies.hemisphere(hemi, COARSE), n), native["sphere"]
            if templates is not None:
                with tempfile.TemporaryDirectory() as temporary:
                    resampled, sphere = on_32k(native, hemi, templates, Path(temporary))
            name, anat = f"sub-{n:02}", folder / "fmriprep" / f"sub-{n:02}" / "anat"
            studies.write_derivatives(anat, name, hemi, native)
            registered = anat / f"{name}_hemi-{letter}_space-fsLR_desc-msmsulc_sphere.surf.gii"
            studies.write_surface(registered, hemi, sphere, native["faces"])
            studies.write_32k(anat, name, hemi, resampled, series=5)
            studies.write_hcp(folder / "hcp" / f"10000{n}", hemi, {**native, "sphere": sphere}, resampled)
    for subject in sorted((folder / "hcp").iterdir()):
        shutil.copytree(subject / "MNINonLinear", folder / "mni" / subject.name / "MNINonLinear")


def started(study, out, space, *more):
    """Start voxflat."""
    words = ["bids", study, out, "participant", "--space", space, *more]
    command = [sys.executable, "-m", "voxflat.cli", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run(study, out, space, *more):
    """Run voxflat, and return what it printed."""
    made = started(study, out, space, *more)
    told, warned = made.communicate()
    if made.returncode:
        sys.exit(f"{study} {space}: status {made.returncode}\n{warned}")
    return told


def killed_and_continued(study, out, space):
    """Kill a run after five hemispheres and a half, continue it, and return the people who were then due."""
    made = started(study, out, space)
    for _ in range(5):
        made.stdout.readline()
    time.sleep(2)
    made.send_signal(signal.SIGKILL)
    made.wait()
    there = len(list(out.rglob("*_flat.json")))
    told = run(study, out, space)
    print(f"  killed after {there} hemispheres; then: {told.splitlines()[-3]}", flush=True)
    again = run(study, out, space)
    print(f"  again: {again.splitlines()[-3]}", flush=True)
    labels = sorted(path.name.removeprefix("sub-") for path in out.glob("sub-*") if path.is_dir())
    return labels[2:4]


def compare(study, out, space, labels, folder):
    """Compare people with those of an uninterrupted run."""
    run(study, folder, space, "--participant-label", *labels)
    names = [path.relative_to(folder) for path in sorted(folder.rglob("*.gii"))]
    pairs = [(nib.load(folder / name), nib.load(out / name)) for name in names]
    same = sum(
        all(one.data.tobytes() == two.data.tobytes() for one, two in zip(a.darrays, b.darrays, strict=True))
        for a, b in pairs
    )
    print(f"  {same} of {len(names)} files of {len(labels)} people equal those of an uninterrupted run", flush=True)


def opened(out):
    """Open all results, and print how many were opened."""
    counts = dict.fromkeys(("nibabel", "nilearn", "wb_command", "spec entries", "scenes drawn"), 0)
    for path in sorted(out.rglob("*.gii")):
        count = len(nib.load(path).darrays[0].data)
        read = load_surf_mesh(path).coordinates if path.name.endswith(".surf.gii") else load_surf_data(path)
        told = workbench("-file-information", path)
        counts["nibabel"] += 1
        counts["nilearn"] += len(read) == count
        counts["wb_command"] += bool(re.search(rf"Number of Vertices: +{count}\b.*", told))
    for path in sorted(out.rglob("*.spec")):
        counts["spec entries"] += len(re.findall(r"\.(?:gii|nii) ", workbench("-file-information", path)))
        picture = path.with_name("scene.png")
        workbench("-show-scene", path.with_suffix(".scene"), 1, picture, 1200, 600)
        counts["scenes drawn"] += picture.stat().st_size > 20_000
        shutil.move(picture, out / f"{path.stem}.png")
    print("  opened:", ", ".join(f"{name} {count}" for name, count in counts.items()), flush=True)


def figures(out):
    """Print the distortion of the maps, and their warnings."""
    records = [json.loads(path.read_text()) for path in out.rglob("*_flat.json")]
    errors = [100 * record["figures"]["best_scale"]["relative_error"] for record in records]
    flipped = sum(record["figures"]["triangles"]["flipped"] for record in records)
    points = [record["map"]["points"] for record in records]
    seconds = np.median([sum(record["seconds"].values()) for record in records])
    warned = sorted({text for record in records for text in record["warnings"]})
    print(f"  {len(records)} maps of {min(points)} to {max(points)} points, median {seconds:.0f} s", flush=True)
    print(
        f"  distance error {np.mean(errors):.1f} % (up to {max(errors):.1f} %), {flipped} flipped triangles", flush=True
    )
    print(f"  warnings: {warned or 'none'}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--templates", type=Path)
    given = parser.parse_args()
    shutil.rmtree(given.folder, ignore_errors=True)
    build(given.folder, given.templates)
    for name, (study, space) in LAYOUTS.items():
        start = time.perf_counter()
        out = given.folder / "out" / name.replace("/", "_").replace(" ", "_")
        print(name, flush=True)
        labels = killed_and_continued(given.folder / study, out, space)
        with tempfile.TemporaryDirectory() as temporary:
            compare(given.folder / study, out, space, labels, Path(temporary))
        figures(out)
        opened(out)
        print(f"  {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
