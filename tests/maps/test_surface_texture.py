import numpy as np
import pytest
import pyvista as pv
from command_line import succeed
from PIL import Image
from refusals import refused
from textures import chessboard, cylinder

import voxflat
from voxflat.io.meshes import Mesh, write_mesh
from voxflat.maps.textures.surface_texture import _reduced
from voxflat.methods import Voxflat


@pytest.fixture(scope="module")
def mesh():
    """Return a cylinder of few triangles, and its own texture coordinates, along the arc and along the axis."""
    points, faces = cylinder(13, 21)
    return points, faces, np.column_stack([np.arctan2(points[:, 1], points[:, 0]) / 2, points[:, 2] / 12])


@pytest.fixture(scope="module")
def flat_map(mesh):
    return voxflat.flatten(mesh[:2], Voxflat(sources=200))


def save_obj(folder, mesh, picture, corners=None, map_kd="map_Kd picture.png"):
    """Write an OBJ file by hand, of texture coordinates at the points, or at each corner of the faces."""
    points, faces, coordinates = mesh
    numbers = faces if corners is None else np.arange(faces.size).reshape(faces.shape)
    places = coordinates if corners is None else corners.reshape(-1, 2)
    lines = ["mtllib picture.mtl", *(f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist())]
    lines += [f"vt {s!r} {t!r}" for s, t in places.tolist()] + ["usemtl skin"]
    corners = np.stack([faces + 1, numbers + 1], axis=2).tolist()
    lines += ["f " + " ".join(f"{v}/{t}" for v, t in ends) for ends in corners]
    (folder / "face.obj").write_text("\n".join(lines) + "\n")
    (folder / "picture.mtl").write_text(f"newmtl other\nmap_Kd missing.png\nnewmtl skin\n{map_kd}\n")
    Image.fromarray(picture).save(folder / "picture.png")
    return folder / "face.obj"


def save_ply(folder, mesh, picture, corners):
    """Write a PLY file as MeshLab does, with texture coordinates at the corners of the faces."""
    points, faces, _ = mesh
    lines = ["ply", "format ascii 1.0", "comment TextureFile picture.png", f"element vertex {len(points)}"]
    lines += [f"property double {axis}" for axis in "xyz"] + [f"element face {len(faces)}"]
    lines += ["property list uchar int vertex_indices", "property list uchar double texcoord", "end_header"]
    lines += [" ".join(map(repr, point)) for point in points.tolist()]
    places = corners.reshape(len(faces), 6).tolist()
    lines += [f"3 {a} {b} {c} 6 {' '.join(map(repr, of))}" for (a, b, c), of in zip(faces, places, strict=True)]
    (folder / "face.ply").write_text("\n".join(lines) + "\n")
    Image.fromarray(picture).save(folder / "picture.png")
    return folder / "face.ply"


def faces_at(flat_map, image):
    """Find, by trying all triangles, which one covers each pixel's centre; −1 outside, −2 too near to a side to say."""
    rows, columns = np.indices(image.data.shape[:2])
    places = np.column_stack([columns.ravel(), -rows.ravel()]) * image.pixel_size + image.origin
    found = np.full(len(places), -1)
    for number, (a, b, c) in enumerate(flat_map.uv[flat_map.faces]):
        weights = np.linalg.solve(np.column_stack([b - a, c - a]), (places - a).T)
        least = np.minimum(weights.min(axis=0), 1 - weights.sum(axis=0))
        found[least > 0.02] = number
        found[np.abs(least) <= 0.02] = -2
    return found.reshape(rows.shape)


