"""Downloads that resume, are checked, and appear whole or not at all: the MERL database, and scenes' assets."""

import hashlib
import os
import re
import shutil
import tarfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import requests
from requests.adapters import HTTPAdapter
from urllib3.util import Retry

from brdfatlas.constants import NAME
from brdfatlas.files import atomic_path, read_json, write_json, write_text
from brdfatlas.formats.merl import FILE_BYTES, check_header
from brdfatlas.formats.rgl import check as check_rgl
from brdfatlas.measured import MeasuredError

CHUNK = 1 << 20
#: Tells a person a line.
Say = Callable[[str], None]
#: Statuses that may pass by themselves; every other fault of the server is final.
PASSING = (408, 425, 429, 500, 502, 503, 504)
#: A library's fault -> a person's words; the first that fits.
REASONS = (
    (requests.exceptions.Timeout, "no answer in time; is this machine online?"),
    (requests.exceptions.SSLError, "the server's certificate is not accepted"),
    (requests.exceptions.ProxyError, "the proxy cannot be reached; check HTTPS_PROXY"),
    (requests.exceptions.ConnectionError, "no connection; is this machine online?"),
    (requests.exceptions.RequestException, "not a usable address"),
)

MERL_TERMS = """\
MERL BRDF database: reflectance functions of 100 materials, (c) Mitsubishi Electric Research Laboratories (MERL).
Two statements of its terms are public, and they differ:
  - the archive on Zenodo (record 8101681) is published under CC-BY-SA-4.0;
  - the database's home (https://cdfg.csail.mit.edu/wojciech/brdfdatabase, https://www.merl.com/brdf/) gives it for
    research or academic use.
Which of them covers your use is for you to decide. Whoever publishes results of it cites:
  Wojciech Matusik, Hanspeter Pfister, Matt Brand and Leonard McMillan. A Data-Driven Reflectance Model.
  ACM Transactions on Graphics 22, 3 (2003), 759-769.
"""

RGL_TERMS = """\
RGL material database (https://rgl.epfl.ch/materials), EPFL: its home says how it may be used. Whoever publishes results
of it cites:
  Jonathan Dupuy and Wenzel Jakob. An Adaptive Parameterization for Efficient Material Acquisition and Rendering.
  ACM Transactions on Graphics 37, 6 (2018), 274:1-274:14.
"""


class DownloadError(ValueError):
    """What could not be downloaded or unpacked; one line that names the address or file, the fault and the remedy."""


@dataclass(frozen=True)
class Remote:
    """A file of the web. ``size`` in bytes and ``checksum`` ("md5:..." or "sha256:...") are checked if given."""

    url: str
    size: int | None = None
    checksum: str | None = None


def checksum_of(path: str | os.PathLike, algorithm: str = "sha256") -> str:
    """ "algorithm:hexdigest" of a file."""
    with open(path, "rb") as handle:
        return f"{algorithm}:{hashlib.file_digest(handle, algorithm).hexdigest()}"


def download(
    remote: Remote,
    path: str | os.PathLike,
    *,
    say: Say,
    attempts: int = 8,
    timeout: float = 30.0,
    pause: float = 2.0,
) -> None:
    """Fetch ``remote`` into ``path``; what came of an earlier try is continued where the server allows it.

    Until size and checksum are right the bytes are in ``path`` + ".part". Answers that fail are asked for again, and
    bodies that break off continued, up to ``attempts`` times in a row without progress, ``pause`` seconds apart.
    ``say`` tells a person how it goes. Raises DownloadError.
    """
    path = Path(path)
    part = path.with_name(path.name + ".part")
    retry = Retry(attempts - 1, connect=2, backoff_factor=pause, status_forcelist=PASSING, raise_on_status=False)
    with _writing(path), requests.Session() as session:
        for scheme in ("http://", "https://"):
            session.mount(scheme, HTTPAdapter(max_retries=retry))
        path.parent.mkdir(parents=True, exist_ok=True)
        left, most, old = attempts, _size(part), part.exists()
        while left:
            fault = _fetch(session, remote, part, timeout, say)
            if not fault:
                fault = _wrong(remote, part)
                if not fault:
                    os.replace(part, path)
                    _forget(part)
                    return
                _forget(part)
                if not old:
                    raise DownloadError(f"{remote.url}: {fault}; nothing of it is kept")
                old = False  # bytes of an earlier try may be the culprits: once more, from the first byte
            elif _size(part) > most:  # only what is new is progress: a server may begin again and again
                left, most, old = attempts, _size(part), True
            else:
                left -= 1
            say(f"{remote.url}: {fault}; trying again")
            time.sleep(pause)
    raise DownloadError(f"{remote.url}: {fault}{_kept(part)}")


