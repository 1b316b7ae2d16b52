"""`make bench`: every benchmark of this folder, one after another, on one machine in one run.

Each bench_*.py has ``main(files)``: it prints seconds and, against a plain implementation in the same process, ratios.
Seconds say little elsewhere; ratios travel.
"""

import argparse
import importlib.util
import os
import platform
import tempfile
from pathlib import Path

from brdfatlas.pipeline.standins import write_standin

#: Of different classes, for a machine without MERL files.
STANDINS = ("pink-felt", "alum-bronze", "yellow-plastic", "chrome")


def load(path: Path):
    """The benchmark's module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--files", type=Path, help="folder of MERL .binary files; default: built-in stand-ins")
    arguments.add_argument("--limit", type=int, default=4, help="how many of the files, at most")
    arguments.add_argument("--only", help="run only the benchmark of this name (bench_NAME.py)")
    args = arguments.parse_args()
    benchmarks = sorted(Path(__file__).parent.glob("bench_*.py"))
    if args.only:
        benchmarks = [path for path in benchmarks if path.stem == f"bench_{args.only}"]
        if not benchmarks:
            arguments.error(f"no benchmark named {args.only}")
    with tempfile.TemporaryDirectory() as folder:
        if args.files:
            files = sorted(args.files.glob("*.binary"))[: args.limit]
            if not files:
                arguments.error(f"{args.files}: no .binary file")
        else:
            files = [Path(folder) / f"{name}.binary" for name in STANDINS[: args.limit]]
            for path in files:
                write_standin(path.stem, path)
        print(
            f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores; "
            f"{'given files' if args.files else 'stand-ins'}: {', '.join(path.stem for path in files)}"
        )
        for path in benchmarks:
            print(f"\n== {path.stem.removeprefix('bench_')}", flush=True)
            load(path).main(files)


if __name__ == "__main__":
    main()
