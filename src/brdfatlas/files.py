"""Files appear whole or not at all; npz files hold no pickles and no clock; nothing is read that is no regular file."""

import errno
import hashlib
import json
import math
import os
import re
import stat
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, AnyStr, BinaryIO

import numpy as np

from brdfatlas import interrupts

#: Most bytes that an npz file may expand to, and that a JSON file may have: beyond any file of ours.
MOST_BYTES = 2**31
#: Most bytes of a part of a path, and of a path.
LONGEST, LONGEST_PATH = 255, 4095
#: Kind of an output -> endings that it may have; an ending that nobody knows goes with every kind.
ENDINGS = {
    "fit": (".npz",),
    "MERL table": (".binary",),
    "table": (".binary", ".csv"),
    "EXR picture": (".exr",),
    "picture": (".exr", ".png"),
    "JSON": (".json",),
    "XML": (".xml",),
    "MaterialX": (".mtlx",),
    "glTF": (".gltf",),
}
_OTHER_ENDINGS = (".astm", ".bsdf", ".csv", ".glb", ".hdr", ".html", ".jpeg", ".jpg", ".md", ".npy", ".obj", ".pdf")
_OTHER_ENDINGS += (".pfm", ".ply", ".py", ".rgbe", ".toml", ".tsv", ".txt", ".webp", ".yaml", ".yml", ".zip")
_COMMENTS = rb"(\s*<!--((?!-->).)*-->)*?\s*<!-- written by: brdfatlas "
#: Bytes from which a format is told, and our marks.
HEAD_BYTES = 4096
#: How a file begins that we wrote, by its ending.
_MARKS = {
    ".exr": rb"v/1\x01.*?brdfatlas:\w+\0string\0",
    ".png": rb"\x89PNG.*?tEXtSoftware\0brdfatlas",
    ".json": rb'\{\s*"format": "brdfatlas[ -](fit|sampler|recommendation)\b',
    ".xml": rb'<scene version="3\.0\.0">' + _COMMENTS,
    ".mtlx": rb'<\?xml version="1\.0"\?>\s*<materialx [^<>]*>' + _COMMENTS,
    ".csv": rb"# values: f\n# angles: degrees\n# kind: [\w-]+\n# note: [^\n]*, converted by brdfatlas\n",
    ".gltf": rb'\{\s*"asset": \{\s*"version": "2\.0",\s*"generator": "brdfatlas ',
}

#: What the hidden name of an unfinished file begins with, so that what a killed job leaves can be told from all else.
UNFINISHED = ".brdfatlas."
#: A write that fails for these numbers fails for the disk's sake.
_DISK_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


class FileFault(ValueError):
    """A file that is not read or not written; the message is one line that names the file and the remedy."""