def _fetch(session: requests.Session, remote: Remote, part: Path, timeout: float, say: Say) -> str:
    """One request, whose body is appended to ``part``. Returns why the body is not whole, "" if it is."""
    start, mark = _size(part), _mark(part, remote.url)
    if start and (not mark or start > (remote.size or start)):
        _forget(part)
        start = 0
    if start and start == remote.size:
        return ""
    # identity: a compressing proxy would make sizes and ranges meaningless.
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={start}-", "If-Range": mark} if start else {})
    try:
        response = session.get(remote.url, headers=headers, stream=True, timeout=timeout)
    except requests.RequestException as error:
        reason = next(words for kind, words in REASONS if isinstance(error, kind))
        raise DownloadError(f"{remote.url}: {reason}{_kept(part)}") from None
    with response:
        status, total = response.status_code, response.headers.get("Content-Length", "")
        if status == 206:
            span = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
            total = span[2] if span and int(span[1]) == start else None
        if status == 416 or total is None:
            _forget(part)
            return "the server does not continue where it was asked to, starting afresh"
        if status not in (200, 206):
            remedy = f"try again later{_kept(part)}" if status in PASSING else "check the address"
            raise DownloadError(f"{remote.url}: the server answers {status} {response.reason}; {remedy}")
        start = start if status == 206 else 0
        expected = int(total) if total.isdigit() else remote.size
        if remote.size not in (None, expected):
            _forget(part)
            offered = f"{expected:,} bytes offered, {remote.size:,} expected"
            raise DownloadError(f"{remote.url}: {offered}; check the address")
        needed, free = (expected or 0) - start, shutil.disk_usage(part.parent).free
        if needed > free:
            places = f"needs {needed / 1e9:.2f} GB in {part.parent}, where {free / 1e9:.2f} GB are free"
            raise DownloadError(f"{remote.url}: {places}")
        with open(part, "ab" if start else "wb") as handle:
            etag = response.headers.get("ETag", "W/")  # a weak one does not tell bytes apart
            mark = response.headers.get("Last-Modified", "") if etag.startswith("W/") else etag
            write_text(_notes(part), f"{remote.url} {mark}")
            response.raw.enforce_content_length = False  # else the last bytes before a cut are thrown away
            done, shown, of = start, time.monotonic(), f" of {expected / 1e6:,.0f}" if expected else ""
            with suppress(requests.RequestException):  # what of a cut body has come is counted below
                for chunk in response.iter_content(CHUNK):
                    done += handle.write(chunk)
                    if expected is not None and done > expected:
                        _forget(part)
                        raise DownloadError(f"{remote.url}: more than the {expected:,} bytes expected")
                    if time.monotonic() - shown > 10.0:
                        shown = time.monotonic()
                        say(f"{remote.url}: {done / 1e6:,.0f} MB{of}")
                return "" if expected in (None, done) else f"connection closed after {done:,} of {expected:,} bytes"
    return "connection cut"


def _notes(part: Path) -> Path:
    """Beside the bytes of an unfinished download: the address and the server's mark of the version that they are of."""
    return part.with_name(part.name + ".txt")


def _mark(part: Path, url: str) -> str:
    """The mark of the version that the bytes are of; "" if they cannot be continued from this address."""
    address, _, mark = (
        _notes(part).read_text(errors="replace").partition(" ") if _notes(part).exists() else ("", "", "")
    )
    return mark if address == url else ""


def _size(part: Path) -> int:
    return part.stat().st_size if part.exists() else 0


def _forget(part: Path) -> None:
    part.unlink(missing_ok=True)
    _notes(part).unlink(missing_ok=True)


