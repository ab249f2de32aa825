"""Small microscopy stacks to damage: TIFF, ImageJ, OME-TIFF, OME-Zarr and HDF5 files."""

import json
import uuid

import numpy as np

from voxflat.io import chunks
from voxflat.io.chunks import Chunked, chunked_of, voxels_at
from voxflat.io.files import naming
from voxflat.io.volumes import read_volume

PIXELS = np.random.default_rng(1).integers(1, 200, (2, 5, 6, 8), dtype=np.uint8)  # c, z, y, x; without zeros
_LARGE = chunks._WHOLE
_MOST = 4  # channels that a case reads


def stack(path):
    """Return the channels of a stack, read as a whole and in chunks; the results must agree."""
    found = []
    for limit in (_LARGE, 0):
        chunks._WHOLE = limit
        with naming(path, "copy the file again"):
            channels, affine, unit = chunked_of(path) or (None, None, None)
        if channels is None:
            return [read_volume(path).data]
        for number in range(min(len(channels), _MOST)):
            volume = channels.read(number)
            if isinstance(volume, Chunked):
                volume.dtype, volume.grids  # noqa: B018
                voxels_at(volume, np.array([[0, 0, 0], np.array(volume.shape) - 1]), np.zeros((1, 3), int))
                volume = volume.whole()
            found.append(volume)
        found.append(channels.names)
    chunks._WHOLE = _LARGE
    half = len(found) // 2
    assert all(np.array_equal(one, other) for one, other in zip(found[:half], found[half:], strict=True))
    return [*found[:half], affine, unit]


def entries(entry):
    """Write the stacks with `entry(name, opener, write)`."""
    tiffs = {
        "pages.tif": {"data": PIXELS[0], "compression": "zlib", "metadata": None},
        "plain.tif": {"data": PIXELS[0].astype(np.uint16), "photometric": "minisblack"},
        "shaped.tif": {"data": PIXELS[0].astype(np.float32), "compression": "deflate", "metadata": {"axes": "ZYX"}},
        "tiles.tif": {"data": np.kron(PIXELS[0], np.ones((1, 5, 5), np.uint8)), "tile": (16, 16), "bigtiff": True},
        "imagej.tif": {"data": PIXELS[0], "imagej": True, "resolution": (2, 2), **_placed("spacing", "ZYX")},
        "hyper.tif": {"data": PIXELS.swapaxes(0, 1), "imagej": True, **_placed("spacing", "ZCYX")},
        "c.ome.tif": {"data": PIXELS, "compression": "zlib", **_placed("PhysicalSizeZ", "CZYX")},
        "t.ome.tif": {"data": PIXELS[:, None].astype(np.uint16), **_placed("PhysicalSizeZ", "TCZYX")},
    }
    tiffs["big.ome.tif"] = {**tiffs["c.ome.tif"], "data": PIXELS, "byteorder": ">", "bigtiff": True}
    for name, given in tiffs.items():
        entry(name, "stack", lambda path, given=given: _write_tiff(path, **given))
    entry("two.ome.tif", "stack", _write_two)
    for name, form in {"v2.zarr": 2, "blosc.zarr": 2, "v3.zarr": 3, "shards.zarr": 3}.items():
        entry(name, "stack", lambda path, form=form: write_zarr(path, form))
    entry("chunks.h5", "stack", lambda path: _write_hdf5(path, chunks=(1, 3, 3, 4), compression="gzip"))
    entry("block.hdf5", "stack", _write_hdf5)


def _placed(depth, axes):
    told = {"axes": axes, "unit": "um", depth: 2.0}
    if depth != "spacing":
        told |= {"PhysicalSizeX": 1.0, "PhysicalSizeY": 1.0, "Channel": {"Name": ["red", "green"]}}
    return {"metadata": told if "C" in axes or depth == "spacing" else {**told, "Channel": {"Name": "red"}}}


def _write_tiff(path, data, **options):
    import tifffile

    if path.name.endswith(".ome.tif") and data.ndim == 5:
        options["metadata"] = {**options["metadata"], "Channel": {"Name": ["red"]}}
    tifffile.imwrite(path, data, **options)


def _write_two(path):
    """Write an OME-TIFF image whose second channel is in another file."""
    import tifffile

    names, identities = (path.name, "other.ome.tif"), [f"urn:uuid:{uuid.UUID(int=n)}" for n in (1, 2)]
    planes = "".join(
        f'<TiffData FirstC="{c}" FirstZ="{z}" IFD="{z}" PlaneCount="1"><UUID FileName="{name}">{own}</UUID></TiffData>'
        for c, (name, own) in enumerate(zip(names, identities, strict=True))
        for z in range(5)
    )
    channels = "".join(f'<Channel ID="Channel:0:{n}" SamplesPerPixel="1"/>' for n in range(2))
    pixels = '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="8" SizeY="6" '
    pixels += f'SizeZ="5" SizeC="2" SizeT="1" PhysicalSizeX="1" PhysicalSizeY="1" PhysicalSizeZ="2">{channels}{planes}'
    for name, own, data in zip(names, identities, PIXELS, strict=True):
        text = f'<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="{own}">'
        text = f'<?xml version="1.0" encoding="UTF-8"?>{text}{pixels}</Pixels></Image></OME>'
        tifffile.imwrite(path.with_name(name), data, description=text, metadata=None, photometric="minisblack")


def write_zarr(path, form):
    """Write a two-channel OME-Zarr image in version 2 or 3 of the format, with Blosc or shards if named so."""
    import zarr
    from numcodecs import Blosc

    group = zarr.open_group(path, mode="w", zarr_format=form)
    more = {"shards": {"shards": (1, 4, 6, 8)}, "blosc": {"compressors": Blosc()}}.get(path.stem, {})
    group.create_array("0", data=PIXELS, chunks=(1, 2, 3, 4), **more)
    axes = [{"name": "c", "type": "channel"}]
    axes += [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    sets = [{"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1, 2, 1, 1]}]}]
    scales = [{"version": "0.4" if form == 2 else "0.5", "name": "cells", "axes": axes, "datasets": sets}]
    named = {"channels": [{"label": "red"}, {"label": "green"}]}
    content = {"multiscales": scales, "omero": named}
    group.attrs.update(content if form == 2 else {"ome": {"version": "0.5", **content}})


def _write_hdf5(path, **options):
    import h5py

    with h5py.File(path, "w") as file:
        data = file.create_dataset("exported_data", data=PIXELS, **options)
        data.attrs["axistags"] = json.dumps({"axes": [{"key": axis} for axis in "czyx"]})
