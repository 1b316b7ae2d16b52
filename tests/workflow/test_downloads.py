"""`snakemake assets` and `snakemake merl` against a local server: asked for, they run where a run cannot begin."""

import hashlib
import io
import threading
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest
import yaml

from brdfatlas.angles import GRID_SHAPE
from brdfatlas.formats.merl import write_merl


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args):
        pass


@pytest.fixture
def address(tmp_path_factory):
    """(folder, its address): what lies in the folder can be fetched."""
    folder = tmp_path_factory.mktemp("served")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    yield folder, f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_scene_waits_for_its_probe_and_gets_it(project, address):
    """The run stops before any work and names the command; that command runs under the same configuration."""
    folder, url = address
    probe = b"PF\n32 16\n-1.0\n" + np.ones((16, 32, 3), "<f4").tobytes()
    (folder / "sky.pfm").write_bytes(probe)
    asset = {"url": f"{url}/sky.pfm", "checksum": f"sha256:{hashlib.sha256(probe).hexdigest()}", "terms": "ours"}
    (project.root / "config" / "assets.yaml").write_text(yaml.safe_dump({"sky.pfm": asset}))
    scenes = project.root / "config" / "scenes.yaml"
    scene = {
        "geometry": [{"shape": "sphere"}],
        "environment": {"kind": "file", "file": "data/assets/sky.pfm"},
        "camera": {"origin": [0, 0, 6]},
    }
    scenes.write_text(yaml.safe_dump({"mine": scene}))
    project.configure(scenes=["mine"])

    done = project.snakemake(check=False)
    assert done.returncode != 0
    fault = "mine.environment.file: data/assets/sky.pfm: no such file; `snakemake assets` fetches it"
    assert fault in done.stdout
    assert not list((project.root / "results").rglob("*.npz"))
    project.snakemake("assets")
    assert (project.root / "data" / "assets" / "sky.pfm").read_bytes() == probe
    project.snakemake("--", "results/scenes/mine.npz")
    assert (project.root / "results/scenes/mine.npz").exists()


def test_the_database_takes_the_place_of_the_stand_ins(project, address, tmp_path_factory):
    folder, url = address
    binary = tmp_path_factory.mktemp("merl") / "chrome.binary"
    write_merl(binary, np.full((*GRID_SHAPE, 3), 0.1, np.float32))
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as handle:
        handle.write(binary, "BRDFDatabase/brdfs/chrome.binary")
    (folder / "merl.zip").write_bytes(archive.getvalue())
    source = {"url": f"{url}/merl.zip", "size": 0, "checksum": ""}
    project.configure(merl_source=source, materials=["chrome"], strict=True)

    done = project.snakemake("--dry-run", check=False)
    assert done.returncode != 0
    assert "data/measured and data/merl: no measurement there (strict: true" in done.stdout
    assert "`snakemake rgl --config strict=False` downloads some" in done.stdout
    project.snakemake("merl", "--config", "strict=False")
    assert (project.root / "data" / "merl" / "chrome.binary").read_bytes() == binary.read_bytes()
    planned = project.planned()
    assert "make_standin" not in planned
    assert planned["describe_material"] == 1
