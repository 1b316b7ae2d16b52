"""Downloads against a local server that cuts connections and tells lies: whole and right, or not there at all."""

import hashlib
import json
import tarfile
import threading
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from brdfatlas import read_merl
from brdfatlas.angles import GRID_SHAPE
from brdfatlas.formats.merl import FILE_BYTES, check_header
from brdfatlas.pipeline import download as dl
from brdfatlas.pipeline.download import DownloadError, Remote, download
from brdfatlas.pipeline.fetch import fetch_asset, fetch_merl, fetch_rgl, unpack_merl

QUICK = {"attempts": 3, "pause": 0.01, "timeout": 5.0, "say": lambda line: None}


class Server:
    """What the next answers are: ``files`` by path, and faults."""

    def __init__(self):
        self.files: dict[str, bytes] = {}
        self.etag = '"1"'
        self.ranges = True
        self.cuts: list[int] = []  # bytes after which the next answers are cut
        self.statuses: list[int] = []  # statuses of the next answers
        self.claim: int | None = None  # a lie about the length
        self.shift = 0  # a lie about where a continued answer starts
        self.seen: list[tuple[int, str]] = []  # (status, Range header) of each answer

    def url(self, path: str) -> str:
        return f"http://127.0.0.1:{self.http.server_port}{path}"


