"""Every page in a real browser, from file://: it loads, it does what it says, everyone can use it."""

import re
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from synthetic import HOSTILE, Run


def pages_of(run: Run) -> list[Path]:
    return sorted(run.reports.rglob("*.html"))


def check_that_it_loads_clean(tab, path: Path):
    """Open a page; fail on errors of scripts, missing or broken files, and requests to a network."""
    page = tab.open(path)
    # Lazy pictures are fetched when they are near the window: bring each there.
    page.evaluate("document.querySelectorAll('img').forEach((i) => { i.loading = 'eager'; })")
    page.wait_for_function("[...document.images].every((i) => i.complete)")
    broken = page.evaluate("[...document.images].filter((i) => !i.naturalWidth).map((i) => i.src)")
    assert broken == [], path.name
    assert tab.faults == [], f"{path.name}: {tab.faults}"
    return page


def serious_faults(page) -> list[str]:
    """What an accessibility scan calls serious or critical."""
    return [
        f"{v['id']} ({v['impact']}): {v['nodes'][0]['html'][:160]}"
        for v in Axe().run(page).response["violations"]
        if v["impact"] in ("serious", "critical")
    ]


def test_every_page_loads_clean(tab, site):
    found = pages_of(site)
    assert len(found) == len(site.materials) + len(site.models) + 2
    for path in found:
        check_that_it_loads_clean(tab, path)


def test_every_page_of_a_real_run(tab, finished_run):
    """Standings and viewer among them, which the made-up site does not have."""
    reports = finished_run.root / "reports"
    found = sorted(reports.rglob("*.html"))
    names = {path.relative_to(reports).as_posix() for path in found}
    assert {"index.html", "compare.html", "standings.html", "viewer.html", "materials/chrome.html"} <= names
    for path in found:
        page = check_that_it_loads_clean(tab, path)
        assert serious_faults(page) == [], path.name
        tab.faults.clear()  # the scan itself asks for the style sheet in a way that file:// refuses


def test_links_inside_the_report_lead_somewhere(tab, site):
    for path in pages_of(site):
        page = tab.open(path)
        links = "new URL(a.getAttribute('href'), document.baseURI).href"
        for href in page.evaluate(f"[...document.querySelectorAll('a[href]')].map((a) => {links})"):
            if href.startswith("file:") and not href.split("#")[0].endswith("supplement.pdf"):
                target = Path(page.evaluate("(h) => decodeURIComponent(new URL(h).pathname)", href))
                assert target.exists(), f"{path.name} links to {target.name}"


def test_hostile_names_are_text(tab, site):
    page = tab.open(site.reports / "materials" / "alum-bronze.html")
    assert page.locator("h1").inner_text().startswith(HOSTILE)
    page = tab.open(site.reports / "index.html")
    assert page.locator("main script").count() == 0
    assert HOSTILE in page.locator("#heat").inner_text()
    assert tab.faults == []


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_serious_accessibility_fault(browser, site, width, scheme):
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page = context.new_page()
    for name in ("index.html", "materials/chrome.html", "models/toy_01.html", "compare.html"):
        page.goto((site.reports / name).as_uri())
        page.wait_for_timeout(200)
        assert serious_faults(page) == [], name
        wide = page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
        assert wide <= 1, f"{name} is {wide} pixels wider than a window of {width}"
    context.close()


def column(page, table: str, index: int) -> list[float]:
    cells = page.locator(f"{table} tbody tr:visible td:nth-child({index})").all_inner_texts()
    return [float(re.sub(r"[^0-9.]", "", text.split("±")[0])) for text in cells if re.search(r"\d", text)]


