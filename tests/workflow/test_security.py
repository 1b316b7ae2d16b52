"""Names and paths from configuration and file system reach neither a shell, nor a page, nor a place outside."""

import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

from brdfatlas.fits import load_fit
from brdfatlas.pipeline.configuration import ConfigError, check_name, choose

HOSTILE = [
    "../x",
    "/etc/passwd",
    "a/b",
    "a b;rm",
    "$(touch pwned)",
    "`touch pwned`",
    "<script>alert(1)</script>",
    "a\nb",
    "a'\"",
    "-rf",
    ".hidden",
    "..",
    "{material}",
    "",
    "a\0b",
    "ä",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_name_is_no_name(name):
    with pytest.raises(ConfigError) as fault:
        check_name(name, "file.yaml")
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_not_listed_is_not_chosen(name):
    with pytest.raises(ConfigError, match="is not known") as fault:
        choose([name], ["chrome"], "materials", "config")
    assert "\n" not in str(fault.value)


def refused(project, *arguments: str) -> str:
    """The one line with which a run stops before any work."""
    done = project.snakemake(*arguments, check=False)
    assert done.returncode == 1
    assert "Traceback" not in done.stdout
    assert not list((project.root / "results").rglob("*"))
    return done.stdout


@pytest.mark.parametrize("name", ["../x", "a b;touch pwned", "<script>"])
def test_hostile_materials_of_the_configuration_stop_the_run(project, name):
    project.configure(materials=[name])
    assert "config: materials:" in refused(project)
    assert not list(project.root.parent.rglob("pwned*"))


@pytest.mark.parametrize("file", ["models", "scenes", "assets"])
def test_hostile_names_of_other_files_stop_the_run(project, file):
    path = project.root / "config" / f"{file}.yaml"
    entries = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(entries | {"../x; touch pwned": next(iter(entries.values()))}))
    assert f"{file}.yaml" in refused(project, "--dry-run")


def test_hostile_paths_and_files_do_no_harm_in_a_run(project):
    """A folder whose name a shell would act on, with files whose names it would act on; one job runs."""
    folder = project.root / "data" / "a b; touch pwned; $(touch pwned) 'x"
    folder.mkdir(parents=True)
    felt = folder / "felt.binary"
    program = (
        "import sys; from brdfatlas.pipeline.standins import write_standin; write_standin('pink-felt', sys.argv[1])"
    )
    subprocess.run([sys.executable, "-c", program, str(felt)], check=True)
    names = ["a b; touch pwned", "$(touch pwned)", "<script>alert(1)<", "-rf", "new\nline", "..", "a&&touch pwned"]
    for name in names:
        (folder / f"{name}.binary").symlink_to("felt.binary")
    project.configure(merl_folder=str(folder.relative_to(project.root)), materials="all", models=["ggx"])
    done = project.snakemake("--", "results/materials/felt.json")
    # A name that begins with a dot is hidden, any other is left out, aloud.
    assert done.stdout.count("left out: ") == len(names) - 1
    assert (project.root / "results" / "materials" / "felt.json").is_file()
    made = {path.name for path in (project.root / "results" / "materials").iterdir()}
    assert made == {"felt.json"}
    assert not [path for path in project.root.rglob("pwned*") if path.name.startswith("pwned")]


class Bomb:
    """Unpickled, it makes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_a_fit_with_a_pickle_is_refused_unopened(tmp_path):
    exploded = tmp_path / "exploded"
    np.savez(tmp_path / "array.npz", model=np.array([Bomb(exploded)], object))
    with zipfile.ZipFile(tmp_path / "raw.npz", "w") as archive:
        archive.writestr("model.npy", pickle.dumps(Bomb(exploded)))
    for name in ("array.npz", "raw.npz"):
        with pytest.raises(ValueError, match=f"{name}"):
            load_fit(tmp_path / name)
    assert not exploded.exists()
