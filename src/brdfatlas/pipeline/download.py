"""Downloads that resume, are checked, and appear whole or not at all: the MERL database, and scenes' assets."""

import hashlib
import os
import shutil
import sys
import tarfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import requests

from brdfatlas.files import atomic_path, read_json, write_json, write_text
from brdfatlas.formats.merl import FILE_BYTES, check_header
from brdfatlas.formats.rgl import check as check_rgl
from brdfatlas.measured import MeasuredError

CHUNK = 1 << 20
#: Statuses that may pass by themselves; every other fault of the server is final.
PASSING = {408, 425, 429, 500, 502, 503, 504}
#: What names of unpacked materials may consist of; the same rule as for every material of a run.
NAME_CHARACTERS = frozenset("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")

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


@dataclass
class _Partial:
    """What is on disk of an unfinished download: bytes in ``path``, and beside it which version they are of."""

    path: Path

    @property
    def notes(self) -> Path:
        return self.path.with_name(self.path.name + ".json")

    @property
    def size(self) -> int:
        return self.path.stat().st_size if self.path.exists() else 0

    def version(self, url: str) -> str | None:
        """The server's mark of the version (ETag or date) if the bytes are of this address; else None."""
        try:
            notes = read_json(self.notes)
        except (OSError, ValueError):
            return None
        return notes.get("version") if notes.get("url") == url else None

    def forget(self) -> None:
        self.path.unlink(missing_ok=True)
        self.notes.unlink(missing_ok=True)


def checksum_of(path: str | os.PathLike, algorithm: str = "sha256") -> str:
    """ "algorithm:hexdigest" of a file."""
    with open(path, "rb") as handle:
        return f"{algorithm}:{hashlib.file_digest(handle, algorithm).hexdigest()}"


