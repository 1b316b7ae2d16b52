"""Choosing a libLLVM: old and broken libraries are never chosen, and the message says what to do."""

import ctypes.util
import os
import subprocess
import sys

import pytest

from brdfatlas.rendering import llvm


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
    monkeypatch.setattr(llvm, "_apt_prefix", lambda: None)
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    for call in (llvm.use_libllvm, llvm.install):
        with pytest.raises(llvm.LlvmError) as caught:
            call()
        message = str(caught.value)
        assert "\n" not in message
        assert all(word in message for word in ("Debian", "Ubuntu", "brew", "conda", llvm.VARIABLE))
    assert llvm.main(["--install"]) == 1


def test_a_useless_choice_of_the_user_is_an_error(tmp_path):
    environment = os.environ | {llvm.VARIABLE: str(tmp_path / "libLLVM-15.so")}
    command = [sys.executable, "-m", "brdfatlas.rendering.llvm", "--install"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert llvm.VARIABLE in done.stderr
    assert done.stdout == ""


def test_apt_is_asked_for_each_package_in_turn(monkeypatch):
    """apt-get update first; a package that apt does not know is skipped; the first that works ends the search."""
    found = [None, None]  # before the installation; then whatever is left in the list is what installing brings

    def find():
        return found.pop(0) if found else "libLLVM-18.so"

    calls = []

    class Done:
        def __init__(self, returncode):
            self.returncode = returncode

    monkeypatch.setattr(llvm, "find_libllvm", find)
    monkeypatch.setattr(llvm, "_apt_prefix", lambda: ["sudo", "-n"])
    monkeypatch.setattr(llvm.subprocess, "run", lambda command, **_: Done(0 if "libllvm19" not in command else 100))
    monkeypatch.setattr(llvm, "_run", lambda command, environment: calls.append(command) or True)
    found.pop()
    assert llvm.install() == "libLLVM-18.so"
    assert calls[0] == ["sudo", "-n", "apt-get", "-q", "update"]
    assert calls[1][-1] == "libllvm20"
    assert len(calls) == 2
