"""Pictures of the report: the HDR encoding, maps with fixed ranges, colour bars, what is left of failed models."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from PIL import Image

from brdfatlas.figures import pictures
from brdfatlas.figures.scripts import read_script, write_script
from brdfatlas.measures.errors import Tone, delta_e, displayed_lab, image_errors
from brdfatlas.rendering.images import Render, save_render

TONE = Tone(1.0, 2.2)
SVG = "{http://www.w3.org/2000/svg}"


def flat(value, size=16, **meta):
    """A render of one colour with a mask that leaves out a border."""
    mean = np.full((size, size, 3), value, np.float32)
    mask = np.zeros((size, size), bool)
    mask[3:-3, 3:-3] = True
    return Render(mean, np.stack([mean] * 3), mask, {"status": "ok"} | meta)


@pytest.fixture
def renders(tmp_path):
    for model, image in {
        "reference": flat(0.4),
        "reference_again": flat(0.4001),
        "bright": flat(0.6),
        "dark": flat(0.2),
        "failing": flat(0.0, status="failed"),
    }.items():
        save_render(tmp_path / "renders" / model / "room.exr", image)
    return tmp_path / "renders"


def test_linear_pictures_keep_the_accuracy_that_the_page_states(tmp_path):
    """The reference within 1/192 stop; a fit's green, and its red and blue against green, within 1/24 stop, at any
    brightness and however far it is from its reference; black stays black, for either and both."""
    rng = np.random.default_rng(0)
    reference = (10.0 ** rng.uniform(-6, 6, (40, 30, 1)) * rng.random((40, 30, 3))).astype(np.float32)
    near = reference * np.exp2(rng.normal(0, 0.2, reference.shape)).astype(np.float32)
    far = (10.0 ** rng.uniform(-6, 6, reference.shape)).astype(np.float32)
    reference[:2], near[1:3], far[0] = 0, 0, 0
    base = pictures.hdr_levels(reference)
    folder, images = tmp_path / 'a "felt"', {"reference": reference, "near": near, "far": far}
    for model, image in images.items():
        own = None if model == "reference" else base
        path = pictures.write_hdr(folder, "room", model, pictures.hdr_levels(image, own), own)
        assert path == pictures.hdr_file(folder, "room", model)
        back, lit = pictures.read_hdr(folder, "room", model), image > 0
        assert np.array_equal(back > 0, lit)
        off = np.log2(back, where=lit, out=np.zeros(lit.shape)) - np.log2(image, where=lit, out=np.zeros(lit.shape))
        if model == "reference":
            assert np.abs(off).max() <= 1.0001 / 192
        else:
            assert np.abs(off[..., 1]).max() <= 1.0001 / 24
            assert np.abs(off - off[..., 1:2])[lit & lit[..., 1:2]].max() <= 1.0001 / 24


def test_the_steps_of_a_fit_are_hardly_seen():
    """Half of what is just visible on average, for colours of usual saturation and brightness and fits that are up to
    a stop off."""
    rng = np.random.default_rng(2)
    grey = np.exp2(rng.uniform(-4, 2, (200, 200, 1)))
    reference = grey * np.exp2(rng.normal(0, 0.5, (200, 200, 3)))
    fit = reference * np.exp2(rng.uniform(-1, 1, grey.shape) + rng.normal(0, 0.1, reference.shape))
    shown = pictures.radiance_of(pictures.hdr_levels(fit, pictures.hdr_levels(reference)))
    delta = delta_e(*(displayed_lab(picture.reshape(-1, 3), 1.0) for picture in (shown, fit)))
    assert np.mean(delta) < 0.55


def test_bytes_survive_a_script(tmp_path):
    """Any bytes, any number of them; no character needs an escape, and 15 bits a character cost 16."""
    rng = np.random.default_rng(3)
    for count in (0, 1, 14, 15, 16, 29, 30, 1000):
        content = rng.bytes(count)
        write_script(tmp_path / "a.js", "CALL", ['say "a"', [1, 2]], content)
        assert read_script(tmp_path / "a.js") == content
    assert (tmp_path / "a.js").read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff"), "the mark that browsers obey"
    assert (tmp_path / "a.js").stat().st_size < 1.07 * 1000 + 100


def test_hdr_takes_what_no_radiance_should_be():
    spoilt = np.array([[[np.nan, 1, 2], [-1, 4, 0], [np.inf, 1, 1], [1e-80, 0, 0]]])
    back = pictures.radiance_of(pictures.hdr_levels(spoilt))
    np.testing.assert_array_equal(back[0], [[0, 1, 2], [0, 4, 0], [0, 1, 1], [0, 0, 0]])


def files_in(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_names_of_models_never_share_a_file():
    """`ggx` and `ggx-diff`, a scene's name with a model's in it, a model called as a kind of picture."""
    names = ["a", "a-b", "b", "a-diff", "diff", "render", "a.webp", "reference"]
    files = [pictures.picture_file("", s, m, k) for s in names for m in names for k in pictures.KINDS]
    assert len(set(files)) == len(files)


def test_every_picture_of_every_model_and_nothing_of_a_failed_one(renders, tmp_path):
    stale = pictures.picture_file(tmp_path / "out", "room", "failing", "de00")
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"left by an earlier run")
    bystander = tmp_path / "out" / "lobes.svg"
    bystander.write_text("another rule's")
    names = pictures.material_pictures(["bright", "failing", "dark"], {"room": TONE}, renders, tmp_path / "out")
    expected = {f"renders/room/{model}/{kind}.webp" for model in ("bright", "dark") for kind in pictures.KINDS}
    expected |= {f"renders/room/{model}/hdr.js" for model in ("bright", "dark", "reference")}
    expected |= {"renders/room/reference/render.webp"}
    expected |= {"renders/room/reference_again/de00.webp"}
    assert set(names) == expected
    assert files_in(tmp_path / "out") == expected | {bystander.name}


def test_the_tone_mapped_picture_shows_the_tone_map(renders, tmp_path):
    pictures.material_pictures(["bright"], {"room": TONE}, renders, tmp_path)
    shown = np.array(Image.open(pictures.picture_file(tmp_path, "room", "bright")).convert("RGB")).astype(float)
    assert np.abs(shown - 255 * (1 - 2**-0.6) ** (1 / 2.2)).max() <= 3  # lossy WebP


def test_the_sign_of_a_difference_is_its_colour_and_the_background_is_transparent():
    bright, dark, same = (pictures.Scene(flat(0.4), TONE).pictures(flat(v))["diff"] for v in (0.6, 0.2, 0.4))
    centre = (8, 8)
    assert bright[centre][0] > bright[centre][2] + 20  # red: too bright
    assert dark[centre][2] > dark[centre][0] + 20  # blue: too dark
    assert np.ptp(same[centre][:3].astype(int)) <= 3  # neutral
    for picture in (bright, dark, same):
        assert picture[0, 0, 3] == 0
        assert picture[centre][3] == 255


def test_maps_of_different_models_share_one_scale():
    near, far = (pictures.Scene(flat(0.4), TONE).pictures(flat(v))["de00"] for v in (0.41, 0.45))
    table = pictures.colour_table("cividis").astype(int)

    def place(picture):
        return int(np.argmin(np.abs(table - picture[8, 8, :3].astype(int)).sum(1)))

    for picture, value in ((near, 0.41), (far, 0.45)):
        delta = float(delta_e(*(displayed_lab(np.full((1, 3), v), 1.0) for v in (0.4, value)))[0])
        assert place(picture) == pytest.approx(255 * np.log(delta / 0.1) / np.log(300), abs=1.5)


def test_maps_tell_small_errors_apart():
    """Three errors a decade apart each are spread over the scale; what lies outside is shown as its ends."""
    place = pictures.log_place(np.array([0.0, 0.1, 1.0, 10.0, 30.0, 99.0]), pictures.DE00_RANGE)
    assert list(place[[0, 1, 4, 5]]) == pytest.approx([0, 0, 1, 1])
    assert np.diff(place[1:4]) == pytest.approx([np.log(10) / np.log(300)] * 2)


def test_a_hundredth_of_white_is_visible_and_the_scale_is_odd():
    d = np.array([-2.0, -1.0, -0.01, 0.0, 0.01, 1.0, 2.0])
    place = pictures.signed_root(d)
    np.testing.assert_allclose(place + place[::-1], 1)
    assert place[0] == place[1] == 0
    assert place[4] - place[3] == pytest.approx(0.05)


def test_bars_are_svg_whose_labels_sit_where_the_map_puts_their_values(tmp_path):
    pictures.write_bars(tmp_path)
    for name, table, place in (
        ("bar-de00", "cividis", lambda v: float(pictures.log_place(np.array(v), pictures.DE00_RANGE))),
        ("bar-flip", "magma", lambda v: float(pictures.log_place(np.array(v), pictures.FLIP_RANGE))),
        ("bar-diff", "RdBu_r", lambda v: float(pictures.signed_root(np.array(v)))),
    ):
        root = ElementTree.parse(tmp_path / f"{name}.svg").getroot()
        bar = root.find(f".//{SVG}rect")
        left, width = float(bar.get("x")), float(bar.get("width"))
        labels = [text for text in root.iter(f"{SVG}text") if text.get("text-anchor") == "middle"]
        assert len(labels) >= 5
        for text in labels:
            value = float(text.text.replace("≥", "").replace("−", "-"))
            assert float(text.get("x")) == pytest.approx(left + width * place(value), abs=0.06)
        colours = pictures.colour_table(table)
        for stop in root.iter(f"{SVG}stop"):
            r, g, b = colours[round(float(stop.get("offset")) * 255)]
            assert stop.get("stop-color") == f"#{r:02x}{g:02x}{b:02x}"


def test_maps_show_what_the_measures_average():
    """Both look at one view of the pictures, on the same pixels."""
    rng = np.random.default_rng(5)
    base = flat(0.4, 48)
    image = Render(base.mean * rng.uniform(1.1, 1.6, base.mean.shape).astype(np.float32), base.batches, base.mask)
    found, maps = image_errors(base, image, TONE, common_numbers=False), pictures.Scene(base, TONE).pictures(image)
    for kind, colours, (low, high) in (
        ("de00", "cividis", pictures.DE00_RANGE),
        ("flip", "magma", pictures.FLIP_RANGE),
    ):
        table, shown = pictures.colour_table(colours).astype(int), maps[kind][base.mask][:, :3].astype(int)
        place = np.abs(table - shown[:, None]).sum(-1).argmin(1) / 255
        assert np.mean(low * (high / low) ** place) == pytest.approx(found[f"{kind}_mean"], rel=0.01)