def download(
    remote: Remote,
    path: str | os.PathLike,
    *,
    attempts: int = 8,
    timeout: float = 30.0,
    pause: float = 2.0,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Fetch ``remote`` into ``path``; what came of an earlier try is continued where the server allows it.

    Until size and checksum are right the bytes are in ``path`` + ".part". Connections that fail are tried again, up to
    ``attempts`` times in a row without progress, ``pause`` seconds apart and doubling. Raises DownloadError.
    """
    path, say = Path(path), say or _to_stderr
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = _Partial(path.with_name(path.name + ".part"))
    left, waiting, continued, best, fault = attempts, pause, partial.size > 0, partial.size, ""
    while True:
        try:
            with _writing(path):
                expected = _fetch(remote, partial, timeout, say)
            got = partial.size
            if got == expected or expected is None:
                fault = _wrong(remote, partial.path)
                if not fault:
                    with _writing(path):
                        os.replace(partial.path, path)
                        partial.notes.unlink(missing_ok=True)
                    return path
                partial.forget()
                if not continued:
                    raise DownloadError(f"{remote.url}: {fault}; nothing of it is kept")
                # Bytes of an earlier try may be the culprits: once more, from the first byte.
                say(f"{remote.url}: {fault}; starting afresh")
                continued = False
                continue
            fault = f"connection closed after {got:,} of {expected:,} bytes"
        except requests.RequestException as error:
            fault = _reason(error)
            if partial.size == best and isinstance(error, requests.ConnectionError):
                left = min(left, 3)  # nobody there: say so soon
        except _Passing as passing:
            fault = str(passing)
        if partial.size > best:  # only what is new counts as progress: a server may begin again and again
            left, waiting, best = attempts, pause, partial.size
        left -= 1
        if left <= 0:
            kept = f"; {partial.size:,} bytes are kept and the next try continues them" if partial.size else ""
            raise DownloadError(f"{remote.url}: {fault}{kept}")
        continued = continued or partial.size > 0
        say(f"{remote.url}: {fault}; trying again")
        time.sleep(waiting)
        waiting = min(2 * waiting, 60.0)


class _Passing(Exception):
    """A fault that may have passed at the next try."""


def _fetch(remote: Remote, partial: _Partial, timeout: float, say: Callable[[str], None]) -> int | None:
    """One request; appends to the partial file. Returns the size the whole must have, None if nobody knows."""
    version, start = partial.version(remote.url), partial.size
    if start and version is None:
        partial.forget()
        start = 0
    if remote.size is not None and start > remote.size:
        partial.forget()
        start = 0
    if start and start == remote.size:
        return remote.size
    # identity: a compressing proxy would make sizes and ranges meaningless.
    headers = {"Accept-Encoding": "identity"}
    if start:
        headers["Range"] = f"bytes={start}-"
        if version:
            headers["If-Range"] = version
    with requests.get(remote.url, headers=headers, stream=True, timeout=timeout) as response:
        if response.status_code == 416:
            partial.forget()
            raise _Passing("the server refuses to continue, starting afresh")
        if response.status_code in PASSING:
            raise _Passing(f"the server answers {response.status_code} {response.reason}")
        if response.status_code not in (200, 206):
            raise DownloadError(
                f"{remote.url}: the server answers {response.status_code} {response.reason}; check the address"
            )
        if response.status_code == 206:
            first, total = _content_range(response.headers.get("Content-Range", ""))
            if first != start:
                partial.forget()
                raise _Passing("the server continues at another place, starting afresh")
        else:
            start, total = 0, _number(response.headers.get("Content-Length"))
        if remote.size is not None and total is not None and total != remote.size:
            partial.forget()
            raise DownloadError(f"{remote.url}: {total:,} bytes offered, {remote.size:,} expected; check the address")
        expected = remote.size if remote.size is not None else total
        if expected is not None:
            _check_space(partial.path.parent, expected - start, remote.url)
        etag = response.headers.get("ETag", "")
        mark = etag if etag and not etag.startswith("W/") else response.headers.get("Last-Modified", "")
        with open(partial.path, "ab" if start else "wb") as handle:
            write_json(partial.notes, {"url": remote.url, "version": mark})
            _copy(response, handle, start, expected, remote.url, say)
    return expected


def _copy(
    response: requests.Response,
    handle: BinaryIO,
    start: int,
    expected: int | None,
    url: str,
    say: Callable[[str], None],
) -> None:
    """The body into the file, with a line of progress every ten seconds; over-long bodies are cut off and refused."""
    done, shown = start, time.monotonic()
    response.raw.enforce_content_length = False  # else the last bytes before a cut are thrown away; sizes are ours
    for chunk in response.iter_content(CHUNK):
        done += len(chunk)
        if expected is not None and done > expected:
            handle.truncate(start)
            raise DownloadError(f"{url}: more than the {expected:,} bytes expected; check the address")
        handle.write(chunk)
        if time.monotonic() - shown > 10.0:
            shown = time.monotonic()
            say(f"{url}: {done / 1e6:,.0f}" + (f" of {expected / 1e6:,.0f} MB" if expected else " MB"))


def _content_range(value: str) -> tuple[int, int | None]:
    """(first byte, total or None) of "bytes 5-9/10"; (-1, None) for anything else."""
    unit, _, rest = value.partition(" ")
    span, _, total = rest.partition("/")
    first = _number(span.partition("-")[0])
    return (first if unit == "bytes" and first is not None else -1), _number(total)


def _number(text: str | None) -> int | None:
    return int(text) if text and text.isdigit() else None


def _wrong(remote: Remote, path: Path) -> str:
    """What is wrong with a complete download, or ""."""
    size = path.stat().st_size
    if remote.size is not None and size != remote.size:
        return f"{size:,} bytes instead of {remote.size:,}"
    if remote.checksum:
        algorithm = remote.checksum.partition(":")[0]
        if checksum_of(path, algorithm) != remote.checksum:
            return f"wrong checksum, {algorithm} is not {remote.checksum.partition(':')[2]}"
    return ""


def _reason(error: requests.RequestException) -> str:
    """A person's words for a library's fault."""
    if isinstance(error, requests.exceptions.Timeout):
        return "no answer in time; is this machine online?"
    if isinstance(error, requests.exceptions.SSLError):
        return "the server's certificate is not accepted"
    if isinstance(error, requests.exceptions.ProxyError):
        return "the proxy cannot be reached; check HTTPS_PROXY"
    if isinstance(error, requests.exceptions.ChunkedEncodingError):
        return "connection cut"
    if isinstance(error, requests.exceptions.ConnectionError):
        return "no connection; is this machine online?"
    if isinstance(error, requests.exceptions.InvalidURL | requests.exceptions.MissingSchema):
        raise DownloadError(f"{error.request.url if error.request else error}: not a usable address") from None
    return f"{type(error).__name__}"


def _check_space(folder: Path, needed: int, what: str) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise DownloadError(f"{what}: needs {needed / 1e9:.2f} GB in {folder}, where {free / 1e9:.2f} GB are free")


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Faults of the disk as one line."""
    try:
        yield
    except requests.RequestException:
        raise  # a subclass of OSError, but of the network
    except OSError as error:
        raise DownloadError(f"{path}: cannot be written ({error.strerror or error})") from None


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


# MERL ---------------------------------------------------------------------------------------------------------------


def material_of(member: str) -> str | None:
    """The material that a member of the archive holds; None for anything else.

    Only the last part of the member's path is used, so that no member can leave the folder it is unpacked into.
    """
    name = PurePosixPath(member.replace("\\", "/")).name
    stem = name.removesuffix(".binary")
    if stem == name or not stem or not set(stem) <= NAME_CHARACTERS or not stem[0].isalnum():
        return None
    return stem


def unpack_merl(
    archive: str | os.PathLike, folder: str | os.PathLike, say: Callable[[str], None] | None = None
) -> list:
    """Unpack the .binary files of a MERL archive into ``folder``; returns [{"name", "crc32"}] by name.

    All are first unpacked and checked in a hidden folder beside them: a run never sees half of the database. What is
    there from an earlier try is used again if it is right. A file of the same name and other contents is never
    replaced. Raises DownloadError.
    """
    archive, folder, say = Path(archive), Path(folder), say or _to_stderr
    staging = folder / ".incoming"
    with _writing(folder):
        staging.mkdir(parents=True, exist_ok=True)
        try:
            with zipfile.ZipFile(archive) as zipped:
                members = _members(zipped, archive)
                missing = [name for name in members if not (staging / f"{name}.binary").exists()]
                _check_space(folder, FILE_BYTES * len(missing), str(archive))
                for count, (name, info) in enumerate(members.items(), 1):
                    _unpack_member(zipped, info, staging / f"{name}.binary", folder / f"{name}.binary")
                    if count % 10 == 0:
                        say(f"{archive.name}: {count} of {len(members)} materials unpacked")
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, NotImplementedError) as error:
            raise DownloadError(f"{archive}: cannot be unpacked ({error}); delete it and try again") from None
        for path in sorted(staging.glob("*.binary")):
            if path.stem in members:
                os.replace(path, folder / path.name)
        shutil.rmtree(staging)
    return [{"name": name, "crc32": f"{info.CRC:08x}"} for name, info in members.items()]


