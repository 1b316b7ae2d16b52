"""Files appear whole or not at all, without pickle, equal bytes for equal content."""

import numpy as np
import pytest

from brdfatlas import files


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    files.write_text(path, "old")

    def fail_half_way():
        with files.atomic_path(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_npz_round_trip_is_deterministic_and_readable_by_numpy(tmp_path):
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "name/b": np.array("text")}
    files.write_npz(tmp_path / "1.npz", arrays)
    files.write_npz(tmp_path / "2.npz", arrays)
    assert (tmp_path / "1.npz").read_bytes() == (tmp_path / "2.npz").read_bytes()
    with np.load(tmp_path / "1.npz", allow_pickle=False) as store:
        np.testing.assert_array_equal(store["a"], arrays["a"])
    assert str(files.read_npz(tmp_path / "1.npz")["name/b"]) == "text"


def test_pickles_are_neither_written_nor_read(tmp_path):
    with pytest.raises(ValueError, match="allow_pickle"):
        files.write_npz(tmp_path / "x.npz", {"a": np.array([{}], object)})
    np.savez(tmp_path / "evil.npz", a=np.array([{}], object))
    with pytest.raises(ValueError, match=r"evil.npz: .*a.npy holds Python objects"):
        files.read_npz(tmp_path / "evil.npz")


def test_json_has_no_nan(tmp_path):
    files.write_json(tmp_path / "x.json", {"a": np.float32(1.5), "b": float("nan"), "c": np.array([1, np.inf])})
    assert files.read_json(tmp_path / "x.json") == {"a": 1.5, "b": None, "c": [1.0, None]}
