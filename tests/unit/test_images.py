"""Images: what is written is what is read, and what cannot be read says so in one line."""

import numpy as np
import OpenEXR
import pytest

from brdfatlas.rendering.images import ImageError, Render, load_exr, load_render, read_meta, save_render, tone_map


@pytest.fixture
def render():
    rng = np.random.default_rng(1)
    batches = rng.lognormal(0, 4, (4, 7, 9, 3)).astype(np.float32)
    return Render(
        batches.mean(0), batches, rng.random((7, 9)) > 0.5, {"status": "ok", "seed": "3", "note": "Grüße\n{}"}
    )


def test_a_render_survives_the_file(render, tmp_path):
    save_render(tmp_path / "a.exr", render)
    again = load_render(tmp_path / "a.exr")
    np.testing.assert_array_equal(again.mean, render.mean)
    np.testing.assert_array_equal(again.mask, render.mask)
    assert again.meta == render.meta == read_meta(tmp_path / "a.exr")
    # 12 bits of the deviation from the mean, and float32 in adding the mean again.
    tolerance = 2.0**-12 * abs(render.batches - render.mean) + 2.0**-23 * (abs(render.mean) + abs(render.batches))
    assert (abs(again.batches - render.batches) <= tolerance).all()
    np.testing.assert_array_equal(load_exr(tmp_path / "a.exr"), render.mean)


def test_equal_renders_have_equal_batches(render, tmp_path):
    """Rounding must not make two equal renders differ: their error has to be exactly zero."""
    for name in "ab":
        save_render(tmp_path / f"{name}.exr", render)
    np.testing.assert_array_equal(load_render(tmp_path / "a.exr").batches, load_render(tmp_path / "b.exr").batches)


def test_what_is_no_render_is_named(render, tmp_path):
    import OpenEXR

    save_render(tmp_path / "whole.exr", render)
    (tmp_path / "cut.exr").write_bytes((tmp_path / "whole.exr").read_bytes()[:400])
    (tmp_path / "text.exr").write_text("no image")
    plain = {name: np.ones((2, 3), np.float32) for name in "RGB"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, plain).write(str(tmp_path / "plain.exr"))
    for name in ("cut.exr", "text.exr", "missing.exr", "plain.exr"):
        with pytest.raises(ImageError, match=name) as caught:
            load_render(tmp_path / name)
        assert "\n" not in str(caught.value)
    assert load_exr(tmp_path / "plain.exr").shape == (2, 3, 3)
    assert read_meta(tmp_path / "text.exr") == {} == read_meta(tmp_path / "missing.exr")


def test_chroma_is_not_left_out_silently(tmp_path):
    import OpenEXR

    values = np.full((4, 6), 0.5, np.float32)
    header = {"type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": values}).write(str(tmp_path / "grey.exr"))
    assert (load_exr(tmp_path / "grey.exr") == 0.5).all()
    OpenEXR.File(header, {"Y": values, "RY": values, "BY": -values}).write(str(tmp_path / "colour.exr"))
    with pytest.raises(ImageError, match=r"colour\.exr: .*chroma"):
        load_exr(tmp_path / "colour.exr")


def test_a_failed_write_leaves_nothing(render, tmp_path):
    bad = Render(render.mean, render.batches[:, :3], render.mask)
    with pytest.raises(Exception):  # noqa: B017, PT011 - whatever the library raises for unequal channel sizes
        save_render(tmp_path / "a.exr", bad)
    assert list(tmp_path.iterdir()) == []


def test_tone_map():
    """Monotone, 0 to 0, bright to 1; half of the way at exposure x = 1 before gamma."""
    values = tone_map(np.array([0.0, 0.5, 1.0, 50.0]), 1.0, 1.0)
    np.testing.assert_allclose(values, [0, 1 - 2**-0.5, 0.5, 1], atol=1e-12)
    assert tone_map(np.array(1.0), 1.0, 2.2) == pytest.approx(0.5 ** (1 / 2.2))


def test_one_of_several_pictures_in_a_file_is_not_chosen(tmp_path):
    pixels = {"RGB": np.ones((2, 3, 3), np.float32)}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, pixels, name=name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    with pytest.raises(ImageError, match=r"a\.exr: .*2 pictures in one file"):
        load_exr(tmp_path / "a.exr")