def _members(zipped: zipfile.ZipFile, archive: Path) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    for info in zipped.infolist():
        name = None if info.is_dir() else material_of(info.filename)
        if name is None:
            continue
        if info.file_size != FILE_BYTES:
            raise DownloadError(f"{archive}: {name}.binary has {info.file_size:,} bytes, a MERL file {FILE_BYTES:,}")
        if name in members:
            raise DownloadError(f"{archive}: {name}.binary is in it twice")
        members[name] = info
    if not members:
        raise DownloadError(f"{archive}: holds no .binary file; is it the MERL database?")
    return dict(sorted(members.items()))


def _unpack_member(zipped: zipfile.ZipFile, info: zipfile.ZipInfo, staged: Path, final: Path) -> None:
    for path in (staged, final):
        if path.exists():
            if _crc32(path) == info.CRC:
                return
            if path is final:
                raise DownloadError(f"{final}: there already, with other contents; move it away and try again")
    with atomic_path(staged) as temporary, zipped.open(info) as source, open(temporary, "wb") as target:
        shutil.copyfileobj(source, target, CHUNK)  # the last read checks the CRC
        target.flush()
        try:
            check_header(temporary)
        except MeasuredError as error:
            fault = str(error).partition(": ")[2]
            raise DownloadError(f"{zipped.filename}: {info.filename}: {fault}") from None