def shown(text: object) -> str:
    """``text`` on one line: control characters of a file's name as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in str(text))


def digits(text: AnyStr) -> AnyStr:
    """``text`` for ``float`` or ``int``. ValueError for ``1_0``, which they read as 10, and digits of other scripts."""
    if isinstance(text, bytes):
        other = b"_" in text
    else:
        other = "_" in text or (not text.isascii() and any(c.isdecimal() and not c.isascii() for c in text))
    if other:
        raise ValueError(f"{text[:40]!r} is not a number")
    return text


def check_path(path: object) -> None:
    """TypeError for what is no path. Bytes are none here, and a number would be taken for an open file."""
    if not isinstance(path, str | os.PathLike) or isinstance(os.fspath(path), bytes):
        raise TypeError(f"{shown(repr(path))[:80]} is no path; give a str or a pathlib.Path")


def check_length(path: str | os.PathLike) -> None:
    """FileFault for a name that no file system holds, TypeError for what is no path."""
    check_path(path)
    if any(len(os.fsencode(part)) > LONGEST for part in Path(path).parts) or len(os.fsencode(path)) > LONGEST_PATH:
        raise FileFault(
            f"{shown(path)[:40]}...: longer than a name ({LONGEST} bytes) or a path ({LONGEST_PATH:,}) may be; "
            "choose a shorter one"
        )


def check_regular(path: str | os.PathLike) -> Path:
    """``path`` if it is a regular file or a link to one: a FIFO would wait for ever, a device never end.

    Raises FileFault naming the file; FileNotFoundError and other OSErrors as ``os.stat`` does; TypeError for no path.
    """
    check_path(path)
    if not stat.S_ISREG(os.stat(path).st_mode):
        what = "a folder" if os.path.isdir(path) else "not a regular file"
        raise FileFault(f"{shown(path)}: {what}; name a file")
    return Path(path)


def stamps(paths: Iterable[str | os.PathLike]) -> dict[str, str]:
    """path -> size and time of a file, which change with its content, and a checksum of parts of it: files of one size
    and time, as archives and formats have them, may be renamed to each other. "" where there is none."""
    found = {}
    for path in paths:
        try:
            status = os.stat(path)
            found[os.fspath(path)] = f"{status.st_size} {status.st_mtime_ns} {_sample(path, status):08x}"
        except OSError:
            found[os.fspath(path)] = ""
    return found


def _sample(path: str | os.PathLike, status: os.stat_result, part: int = 2**16) -> int:
    """CRC-32 of the beginning, the middle and the end of a file; 0 of one that is not regular or cannot be read."""
    found = 0
    if stat.S_ISREG(status.st_mode) and os.access(path, os.R_OK):
        with open(path, "rb") as file:
            for share in (0, 0.5, 1):
                file.seek(int(share * max(status.st_size - part, 0)))
                found = zlib.crc32(file.read(part), found)
    return found


def digest_of(*arrays: np.ndarray) -> str:
    """SHA-256 of the values of arrays, one after another."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def file_digest(path: str | os.PathLike) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def fingerprint(*told: Any) -> str:
    """SHA-256 of what JSON can hold."""
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def _target(path: str | os.PathLike) -> Path:
    """Where writing to ``path`` goes: through links, and only to a regular file or a new one. FileFault if neither."""
    check_length(path)
    target = Path(os.path.realpath(path))
    if target.is_symlink():
        raise FileFault(f"{shown(path)}: a link to itself; name another output")
    if os.path.exists(path) and not target.is_file():  # /dev/stdout may be a pipe, which has no path
        what = "a folder" if target.is_dir() else "not a regular file"
        raise FileFault(f"{shown(path)}: {what}, nothing is written there; name another output")
    return target


def check_output(
    path: str | os.PathLike, kind: str, inputs: Iterable[str | os.PathLike] = (), *, force: bool = False
) -> None:
    """Refuse, before any work, an output that would destroy something or that could not be written.

    ``kind``: one of ENDINGS. Raises FileFault naming file and remedy: the output is one of ``inputs``; it is no regular
    file; its ending says another format; it exists and was not written by this package as ``kind``, unless ``force``;
    its folder is none or cannot be written to.
    """
    target, name = _target(path), shown(path)
    if os.fspath(path).endswith(os.sep):
        raise FileFault(f"{name}: the name of a folder; name a file in it")
    for item in inputs:
        if (os.path.exists(item) and os.path.realpath(item) == str(target)) or _same(item, target):
            raise FileFault(f"{name}: is an input of this command ({shown(item)}); name another output")
    ending = target.suffix.lower()
    known = {ending for endings in ENDINGS.values() for ending in endings}.union(_OTHER_ENDINGS)
    if ending in known and ending not in ENDINGS[kind]:
        raise FileFault(f"{name}: the {kind} to write ends in {' or '.join(ENDINGS[kind])}; name such an output")
    if target.exists() and not force and not ours(target, kind):
        raise FileFault(
            f"{name}: exists, and is no {kind} that brdfatlas wrote; name another output, or replace it by --force"
        )
    check_new_folders(Path(path).parents, name)
    folder = next(parent for parent in target.parents if parent.exists())
    if not folder.is_dir():
        raise FileFault(f"{name}: {shown(folder)} is not a folder; name another output")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileFault(f"{name}: {shown(folder)} cannot be written to; name another output")