def test_each_pixel_shows_what_its_place_on_the_surface_shows(mesh, flat_map, tmp_path):
    """The picture's red is s, its green t: so a pixel's colour tells the place in the picture that it shows."""
    ramp = np.arange(256, dtype=np.uint8)
    picture = np.dstack(np.broadcast_arrays(ramp[None, :], ramp[::-1, None], np.uint8(7)))
    image = flat_map.image(save_obj(tmp_path, mesh, picture), 0.06)  # finer than the picture, which is not averaged
    assert (image.is_colour, image.name) == (True, "face.obj")
    raster = flat_map.raster(0.06)
    np.testing.assert_array_equal(image.data[..., 3], np.where(raster.inside, 255, 0))
    places = raster.interpolate(mesh[2][flat_map.ids])[raster.inside]
    np.testing.assert_allclose(image.data[raster.inside][:, :2], np.clip(256 * places - 0.5, 0, 255), atol=0.51)
    assert (image.data[raster.inside][:, 2] == 7).all()


@pytest.mark.medium
@pytest.mark.parametrize("save", [save_obj, save_ply])
def test_seams_of_the_texture_are_kept(mesh, flat_map, tmp_path, save):
    """Every triangle has a patch of its own in the picture, its corners in any order: each pixel has its colour."""
    points, faces, _ = mesh
    rng = np.random.default_rng(5)
    faces = np.stack([np.roll(face, turn) for face, turn in zip(faces, rng.integers(0, 3, len(faces)), strict=True)])
    side = int(np.ceil(np.sqrt(len(faces))))
    colours = rng.integers(0, 256, (side, side, 3), dtype=np.uint8)
    picture = np.kron(colours, np.ones((32, 32, 1))).astype(np.uint8)
    row, column = np.divmod(rng.permutation(len(faces)), side)
    corner = np.array([[0.3, 0.3], [0.7, 0.3], [0.3, 0.7]])
    corners = (np.column_stack([column, side - 1 - row])[:, None] + corner) / side
    shuffled = rng.permutation(len(faces))
    path = save(tmp_path, (points, faces[shuffled], None), picture, corners[shuffled])
    assert not any("seam" in warning for warning in voxflat.surface(path).warnings)
    image = flat_map.image(path, 0.25)
    at = faces_at(flat_map, image)
    assert (at >= 0).sum() > 1000
    number = {tuple(sorted(face)): k for k, face in enumerate(faces.tolist())}
    own = np.array([number[tuple(sorted(face))] for face in flat_map.ids[flat_map.faces].tolist()])
    np.testing.assert_array_equal(image.data[at >= 0][:, :3], colours[row, column][own[at[at >= 0]]])
    assert (image.data[at == -1][:, 3] == 0).all()


@pytest.mark.medium
@pytest.mark.parametrize("is_there", [True, False])
def test_triangles_without_texture_are_transparent(mesh, flat_map, tmp_path, is_there):
    path = save_obj(tmp_path, mesh, chessboard())
    text = path.read_text()
    first = f"f {' '.join(f'{v}/{v}' for v in mesh[1][0] + 1)}\n"
    assert first in text
    path.write_text(text.replace(first, f"f {' '.join(map(str, mesh[1][0] + 1))}\n" if is_there else ""))
    image = flat_map.image(path, 0.2)
    at = faces_at(flat_map, image)
    (bare,) = np.flatnonzero((np.sort(flat_map.ids[flat_map.faces], axis=1) == np.sort(mesh[1][0])).all(axis=1))
    assert (at == bare).sum() > 3
    assert (image.data[at == bare][:, 3] == 0).all()
    assert (image.data[(at >= 0) & (at != bare)][:, 3] == 255).all()