def _crc32(path: Path) -> int:
    value = 0
    with open(path, "rb") as handle:
        while chunk := handle.read(CHUNK):
            value = zlib.crc32(chunk, value)
    return value


def fetch_merl(remote: Remote, folder: str | os.PathLike, record: str | os.PathLike, **options: Any) -> None:
    """The database from its public home into ``folder``: downloaded, checked, unpacked, its terms shown and recorded.

    ``record`` (JSON) is written last: where it exists the database is complete. ``options`` as of :func:`download`.
    Raises DownloadError.
    """
    folder = Path(folder)
    say = options.get("say") or _to_stderr
    say(MERL_TERMS)
    archive = folder / "BRDFDatabase.zip"
    if not (archive.exists() and not _wrong(remote, archive)):
        download(remote, archive, **options)
    materials = unpack_merl(archive, folder, say)
    with _writing(folder):
        write_text(folder / "TERMS.txt", MERL_TERMS)
        write_json(record, {"url": remote.url, "checksum": checksum_of(archive, "md5"), "materials": materials})
        archive.unlink()
    say(f"{folder}: {len(materials)} materials")


# RGL ----------------------------------------------------------------------------------------------------------------


def fetch_rgl(materials: Mapping[str, str], folder: str | os.PathLike, **options: Any) -> list[str]:
    """Isotropic materials of the RGL database, name -> address, into ``folder``: each is checked by its content before
    it appears there. Files that are there stay as they are. Returns the names that were fetched. ``options`` as of
    :func:`download`. Raises DownloadError.
    """
    folder, say = Path(folder), options.get("say") or _to_stderr
    say(RGL_TERMS)
    fetched = []
    for name, url in materials.items():
        path, arriving = folder / f"{name}_rgb.bsdf", folder / ".incoming" / f"{name}_rgb.bsdf"
        if path.exists():
            continue
        download(Remote(url), arriving, **options)
        try:
            check_rgl(arriving)
        except MeasuredError as error:
            arriving.unlink()
            raise DownloadError(f"{url}: {str(error).partition(': ')[2]}; nothing of it is kept") from None
        with _writing(path):
            os.replace(arriving, path)
        fetched.append(name)
    with _writing(folder), suppress(FileNotFoundError):
        (folder / ".incoming").rmdir()
    say(f"{folder}: {len(materials)} materials of the RGL database, {len(fetched)} of them new")
    return fetched


def fetch_rgl_job(materials: Mapping[str, str], folder: str, say: Callable[[str], None]) -> None:
    """Body of the rule: a fault ends the job with its one line; what has arrived stays."""
    try:
        fetch_rgl(materials, folder, say=say)
    except DownloadError as error:
        raise SystemExit(f"rgl: {error}") from None


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
        hint = f" ({record} has its checksum from the first download)" if not remote.checksum else ""
        raise DownloadError(f"{error}{hint if 'checksum' in str(error) else ''}") from None
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


def fetch_merl_job(source: Mapping[str, Any], folder: str, record: str, say: Callable[[str], None]) -> None:
    """Body of the rule: a fault ends the job with its one line."""
    try:
        fetch_merl(remote_of(source), folder, record, say=say)
    except DownloadError as error:
        raise SystemExit(f"merl: {error}") from None


def fetch_assets_job(assets: Mapping[str, Mapping[str, Any]], folder: str, say: Callable[[str], None]) -> None:
    """Body of the rule: fetch what is not in ``folder`` yet; what is there stays as it is, whoever put it there."""
    for name, source in assets.items():
        path = Path(folder) / name
        if path.exists():
            say(f"{path}: there already")
            continue
        say(f"{path}: {source['terms']}")
        record = path.parent / "checksums" / f"{name}.json"
        try:
            fetch_asset(path, remote_of(source), record, source["member"] or None, say=say)
        except DownloadError as error:
            raise SystemExit(f"{path.parent.name}: {error}") from None
