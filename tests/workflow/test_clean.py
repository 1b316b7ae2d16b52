"""`make clean` removes what a run made and nothing else."""

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_clean_keeps_what_a_person_has_put_into_reports(tmp_path):
    shutil.copy(ROOT / "Makefile", tmp_path)
    made = ("reports/index.html", "reports/data/fits.tsv", "reports/materials/a.html")
    own = ("reports/README.md", "reports/notes.txt", "reports/data/mine.tsv", "data/measured/a.binary")
    for name in (*made, *own, "results/fits/a/ggx.npz"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
    record = "".join(f"{hashlib.sha256(name.encode()).hexdigest()}\t{name}\n" for name in made)
    (tmp_path / "results" / "reports.tsv").write_text(record)
    (tmp_path / made[2]).write_text("edited")
    clean = ["make", "clean", f"BIN={Path(sys.executable).parent}"]
    done = subprocess.run(clean, cwd=tmp_path, capture_output=True, text=True, check=True)
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert left == {"Makefile", *own, made[2]}
    assert not (tmp_path / "results").exists()
    assert "reports/notes.txt: kept" in done.stdout
    shutil.rmtree(tmp_path / "reports")
    subprocess.run(clean, cwd=tmp_path, check=True)
