"""What others publish, from its public home: the MERL database, materials of the RGL database, assets of scenes."""

import os
import shutil
import tarfile
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from brdfatlas.constants import NAME
from brdfatlas.files import atomic_path, read_record, write_json, write_text
from brdfatlas.formats.merl import FILE_BYTES, check_header
from brdfatlas.formats.rgl import check as check_rgl
from brdfatlas.measured import MeasuredError
from brdfatlas.pipeline.download import CHUNK, DownloadError, Remote, Say, checksum_of, download, writing, wrong

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
    with writing(folder):
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
    if not archive.exists() or wrong(remote, archive):
        download(remote, archive, say=say, **options)
    materials = unpack_merl(archive, folder, say)
    with writing(folder):
        write_text(folder / "TERMS.txt", MERL_TERMS)
        write_json(record, {"url": remote.url, "checksum": checksum_of(archive, "md5"), "materials": materials})
        archive.unlink()
    say(f"{folder}: {len(materials)} materials")


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
        with writing(paths[name]):
            os.replace(arriving, paths[name])
    with suppress(OSError):
        (folder / ".incoming").rmdir()
    say(f"{folder}: {len(materials)} materials of the RGL database, {len(missing)} of them new")
    return missing


def fetch_asset(
    path: str | os.PathLike, remote: Remote, record: str | os.PathLike, member: str | None = None, **options: Any
) -> None:
    """A file that a scene needs, from its public home into ``path``.

    Where nobody publishes a checksum, the SHA-256 of the first download is kept in ``record`` (JSON, by address), and
    a later download that differs is refused. ``member``: the file to take out of a .tar.gz at the address. Raises
    DownloadError.
    """
    path, record = Path(path), Path(record)
    known = dict(read_record(record)) if record.exists() else {}
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
