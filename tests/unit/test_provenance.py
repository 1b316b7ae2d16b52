"""What a result depends on: a model's own file, what it imports, and no other model."""

import os
import subprocess
import sys

import pytest

from brdfatlas.models.loading import BUILTIN
from brdfatlas.pipeline import provenance as room
from brdfatlas.pipeline.provenance import imports_of, module_path, provenance, shipped, sources_of

#: What a model is made of, as its paper says: a metric changed, or fits that others start from.
STARTS = {"sgd", "g_from_d"}
BUILT_ON = {
    "ggx2_diffuse": {"ggx_diffuse"},
    "independent_g": STARTS,
    "bivariate_g": STARTS | {"independent_g"},
    "low_rank": STARTS | {"independent_g", "bivariate_g"},
    "ward_duer": {"ward"},
}


def test_a_model_depends_on_itself_and_shared_parts_and_on_no_model_but_those_it_is_built_on():
    own = {name: str(module_path(module)) for name, module in BUILTIN.items()}
    for name, module in BUILTIN.items():
        found = {str(path) for path in sources_of(module)}
        assert any(own[name].endswith(path) for path in found)
        strangers = {other for other, path in own.items() if path != own[name] and any(path.endswith(p) for p in found)}
        assert strangers == BUILT_ON.get(name, set()), f"{name} depends on {strangers}"


def test_imports_are_followed_into_rooms_and_not_into_the_registry():
    found = {str(path.relative_to(room.ROOT)) for path in sources_of("brdfatlas.fits", "brdfatlas.rendering.jobs")}
    assert {"measured.py", "rendering/__init__.py"} <= found
    assert not {"__init__.py", "models/__init__.py"} & found
    readers = {str(path.relative_to(room.ROOT)) for path in sources_of("brdfatlas.formats.reader")}
    assert {"formats/merl.py", "formats/rgl.py"} <= readers


def test_a_model_file_of_a_user(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("from brdfatlas.models.base import Model\nimport numpy\n")
    found = sources_of(str(path))
    assert any(file.name == "mine.py" for file in found)
    assert any(file.name == "measured.py" for file in found)
    assert imports_of(path) == ("brdfatlas.models.base", "brdfatlas.models.base.Model")


def test_what_a_model_from_outside_imports_of_its_folder_or_package_counts(tmp_path):
    files = {
        "mine.py": "import brdfatlas, numpy\nimport shared.lobes\ndef f():\n    from shared import parts, broken\n",
        "shared/__init__.py": "",
        "shared/lobes.py": "from . import deep\n",
        "shared/deep.py": "",
        "shared/parts.py": "",
        "shared/broken.py": "def (:",
        "shared/aside.py": "",
        "brdfatlas/__init__.py": "",
        "site-packages/numpy/__init__.py": "",
        "site-packages/alone.py": "import numpy\n",
        "site-packages/pack/__init__.py": "",
        "site-packages/pack/util.py": "",
        "site-packages/pack/models/__init__.py": "",
        "site-packages/pack/models/mine.py": "import numpy, pack.util\nfrom .near import b\nfrom .. import far\n",
        "site-packages/pack/models/near.py": "",
        "site-packages/pack/far.py": "",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def found(name):
        return {
            str(path.relative_to(tmp_path))
            for path in sources_of(str(tmp_path / name))
            if path.is_relative_to(tmp_path)
        }

    package = {f"shared/{name}.py" for name in ("__init__", "lobes", "deep", "parts")}
    assert found("mine.py") - {"shared/__init__.py"} == {"mine.py"} | package - {"shared/__init__.py"}
    assert found("site-packages/alone.py") == {"site-packages/alone.py"}
    wanted = {"models/mine.py", "models/near.py", "util.py", "far.py", "__init__.py"}
    assert found("site-packages/pack/models/mine.py") - {"site-packages/pack/models/__init__.py"} == {
        f"site-packages/pack/{name}" for name in wanted
    }


def test_an_absent_module_is_an_error():
    with pytest.raises(FileNotFoundError, match=r"brdfatlas\.nothing"):
        sources_of("brdfatlas.nothing")


MODEL = '''"""A model."""

from brdfatlas.models.base import Model


class Mine(Model):
    """Mine."""

    name = "mine"
    kinds = {"a", "b", "c"}

    def evaluate(self, x):
        """x, doubled."""
        return 2 * x if x in {"p", "q", "r"} else 0
'''


def forget():
    for function in (room._compiled, room._source_digest, room._file_digest, imports_of, sources_of, provenance):
        function.cache_clear()


@pytest.fixture
def digest(tmp_path):
    """digest(text): provenance of a model file with that content."""
    path = tmp_path / "mine.py"

    def of(text, **more):
        path.write_text(text)
        forget()
        return provenance(str(path), "brdfatlas.fits", **more)

    yield of
    forget()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""x, doubled."""', '"""Twice x.\n\n        With an example."""'),
        ("return", "# why\n        return"),
        ("\n\n", "\n\n\n"),
    ],
)
def test_words_change_no_result(digest, old, new):
    assert digest(MODEL) == digest(MODEL.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2 * x", "3 * x"),
        ('"""x, doubled."""', '"""x, doubled."""\n        assert x'),
        ("2 * x", "2.0 * x"),
        ("else 0", "else 1"),
        ('"mine"', '"yours"'),
        ("self, x", "self, x=1"),
        ('"c"', '"d"'),
        ('"r"', '"s"'),
        ("models.base import Model", "models.sgd import SGD as Model"),
    ],
)
def test_a_change_of_code_is_seen(digest, old, new):
    assert digest(MODEL) != digest(MODEL.replace(old, new))


def test_a_place_is_no_part_of_it(digest, tmp_path):
    before = digest(MODEL)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "mine.py").write_text(MODEL)
    assert provenance(str(tmp_path / "elsewhere" / "mine.py"), "brdfatlas.fits") == before


def test_an_upgrade_of_a_library_is_seen_and_told(digest, monkeypatch):
    before = digest(MODEL, libraries=("numba",))
    monkeypatch.setattr(room, "version", lambda name: "99.1")
    after = digest(MODEL, libraries=("numba",))
    assert after.split()[0] == before.split()[0]
    assert after.endswith(" numba 99.1")
    assert after != before


def test_files_that_the_package_ships_count_by_content(digest, monkeypatch, tmp_path):
    (tmp_path / "package").mkdir()
    template = tmp_path / "package" / "a.j2"
    template.write_text("x")
    before = provenance("brdfatlas.fits", files=("reports/templates/*.j2",))
    assert before != provenance("brdfatlas.fits")
    monkeypatch.setattr(room, "ROOT", tmp_path / "package")
    assert [path.name for path in shipped("*.j2")] == ["a.j2"]


def test_two_processes_agree():
    """The order of a set in the code differs between processes; its digest must not."""
    program = "from brdfatlas.pipeline.provenance import provenance; print(provenance('brdfatlas.reports.site'))"
    environments = [os.environ | {"PYTHONHASHSEED": seed} for seed in ("1", "2")]
    told = {subprocess.check_output([sys.executable, "-c", program], env=env) for env in environments}
    assert len(told) == 1
