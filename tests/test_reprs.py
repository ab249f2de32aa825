"""The repr of a result is one line, however large the result is."""

import inspect

import numpy as np
import pytest
from hard_shapes import sheet
from matplotlib.figure import Figure

import voxflat
from voxflat import io
from voxflat.io.notebook import page
from voxflat.surfaces.cuts import Cut
from voxflat.surfaces.standard.registration import Registration


@pytest.mark.medium
def test_the_repr_of_each_public_class_is_a_line(tmp_path):
    points, faces = sheet(lambda u, v: (u, v, 3 * np.sin(u / 4) * np.cos(v / 4)), (39, 39), (40, 40))
    mesh = io.Mesh(points, faces)
    flat_map = voxflat.flatten(mesh, method=voxflat.methods.Voxflat(sources=30))
    atlas = voxflat.surface(mesh).patches(15)
    glued = atlas.glue(1.6)
    compared = voxflat.compare(mesh, {f"map {n}": flat_map for n in range(40)}, sources=5)
    cut = voxflat.surface(mesh).cut()
    voxflat.surface(mesh).geodesic(5, store=tmp_path / "store")
    patch = io.Patch(np.arange(1600), points, np.zeros(1600, dtype=bool))
    worst = voxflat.worst_places(flat_map, 1, beyond=1.0001)
    registration = Registration(cut.surface, points, "left", 0.99, {"scores": points})
    rim = voxflat.rim(voxflat.samples.rim())
    series = voxflat.flatten_series([voxflat.samples.hill()] * 2)
    results = [
        *(mesh, flat_map, flat_map.distortion, flat_map.distortion.raw, flat_map.distortion.triangles),
        *(flat_map.distortion.standard_error, flat_map.raster(), flat_map.heat_map(), flat_map.look_up(points[:, :2])),
        *(atlas, atlas[0], atlas[0].plane, atlas.certificate, atlas.page(), glued, glued[0], glued.seams),
        *(atlas.page().textured(), compared, compared.maps["map 0"], voxflat.check(mesh), voxflat.surface(mesh)),
        *(voxflat.surface(mesh).path(0, 1599), voxflat.open_rows(tmp_path / "store"), cut, patch),
        voxflat.samples.hill().geodesic_matrix(),
        *(Cut(np.arange(1600), 1.5, "given"), voxflat.cite(flat_map)),
        *(rim, rim.profile(rim.thickness()), rim.columns(9), registration, worst, worst.places[0], worst.places[0].cut),
        *(series, series.images(metric=True), flat_map.images(points), voxflat.samples.embryo(1)),
        flat_map.regions({f"region {n}": [[0, 0], [9, 0], [0, 9]] for n in range(99)}),
        *(mesh.space, io.VolumeGeometry(np.eye(3), np.array([3.0, -17.0, 22.0]), filename="x" * 40)),
        io.Volume(np.zeros((30, 40, 50), dtype=np.float32), np.diag([0.7, 0.7, 1.25, 1.0])),
    ]
    shown = {type(result).__name__: repr(result) for result in results}
    public = {value for module in (voxflat, io) for value in vars(module).values() if inspect.isclass(value)}
    kinds = {one.__name__ for one in public if not issubclass(one, Exception)} - {"Atlas"}  # which is none by itself
    assert kinds <= set(shown)
    for text in shown.values():
        assert "\n" not in text
        assert len(text) <= 300
        assert "array(" not in text


def test_the_picture_of_a_repr_is_not_kept():
    figure = Figure()
    figure.add_subplot().imshow(np.zeros((9, 9)))
    assert "data:image/png" in page(3, figure=figure)
    assert figure.axes == []
