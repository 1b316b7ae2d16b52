"""Choosing a libLLVM: old and broken libraries are never chosen, and the message says what to do."""

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from brdfatlas.rendering import llvm

ROOT = Path(__file__).resolve().parents[2]


def test_the_found_library_is_new_enough():
    path = llvm.find_libllvm()
    if path is None:
        pytest.skip("no libLLVM >= 16 on this machine")
    assert llvm.llvm_version(path)[0] >= llvm.MINIMUM


def test_what_is_no_llvm_is_refused(tmp_path):
    (tmp_path / "libLLVM-19.so").write_bytes(b"\x7fELF nonsense")
    assert llvm.llvm_version(tmp_path / "libLLVM-19.so") is None
    assert llvm.llvm_version(tmp_path / "absent.so") is None
    assert llvm.llvm_version(ctypes.util.find_library("c")) is None  # loads, but has no LLVMGetVersion


def test_a_library_that_kills_its_process_kills_only_the_probe(monkeypatch):
    monkeypatch.setattr(llvm, "_PROBE", "import os; os.abort()")
    assert llvm.llvm_version("whatever") is None


def test_old_versions_are_not_even_probed(tmp_path, monkeypatch):
    for name in ("libLLVM-14.so.1", "libLLVM-15.so", "libLLVM.so.19.1", "libLLVM.so.22.1", "libLLVM.so.99.0"):
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "_places", lambda: iter(sorted(tmp_path.iterdir())))
    names = [path.name for path in llvm.candidates()]
    assert names == ["libLLVM.so.22.1", "libLLVM.so.19.1", "libLLVM.so.99.0"]
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    versions = {"libLLVM.so.22.1": None, "libLLVM.so.19.1": (19, 1, 7), "libLLVM.so.99.0": (99, 0, 0)}
    monkeypatch.setattr(llvm, "llvm_version", lambda path: versions[os.path.basename(path)])
    assert llvm.find_libllvm().name == "libLLVM.so.19.1"


def test_only_old_llvm_ends_in_one_message(tmp_path, monkeypatch):
    """What a machine with LLVM 14 alone gets: the advice, no abort, whether asked from Python or from make."""
    (tmp_path / "libLLVM-14.so").touch()
    monkeypatch.setattr(llvm, "_places", lambda: iter([tmp_path / "libLLVM-14.so"]))
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    with pytest.raises(llvm.LlvmError) as caught:
        llvm.use_libllvm()
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in ("Debian", "Ubuntu", "brew", "conda", llvm.VARIABLE))
    assert llvm.main() == 1


def test_a_useless_choice_of_the_user_is_an_error(tmp_path):
    environment = os.environ | {llvm.VARIABLE: str(tmp_path / "libLLVM-15.so")}
    command = [sys.executable, "-m", "brdfatlas.rendering.llvm"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert llvm.VARIABLE in done.stderr
    assert done.stdout == ""


FAKES = {
    "python": """#!/bin/sh
case "$*" in *llvm*) test -e "$HOME/installed" && cat "$HOME/installed" || { echo advice >&2; exit 1; } ;; esac
""",
    "pip": "#!/bin/sh\n",
    "sudo": "#!/bin/sh\nexit 1\n",
    "apt-get": """#!/bin/sh
echo "$*" >> "$HOME/asked"
case "$*" in *$WORKS*) echo /usr/lib/libLLVM-18.so > "$HOME/installed" ;; *update*) ;; *) exit 100 ;; esac
""",
}


@pytest.mark.skipif(os.geteuid() != 0, reason="apt is asked where this user may install")
@pytest.mark.parametrize(("works", "status"), [("libllvm18", 0), ("no package", 1)])
def test_set_up_asks_apt_for_each_package_in_turn_and_stops_without_any(tmp_path, works, status):
    """With a Python and an apt-get of our own: nothing is installed here."""
    project, tools = tmp_path / "a project" / "here", tmp_path / "tools"
    (project / "scripts").mkdir(parents=True)
    tools.mkdir()
    shutil.copy(ROOT / "scripts" / "setup", project / "scripts")
    (project / "requirements.lock").touch()
    (project / ".venv" / "bin").mkdir(parents=True)
    for name, text in FAKES.items():
        for folder in (tools, project / ".venv" / "bin"):
            (folder / name).write_text(text)
            (folder / name).chmod(0o755)
    (tools / "python").unlink()
    environment = {"PATH": f"{tools}:/usr/bin:/bin", "HOME": str(tmp_path), "WORKS": works, "PYTHON": sys.executable}
    done = subprocess.run([project / "scripts" / "setup", "venv"], env=environment, capture_output=True, text=True)
    assert done.returncode == status, done.stderr
    asked = [line.split()[-1] for line in (tmp_path / "asked").read_text().splitlines() if " install " in f" {line}"]
    assert asked[:2] == ["libllvm19", "libllvm20"]
    if status == 0:
        assert asked[-1] == works
        assert done.stderr.splitlines()[-1] == "libLLVM: /usr/lib/libLLVM-18.so"
    else:
        assert done.stderr.splitlines()[-2:] == [
            "advice",
            "error: without a usable libLLVM nothing can be rendered; set-up stops here",
        ]