def check_new_folders(folders: Iterable[Path], name: str) -> None:
    """FileFault where one of ``folders`` is not there and has a name that was meant to be replaced: ``~``, ``$HOME``,
    ``file:`` of an address. A folder ``~`` invites ``rm -r ~``."""
    for folder in folders:
        if re.match(r"[~$]|\w+:$", folder.name) and not os.path.lexists(folder):
            raise FileFault(
                f"{name}: there is no folder {shown(folder)}, and none of such a name is made; write the path in full"
            )


def _same(item: str | os.PathLike, target: Path) -> bool:
    """Whether both are one file, under links of either kind."""
    return os.path.exists(item) and target.exists() and os.path.samefile(item, target)


def ours(path: str | os.PathLike, kind: str) -> bool:
    """Whether ``path`` is a ``kind`` that this package wrote, or empty: such a file may be replaced.

    Told by marks that we alone write. A table is ours only where it is marked as a stand-in or reconstructed: any other
    may be a measurement.
    """
    with open(path, "rb") as handle:
        head = handle.read(HEAD_BYTES)
        if not head:
            return True
        if kind == "fit":
            return _is_fit(handle)
        if ".binary" in ENDINGS[kind] and head.startswith(np.array([90, 90, 180], "<i4").tobytes()):
            handle.seek(-8, os.SEEK_END)
            return float(np.frombuffer(handle.read(), "<f8")[0]) in (-5.0, -6.0)
    return any(re.match(_MARKS[ending], head, re.DOTALL) for ending in ENDINGS[kind] if ending in _MARKS)


def json_of(path: str | os.PathLike) -> str:
    """What a regular file holds that is a JSON of ours: "fit", "sampler" or "recommendation"; "" for any other."""
    with open(path, "rb") as handle:
        found = re.match(_MARKS[".json"], handle.read(HEAD_BYTES))
    return found[1].decode("ascii") if found else ""


def _is_fit(handle: BinaryIO) -> bool:
    """Whether an npz file has the members of a fit and no other, its model a text."""
    try:
        with zipfile.ZipFile(handle) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
            labels = {name for name in names if not name.startswith(("option/", "parameter/"))}
            model = archive.getinfo("model.npy")
            stated = {"model", "material", "standin"} <= labels <= {"model", "material", "standin", "entry", "source"}
            return stated and model.file_size < 4096 and _read_member(archive, model).dtype.kind == "U"
    except Exception:  # zipfile and zlib raise a dozen kinds for damaged files
        return False


def _disk_fault(error: OSError | RuntimeError) -> tuple[int, str] | None:
    """Number and words of a fault of the disk, None for any other. OpenEXR and NumPy state it in words, and nobody the
    file."""
    if getattr(error, "errno", None) in _DISK_FAULTS:
        return error.errno, os.strerror(error.errno)  # type: ignore[union-attr,arg-type,return-value]
    if re.search(r"\d+ requested and \d+ written", str(error)):  # NumPy asks for no reason
        return errno.EIO, "cannot be written in full, the disk or a limit on sizes is reached"
    if "Not enough free space" in str(error):
        return errno.ENOSPC, os.strerror(errno.ENOSPC)
    return next(((n, os.strerror(n)) for n in _DISK_FAULTS if os.strerror(n) in str(error)), None)


