"""Small studies in the layouts of FreeSurfer, sMRIPrep and the HCP pipelines: nilearn's fsaverage5 and
warped variants of it.

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
    surfaces = {"white": of["white"], "pial": of["pial"], "midthickness": (of["white"] + of["pial"]) / 2}
    for ending, points in {**surfaces, "space-fsaverage_desc-reg_sphere": of["sphere"]}.items():
        write_surface(folder / f"{name}_hemi-{letter}_{ending}.surf.gii", hemi, points, of["faces"])
    write_values(folder / f"{name}_hemi-{letter}_thickness.shape.gii", hemi, of["thickness"])
    cortex = folder / f"{name}_hemi-{letter}_desc-cortex_mask.label.gii"
    write_gifti(cortex, hemi, (of["cortex"].astype("i4"), "LABEL"))


def write_z(path):
    """Write a volume with 4 mm voxels whose values are z in scanner RAS, mm."""
    path.parent.mkdir(parents=True, exist_ok=True)
    affine = np.diag([4.0, 4, 4, 1])
    affine[:3, 3] = -140
    z = np.broadcast_to(affine[2, 3] + 4.0 * np.arange(70), (70, 70, 70))
    nib.save(nib.MGHImage(z.astype(np.float32), affine), path)


def write_32k(folder, name, hemi, of, series=0):
    """Write the surfaces of a participant on the mesh of fs_LR into its ``anat`` folder, like fMRIPrep.

    The values of both hemispheres, and `series` frames of a run, are in CIFTI files, which the second hemisphere adds.
    """
    letter = SIDES[hemi][1]
    for ending in ("white", "pial", "midthickness"):
        points = (of["white"] + of["pial"]) / 2 if ending == "midthickness" else of[ending]
        path = folder / f"{name}_hemi-{letter}_space-fsLR_den-32k_{ending}.surf.gii"
        write_surface(path, hemi, points, of["faces"])
    values = folder / f"{name}_space-fsLR_den-91k_thickness.dscalar.nii"
    write_grayordinates(values, hemi, of["cortex"], of["thickness"][None], nib.cifti2.ScalarAxis(["thickness"]))
    if series:
        run = folder.parent / "func" / f"{name}_task-rest_space-fsLR_den-91k_bold.dtseries.nii"
        run.parent.mkdir(exist_ok=True)
        frames = of["thickness"] + np.arange(series)[:, None]
        write_grayordinates(run, hemi, of["cortex"], frames, nib.cifti2.SeriesAxis(0, 2, series))


def write_hcp(folder, hemi, native, resampled):
    """Write the files of a subject such as ``100307`` on the native mesh and that of fs_LR, like the HCP pipelines."""
    name, letter = folder.name, SIDES[hemi][1]
    atlas = folder / "MNINonLinear"
    places = {"native": (native, "Native", "sphere.reg.reg_LR", "roi")}
    places["32k_fs_LR"] = (resampled, "fsaverage_LR32k", "sphere", "atlasroi")
    for mesh, (of, below, sphere, cortex) in places.items():
        for at in (folder / "T1w" / below, atlas / below):
            at.mkdir(parents=True, exist_ok=True)
            size = 1.0 if at.parent.name == "T1w" else 1.1  # as the brain of MNI152 is larger
            for ending in ("white", "pial"):
                path = at / f"{name}.{letter}.{ending}.{mesh}.surf.gii"
                write_surface(path, hemi, size * of[ending], of["faces"])
        write_surface(atlas / below / f"{name}.{letter}.{sphere}.{mesh}.surf.gii", hemi, of["sphere"], of["faces"])
        for ending, values in (("thickness", of["thickness"]), (cortex, of["cortex"])):
            write_values(atlas / below / f"{name}.{letter}.{ending}.{mesh}.shape.gii", hemi, values)
    path = atlas / "fsaverage_LR32k" / f"{name}.MyelinMap.32k_fs_LR.dscalar.nii"
    axis = nib.cifti2.ScalarAxis(["MyelinMap"])
    write_grayordinates(path, hemi, resampled["cortex"], resampled["curv"][None], axis)


def write_grayordinates(path, hemi, cortex, values, axis):
    """Write a CIFTI file with values (K, V) at the vertices of a hemisphere; add them to an existing file."""
    model = nib.cifti2.BrainModelAxis.from_mask(cortex, f"cortex_{SIDES[hemi][0]}")
    data = values[:, cortex].astype(np.float32)
    if path.is_file():
        other = nib.load(path)
        model, data = (
            other.header.get_axis(1) + model,
            np.concatenate([other.get_fdata(dtype=np.float32), data], axis=1),
        )
    nib.save(nib.Cifti2Image(data, (axis, model)), path)


def write_surface(path, hemi, points, faces):
    """Write a GIFTI surface."""
    write_gifti(path, hemi, (points.astype("f4"), "POINTSET"), (faces.astype("i4"), "TRIANGLE"))


def write_values(path, hemi, values):
    """Write GIFTI values at the vertices."""
    write_gifti(path, hemi, (values.astype("f4"), "SHAPE"))


def write_gifti(path, hemi, *arrays):
    """Write arrays of a hemisphere, each with the name of its intent."""
    structure = {"lh": "CortexLeft", "rh": "CortexRight"}[hemi]
    images = [nib.gifti.GiftiDataArray(data, f"NIFTI_INTENT_{intent}") for data, intent in arrays]
    for image in images:
        image.meta["AnatomicalStructurePrimary"] = structure
    meta = nib.gifti.GiftiMetaData(AnatomicalStructurePrimary=structure)
    nib.save(nib.gifti.GiftiImage(darrays=images, meta=meta), path)