def test_tables_sort_and_filter(tab, site):
    page = tab.open(site.reports / "models" / "toy_02.html")
    page.locator("#materials thead button", has_text=re.compile(r"^PSNR \(dB\)$")).click()
    down = column(page, "#materials", 3)
    assert len(down) == 5
    assert down == sorted(down, reverse=True)
    page.locator("#materials thead button", has_text=re.compile(r"^PSNR \(dB\)$")).click()
    assert column(page, "#materials", 3) == sorted(down)
    page.locator("input[data-filter]").fill("pink")
    assert page.locator("#materials tbody tr:visible").count() == 1
    page.locator("input[data-filter]").fill("")
    assert page.locator("#materials tbody tr:visible").count() == 5


def test_index_heat_map_sorts_marks_and_filters(tab, site):
    page = tab.open(site.reports / "index.html")
    assert page.locator("#heat tbody tr").count() == 5
    page.locator("#heat thead button[data-key='4']").click()
    values = column(page, "#heat", 4 + 4)
    assert values == sorted(values, reverse=True)
    for row in page.locator("#heat tbody tr").all():
        cells = row.locator("td a").all_inner_texts()
        numbers = [float(re.sub(r"[^0-9.]", "", text)) for text in cells]
        marked = [n for n, text in zip(numbers, cells, strict=True) if "●" in text]
        assert marked == [max(numbers)]
    page.locator("#query").fill("chrome")
    assert page.locator("#heat tbody tr").count() == 1
    assert page.locator("#gallery li:visible").count() == 1
    assert page.locator("#heat td.fail").count() == 1, "the failed fit is an empty cell with its reason"
    page.locator("#query").fill("")
    page.locator("#class").select_option("glossy")
    assert page.locator("#heat tbody tr").count() == 2
    page.locator("#class").select_option("")
    page.locator("#measure").select_option("de00_mean")
    row = page.locator("#heat tbody tr").first
    cells = row.locator("td a").all_inner_texts()
    numbers = [float(re.sub(r"[^0-9.]", "", text)) for text in cells]
    marked = [n for n, text in zip(numbers, cells, strict=True) if "●" in text]
    assert marked == [min(numbers)], "small is good for dE00"


def test_index_says_that_nothing_matches_and_what_is_not_told_apart(tab, site):
    page = tab.open(site.reports / "index.html")
    page.locator("#query").fill("no such material")
    assert page.locator("#heat-bar").inner_text() == "Nothing matches."
    assert page.locator("#heat tr").count() == 0
    page.locator("#query").fill("")
    page.locator("#scene").select_option("grove")
    best = page.locator("#heat td.best").count()
    assert best == page.evaluate("ATLAS.best.filter((place) => place >= ATLAS.materials.length * 8).length"), (
        "the second scene: 7 models and the noise floor a material"
    )
    page.locator("#measure").select_option("rel_mse")
    texts = page.locator("#heat td a").all_inner_texts()
    assert texts
    assert not any(re.fullmatch(r"[●\s]*0\.?0*", text) for text in texts), "an error that is not 0 never reads as 0"
    assert tab.faults == []


def test_index_charts_agree_with_the_table(tab, site):
    page = tab.open(site.reports / "index.html")
    assert page.locator("#pareto-bytes svg a").count() == len(site.models)
    assert page.locator("#curves path.line").count() == len(site.models)
    page.locator("#legend button").first.click()
    assert page.locator("#curves path.line").count() == len(site.models) - 1
    label = page.locator("#pareto-bytes svg a").first.get_attribute("aria-label")
    name, shown = re.match(r"(.+): ([\d.]+) PSNR", label).groups()
    row = page.locator("#models-table tbody tr", has=page.get_by_role("link", name=name, exact=True))
    assert shown in row.inner_text()


def shown(page) -> str:
    page.wait_for_function("document.getElementById('canvas').dataset.ready === 'true'")
    return page.locator("#canvas").get_attribute("data-shown")


def address(page) -> str:
    """The address as the page has it; Playwright's page.url may lag behind what a script wrote there."""
    return page.evaluate("location.href")


