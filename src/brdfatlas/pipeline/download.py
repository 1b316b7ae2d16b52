"""Downloads that resume, are checked, and appear whole or not at all."""

import hashlib
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import requests
from requests.adapters import HTTPAdapter
from urllib3.util import Retry

from brdfatlas.files import write_text

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
    with writing(path), requests.Session() as session:
        for scheme in ("http://", "https://"):
            session.mount(scheme, HTTPAdapter(max_retries=retry))
        path.parent.mkdir(parents=True, exist_ok=True)
        left, most, old = attempts, _size(part), part.exists()
        while left:
            fault = _fetch(session, remote, part, timeout, say)
            if not fault:
                fault = wrong(remote, part)
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


def wrong(remote: Remote, path: Path) -> str:
    """What is wrong with a complete download, or ""."""
    if remote.size not in (None, path.stat().st_size):
        return f"{path.stat().st_size:,} bytes instead of {remote.size:,}"
    algorithm, _, digest = (remote.checksum or "").partition(":")
    if algorithm and checksum_of(path, algorithm) != remote.checksum:
        return f"wrong checksum, {algorithm} is not {digest}"
    return ""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Faults of the disk as one line."""
    try:
        yield
    except OSError as error:
        raise DownloadError(f"{path}: cannot be written ({error.strerror or error})") from None
