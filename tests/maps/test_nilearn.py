"""Both hemispheres in nilearn: its plotting functions and maskers run on the flat meshes."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from mesh_files import fsaverage5
from refusals import refused

import voxflat

pytest.importorskip("nilearn")
from nilearn import datasets, plotting
from nilearn.maskers import SurfaceLabelsMasker, SurfaceMasker
from nilearn.surface import PolyMesh, SurfaceImage


@pytest.fixture(scope="module")
def maps():
    """Maps of a part of each hemisphere of fsaverage5."""
    sides = ("left", "right")
    whole = [voxflat.surface(fsaverage5(f"white_{side}"), pial=fsaverage5(f"pial_{side}")) for side in sides]
    return [surface.disk(5000, 30.0).flatten(voxflat.methods.Voxflat(sources=30), relax=False) for surface in whole]


@pytest.fixture(scope="module")
def images():
    """Thickness, two frames, and an atlas with three parcels, on the folded surface."""
    thickness = datasets.load_fsaverage_data("fsaverage5", data_type="thickness")
    parts = thickness.data.parts
    frames = {side: np.column_stack([values, values**2]) for side, values in parts.items()}
    labels = {side: (values > 2.5).astype(int) + (values > 2.8) for side, values in parts.items()}
    return [SurfaceImage(thickness.mesh, each) for each in (parts, frames, labels)]


@pytest.mark.slow
def test_nilearn_plots_both_hemispheres(maps, images):
    mesh, stat, atlas = voxflat.to_nilearn(*maps), *(voxflat.to_nilearn(*maps, image) for image in images[::2])
    assert isinstance(mesh, PolyMesh)
    for side, flat_map in zip(("left", "right"), maps, strict=True):
        assert mesh.parts[side].n_vertices == 10242
        np.testing.assert_array_equal(mesh.parts[side].coordinates[flat_map.ids, :2], flat_map.uv)
        np.testing.assert_array_equal(stat.data.parts[side], images[0].data.parts[side])
    for hemi in ("left", "right", "both"):
        figure = plotting.plot_surf_stat_map(
            stat_map=stat, bg_map=stat, hemi=hemi, view=(90, 270), threshold=2.0, colorbar=True, engine="matplotlib"
        )
        assert len(figure.axes) == 2
        plotting.plot_surf_contours(roi_map=atlas, hemi=hemi, levels=[1, 2], figure=figure, axes=figure.axes[0])
        triangles = figure.axes[0].collections[0]
        count = sum(len(part.faces) for name, part in mesh.parts.items() if hemi in (name, "both"))
        assert len(triangles._facecolors) == count
        plt.close(figure)
    assert plotting.view_surf(surf_mesh=mesh, surf_map=stat, hemi="both", engine="niivue").html


@pytest.mark.slow
def test_view_surf(maps, images):
    pytest.importorskip("plotly")
    stat = voxflat.to_nilearn(*maps, images[0])
    assert "plotly" in plotting.view_surf(surf_mesh=stat.mesh, surf_map=stat, hemi="both").html.lower()


@pytest.mark.slow
def test_maskers_return_the_same_numbers_as_on_the_folded_surface(maps, images):
    """Also the reverse: values of the flat image belong to the folded mesh."""
    _, series, atlas = images
    flat_series, flat_atlas = (voxflat.to_nilearn(*maps, image) for image in (series, atlas))
    folded, flat = SurfaceMasker().fit_transform(series), SurfaceMasker().fit_transform(flat_series)
    np.testing.assert_array_equal(folded, flat)
    means = [
        SurfaceLabelsMasker(labels).fit_transform(data) for labels, data in ((atlas, series), (flat_atlas, flat_series))
    ]
    np.testing.assert_array_equal(*means)
    masker = SurfaceMasker().fit(flat_series)
    back = masker.inverse_transform(masker.transform(flat_series))
    again = SurfaceImage(series.mesh, back.data)
    for side, part in again.data.parts.items():
        np.testing.assert_allclose(part, series.data.parts[side], rtol=1e-6)


@pytest.mark.slow
def test_a_single_hemisphere(maps, images):
    assert list(voxflat.to_nilearn(maps[0]).parts) == ["left"]
    image = voxflat.to_nilearn(None, maps[1], images[0])
    assert list(image.mesh.parts) == list(image.data.parts) == ["right"]


@pytest.mark.slow
def test_refusals(maps, images):
    left, right = maps
    refused("left is the map of CortexRight. Pass left, right in this order", voxflat.to_nilearn, right, left)
    refused("no map is given", voxflat.to_nilearn, None)
    refused("left is .*Pass a flat map", voxflat.to_nilearn, "lh.npz")
    refused("image is ndarray. Pass a nilearn SurfaceImage", voxflat.to_nilearn, left, right, np.zeros(10242))
    hill = voxflat.samples.hill().flatten()
    refused(
        "10242 values for the left hemisphere, but its mesh has 441 vertices", voxflat.to_nilearn, hill, None, images[0]
    )
    alone = voxflat.to_nilearn(left, None, images[0])
    refused("image has no values for the right hemisphere", voxflat.to_nilearn, left, right, alone)
    ball = voxflat.surface(voxflat.samples.ball()).disk((4, 12, 12), 6.0).flatten()
    refused("left is the map of a volume", voxflat.to_nilearn, ball)
