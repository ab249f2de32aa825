"""Volumes in chunks, larger than memory: the same values, each chunk that the surface meets read once, and no other."""

import json
import tracemalloc
from collections import Counter

import nibabel as nib
import numpy as np
import pytest
from command_line import succeed
from mesh_files import icosphere, patch
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

import voxflat
from voxflat.io import Volume
from voxflat.io.chunks import PLACE_BYTES, Chunked, chunked_of, is_chunked, voxels_at
from voxflat.methods import Voxflat

SHAPE, CHUNKS = (61, 60, 59), (16, 13, 20)
GRID = np.array([[0.5, 0, 0, -15], [0, 0.5, 0, -15], [0, 0, 0.5, -14], [0, 0, 0, 1.0]])


class Counting:
    """An array of which every chunk that is read is counted; a box across chunks is refused."""

    def __init__(self, data, chunks):
        self.data, self.shape, self.dtype, self.chunks, self.read = data, data.shape, data.dtype, chunks, Counter()

    def __getitem__(self, key):
        at = []
        for item, size, length in zip(key, self.chunks, self.shape, strict=True):
            first, last = (item, item + 1) if isinstance(item, int) else (item.start, item.stop)
            assert first // size == (last - 1) // size
            assert isinstance(item, int) or (first % size == 0 and last in (first + size, length))
            at.append(first // size)
        self.read[tuple(at)] += 1
        return self.data[key]


class Endless:
    """An array whose values are their indices along i, of as many voxels as one likes."""

    dtype = np.dtype(np.int64)

    def __init__(self, shape, chunks):
        self.shape, self.chunks = shape, chunks

    def __getitem__(self, key):
        return np.broadcast_to(np.arange(key[0].start, key[0].stop)[:, None, None], [at.stop - at.start for at in key])


@pytest.fixture(scope="module")
def m():
    return voxflat.surface(icosphere(10, 3), pial=icosphere(12, 3)).disk(0, 7.0).flatten(Voxflat(sources=30))


@pytest.fixture(scope="module")
def values():
    return np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)


@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
@pytest.mark.parametrize("how", [{"fraction": 0.4}, {"depth": (-1.0, 0.0, 1.0)}, {"fraction": (0.1, 0.5, 1.0)}])
def test_the_same_values_by_reading_each_chunk_once(m, values, how, interpolation):
    counting = Counting(values, CHUNKS)
    shown = m.images(Volume(counting, GRID), 0.4, interpolation=interpolation, **how)
    expected = m.images(Volume(values, GRID), 0.4, interpolation=interpolation, **how)
    assert_allclose(shown.data, expected.data, rtol=1e-6, atol=1e-6)
    assert set(counting.read.values()) == {1}
    assert 1 < len(counting.read) < 60 / 2  # of 4 * 5 * 3 chunks the surface meets some


@pytest.mark.parametrize("kind", [np.int16, np.float32])
@pytest.mark.parametrize("how", [{}, {"fraction": (0.1, 0.5, 1.0)}, {"interpolation": "nearest"}])
def test_phases_in_chunks_are_those_in_memory(m, how, kind):
    i, j, _ = np.indices(SHAPE)
    values = ((24 * i + 9 * j) % 360 - 180).astype(kind)  # begins again within the map
    counting = Counting(values, CHUNKS)
    shown = m.images(Volume(counting, GRID), 0.4, period=360, **how).data
    assert_allclose(shown, m.images(Volume(values, GRID), 0.4, period=360, **how).data, atol=1e-4)
    assert np.ptp(shown[np.isfinite(shown)]) > 300  # the seam is among them
    assert set(counting.read.values()) == {1 if "interpolation" in how else 2}


