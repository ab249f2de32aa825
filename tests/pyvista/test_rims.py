"""The borders of a rim as PyVista meshes, on a cylinder whose radii are known."""

import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_array_equal
from refusals import refused

import voxflat


@pytest.mark.medium
def test_the_borders_of_a_rim_correspond():
    rim = voxflat.rim(voxflat.samples.rim())  # a cylinder along z: grey matter between the radii 4.5 and 7 mm
    blocks = rim.to_pyvista()
    assert isinstance(blocks, pv.MultiBlock)
    assert blocks.keys() == ["inner", "middle", "outer"]
    inner, middle, outer = blocks
    for mesh, radius in zip(blocks, (4.5, 5.75, 7.0), strict=True):
        found = np.hypot(mesh.points[:, 0] - 7.8, mesh.points[:, 1])
        inside = np.abs(mesh.points[:, 1] - 3) < 2  # away from the ends, where the labels stop
        assert abs(np.median(found[inside]) - radius) < 0.12
        assert mesh.n_points == len(rim.surface)
        assert_array_equal(mesh.regular_faces, rim.surface.faces)
        assert_array_equal(mesh["voxel_ids"], rim.surface.ids)
        assert mesh.active_scalars_name == "thickness"
    np.testing.assert_allclose(np.linalg.norm(outer.points - inner.points, axis=1), middle["thickness"], atol=1e-5)
    outwards = (middle.face_normals * (outer.points - inner.points)[middle.regular_faces[:, 0]]).sum(axis=1)
    assert (outwards > 0).all()  # triangles are counterclockwise seen from outside


@pytest.mark.medium
def test_columns_are_numbers_of_points():
    rim = voxflat.rim(voxflat.samples.rim())
    columns = rim.columns(20)
    for mesh in rim.to_pyvista(columns):
        assert_array_equal(mesh["column"], columns.vertex_columns)
        assert mesh.active_scalars_name == "column"
    other = voxflat.rim(voxflat.samples.rim().data[:, :, :10])
    refused("Pass columns of this rim", other.to_pyvista, columns)