def test_a_surface_flattens_and_shows_its_own_texture(tmp_path, mesh):
    """The squares of a chessboard on a cylinder are squares of the same size on its map (figure 4)."""
    points, faces, _ = mesh
    arc = np.column_stack([10 * np.arctan2(points[:, 1], points[:, 0]), points[:, 2]]) / 20
    path = save_obj(tmp_path, (points, faces, arc), chessboard(10, 16))  # squares of 2 mm
    flat_map = voxflat.flatten(path, Voxflat(sources=200))
    image = flat_map.image(path, 0.1)
    white, seen = image.data[..., 0] > 127, image.data[..., 3] > 0
    assert abs(white[seen].mean() - 0.5) < 0.02
    # runs of one colour along the map's longer axis are as long as a square, 20 pixels
    lines = white if np.ptp(flat_map.uv, axis=0).argmax() == 0 else white.T
    changes = np.diff(np.flatnonzero(np.diff(lines[lines.shape[0] // 2 + 5].astype(int))))
    assert np.abs(changes - 20).max() <= 2


def test_colours_at_the_vertices(mesh, flat_map, tmp_path):
    points, faces, _ = mesh
    colours = np.random.default_rng(2).integers(0, 256, (len(points), 3), dtype=np.uint8)
    image = flat_map.image(colours, 0.5)
    raster = flat_map.raster(0.5)
    expected = raster.interpolate(colours[flat_map.ids].astype(float))[raster.inside]
    np.testing.assert_allclose(image.data[raster.inside][:, :3], expected, atol=0.51)
    np.testing.assert_array_equal(image.data[..., 3], np.where(raster.inside, 255, 0))
    polydata = pv.PolyData.from_regular_faces(points, faces)
    polydata.point_data["RGB"] = colours
    polydata.save(tmp_path / "face.vtp")
    polydata.save(tmp_path / "face.ply", texture="RGB")
    for name in ("face.vtp", "face.ply"):
        np.testing.assert_array_equal(flat_map.image(tmp_path / name, 0.5).data, image.data)
    see_through = np.column_stack([colours, np.full(len(colours), 99, dtype=np.uint8)])
    assert (flat_map.image(see_through, 0.5).data[raster.inside][:, 3] == 99).all()


@pytest.mark.parametrize("name", ["face.vtp", "face.ply", "named.ply"])
def test_a_picture_beside(mesh, flat_map, tmp_path, name):
    """One of the same name, or the one that a PLY file names."""
    points, faces, coordinates = mesh
    path, skin = tmp_path / name, "skin.png" if name == "named.ply" else "face.png"
    write_mesh(path, Mesh(points, faces, texture_coordinates=coordinates))
    refused(f"{name}: has no texture .texture coordinates with a picture", flat_map.image, path)
    if name == "named.ply":
        path.write_bytes(path.read_bytes().replace(b"comment voxflat", b"comment TextureFile skin.png"))
    Image.fromarray(chessboard()).save(tmp_path / skin)
    expected = flat_map.image(save_obj(tmp_path, mesh, chessboard()), 0.25).data
    np.testing.assert_array_equal(flat_map.image(path, 0.25).data, expected)


def test_a_finer_picture_than_pixels_is_averaged(mesh, flat_map, tmp_path):
    fine = chessboard(2048, 1)  # some hundred texels a pixel
    pixels = flat_map.image(save_obj(tmp_path, mesh, fine), 1.0).data
    assert np.abs(pixels[pixels[..., 3] > 0][:, 0] - 127.5).max() < 8


def test_what_textured_writes_shows_the_picture_again(flat_map, mesh, tmp_path):
    """The picture on the surface, seen on the map, is the picture."""
    picture = np.zeros((96, 96, 3), dtype=np.uint8)
    picture[..., 0], picture[..., 1] = np.mgrid[:96, :96] * 2
    textured = flat_map.textured(picture, texel_size=0.25)
    assert len(flat_map) == len(mesh[0])
    places = textured.texture_coordinates[np.argsort(flat_map.ids)]
    image = flat_map.image(save_obj(tmp_path, (*mesh[:2], places), picture), 0.25)
    seen = image.data[..., 3] > 0
    # the map's pixels lie on multiples of their size, the picture's about its middle: so by less than a texel
    rows, columns = np.argwhere(seen).T
    for channel, axis in enumerate((rows, columns)):
        assert np.ptp(image.data[seen][:, channel] / 2 - axis) <= 0.51 + 0.02


@pytest.mark.parametrize("reach", [3, 1.19])
def test_a_picture_goes_on_beyond_its_borders(mesh, flat_map, tmp_path, reach):
    points, faces, coordinates = mesh
    picture = np.random.default_rng(3).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    (tmp_path / "tiled").mkdir()
    repeated = flat_map.image(save_obj(tmp_path, (points, faces, reach * coordinates), picture), 0.1)
    of_tiles = (points, faces, reach / 3 * coordinates)
    tiled = flat_map.image(save_obj(tmp_path / "tiled", of_tiles, np.tile(picture, (3, 3, 1))), 0.1)
    np.testing.assert_allclose(repeated.data.astype(int)[12:-12, 12:-12], tiled.data[12:-12, 12:-12], atol=1)


def test_the_command_writes_it(mesh, flat_map, tmp_path):
    flat_map.save(tmp_path / "map.npz")
    path, out = save_obj(tmp_path, mesh, chessboard()), tmp_path / "flat.png"
    succeed("image", tmp_path / "map.npz", "--volume", path, "--pixel-size", 0.25, "-o", out)
    np.testing.assert_array_equal(np.asarray(Image.open(out)), flat_map.image(path, 0.25).data)


class TestRefusals:
    def test_materials(self, mesh, flat_map, tmp_path):
        for map_kd, told in (
            ("Kd 1 1 1", "face.obj: has no texture. Add texture coordinates"),
            ("map_Kd a.png\nnewmtl skin2\nKd 1 1 1", "its material 'skin2' has no picture, but others do. Bake all"),
            ("map_Kd a.png\nnewmtl skin2\nmap_Kd b.png", r"has 2 pictures \(a.png, b.png\). Bake them into one"),
        ):
            path = save_obj(tmp_path, mesh, chessboard(), map_kd=map_kd)
            path.write_text(path.read_text() + "usemtl skin2\n")
            refused(told, flat_map.image, path)

    @pytest.mark.parametrize("options", [{"depth": 1.0}, {"interpolation": "nearest"}, {"period": 360}])
    def test_options_of_volumes(self, mesh, flat_map, tmp_path, options):
        told = "depth, fraction, interpolation and period do not apply to textures"
        refused(told, flat_map.image, save_obj(tmp_path, mesh, chessboard()), **options)

    @pytest.mark.parametrize("name", ["picture.png", "picture.mtl"])
    def test_missing_files(self, mesh, flat_map, tmp_path, name):
        path = save_obj(tmp_path, mesh, chessboard())
        (tmp_path / name).unlink()
        with pytest.raises(FileNotFoundError, match=name):
            flat_map.image(path)

    def test_another_surface(self, mesh, flat_map, tmp_path):
        points, faces, coordinates = mesh
        fewer = faces[(faces < len(points) - 1).all(axis=1)]
        path = save_obj(tmp_path, (points[:-1], fewer, coordinates), chessboard())
        refused("has 272 vertices, but the flattened mesh has 273. Pass the same mesh", flat_map.image, path)

    def test_several_colours(self, mesh, flat_map, tmp_path):
        polydata = pv.PolyData.from_regular_faces(*mesh[:2])
        for name in ("day", "night"):
            polydata.point_data[name] = np.zeros((len(mesh[0]), 3), dtype=np.uint8)
        polydata.save(tmp_path / "face.vtp")
        told = r"several colour arrays at its vertices \(day, night\). Pass one as an array"
        refused(told, flat_map.image, tmp_path / "face.vtp")

    def test_options_of_the_material_come_before_the_name(self, mesh, flat_map, tmp_path):
        plain = flat_map.image(save_obj(tmp_path, mesh, chessboard()))
        path = save_obj(tmp_path, mesh, chessboard(), map_kd="map_Kd -clamp on picture.png")
        np.testing.assert_array_equal(flat_map.image(path).data, plain.data)


def test_a_picture_is_averaged_over_the_texels_of_a_pixel():
    picture = np.random.default_rng(0).integers(0, 256, (12, 18, 3), dtype=np.uint8)
    u, v = np.meshgrid(np.arange(6) * 3 / 18, np.arange(4) * 3 / 12)  # pixels are 3 texels apart
    reduced = _reduced(picture, np.stack([u, v], axis=-1))
    np.testing.assert_allclose(reduced, picture.reshape(4, 3, 6, 3, 3).mean(axis=(1, 3)), atol=1)  # rounded twice
