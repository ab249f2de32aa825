"""Small studies in the layouts of FreeSurfer and sMRIPrep: nilearn's fsaverage5 and warped variants of it.

The vertices of fsaverage5 are those of an icosahedron that was subdivided five times. The first 2,562 vertices are
those after four subdivisions, the first 642 after three, and the first 162 after two.
"""

from functools import lru_cache

import nibabel as nib
import numpy as np
from anatomy import fsaverage5_file

SIDES = {"lh": ("left", "L"), "rh": ("right", "R")}
SIZES = (10_242, 2562, 642, 162)
C_RAS = (3.0, -17.0, 22.0)
THIN = 0.3  # mm between the white and pial surfaces; less on the medial wall


@lru_cache
def hemisphere(hemi, vertices=SIZES[0]):
    """Return white, pial, sphere, each (N, 3), curv, thickness, cortex, each (N,), and faces (F, 3), by name."""

    def arrays(name):
        return nib.load(fsaverage5_file(name, SIDES[hemi][0])).agg_data()

    (white, faces), (pial, _), (sphere, _) = (arrays(name) for name in ("white", "pial", "sphere"))
    faces = faces.astype(np.int64)
    for size in SIZES[1 : 1 + SIZES.index(vertices)]:
        faces = before_subdivision(faces, size)
    found = {"white": white, "pial": pial, "sphere": sphere, "curv": arrays("curv"), "thickness": arrays("thick")}
    found = {name: np.asarray(values[:vertices], dtype=np.float64) for name, values in found.items()}
    return {**found, "faces": faces, "cortex": np.linalg.norm(found["pial"] - found["white"], axis=1) >= THIN}


def before_subdivision(faces, size):
    """Return the triangles before a subdivision: each contains three midpoints of two corners."""
    parents = {}
    for edge in np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist():
        for middle, corner in (edge, edge[::-1]):
            if middle >= size > corner:
                parents.setdefault(middle, set()).add(corner)
    inner = faces[(faces >= size).all(axis=1)].tolist()
    between = [[parents[middle] for middle in triangle] for triangle in inner]
    return np.array([[*(a & c), *(a & b), *(b & c)] for a, b, c in between])


def warped(of, seed, amplitude=2.5):
    """Return another subject, with another size and thickness, and with points displaced by long waves (mm)."""
    random = np.random.default_rng(seed)
    size, waves = random.uniform(0.94, 1.06, 3), random.normal(scale=0.04, size=(3, 3))
    phases = random.uniform(0, 2 * np.pi, 3)

    def moved(points):
        return points * size + amplitude * np.sin(points @ waves + phases)

    thickness = of["thickness"] * random.uniform(0.9, 1.1)
    return {**of, "white": moved(of["white"]), "pial": moved(of["pial"]), "thickness": thickness}


def write_freesurfer(folder, hemi, of, c_ras=(0, 0, 0)):
    """Write ``surf`` and ``label`` like recon-all."""
    for name in ("surf", "label"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for name, points in (("white", "white"), ("smoothwm", "white"), ("pial", "pial"), ("sphere.reg", "sphere")):
        path = folder / "surf" / f"{hemi}.{name}"
        nib.freesurfer.write_geometry(path, of[points], of["faces"], volume_info=footer(c_ras))
    for name in ("curv", "thickness"):
        nib.freesurfer.write_morph_data(folder / "surf" / f"{hemi}.{name}", of[name])
    write_label(folder / "label" / f"{hemi}.cortex.label", np.flatnonzero(of["cortex"]), of["white"])


def footer(c_ras):
    """Return the footer that FreeSurfer writes after a surface of a conformed volume."""
    return {
        "head": np.array([2, 0, 20], np.int32),
        "valid": "1  # volume info valid",
        "filename": "../mri/orig.mgz",
        "volume": np.array([256, 256, 256]),
        "voxelsize": np.ones(3),
        **{"xras": np.array([-1.0, 0, 0]), "yras": np.array([0.0, 0, -1]), "zras": np.array([0.0, 1, 0])},
        "cras": np.array(c_ras, dtype=float),
    }


def write_label(path, vertices, points):
    """Write a label like FreeSurfer."""
    placed = zip(vertices, points[vertices], strict=True)
    rows = "".join(f"{v}  {x:.3f}  {y:.3f}  {z:.3f} 0.0\n" for v, (x, y, z) in placed)
    path.write_text(f"#!ascii label , from subject\n{len(vertices)}\n{rows}")


def write_derivatives(folder, name, hemi, of):
    """Write the surfaces of a participant such as ``sub-01`` into its ``anat`` folder, like sMRIPrep."""
    folder.mkdir(parents=True, exist_ok=True)
    letter = SIDES[hemi][1]
    structure = {"L": "CortexLeft", "R": "CortexRight"}[letter]

    def save(ending, *arrays):
        meta = nib.gifti.GiftiMetaData(AnatomicalStructurePrimary=structure)
        nib.save(nib.gifti.GiftiImage(darrays=list(arrays), meta=meta), folder / f"{name}_hemi-{letter}_{ending}.gii")

    def values(data, intent, kind):
        return nib.gifti.GiftiDataArray(data.astype(kind), f"NIFTI_INTENT_{intent}")

    triangles = values(of["faces"], "TRIANGLE", "i4")
    surfaces = {"white": of["white"], "pial": of["pial"], "midthickness": (of["white"] + of["pial"]) / 2}
    for ending, points in {**surfaces, "space-fsaverage_desc-reg_sphere": of["sphere"]}.items():
        save(f"{ending}.surf", values(points, "POINTSET", "f4"), triangles)
    save("thickness.shape", values(of["thickness"], "SHAPE", "f4"))
    save("desc-cortex_mask.label", values(of["cortex"], "LABEL", "i4"))


def write_z(path):
    """Write a volume with 4 mm voxels whose values are z in scanner RAS, mm."""
    path.parent.mkdir(parents=True, exist_ok=True)
    affine = np.diag([4.0, 4, 4, 1])
    affine[:3, 3] = -140
    z = np.broadcast_to(affine[2, 3] + 4.0 * np.arange(70), (70, 70, 70))
    nib.save(nib.MGHImage(z.astype(np.float32), affine), path)
