"""Find a libLLVM that Mitsuba's ``llvm_ad_rgb`` can use, before Dr.Jit loads one by itself.

Dr.Jit's code generator ends the whole process with LLVM 14 and 15 ("Cannot select fmaximum"), and these are what many
machines have. ``LLVMGetVersion`` has been exported since LLVM 16: a library without it is too old. Candidates are
probed in a child process, so that no broken library can take this one down.

``python -m brdfatlas.rendering.llvm`` prints the path of a usable library; scripts/setup installs one where it can.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

MINIMUM = 16
#: Newer ones are tried only when nothing else is there.
KNOWN_GOOD = 22
VARIABLE = "DRJIT_LIBLLVM_PATH"

ADVICE = (
    f"Mitsuba needs a libLLVM of version {MINIMUM} or newer (14 and 15 make it abort) and none was found. "
    "Debian: apt install libllvm19. Ubuntu: apt install libllvm19 (or libllvm18). macOS: brew install llvm. "
    f"conda: conda install -c conda-forge 'libllvm19'. Elsewhere: set {VARIABLE} to the library's path."
)

_PROBE = """
import ctypes, sys
numbers = [ctypes.c_uint() for _ in range(3)]
ctypes.CDLL(sys.argv[1]).LLVMGetVersion(*map(ctypes.byref, numbers))
print(*(n.value for n in numbers))
"""


class LlvmError(ValueError):
    """No usable libLLVM; the message is one line that says what to do."""


def llvm_version(library: str | os.PathLike) -> tuple[int, int, int] | None:
    """Version of a libLLVM; None if it cannot be loaded or is older than 16. Cannot crash this process."""
    try:
        command = [sys.executable, "-I", "-S", "-c", _PROBE, os.fspath(library)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        major, minor, patch = map(int, done.stdout.split())
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return (major, minor, patch) if done.returncode == 0 else None


def _guess(path: Path) -> int:
    """The major version that a path claims, 0 if none; it only orders the candidates, the probe decides."""
    real = os.path.realpath(path)
    for pattern in (r"libLLVM-(\d+)", r"libLLVM\.so\.(\d+)", r"llvm[-@]?(\d+)", r"/llvm/(\d+)\."):
        found = re.search(pattern, real)
        if found:
            return int(found[1])
    return 0


def _places() -> Iterator[Path]:
    """Files that may be a libLLVM on Debian, Ubuntu and other Linuxes, Homebrew, MacPorts and conda."""
    folders = [os.path.join(prefix, "lib") for prefix in (os.environ.get("CONDA_PREFIX"), sys.prefix) if prefix]
    for ldconfig in ("ldconfig", "/sbin/ldconfig"):
        if shutil.which(ldconfig):
            listing = subprocess.run([ldconfig, "-p"], capture_output=True, text=True).stdout
            yield from map(Path, re.findall(r"libLLVM\S* .*=> (\S+)", listing))
            break
    for brew in filter(
        None, (os.environ.get("HOMEBREW_PREFIX"), "/opt/homebrew", "/usr/local", "/home/linuxbrew/.linuxbrew")
    ):
        folders += map(str, Path(brew, "opt").glob("llvm*/lib"))
    folders += map(str, Path("/opt/local/libexec").glob("llvm-*/lib"))
    folders += map(str, Path("/usr/lib").glob("llvm*/lib"))
    folders += map(str, Path("/usr/lib").glob("*-linux-*"))
    folders += ["/usr/lib64", "/usr/lib", "/usr/local/lib", "/usr/lib64/llvm"]
    for folder in folders:
        for pattern in ("libLLVM.so*", "libLLVM-*.so*", "libLLVM*.dylib"):
            yield from Path(folder).glob(pattern)


def candidates() -> list[Path]:
    """Libraries worth a probe, best first: the newest known to work, then unnamed versions, then newer ones."""
    unique = {os.path.realpath(path): path for path in _places() if path.is_file()}
    worth = [path for path in unique.values() if _guess(path) == 0 or _guess(path) >= MINIMUM]

    def rank(path: Path) -> tuple[int, int]:
        guess = _guess(path)
        return (0, -guess) if MINIMUM <= guess <= KNOWN_GOOD else (1, 0) if guess == 0 else (2, guess)

    return sorted(worth, key=rank)


def find_libllvm() -> Path | None:
    """Path of a usable libLLVM, or None. ``DRJIT_LIBLLVM_PATH`` wins; LlvmError if it is set and useless."""
    chosen = os.environ.get(VARIABLE)
    if chosen:
        if llvm_version(chosen) is None:
            raise LlvmError(
                f"{VARIABLE}={chosen} is not a loadable libLLVM of version {MINIMUM} or newer; correct or unset it"
            )
        return Path(chosen)
    newer = None
    for path in candidates():
        version = llvm_version(path)
        if version is None:
            continue
        if version[0] <= KNOWN_GOOD:
            return path
        newer = newer or path
    return newer


def use_libllvm() -> Path:
    """Point Dr.Jit to a usable libLLVM; call before Mitsuba sets an llvm variant. LlvmError says what to do."""
    path = find_libllvm()
    if path is None:
        raise LlvmError(ADVICE)
    os.environ[VARIABLE] = os.fspath(path)
    return path


def main() -> int:
    """Print the path of a usable libLLVM; 1 and the advice if there is none."""
    try:
        print(use_libllvm())
    except LlvmError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
