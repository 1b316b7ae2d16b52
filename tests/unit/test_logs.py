"""What the log of a job says about an error."""

from pathlib import Path

import pytest

from brdfatlas.files import check_regular
from brdfatlas.pipeline.logs import fault


@pytest.fixture
def results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results/fits/nickel").mkdir(parents=True)
    return tmp_path / "results/fits/nickel"


def test_a_folder_in_place_of_a_result_is_named_with_the_remedy(results):
    (results / "ggx.npz").mkdir()
    for read in (check_regular, lambda path: Path(path).read_bytes()):
        with pytest.raises(Exception, match=r"a folder|a directory") as caught:
            read("results/fits/nickel/ggx.npz")
        assert fault(caught.value).endswith("delete it: the next run makes it again")


def test_no_file_is_blamed_for_what_it_has_no_part_in(results):
    (results / "ggx.npz").write_bytes(b"")
    assert "delete it" in fault(ValueError("results/fits/nickel/ggx.npz: no zip file"))
    assert "delete" not in fault(OSError(28, "No space left on device", "results/fits/nickel/ggx.npz"))
    assert "delete" not in fault(ValueError("results/fits/nickel: nothing there"))
    assert "delete" not in fault(ValueError("results/fits/nickel/gone.npz: no such file"))