@pytest.fixture
def server():
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *args):
            pass

        def do_GET(self):
            asked = self.headers.get("Range", "")
            body = state.files.get(self.path)
            status = state.statuses.pop(0) if state.statuses else (200 if body is not None else 404)
            start = 0
            if status == 200 and asked and state.ranges and self.headers.get("If-Range") == state.etag:
                start = int(asked.removeprefix("bytes=").rstrip("-"))
                status = 206 if start < len(body) else 416
            state.seen.append((status, asked))
            self.send_response(status)
            if status not in (200, 206):
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            part = body[start:]
            if status == 206:
                first = start + state.shift
                self.send_header("Content-Range", f"bytes {first}-{len(body) - 1}/{len(body)}")
            self.send_header("ETag", state.etag)
            self.send_header("Content-Length", str(state.claim if state.claim is not None else len(part)))
            self.end_headers()
            if state.cuts:
                part = part[: state.cuts.pop(0)]
                self.close_connection = True
            self.wfile.write(part)

    state.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.http.handle_error = lambda *request: None  # who refuses an answer hangs up on the server
    thread = threading.Thread(target=state.http.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield state
    state.http.shutdown()
    state.http.server_close()


BODY = np.random.default_rng(1).bytes(3_000_000)
MD5 = "md5:" + hashlib.md5(BODY).hexdigest()


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_good_download_leaves_one_file(server, tmp_path):
    server.files["/a"] = BODY
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert leftovers(tmp_path) == ["a"]


def test_cut_connections_are_continued_where_they_broke(server, tmp_path):
    server.files["/a"] = BODY
    server.cuts = [1_000_000, 500_000, 700_001, 10]
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert [status for status, _ in server.seen] == [200, 206, 206, 206, 206]
    assert server.seen[1][1] == "bytes=1000000-"


def test_a_later_run_continues_an_earlier_one(server, tmp_path):
    server.files["/a"] = BODY
    server.cuts = [1_000_000, 0, 0, 0]
    with pytest.raises(DownloadError, match=r"1,000,000 bytes are kept"):
        download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert not (tmp_path / "a").exists()
    server.seen.clear()
    server.cuts = []
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert server.seen == [(206, "bytes=1000000-")]


def test_a_server_that_ignores_range_is_read_from_the_start(server, tmp_path):
    server.files["/a"] = BODY
    server.ranges = False
    server.cuts = [1_000_000]
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert [status for status, _ in server.seen] == [200, 200]


def test_a_file_that_changed_meanwhile_is_not_mixed(server, tmp_path):
    other = bytes(reversed(BODY))
    server.files["/a"] = BODY
    server.cuts = [1_000_000, 0, 0, 0]
    with pytest.raises(DownloadError):
        download(Remote(server.url("/a")), tmp_path / "a", **QUICK)
    server.files["/a"], server.etag, server.cuts = other, '"2"', []
    download(Remote(server.url("/a")), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == other


def test_an_answer_from_the_wrong_place_is_refused(server, tmp_path):
    server.files["/a"] = BODY
    server.cuts, server.shift = [1_000_000], 7
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert [status for status, _ in server.seen] == [200, 206, 200]


def test_bytes_of_another_address_are_not_continued(server, tmp_path):
    server.files["/a"] = BODY
    (tmp_path / "a.part").write_bytes(b"x" * 1000)
    download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY
    assert server.seen == [(200, "")]


def test_a_damaged_part_is_fetched_afresh_once(server, tmp_path):
    server.files["/a"] = BODY
    server.cuts = [1_000_000, 0, 0, 0]
    remote = Remote(server.url("/a"), len(BODY), MD5)
    with pytest.raises(DownloadError):
        download(remote, tmp_path / "a", **QUICK)
    part = tmp_path / "a.part"
    part.write_bytes(b"\0" * part.stat().st_size)
    server.cuts = []
    download(remote, tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY


def test_wrong_checksum_leaves_nothing(server, tmp_path):
    server.files["/a"] = BODY
    with pytest.raises(DownloadError, match="wrong checksum") as fault:
        download(Remote(server.url("/a"), None, "md5:" + "0" * 32), tmp_path / "a", **QUICK)
    assert "\n" not in str(fault.value)
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("offered", [len(BODY) - 1, len(BODY) + 1])
def test_wrong_size_is_refused_before_the_body(server, tmp_path, offered):
    server.files["/a"] = BODY
    server.claim = offered
    with pytest.raises(DownloadError, match="expected; check the address"):
        download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert leftovers(tmp_path) == []


def test_a_body_shorter_than_promised_never_becomes_the_file(server, tmp_path):
    server.files["/a"] = BODY[:-5]
    server.claim = len(BODY)
    with pytest.raises(DownloadError):
        download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize(("status", "answers"), [(404, 1), (403, 1), (500, 3), (503, 3), (429, 3)])
def test_final_faults_are_final_and_passing_ones_are_tried_again(server, tmp_path, status, answers):
    server.files["/a"] = BODY
    server.statuses = [status] * 9
    with pytest.raises(DownloadError, match=str(status)) as fault:
        download(Remote(server.url("/a")), tmp_path / "a", **QUICK)
    assert len(server.seen) == answers
    assert "\n" not in str(fault.value)
    assert leftovers(tmp_path) == []


def test_a_passing_fault_passes(server, tmp_path):
    server.files["/a"] = BODY
    server.statuses = [503]
    download(Remote(server.url("/a")), tmp_path / "a", **QUICK)
    assert (tmp_path / "a").read_bytes() == BODY


def test_offline_is_one_clear_line(tmp_path):
    with pytest.raises(DownloadError, match="is this machine online") as fault:
        download(Remote("http://127.0.0.1:9/x"), tmp_path / "a", **QUICK)
    assert "\n" not in str(fault.value)
    with pytest.raises(DownloadError, match="not a usable address"):
        download(Remote("http://"), tmp_path / "a", **QUICK)


def test_a_full_disk_is_said_before_the_body(server, tmp_path, monkeypatch):
    server.files["/a"] = BODY
    monkeypatch.setattr(dl.shutil, "disk_usage", lambda folder: type("Usage", (), {"free": 1000}))
    with pytest.raises(DownloadError, match="GB are free"):
        download(Remote(server.url("/a"), len(BODY), MD5), tmp_path / "a", **QUICK)


# The database ---------------------------------------------------------------------------------------------------------


def merl_bytes(value: float) -> bytes:
    return np.array(GRID_SHAPE, "<i4").tobytes() + np.full((FILE_BYTES - 12) // 8, value, "<f8").tobytes()


GOOD = {"alum-bronze": merl_bytes(1.0), "pink-felt": merl_bytes(2.0)}


def zipped(path: Path, members: dict[str, bytes]) -> bytes:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path.read_bytes()


@pytest.fixture(scope="module")
def good_zip(tmp_path_factory) -> bytes:
    members = {f"BRDFDatabase/brdfs/{name}.binary": content for name, content in GOOD.items()}
    return zipped(tmp_path_factory.mktemp("zip") / "a.zip", {"BRDFDatabase/code/readme.txt": b"hello"} | members)


def test_the_database_arrives_with_its_terms(server, tmp_path, good_zip):
    server.files["/db.zip"] = good_zip
    server.cuts = [20_000, 30_000]
    said: list[str] = []
    remote = Remote(server.url("/db.zip"), len(good_zip), "md5:" + hashlib.md5(good_zip).hexdigest())
    fetch_merl(remote, tmp_path, tmp_path / "merl_source.json", **QUICK | {"say": said.append})
    assert leftovers(tmp_path) == ["TERMS.txt", "alum-bronze.binary", "merl_source.json", "pink-felt.binary"]
    for name, content in GOOD.items():
        assert (tmp_path / f"{name}.binary").read_bytes() == content
    assert read_merl(tmp_path / "pink-felt.binary").valid.any()
    record = json.loads((tmp_path / "merl_source.json").read_text())
    assert record["checksum"] == remote.checksum
    assert [material["name"] for material in record["materials"]] == list(GOOD)
    terms = (tmp_path / "TERMS.txt").read_text()
    assert terms in said
    assert "CC-BY-SA-4.0" in terms
    assert "research or academic use" in terms


def test_members_cannot_leave_the_folder(tmp_path):
    inside = tmp_path / "merl"
    zipped(
        tmp_path / "evil.zip",
        {
            "../../outside.binary": GOOD["pink-felt"],
            "/absolute.binary": GOOD["pink-felt"],
            "..\\windows.binary": GOOD["pink-felt"],
            "x/..binary": b"x",
            "x/a b;rm.binary": b"x",
            "x/<script>.binary": b"x",
            "x/new\nline.binary": b"x",
            "x/.hidden.binary": b"x",
            "x/readme.txt": b"x",
        },
    )
    unpack_merl(tmp_path / "evil.zip", inside, QUICK["say"])
    assert leftovers(inside) == ["absolute.binary", "outside.binary", "windows.binary"]
    assert leftovers(tmp_path) == ["evil.zip", "merl"]
    assert not Path("/absolute.binary").exists()


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (GOOD["pink-felt"][:-8], "bytes, a MERL file"),
        (GOOD["pink-felt"] + b"\0", "bytes, a MERL file"),
        (b"\1" * FILE_BYTES, "wrong dimensions"),
    ],
)
def test_a_member_that_is_no_merl_file_makes_no_material(tmp_path, content, fault):
    zipped(tmp_path / "a.zip", {"alum-bronze.binary": GOOD["alum-bronze"], "bad.binary": content})
    with pytest.raises(DownloadError, match=fault):
        unpack_merl(tmp_path / "a.zip", tmp_path / "merl", QUICK["say"])
    assert list((tmp_path / "merl").glob("*.binary")) == []


def test_a_damaged_archive_makes_no_material(tmp_path, good_zip):
    damaged = bytearray(good_zip)
    damaged[len(damaged) // 2] ^= 0xFF
    (tmp_path / "a.zip").write_bytes(damaged)
    with pytest.raises(DownloadError, match="cannot be unpacked"):
        unpack_merl(tmp_path / "a.zip", tmp_path / "merl", QUICK["say"])
    assert list((tmp_path / "merl").glob("*.binary")) == []
    (tmp_path / "b.zip").write_bytes(b"<html>not found</html>")
    with pytest.raises(DownloadError, match="cannot be unpacked"):
        unpack_merl(tmp_path / "b.zip", tmp_path / "merl", QUICK["say"])
    zipped(tmp_path / "c.zip", {"readme.txt": b"x"})
    with pytest.raises(DownloadError, match=r"holds no \.binary"):
        unpack_merl(tmp_path / "c.zip", tmp_path / "merl", QUICK["say"])


def test_a_file_of_yours_is_never_replaced(tmp_path, good_zip):
    (tmp_path / "a.zip").write_bytes(good_zip)
    mine = tmp_path / "merl" / "pink-felt.binary"
    mine.parent.mkdir()
    mine.write_bytes(merl_bytes(5.0))
    with pytest.raises(DownloadError, match="other contents; move it away"):
        unpack_merl(tmp_path / "a.zip", mine.parent, QUICK["say"])
    assert mine.read_bytes() == merl_bytes(5.0)
    assert sorted(mine.parent.glob("*.binary")) == [mine]


def test_an_interrupted_unpacking_is_continued_and_shows_nothing_before_its_end(tmp_path, good_zip, monkeypatch):
    (tmp_path / "a.zip").write_bytes(good_zip)
    folder = tmp_path / "merl"
    real, calls = dl.shutil.copyfileobj, []

    def interrupted(source, target, length):
        calls.append(target.name)
        if len(calls) == 2:
            target.write(b"half")
            raise KeyboardInterrupt
        real(source, target, length)

    monkeypatch.setattr(dl.shutil, "copyfileobj", interrupted)
    with pytest.raises(KeyboardInterrupt):
        unpack_merl(tmp_path / "a.zip", folder, QUICK["say"])
    assert list(folder.glob("*.binary")) == []
    unpack_merl(tmp_path / "a.zip", folder, QUICK["say"])
    assert len(calls) == 3, "the material that was whole is not unpacked again"
    assert leftovers(folder) == ["alum-bronze.binary", "pink-felt.binary"]
    for path in folder.iterdir():
        check_header(path)


# Assets ---------------------------------------------------------------------------------------------------------------


def test_the_first_checksum_of_an_asset_binds_the_later_ones(server, tmp_path):
    server.files["/a.hdr"] = BODY
    remote, record, path = Remote(server.url("/a.hdr")), tmp_path / "checksums.json", tmp_path / "a.hdr"
    fetch_asset(path, remote, record, **QUICK)
    assert path.read_bytes() == BODY
    path.unlink()
    fetch_asset(path, remote, record, **QUICK)
    path.unlink()
    server.files["/a.hdr"] = BODY[::-1]
    with pytest.raises(DownloadError, match=r"checksums\.json has its checksum from the first download"):
        fetch_asset(path, remote, record, **QUICK)
    assert leftovers(tmp_path) == ["checksums.json"]


def test_a_member_of_a_tar_comes_out_alone_under_its_new_name(server, tmp_path):
    (tmp_path / "in.ply").write_bytes(b"ply\n")
    with tarfile.open(tmp_path / "in.tar.gz", "w:gz") as packed:
        packed.add(tmp_path / "in.ply", "../../happy.ply")
        packed.add(tmp_path / "in.ply", "other.ply")
    server.files["/t"] = (tmp_path / "in.tar.gz").read_bytes()
    out = tmp_path / "out"
    fetch_asset(out / "b.ply", Remote(server.url("/t")), out / "c.json", "../../happy.ply", **QUICK)
    assert leftovers(out) == ["b.ply", "c.json"]
    with pytest.raises(DownloadError, match="has no file"):
        fetch_asset(out / "d.ply", Remote(server.url("/t")), out / "c.json", "missing.ply", **QUICK)


def test_rgl_materials_are_fetched_once_and_checked_by_content(server, tmp_path):
    """What is there stays; a page of a server instead of the file is refused, and what came before it stays."""
    from test_formats_rgl import container, tensors

    said = []
    server.files = {"/a": container(tensors()), "/b": b"<html>" + bytes(900)}
    materials = {"a": server.url("/a"), "b": server.url("/b")}
    with pytest.raises(DownloadError, match="does not begin with"):
        fetch_rgl(materials, tmp_path, **QUICK | {"say": said.append})
    assert (tmp_path / "a_rgb.bsdf").read_bytes() == server.files["/a"]
    assert not (tmp_path / "b_rgb.bsdf").exists()
    assert any("cites" in line for line in said)
    server.files["/b"] = server.files["/a"]
    assert fetch_rgl(materials, tmp_path, **QUICK) == ["b"]
    assert leftovers(tmp_path) == ["a_rgb.bsdf", "b_rgb.bsdf"]