def test_only_chunks_that_the_surface_touches_are_read(m, values):
    """By an oracle of its own: the chunks of the eight voxels around every place."""
    counting = Counting(values, CHUNKS)
    m.image(Volume(counting, GRID), 0.4, fraction=0.5)
    (places,) = m._triangles.on_surface.in_scanner(m.raster(0.4), voxflat.maps.depth.Depths.of(fraction=0.5))
    at = np.floor(nib.affines.apply_affine(np.linalg.inv(GRID), places[m.raster(0.4).inside])).astype(int)
    touched = {tuple(corner // CHUNKS) for offset in np.ndindex(2, 2, 2) for corner in at + offset}
    assert set(counting.read) == touched


def test_labels_and_means(m, values):
    labels, majority = (values > 0).astype(np.uint8) * 5, {"interpolation": "majority"}
    depths = (0.3, majority), ((0.3, 0.6), majority), ((0.2, 0.8), {})
    for fraction, by in depths:
        data, how = labels if by else values, {"fraction": fraction, **by}
        counting = Counting(data, CHUNKS)
        shown = m.image(Volume(counting, GRID), 0.4, **how).data
        assert_allclose(shown, m.image(Volume(data, GRID), 0.4, **how).data, atol=0 if data is labels else 1e-6)
        assert set(counting.read.values()) == {1}


@pytest.mark.slow
def test_memory_stays_below_the_bound(m):
    """The array would take 64 GB, a chunk 8 MiB; 140,000 places. A block of places' weights takes 20 MiB more."""
    data = Endless((4000, 2000, 1000), (128, 128, 64))
    affine = nib.affines.from_matvec(np.diag([0.007, 0.015, 0.028]), [-14, -14, -14])
    raster = m.raster(0.05)
    stack = m.images(Volume(data, affine), 0.05, fraction=(0.2, 0.8), interpolation="linear")
    places = 2 * raster.corners[..., 0].size
    tracemalloc.start()
    shown = stack.data
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.isfinite(shown).sum() > 20000
    assert peak < PLACE_BYTES * places + 32 * 2**20


def test_dask(m, values):
    dask = pytest.importorskip("dask.array")
    array = dask.from_array(values, chunks=((20, 20, 21), (30, 30), (59,)))
    shown = m.image(Volume(array, GRID), 0.4, fraction=0.5).data
    assert_allclose(shown, m.image(Volume(values, GRID), 0.4, fraction=0.5).data, atol=1e-6)
    colours = dask.stack([array, -array], axis=-1)  # (I, J, K, C): channels
    refused(r"this map.*no volume's shape|map of a mesh", m.images, colours, 0.4)
    stack = m.images(Volume(colours, GRID), 0.4, fraction=(0.2, 0.5))
    assert stack.data.shape[:2] == (2, 2)
    assert_allclose(stack.data[1], -stack.data[0])


def test_a_bare_array_lies_where_the_flattened_volume_lies(values):
    dask = pytest.importorskip("dask.array")
    i, j, k = np.indices((24, 24, 24)) - 11.5
    solid = Volume((i**2 + j**2 + k**2 < 81).astype(np.uint8), np.diag([2.0, 2, 2, 1]))
    flat = voxflat.surface(solid).disk((11, 11, 20), 12.0).flatten(Voxflat(sources=20))
    array = values[:24, :24, :24]
    assert_allclose(flat.image(dask.from_array(array, chunks=10), 1.0).data, flat.image(array, 1.0).data, atol=1e-6)
    refused("Pass a volume of that shape, or one with an affine", flat.image, dask.from_array(values, chunks=10), 1.0)


def ome(path, values, version=0.4, **changes):
    """Write an OME-Zarr of axes c, z, y, x in µm, two channels, two resolutions, as its specification has it."""
    zarr = pytest.importorskip("zarr", minversion="3")
    czyx = np.stack([values, 2 * values]).transpose(0, 3, 2, 1)
    group = zarr.open_group(str(path), mode="w", zarr_format=2 if version == 0.4 else 3)
    for name, data in (("0", czyx), ("1", czyx[:, ::2, ::2, ::2])):
        group.create_array(name, data=data, chunks=(1, 20, 13, 16))
    spatial = [{"name": axis, "type": "space", "unit": "micrometer"} for axis in "zyx"]
    shift = {"type": "translation", "translation": [0, -14000, -15000, -15000]}
    steps = {path: [{"type": "scale", "scale": [1] + 3 * [size]}, shift] for path, size in (("0", 500), ("1", 1000))}
    sets = [{"path": path, "coordinateTransformations": those} for path, those in steps.items()]
    scales = {"axes": [{"name": "c", "type": "channel"}, *spatial], "datasets": sets, **changes}
    old, new = {"multiscales": [{**scales, "version": "0.4"}]}, {"ome": {"multiscales": [scales]}}
    group.attrs.update(old if version == 0.4 else new)
    return path


SCALES = ([1, 500, np.inf, 500], [1, np.nan, 500, 500], [1, 1e300, 500, 500])
SCALED = [{"path": "0", "coordinateTransformations": 2 * [{"type": "scale", "scale": scale}]} for scale in SCALES]


class TestOmeZarr:
    @pytest.mark.medium
    @pytest.mark.parametrize("version", [0.4, 0.5])
    def test_by_its_path(self, m, values, tmp_path, version):
        path = ome(tmp_path / "v.ome.zarr", values, version)
        expected = m.image(Volume(values, GRID), 0.4, fraction=0.5).data
        stack = m.images(path, 0.4, fraction=0.5)
        assert stack.names == ("c0", "c1")
        assert_allclose(stack[0].data, expected, atol=1e-6)
        assert_allclose(stack["c1"].data, 2 * expected, atol=1e-6)
        coarse = m.image(path / "1", 0.4, channel=0, fraction=0.5).data
        half = Volume(np.ascontiguousarray(values[::2, ::2, ::2]), GRID @ np.diag([2.0, 2, 2, 1]))
        assert_allclose(coarse, m.image(half, 0.4, fraction=0.5).data, atol=1e-6)
        assert list(stack.provenance["files"]) == [str(path / ("zarr.json" if version == 0.5 else ".zattrs"))]

    def test_by_the_command_line(self, m, values, tmp_path):
        m.save(tmp_path / "m.npz")
        path, out = ome(tmp_path / "v.ome.zarr", values), tmp_path / "o.npy"
        command = ["image", tmp_path / "m.npz", "--volume", path, "--channel", "c1", "--fraction", "0.5", "-o", out]
        result = succeed(*command, "--pixel-size", 0.4, "--json")
        assert_allclose(np.load(out), m.image(path, 0.4, channel=1, fraction=0.5).data, rtol=1e-6)
        assert json.loads(result.output)["images"] == 1

    def test_orientation_and_transformations_of_the_whole(self, m, values, tmp_path):
        names = {"z": "superior-to-inferior", "y": "posterior-to-anterior", "x": "left-to-right"}
        ways = {axis: {"type": "anatomical", "value": name} for axis, name in names.items()}
        axes = [{"name": axis, "unit": "millimeter", "orientation": way} for axis, way in ways.items()]
        steps = [{"type": "scale", "scale": [1, 0.001, 0.001, 0.001]}]
        path = ome(tmp_path / "v.zarr", values, axes=[{"name": "c"}, *axes], coordinateTransformations=steps)
        turned = GRID * [[1], [1], [-1], [1]]
        shown = m.image(path, 0.4, channel=0, fraction=0.5).data
        assert_allclose(shown, m.image(Volume(values, turned), 0.4, fraction=0.5).data, atol=1e-6)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"axes": [{"name": n} for n in "ctyx"]}, "and the axes c, t, y, x"),
            ({"axes": [{"name": "c"}, *({"name": n, "unit": "parsec"} for n in "zyx")]}, "with the unit parsec"),
            ({"coordinateTransformations": [{"type": "affine", "affine": []}]}, "has the transformation 'affine'"),
            ({"coordinateTransformations": [{"type": "scale", "scale": [1, 0, 1, 1]}]}, "Use positive numbers"),
            ({"datasets": []}, "has no image"),
            ({"datasets": [{"path": "0"}]}, "does not define its scale"),
            ({"coordinateTransformations": [{"type": "scale", "scale": [1, 1, -1, 1]}]}, "Use positive numbers"),
            ({"coordinateTransformations": [{"type": "scale", "scale": [2]}]}, "one number for each of its 4 axes"),
            ({"coordinateTransformations": [{"type": "scale", "scale": 2}]}, "one number for each of its 4 axes"),
            ({"datasets": [{"path": "../secret"}]}, "outside its directory"),
            ({"datasets": [{"path": "/secret"}]}, "outside its directory"),
            *(({"datasets": [scaled]}, "has scale .*Use finite numbers") for scaled in SCALED),
        ],
    )
    def test_what_cannot_be_placed(self, m, values, tmp_path, changes, message):
        refused(message, m.image, ome(tmp_path / "v.zarr", values, **changes), 0.4, channel=0)

    def test_damaged(self, m, values, tmp_path):
        path = ome(tmp_path / "v.zarr", values)
        (path / ".zattrs").write_text('{"multiscales"')
        refused(r"\.zattrs is damaged", m.image, path, 0.4, channel=0)
        (path / ".zattrs").write_text("{}")
        refused("has no multiscales", m.image, path, 0.4, channel=0)
        refused("is a directory", m.image, tmp_path, 0.4)

    @pytest.mark.parametrize(
        ("axis", "length", "message"),
        [(3, 2**31, "an axis of more than 2147483647 voxels"), (0, 2**31 - 1, "of memory is needed")],
    )
    def test_a_shape_beyond_all_files(self, m, values, tmp_path, axis, length, message):
        """Chunks that are not there are zero, so that a header alone may say so."""
        path = ome(tmp_path / "v.zarr", values)
        header = json.loads((path / "0" / ".zarray").read_text())
        header["shape"][axis] = length
        (path / "0" / ".zarray").write_text(json.dumps(header))
        refused(message, m.image, path, 0.4, channel=0)

    def test_a_chunk_that_is_damaged(self, m, values, tmp_path):
        path = ome(tmp_path / "v.zarr", values)
        images = m.images(path, 0.4)
        for chunk in path.glob("0/[0-9]*"):
            chunk.write_bytes(chunk.read_bytes()[:20])
        refused(r"/v\.zarr: contains a chunk that ends after 20 of \d+ bytes", images.__getitem__, 0)

    @pytest.mark.parametrize("version", [0.4, 0.5])
    def test_chunks_that_are_missing_are_reported(self, m, values, tmp_path, version, caplog):
        """By definition, they have the fill value; none at all, or more than they can hold, is refused."""
        path = ome(tmp_path / "v.zarr", values, version)
        m.image(path, 0.4, channel=0)
        assert not caplog.records
        chunks = sorted(file for file in (path / "0").rglob("*") if file.is_file() and file.name[-1].isdecimal())
        chunks[0].unlink()
        m.image(path, 0.4, channel=1)
        assert f"{path}: 1 of {len(chunks)} chunks ({100 / len(chunks):.2g} %) are not stored" in caplog.text
        for chunk in chunks[1:]:
            chunk.write_bytes(b"")
        refused("has chunks of .*, more than its files can contain", m.image, path, 0.4, channel=0)
        for chunk in chunks[1:]:
            chunk.unlink()
        refused(f"contains none of its {len(chunks)} chunks", m.image, path, 0.4, channel=0)

    def test_chunks_larger_than_their_file_can_be_are_refused(self, m, values, tmp_path):
        """A small file could ask for any amount of memory: the chunks of a header are compared with the files."""
        path = ome(tmp_path / "v.zarr", values)
        header = json.loads((path / "0" / ".zarray").read_text())
        header.update(shape=[2, 1 << 8, 1 << 10, 1 << 10], chunks=[1, 1 << 8, 1 << 10, 1 << 10])
        (path / "0" / ".zarray").write_text(json.dumps(header))
        for chunk in path.glob("0/[0-9]*"):
            chunk.unlink()
        (path / "0" / "0.0.0.0").write_bytes(bytes(4096))
        refused("has chunks of 1.00 GiB, more than its files can contain", m.image, path, 0.4, channel=0)

    @pytest.mark.parametrize("compressor", ["blosc", "zstd", "bz2"])
    def test_chunks_that_compress_well_are_read(self, tmp_path, compressor):
        """The strongest compressors, and shards of which only one chunk is stored."""
        codecs = pytest.importorskip("numcodecs")
        zarr = pytest.importorskip("zarr", minversion="3")
        chosen = {"blosc": codecs.Blosc("zstd", 9), "zstd": codecs.Zstd(22), "bz2": codecs.BZ2(9)}[compressor]
        path = ome(tmp_path / "v.zarr", np.zeros((4, 4, 4), np.float32))
        group, shape = zarr.open_group(str(path)), (2, 192, 192, 192)
        group.create_array("0", shape=shape, dtype="u1", chunks=(1, 192, 192, 192), compressors=chosen, overwrite=True)
        group["0"][:] = 7
        assert (chunked_of(path)[0].read(1).whole() == 7).all()

    def test_chunks_of_shards(self, tmp_path):
        zarr = pytest.importorskip("zarr", minversion="3")
        path = ome(tmp_path / "v.zarr", np.zeros((4, 4, 4), np.float32), 0.5)
        layout = {"shape": (2, 256, 256, 256), "chunks": (1, 64, 64, 64), "shards": (1, 256, 256, 256), "dtype": "u2"}
        array = zarr.open_group(str(path)).create_array("0", **layout, overwrite=True)
        array[:, :64, :64, :64] = 9
        volume = chunked_of(path)[0].read(1)
        assert (volume.block([(0, 64)] * 3) == 9).all()
        assert not volume.block([(64, 128)] * 3).any()

    @pytest.mark.parametrize("at", [4, 8])  # bytes of Blosc's header: sizes unpacked and of a block
    def test_a_chunk_that_would_end_the_process(self, m, values, tmp_path, at):
        """C unpacks it: in another process, which happens to be ended or refuses."""
        path = ome(tmp_path / "v.zarr", values)
        for chunk in path.glob("0/[0-9]*"):
            patch(chunk, {at: b"\xf0\xff\xff\x7f"})
        refused(r"/v\.zarr: ", m.image, path, 0.4, channel=0)


def test_what_is_no_volume():
    assert not is_chunked(np.zeros(3))
    assert chunked_of(np.zeros((3, 3, 3))) is None
    for data, chunks, told in (
        (np.zeros((3, 3)), (2, 2), "has shape"),
        (np.zeros((3, 3, 3), complex), (2, 2, 2), "complex"),
        (np.zeros((3, 3, 3)), (2, 0, 2), "is empty"),
        (np.zeros((3, 0, 3)), (2, 2, 2), "is empty"),
    ):
        refused(told, chunked_of, Counting(data, chunks))
    refused("has .* chunks, more than a 64-bit integer can", chunked_of, Endless((2**31 - 1,) * 3, (1, 1, 1)))


def test_chunks_that_are_not_read_take_no_memory():
    data = Chunked(Endless((1 << 24, 3, 3), (1, 2, 3)))
    low = np.array([[0, 0, 0], [(1 << 24) - 1, 2, 2], [12345, 1, 1]])
    tracemalloc.start()
    found = voxels_at(data, low, np.array([[0, 0, 0], [1, 1, 1]]))
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    assert_array_equal(found, [[0, 1], [(1 << 24) - 1] * 2, [12345, 12346]])