def _kept(part: Path) -> str:
    return f"; {_size(part):,} bytes are kept and the next try continues them" if _size(part) else ""


def _wrong(remote: Remote, path: Path) -> str:
    """What is wrong with a complete download, or ""."""
    if remote.size not in (None, path.stat().st_size):
        return f"{path.stat().st_size:,} bytes instead of {remote.size:,}"
    algorithm, _, digest = (remote.checksum or "").partition(":")
    if algorithm and checksum_of(path, algorithm) != remote.checksum:
        return f"wrong checksum, {algorithm} is not {digest}"
    return ""


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Faults of the disk as one line."""
    try:
        yield
    except OSError as error:
        raise DownloadError(f"{path}: cannot be written ({error.strerror or error})") from None


# MERL ---------------------------------------------------------------------------------------------------------------


def material_of(member: str) -> str | None:
    """The material that a member of the archive holds; None for anything else.

    Only the last part of the member's path is used, so that no member can leave the folder it is unpacked into.
    """
    path = PurePosixPath(member.replace("\\", "/"))
    return path.stem if path.suffix == ".binary" and NAME.match(path.stem) else None


def unpack_merl(archive: str | os.PathLike, folder: str | os.PathLike, say: Say) -> list[dict[str, str]]:
    """Unpack the .binary files of a MERL archive into ``folder``; returns [{"name", "crc32"}] by name.

    All are first unpacked and checked in a hidden folder beside them: a run never sees half of the database. What is
    there from an earlier try is used again if it is right. A file of the same name and other contents is never
    replaced. Raises DownloadError.
    """
    archive, folder = Path(archive), Path(folder)
    staging = folder / ".incoming"
    with _writing(folder):
        staging.mkdir(parents=True, exist_ok=True)
        try:
            with zipfile.ZipFile(archive) as zipped:
                members = _members(zipped)
                say(f"{archive.name}: unpacking {len(members)} materials")
                for name, info in members.items():
                    _unpack_member(zipped, info, staging / f"{name}.binary", folder / f"{name}.binary")
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError) as error:
            raise DownloadError(f"{archive}: cannot be unpacked ({error}); delete it and try again") from None
        for name in members:
            if (staging / f"{name}.binary").exists():
                os.replace(staging / f"{name}.binary", folder / f"{name}.binary")
        shutil.rmtree(staging)
    return [{"name": name, "crc32": f"{info.CRC:08x}"} for name, info in members.items()]


def _members(zipped: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    for info in zipped.infolist():
        name = material_of(info.filename)
        if name is None:
            continue
        if info.file_size != FILE_BYTES:
            size = f"{info.file_size:,} bytes, a MERL file {FILE_BYTES:,}"
            raise DownloadError(f"{zipped.filename}: {name}.binary has {size}")
        members[name] = info
    if not members:
        raise DownloadError(f"{zipped.filename}: holds no .binary file; is it the MERL database?")
    return dict(sorted(members.items()))


def _unpack_member(zipped: zipfile.ZipFile, info: zipfile.ZipInfo, staged: Path, final: Path) -> None:
    for path in (staged, final):
        if path.exists() and zlib.crc32(path.read_bytes()) == info.CRC:
            return
    if final.exists():
        raise DownloadError(f"{final}: there already, with other contents; move it away and try again")
    with atomic_path(staged) as temporary, zipped.open(info) as source:
        with open(temporary, "wb") as target:
            shutil.copyfileobj(source, target, CHUNK)  # the last read checks the CRC
        try:
            check_header(temporary)
        except MeasuredError as error:
            fault = str(error).partition(": ")[2]
            raise DownloadError(f"{zipped.filename}: {info.filename}: {fault}") from None


def fetch_merl(
    remote: Remote, folder: str | os.PathLike, record: str | os.PathLike, *, say: Say, **options: Any
) -> None:
    """The database from its public home into ``folder``: downloaded, checked, unpacked, its terms shown and recorded.

    ``record`` (JSON) is written last: where it exists the database is complete. ``options`` as of :func:`download`.
    Raises DownloadError.
    """
    folder = Path(folder)
    say(MERL_TERMS)
    archive = folder / "BRDFDatabase.zip"
    if not archive.exists() or _wrong(remote, archive):
        download(remote, archive, say=say, **options)
    materials = unpack_merl(archive, folder, say)
    with _writing(folder):
        write_text(folder / "TERMS.txt", MERL_TERMS)
        write_json(record, {"url": remote.url, "checksum": checksum_of(archive, "md5"), "materials": materials})
        archive.unlink()
    say(f"{folder}: {len(materials)} materials")


# RGL ----------------------------------------------------------------------------------------------------------------


def fetch_rgl(materials: Mapping[str, str], folder: str | os.PathLike, *, say: Say, **options: Any) -> list[str]:
    """Isotropic materials of the RGL database, name -> address, into ``folder``: each is checked by its content before
    it appears there. Files that are there stay as they are. Returns the names that were fetched. ``options`` as of
    :func:`download`. Raises DownloadError.
    """
    folder = Path(folder)
    say(RGL_TERMS)
    paths = {name: folder / f"{name}_rgb.bsdf" for name in materials}
    missing = [name for name, path in paths.items() if not path.exists()]
    for name in missing:
        arriving = folder / ".incoming" / paths[name].name
        download(Remote(materials[name]), arriving, say=say, **options)
        try:
            check_rgl(arriving)
        except MeasuredError as error:
            arriving.unlink()
            raise DownloadError(f"{materials[name]}: {str(error).partition(': ')[2]}; nothing of it is kept") from None
        with _writing(paths[name]):
            os.replace(arriving, paths[name])
    with suppress(OSError):
        (folder / ".incoming").rmdir()
    say(f"{folder}: {len(materials)} materials of the RGL database, {len(missing)} of them new")
    return missing


# Assets of scenes ---------------------------------------------------------------------------------------------------


def fetch_asset(
    path: str | os.PathLike, remote: Remote, record: str | os.PathLike, member: str | None = None, **options: Any
) -> None:
    """A file that a scene needs, from its public home into ``path``.

    Where nobody publishes a checksum, the SHA-256 of the first download is kept in ``record`` (JSON, by address), and
    a later download that differs is refused. ``member``: the file to take out of a .tar.gz at the address. Raises
    DownloadError.
    """
    path, record = Path(path), Path(record)
    known = read_json(record) if record.exists() else {}
    expected = Remote(remote.url, remote.size, remote.checksum or known.get(remote.url))
    target = path.with_name(path.name + ".tar.gz") if member else path
    try:
        download(expected, target, **options)
    except DownloadError as error:
        first = "checksum" in str(error) and not remote.checksum
        hint = f" ({record} has its checksum from the first download)" if first else ""
        raise DownloadError(f"{error}{hint}") from None
    if remote.url not in known:
        write_json(record, known | {remote.url: checksum_of(target)})
    if member:
        _extract(target, member, path)
        target.unlink()


def _extract(archive: Path, member: str, path: Path) -> None:
    """One regular file of a .tar.gz, under a name of our choosing."""
    try:
        with tarfile.open(archive) as packed:
            source = packed.extractfile(member)
            if source is None:
                raise KeyError(member)
            with atomic_path(path) as temporary, open(temporary, "wb") as target:
                shutil.copyfileobj(source, target, CHUNK)
    except KeyError:
        raise DownloadError(f"{archive}: has no file {member}") from None
    except (tarfile.TarError, EOFError, zlib.error) as error:
        raise DownloadError(f"{archive}: cannot be unpacked ({error})") from None


def remote_of(source: Mapping[str, Any]) -> Remote:
    """A Remote from its entry in a configuration file, where 0 and "" stand for unknown."""
    return Remote(source["url"], source["size"] or None, source["checksum"] or None)


def fetch_assets(assets: Mapping[str, Mapping[str, Any]], folder: str, say: Say) -> None:
    """Fetch what is not in ``folder`` yet; what is there stays as it is, whoever put it there. Raises DownloadError."""
    for name, source in assets.items():
        path = Path(folder) / name
        if path.exists():
            say(f"{path}: there already")
            continue
        say(f"{path}: {source['terms']}")
        record = path.parent / "checksums" / f"{name}.json"
        fetch_asset(path, remote_of(source), record, source["member"] or None, say=say)