@contextmanager
def atomic_path(path: str | os.PathLike) -> Iterator[Path]:
    """A temporary path beside ``path`` that becomes ``path`` when the block ends well and vanishes when it fails.

    It keeps the ending of ``path``, because writers choose a format by it. A link stays: what it names is written. A
    FIFO, a device or a folder is not replaced (FileFault).
    """
    path = _target(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with interrupts.unwound():
        try:
            handle, name = tempfile.mkstemp(
                prefix=f"{UNFINISHED}{path.name[:40]}.", suffix=path.suffix, dir=path.parent
            )
        except OSError as error:
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            os.replace(temporary, path)
        except (OSError, RuntimeError) as error:
            fault = _disk_fault(error)
            if fault:
                raise OSError(*fault, os.fspath(path)) from None
            raise
        finally:
            temporary.unlink(missing_ok=True)


def write_text(path: str | os.PathLike, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_made(path: str | os.PathLike, told: Mapping[str, str]) -> None:
    """The last file of a job: lines "name, tab, checksum", so that it changes with what stands for each name."""
    write_text(path, "".join(f"{name}\t{checksum}\n" for name, checksum in told.items()))


def write_json(path: str | os.PathLike, value: Any) -> None:
    """Write JSON that a person can read; NaN and Inf become null, for other readers' sake."""
    write_text(path, json.dumps(plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it: arrays as lists, NaN and Inf as null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value


def shortest_number(value: np.floating) -> float:
    """The number with the fewest digits that give ``value`` back in its own type: 0.1 for float32(0.1). Unlike ``str``
    it does not depend on the print options of the process, which some libraries change."""
    return float(np.format_float_scientific(value, unique=True))


def read_json(path: str | os.PathLike) -> Any:
    """Read a JSON file. ValueError for what is not JSON; FileFault naming the file for no regular file or one beyond
    MOST_BYTES."""
    path = check_regular(path)
    if path.stat().st_size > MOST_BYTES:
        raise FileFault(f"{shown(path)}: {path.stat().st_size:,} bytes, more than {MOST_BYTES:,}; not one of ours")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{shown(path)}: not JSON, cut off? ({error})") from None
    except RecursionError:
        raise ValueError(f"{shown(path)}: nested too deeply") from None


def read_record(path: str | os.PathLike, *keys: str) -> Mapping[str, Any]:
    """What a job wrote as JSON, with these keys. ValueError naming the file for anything else."""
    record = read_json(path)
    if not isinstance(record, Mapping) or not set(keys) <= record.keys():
        raise ValueError(f"{shown(path)}: not what a run writes there ({', '.join(keys) or 'names'} wanted)")
    return record


def write_npz(path: str | os.PathLike, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays as npz: no object arrays, fixed time stamps, so equal arrays give equal bytes."""
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(info, "w", force_zip64=True) as handle:
                np.lib.format.write_array(handle, np.asarray(array), allow_pickle=False)


def read_npz(path: str | os.PathLike, *, most_bytes: int = MOST_BYTES) -> dict[str, np.ndarray]:
    """Read an npz file without pickle. Sizes are checked before anything is allocated.

    Raises FileFault naming the file: not a regular file, no npz, damaged, Python objects, more than ``most_bytes``.
    """
    path = check_regular(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            total = sum(member.file_size for member in members)
            if total > most_bytes:
                raise ValueError(f"expands to {total:,} bytes, more than {most_bytes:,}")
            if len({member.filename for member in members}) != len(members):
                raise ValueError("a name comes twice")
            return {member.filename.removesuffix(".npy"): _read_member(archive, member) for member in members}
    except OSError:
        raise
    except Exception as error:  # zipfile and zlib raise a dozen kinds for damaged files
        raise FileFault(f"{shown(path)}: not a readable npz file ({shown(error) or type(error).__name__})") from None


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    """One array, of just the size that its header states."""
    with archive.open(member) as handle:
        version = np.lib.format.read_magic(handle)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{member.filename} has npy version {version}")
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = header(handle)
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds Python objects, which are not read")
        if any(n < 0 for n in shape) or math.prod(shape) * dtype.itemsize != member.file_size - handle.tell():
            raise ValueError(f"{member.filename} has not the size that it states")
        values = np.frombuffer(bytearray(handle.read()), dtype)
    return values.reshape(shape, order="F" if fortran else "C")


def digests(folder: str | os.PathLike, names: Iterable[str]) -> dict[str, str]:
    """name -> SHA-256 of files in a folder, for a list that changes with any of them."""
    return {name: file_digest(Path(folder) / name) for name in names}