def test_compare_keys(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=studio&b=toy_01")
    assert shown(page) == "toy_01"
    page.keyboard.press("Space")
    assert shown(page) == "reference"
    page.keyboard.press("Space")
    assert shown(page) == "toy_01"
    page.keyboard.press("4")
    assert shown(page) == "toy_03"
    assert "b=toy_03" in address(page)
    page.keyboard.press("e")
    page.keyboard.press("e")
    assert "e=1" in address(page)
    page.keyboard.press("E")
    assert "e=0.5" in address(page)
    page.keyboard.press("ArrowLeft")
    assert "m=yellow-plastic" in address(page)
    page.keyboard.press("ArrowRight")
    assert "m=pvc" in address(page)
    page.keyboard.press("s")
    assert "s=grove" in address(page)
    page.keyboard.press("v")
    assert "v=swipe" in address(page)
    page.keyboard.press("r")
    assert "e=" not in address(page)
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("Escape")
    assert not page.locator("#help").is_visible()
    assert tab.faults == []


def drawn(page) -> tuple[int, int]:
    """Sum and a position-dependent checksum of what the canvas shows."""
    shown(page)
    page.wait_for_timeout(100)
    script = """(() => {
      const c = document.getElementById('canvas'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
      let sum = 0, check = 0;
      for (let i = 0; i < d.length; i++) { sum += d[i]; check = (check * 31 + d[i]) >>> 0; }
      return [sum, check];
    })()"""
    return tuple(page.evaluate(script))


def test_compare_flips_in_place_and_develops(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&b=toy_01")
    first = drawn(page)
    page.keyboard.press("Space")
    reference = drawn(page)
    assert reference != first, "the two pictures differ"
    page.keyboard.press("Space")
    assert drawn(page) == first, "flipping back shows the same pixels"
    page.keyboard.press("e")
    assert drawn(page)[0] > first[0], "more exposure is brighter"


def test_compare_zoom_pan_and_pixel_values(tab, site):
    import numpy as np
    from PIL import Image

    from brdfatlas.figures.pictures import decode_hdr

    page = tab.open(site.reports / "compare.html", "#m=pvc&s=grove&b=toy_02")
    shown(page)
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] * 0.5, box["y"] + box["height"] * 0.4
    page.mouse.move(x, y)
    before = page.locator("#pixel").inner_text().splitlines()
    page.mouse.wheel(0, -600)
    page.wait_for_function("location.hash.includes('z=')")
    page.mouse.move(x, y + 0.1)
    after = page.locator("#pixel").inner_text().splitlines()
    assert before[0] == after[0], "zooming keeps the pixel under the pointer"
    column, row = map(int, re.match(r"x (\d+)  y (\d+)", after[0]).groups())
    with Image.open(site.reports / "materials/pvc/renders/grove/toy_02/hdr.webp") as picture:
        expected = decode_hdr(np.asarray(picture))[row, column]
    printed = [float(word) for word in after[2].split()[-3:]]
    assert printed == pytest.approx(expected.tolist(), rel=1e-3), "printed with 4 digits"
    page.mouse.down()
    page.mouse.move(x + 80, y)
    page.mouse.up()
    assert "x=" in address(page)
    saved = address(page)
    page.goto("about:blank")
    page.goto(saved)
    assert shown(page) == "toy_02"
    assert address(page) == saved, "the address holds the whole state"


def test_compare_works_without_a_pointer(tab, site):
    """Divider, pan and pixel values by keys alone."""
    import numpy as np
    from PIL import Image

    from brdfatlas.figures.pictures import decode_hdr

    page = tab.open(site.reports / "compare.html", "#m=pvc&s=grove&b=toy_02&v=swipe&z=4")
    half = drawn(page)
    divider = page.get_by_label("Divider")
    divider.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    assert "w=0.7" in address(page)
    assert page.locator("#divided").inner_text() == "70 %"
    assert drawn(page) != half
    divider.blur()
    page.keyboard.press(",")
    assert "w=0.65" in address(page)
    page.locator("#view").select_option("flip")
    assert not divider.is_visible(), "only a swipe has a divider"
    page.get_by_role("button", name="Keys").focus()
    while page.evaluate("document.activeElement.id") != "canvas":
        page.keyboard.press("Tab")
    shown(page)
    column, row = map(int, re.match(r"x (\d+)  y (\d+)", page.locator("#pixel").inner_text()).groups())
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    assert {"x=0.55", "y=0.475"} <= set(address(page).split("&")), "a tenth of what is seen a step"
    assert "m=pvc" in address(page), "the material stays"
    shown(page)
    lines = page.locator("#pixel").inner_text().splitlines()
    x, y = map(int, re.match(r"x (\d+)  y (\d+)", lines[0]).groups())
    assert x > column
    assert y < row
    with Image.open(site.reports / "materials/pvc/renders/grove/toy_02/hdr.webp") as picture:
        expected = decode_hdr(np.asarray(picture))[y, x]
    assert [float(word) for word in lines[2].split()[-3:]] == pytest.approx(expected.tolist(), rel=1e-3)
    assert serious_faults(page) == []


def test_compare_side_by_side_swipe_and_error_map(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&a=toy_00&b=toy_04&v=side")
    shown(page)
    assert page.locator("#tag-left").inner_text().startswith("Toy <b>0</b>")
    assert page.locator("#tag-right").inner_text().startswith("Toy 4")
    page.locator("#view").select_option("error")
    shown(page)
    assert page.locator("#error-bar").is_visible()
    differing = drawn(page)
    page.locator("#a").select_option("toy_04")
    assert drawn(page) != differing, "a model against itself has another map"
    same = page.evaluate("""(() => {
      const c = document.getElementById('canvas');
      return [...c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data].slice(0, 3);
    })()""")
    assert same == [247, 247, 247], "no difference is the middle of the scale"
    page.locator("#view").select_option("swipe")
    assert shown(page) == ""
    assert tab.faults == []


def test_compare_says_why_a_picture_is_missing(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=chrome&b=toy_03")
    page.wait_for_function("document.getElementById('message').textContent.includes('no finite fit')")


def test_first_bytes_are_few(tab, tmp_path):
    """100 materials x 20 models x 4 scenes: at most 1.5 MB before a reader opens a material."""
    from synthetic import make_run, toy_models

    models = toy_models(tmp_path / "toys", 20)
    names = [f"material-{i:03d}" for i in range(100)]
    run = make_run(tmp_path, names, models, ("one", "two", "three", "four"), pictures=False)
    from PIL import Image

    from brdfatlas.reports.pages import write_assets, write_compare

    write_assets(run.reports / "assets")
    write_compare(run.reports / "compare.html")
    for number, name in enumerate(names):
        folder = run.reports / "materials" / name
        folder.mkdir(parents=True)
        noise = Image.effect_noise((112, 112), 40 + number % 5).convert("RGB")
        noise.save(folder / "thumb.webp", quality=82)
    index = run.write_index()
    sizes: dict[str, int] = {}
    tab.page.on("requestfinished", lambda request: sizes.setdefault(request.url, local_size(request.url)))
    page = tab.open(index)
    page.wait_for_function("document.querySelectorAll('#heat tbody tr').length === 100")
    page.wait_for_timeout(300)
    total = sum(sizes.values())
    assert 100_000 < total <= 1_500_000, sizes
    assert tab.faults == []
    took = page.evaluate("""(() => {
      const start = performance.now(), query = document.getElementById('query');
      query.value = '7';
      query.dispatchEvent(new Event('input'));
      return performance.now() - start;
    })()""")
    assert took < 3000, "a search over 2,000 cells answers at once, even on a slow machine"


def local_size(url: str) -> int:
    from urllib.parse import unquote, urlparse

    return Path(unquote(urlparse(url).path)).stat().st_size
