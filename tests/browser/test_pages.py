"""Every page in a real browser, from file://: it loads, it does what it says, everyone can use it."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from axe_playwright_python.sync_playwright import Axe
from synthetic import HOSTILE, Run

from brdfatlas.figures.pictures import read_hdr
from brdfatlas.models import MODELS


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


NONSENSE = [
    "%",
    "fit-%",
    "a=%",
    "m=%ff",
    "kind=toString",
    "cost=toString",
    "measure=__proto__",
    "sort-board=99-x",
    "z=1e400",
]
NONSENSE += [
    "constructor",
    "&&=",
    "off=toString,a",
    "heat=toString,up",
    "scene=toString",
    "v=toString",
    "m=<script>alert(1)",
]


@pytest.mark.parametrize("name", ["index.html", "materials/pvc.html", "models/toy_01.html", "compare.html"])
def test_an_address_of_nonsense_is_a_page_all_the_same(tab, site, name):
    """An address that was cut off or typed wrongly stops no script."""
    plain = tab.open(site.reports / name).locator("main").inner_text()
    for words in NONSENSE:
        tab.page.goto("about:blank")
        page = tab.open(site.reports / name, f"#{words}")
        page.evaluate("dispatchEvent(new HashChangeEvent('hashchange'))")
        assert tab.faults == [], words
        if name.startswith("models"):
            assert page.locator("main").inner_text() == plain, words


def test_the_longest_name_fits_into_a_telephone(browser, site):
    context = browser.new_context(viewport={"width": 320, "height": 640})
    page = context.new_page()
    for name in ("index.html", "materials/chrome.html", "models/toy_01.html"):
        page.goto((site.reports / name).as_uri())
        page.evaluate(
            "(t) => document.querySelectorAll('h1, .pager a').forEach((e) => { e.textContent = t; })", "w_" * 40
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= 321, name
    context.close()


def column(page, table: str, index: int) -> list[float]:
    cells = page.locator(f"{table} tbody tr:visible td:nth-child({index})").all_inner_texts()
    return [float(re.sub(r"[^0-9.]", "", text.split("±")[0])) for text in cells if re.search(r"\d", text)]


def test_tables_sort_and_filter(tab, site):
    page = tab.open(site.reports / "models" / "toy_02.html")
    page.locator("#materials thead button", has_text=re.compile(r"^PSNR \(dB\)$")).click()
    down = column(page, "#materials", 5)
    assert len(down) == 5
    assert down == sorted(down, reverse=True)
    page.locator("#materials thead button", has_text=re.compile(r"^PSNR \(dB\)$")).click()
    assert column(page, "#materials", 5) == sorted(down)
    page.locator("#materials thead button", has_text="ΔE00").click()
    up = column(page, "#materials", 3)
    assert up == sorted(up), "where less is better the best comes first"
    page.reload()
    assert column(page, "#materials", 3) == up, "the order is in the address"
    page.locator("input[data-filter]").fill("pink")
    assert page.locator("#materials tbody tr:visible").count() == 1
    page.locator("input[data-filter]").fill("")
    assert page.locator("#materials tbody tr:visible").count() == 5


def cells_of(page, row) -> list[tuple[float, bool]]:
    """Numbers of a row of the heat map, and whether each is marked as best."""
    texts = row.locator("td a").all_inner_texts()
    return [(float(re.sub(r"[^0-9.]", "", text)), "●" in text) for text in texts]


def test_index_heat_map_sorts_marks_and_filters(tab, site):
    page = tab.open(site.reports / "index.html")
    assert page.locator("#heat tbody tr").count() == 5
    for row in page.locator("#heat tbody tr").all():
        cells = cells_of(page, row)
        best = min(number for number, _ in cells)
        assert [number for number, marked in cells if marked] == [best] * sum(number == best for number, _ in cells)
    page.locator("#measure").select_option("psnr_db")
    page.locator("#heat thead button[data-key='4']").click()
    place = (
        page.locator("#heat thead tr")
        .last.locator("th")
        .evaluate_all("(ths) => ths.findIndex((th) => th.querySelector('[data-key=\"4\"]')) + 1")
    )
    values = column(page, "#heat", place)
    assert values == sorted(values, reverse=True)
    page.locator("#query").fill("chrome")
    assert page.locator("#heat tbody tr").count() == 1
    assert page.locator("#gallery li:visible").count() == 1
    assert page.locator("#heat td.fail").count() == 1, "the failed fit is an empty cell with its reason"
    page.locator("#query").fill("")
    page.locator("#class").select_option("glossy")
    assert page.locator("#heat tbody tr").count() == 2
    saved = address(page)
    page.goto("about:blank")
    page.goto(saved)
    assert page.locator("#heat tbody tr").count() == 2
    assert page.locator("#measure").input_value() == "psnr_db"
    assert page.locator("#heat thead th[aria-sort] button").get_attribute("data-key") == "4"
    assert tab.faults == []


def test_state_of_the_index_survives_back(tab, site):
    """Selects and charts agree after a visit elsewhere."""
    page = tab.open(site.reports / "index.html")
    page.locator("#measure").select_option("flip_mean")
    page.locator("#cost button", has_text="seconds").click()
    page.locator("#switches input[value=published]").check()
    labels = page.locator("#pareto svg a").evaluate_all(
        "(links) => links.map((a) => a.getAttribute('aria-label')).sort()"
    )
    assert all("FLIP" in label for label in labels)
    page.locator("#gallery a").first.click()
    page.wait_for_load_state("load")
    page.go_back()
    page.wait_for_selector("#pareto svg a")
    assert page.locator("#measure").input_value() == "flip_mean"
    assert page.locator("#switches input[value=published]").is_checked()
    again = page.locator("#pareto svg a").evaluate_all(
        "(links) => links.map((a) => a.getAttribute('aria-label')).sort()"
    )
    assert again == labels


def test_index_says_that_nothing_matches(tab, site):
    page = tab.open(site.reports / "index.html")
    page.locator("#query").fill("no such material")
    assert page.locator("#heat-bar").inner_text() == "Nothing matches."
    assert page.locator("#heat tr").count() == 0
    page.locator("#query").fill("")
    page.locator("#measure").select_option("rel_mse")
    texts = page.locator("#heat td a").all_inner_texts()
    assert texts
    assert not any(re.fullmatch(r"[●\s]*0\.?0*", text) for text in texts), "an error that is not 0 never reads as 0"
    assert tab.faults == []


def test_recommendation_follows_its_switches(tab, site):
    """The cells show what the data recommends, and no model of ours when only published ones are asked for."""
    page = tab.open(site.reports / "index.html")
    assert page.locator("#recommended tbody tr").count() == len(site.materials)
    for box in ("published", "reciprocal"):
        page.locator(f"#switches input[value={box}]").check()
    shown = page.locator("#recommended td[data-model]").evaluate_all("(cells) => cells.map((c) => c.dataset.model)")
    assert shown
    assert not {"toy_01", "toy_02"} & set(shown), "one is ours, one is not reciprocal"
    expected = page.evaluate("ATLAS.recommended[3].flat().filter((k) => k >= 0).map((k) => ATLAS.models[k].name)")
    assert shown == expected
    link = page.locator("#recommended td .links a[download]").first
    target = Path(page.evaluate("(a) => decodeURIComponent(new URL(a).pathname)", link.evaluate("(a) => a.href")))
    assert target.stat().st_size > 100


def test_index_charts_agree_with_the_table(tab, site):
    """The medians that the browser computes are those of the leaderboard and its TSV."""
    page = tab.open(site.reports / "index.html")
    assert page.locator("#pareto svg a").count() == len(site.models)
    table = pd.read_csv(site.reports / "data/models.tsv", sep="\t").set_index("model")
    for model in site.models:
        label = page.locator(f"#pareto svg a[data-model={model}]").get_attribute("aria-label")
        number = float(re.search(r": ΔE00 ([\d.]+), ", label)[1])
        row = page.locator(f"#leaderboard tr[data-model={model}] td[data-column=de00_mean]")
        assert number == float(row.inner_text()) == pytest.approx(table.loc[model, "de00_mean_median"], abs=0.0051)


BOXES = """(svg) => [...svg.querySelectorAll('text')].filter((t) => t.textContent && !t.closest('.tip')).map((t) => {
  const b = t.getBoundingClientRect(); return [t.textContent, b.left, b.top, b.right, b.bottom, t.className.baseVal];
})"""


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("measure", ["de00_mean", "flip_mean", "psnr_db", "rel_mse"])
def test_labels_of_charts_never_overlap_nor_leave_their_chart(browser, site, width, measure):
    """By bounding boxes; and no text is smaller than 11 pixels."""
    context = browser.new_context(viewport={"width": width, "height": 900})
    page = context.new_page()
    for path in (f"index.html#measure={measure}", "materials/pvc.html"):
        page.goto((site.reports / "index.html").parent.as_uri() + "/" + path)
        page.wait_for_selector("#pareto svg a")
        for chart in page.locator(".chart svg").all():
            frame = chart.bounding_box()
            boxes = chart.evaluate(BOXES)
            for i, (text, left, top, right, bottom, kind) in enumerate(boxes):
                assert bottom - top >= 11, f"{text}: {bottom - top} pixels high"
                if "name" in kind:
                    assert left >= frame["x"] - 1, text
                    assert right <= frame["x"] + frame["width"] + 1, text
                    assert bottom <= frame["y"] + frame["height"] + 1, text
                for other, start, above, end, below, _ in boxes[:i]:
                    apart = right <= start + 1 or end <= left + 1 or bottom <= above + 2 or below <= top + 2
                    assert apart, f"{text!r} and {other!r} overlap at {width} pixels in {path}"
    context.close()


@pytest.mark.parametrize("width", [1280, 400])
def test_labels_keep_clear_of_markers(browser, site, width):
    """Thirty models of all families, crowded as on a real page, or all of them optimal: every optimal model has a name
    in the chart, which lies on no marker, label or axis."""
    context = browser.new_context(viewport={"width": width, "height": 900})
    page = context.new_page()
    page.goto((site.reports / "materials/pvc.html").as_uri())
    page.wait_for_selector("#pareto svg a")
    rng = np.random.default_rng(5)
    for noise in [0.25] * 8 + [0.0]:
        x = 10 ** rng.uniform(1, 5, 30)
        y = 8 * x**-0.2 * np.exp(np.abs(rng.normal(0, noise, 30)))
        y[rng.random(30) < 0.3] *= 1 + 0.08 * noise
        order = np.argsort(x)
        front = [int(k) for i, k in enumerate(order) if y[k] < min(y[order[:i]], default=np.inf)]
        named = page.evaluate(
            """([x, y, front]) => {
          const families = window.AtlasCharts.FAMILIES, node = document.getElementById('pareto');
          const point = (v, i) => ({ name: `m${i}`, title: `Some model ${i}`, family: families[i % 5], x: v, y: y[i] });
          const points = x.map(point).map((p) => ({ ...p, href: '#', text: '' })), names = front.map((i) => `m${i}`);
          const axes = { xlabel: 'x', ylabel: 'y', label: '', ylog: true };
          window.AtlasCharts.scatter(node, { points, front: names, ...axes });
          const box = (n) => n.getBoundingClientRect();
          const beside = (a, b) => a.right <= b.left || b.right <= a.left;
          const apart = (a, b) => beside(a, b) || a.bottom <= b.top || b.bottom <= a.top;
          const labels = [...node.querySelectorAll('text.name')], frame = box(node.querySelector('svg'));
          const taken = [...node.querySelectorAll('.point, line.axis, svg > text')];
          for (const [i, label] of labels.entries()) {
            const place = box(label);
            const said = label.textContent;
            const across = place.left >= frame.left && place.right <= frame.right;
            const inside = across && place.top >= frame.top && place.bottom <= frame.bottom;
            if (!inside) throw new Error(`${said} leaves the chart`);
            const hit = [...taken, ...labels.slice(0, i)].find((other) => !apart(place, box(other)));
            if (hit) throw new Error(`${said} lies on ${hit.outerHTML}`);
          }
          return labels.map((label) => label.textContent);
        }""",
            [x.tolist(), y.tolist(), front],
        )
        assert sorted(named) == sorted(f"Some model {k}" for k in front)
    context.close()


@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_is_cut_without_a_cue(browser, site, width):
    """A table wider than its frame shows that it scrolls, and its first column stays."""
    context = browser.new_context(viewport={"width": width, "height": 900})
    page = context.new_page()
    for name in ("index.html", "materials/pvc.html", "models/toy_01.html"):
        page.goto((site.reports / name).as_uri())
        page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
        page.wait_for_timeout(300)
        hidden = page.evaluate(
            "[...document.querySelectorAll('.scroll')].filter((s) => s.checkVisibility()"
            " && s.scrollWidth > s.clientWidth + 2 && !s.classList.contains('more'))"
            ".map((s) => s.getAttribute('aria-label'))"
        )
        assert hidden == [], name
        for box in page.locator(".scroll:visible").all():
            if box.evaluate("(s) => s.scrollWidth > s.clientWidth + 2 && s.querySelector('tbody th')"):
                before = box.locator("tbody th").first.evaluate("(c) => c.getBoundingClientRect().left")
                box.evaluate("(s) => { s.scrollLeft = 200; }")
                after = box.locator("tbody th").first.evaluate("(c) => c.getBoundingClientRect().left")
                assert abs(after - before) <= 2, f"{name}: {box.get_attribute('aria-label')}"
    context.close()


def test_charts_are_dark_in_dark_mode(browser, site):
    context = browser.new_context(viewport={"width": 1280, "height": 900}, color_scheme="dark")
    page = context.new_page()
    page.goto((site.reports / "materials/pvc.html").as_uri())
    page.wait_for_selector("#lobes svg path.line")
    ink = page.locator("#lobes svg text").first.evaluate("(t) => getComputedStyle(t).fill")
    assert min(map(int, re.findall(r"\d+", ink)[:3])) > 120, "light ink on a dark page"
    assert "invert" in page.locator(".plot img[src$='.svg']").first.evaluate("(i) => getComputedStyle(i).filter")
    context.close()


def test_material_page_switches_pictures_and_keeps_the_switch(tab, site):
    page = tab.open(site.reports / "materials/pvc.html")
    page.locator("[data-choice=flip]").click()
    page.locator("[data-choice=grove]").click()
    sources = page.locator("#tiles img:visible").evaluate_all("(images) => images.map((i) => i.src)")
    assert len(sources) == len(site.models)
    assert all("/renders/grove/" in source and source.endswith("/flip.webp") for source in sources)
    values = page.locator("#tiles .value").all_inner_texts()
    numbers = [float(re.search(r"[\d.]+", text)[0]) for text in values]
    assert numbers == sorted(numbers), "best first by what is shown"
    page.reload()
    page.wait_for_function("document.querySelector('#tiles .value').textContent.startsWith('FLIP')")
    assert page.locator("[data-choice=grove]").get_attribute("aria-pressed") == "true"
    page.locator("#divider input").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#divider").get_attribute("style") == "--at: 50.5%;"
    assert tab.faults == []


def test_a_place_in_the_page_leaves_what_was_chosen(tab, site):
    """A link to a part of the page names no state in the address; what is chosen next keeps the rest."""
    page = tab.open(site.reports / "materials/pvc.html")
    page.locator("[data-choice=flip]").click()
    page.locator("nav a[href='#numbers']").click()
    page.locator("[data-choice=grove]").click()
    sources = page.locator("#tiles img:visible").evaluate_all("(images) => images.map((i) => i.src)")
    assert all("/renders/grove/" in source and source.endswith("/flip.webp") for source in sources)
    assert page.evaluate("location.hash") == "#kind=flip&scene=grove"
    page.evaluate("location.hash = ''")
    page.locator("[data-choice=flip][aria-pressed=false]").wait_for()
    assert tab.faults == []


def test_a_perfect_fit_and_a_bound_stand_in_charts_and_tiles(tab, tmp_path):
    """An error of 0 has no place on a logarithmic axis, a PSNR of infinity none on any."""
    from synthetic import make_run, toy_models

    with MODELS.restored():
        models = toy_models(tmp_path / "toys", 3)
        run = make_run(tmp_path, ["pvc"], models, ("studio",), size=48)
        path = tmp_path / "results/errors/pvc.tsv"
        table = pd.read_csv(path, sep="\t").set_index("model")
        errors = ["de00_mean", "de00_p95", "flip_mean", "rmse", "rel_mse", "psnr_se_db"]
        table.loc["toy_02", [*errors, "psnr_db", "psnr_tonemapped_db", "ssim"]] = [0.0] * 6 + [np.inf, np.inf, 1.0]
        table.loc["toy_01", "psnr_se_db"] = np.inf
        table.reset_index()[["material", "model", *table.columns.drop("material")]].to_csv(
            path, sep="\t", index=False, na_rep="nan"
        )
        run.write_site()
    page = tab.open(run.reports / "materials/pvc.html", "#kind=diff")
    assert page.locator("#pareto svg a").count() == 3
    values = page.locator("#tiles .tile:visible .value").all_inner_texts()
    assert values[0] == "PSNR ∞ dB best"
    assert [text.startswith("PSNR ≥ ") for text in values] == [False, True, False]
    for key, shown in {"de00_mean": "0.00", "psnr_db": "∞", "rmse": "0"}.items():
        page = tab.open(run.reports / "index.html", f"#measure={key}")
        best = page.locator("#pareto svg a[data-model=toy_02]")
        assert f" {shown}, " in best.get_attribute("aria-label")
        assert "Toy 2" in page.locator("#pareto text.name").all_text_contents(), "it is on the Pareto line"
        assert page.locator("#curves svg a[aria-label]").count() == 3
    assert tab.faults == []


def test_narrow_lobes_are_seen(tab, site):
    """A peak five decades above its base fills the height of the plot."""
    page = tab.open(site.reports / "materials/pvc.html")
    page.wait_for_selector("#lobes svg path.line")
    box = page.locator("#lobes svg path.line.strong").bounding_box()
    frame = page.locator("#lobes svg").bounding_box()
    assert box["height"] > 0.5 * frame["height"]
    assert box["width"] > 0.8 * frame["width"]
    lines = page.locator("#lobes svg path.line").count()
    page.locator("#function-legend button").last.click()
    assert page.locator("#lobes svg path.line").count() == lines + 1


def test_every_function_is_drawn_from_the_start(tab, site):
    """The best models often have none of the functions: the best that has one is drawn, and the best of all."""
    page = tab.open(site.reports / "materials/pvc.html")
    page.wait_for_selector("#lobes svg path.line")
    charts = page.locator("#function-charts .chart")
    for chart in charts.all():
        assert chart.locator("path.line").count() > 0, chart.inner_text()
    pressed = page.locator("#function-legend button[aria-pressed=true]")
    assert pressed.count() == 4
    assert page.locator("#function-legend button").first.get_attribute("aria-pressed") == "true"
    for _ in range(4):
        pressed.first.click()
    assert charts.first.inner_text() == "None of the selected models has this function."
    assert tab.faults == []


def test_every_model_has_its_fit_and_parameters(tab, site):
    page = tab.open(site.reports / "materials/chrome.html")
    assert page.locator(".fits details").count() == len(site.models)
    for model in site.models:
        fold = page.locator(f"#fit-{model}")
        endings = fold.locator("xpath=..").locator(".links a").all_inner_texts()
        assert endings == ([] if model == "toy_03" else [".npz", ".json"])
        assert fold.locator("tbody tr").count() == 2, "kd and n"
    page.locator("#snippet-model").select_option(label="Toy 4")
    named = re.search(r'value="(.+)"', page.locator("#snippet-xml").inner_text())[1]
    assert (site.reports / "materials/chrome/fits" / named).is_file(), "the snippet names a file that is there"
    page = tab.open(site.reports / "materials/chrome.html", "#fit-toy_02")
    page.reload()
    assert "-toy_02.npz" in page.locator("#snippet-xml").inner_text(), "who comes for a fit finds its snippet"


def shown(page) -> str:
    page.wait_for_function("document.getElementById('canvas').dataset.ready === 'true'")
    return page.locator("#canvas").get_attribute("data-shown")


def address(page) -> str:
    """The address as the page has it; Playwright's page.url may lag behind what a script wrote there."""
    return page.evaluate("location.href")


def order_of(page) -> list[str]:
    """Models of the list, in its order."""
    return page.locator("#list button").evaluate_all("(buttons) => buttons.map((b) => b.dataset.model)")


def test_compare_lists_the_best_first(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=studio")
    names = order_of(page)
    assert names[0] == "reference"
    texts = page.locator("#list .value").all_inner_texts()[1:]
    values = [float(re.search(r"ΔE00 ([\d.]+)", text)[1]) for text in texts]
    assert values == sorted(values)
    assert shown(page) == names[1], "without a choice the best model is shown"


def test_compare_keys(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=studio&b=toy_01")
    assert shown(page) == "toy_01"
    page.keyboard.press("Space")
    assert shown(page) == "reference"
    page.keyboard.press("Space")
    assert shown(page) == "toy_01"
    page.keyboard.press("`")
    assert shown(page) == "reference"
    page.keyboard.press("4")
    fourth = order_of(page)[4]
    assert shown(page) == fourth
    assert f"b={fourth}" in address(page)
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


def test_compare_flips_wherever_the_focus_is(tab, site):
    """After a click in the list, in a drop-down and on a button, Space flips and a digit chooses."""
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=studio&b=toy_01")
    shown(page)
    for focus in ("#list button[data-model=toy_02]", "#view", "#copy", "#exposure"):
        if focus.startswith("#list"):
            page.locator(focus).click()
        else:
            page.locator(focus).focus()
        page.keyboard.press("2")
        second = order_of(page)[2]
        assert shown(page) == second, focus
        page.keyboard.press("Space")
        assert shown(page) == "reference", focus
        page.keyboard.press("Space")
        assert shown(page) == second, focus
    page.locator("#scene").select_option("grove")
    page.keyboard.press("Space")
    assert shown(page) == "reference", "after a choice in a drop-down"


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


def pixel(page) -> tuple[tuple[int, int], list[float]]:
    """The place that is read and the radiance of picture B there."""
    place = re.match(r"x (\d+)\s+y (\d+)", page.locator("#place").inner_text())
    cells = page.locator("#pixel tbody tr").nth(1).locator("td").all_inner_texts()
    return (int(place[1]), int(place[2])), [float(cell.replace("−", "-")) for cell in cells]


def test_compare_zoom_pan_and_pixel_values(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=grove&b=toy_02")
    shown(page)
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] * 0.5, box["y"] + box["height"] * 0.4
    page.mouse.move(x, y)
    before = pixel(page)
    page.mouse.wheel(0, -600)
    page.wait_for_function("location.hash.includes('z=')")
    page.mouse.move(x, y + 0.1)
    after = pixel(page)
    assert before[0] == after[0], "zooming keeps the pixel under the pointer"
    column, row = after[0]
    expected = read_hdr(site.reports / "materials/pvc", "grove", "toy_02")[row, column]
    assert after[1] == pytest.approx(expected.tolist(), rel=1e-3), "printed with 4 digits"
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
    (column, row), _ = pixel(page)
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Shift+ArrowUp")
    assert {"x=0.55", "y=0.475"} <= set(address(page).split("&")), "a tenth of what is seen a step"
    assert "m=pvc" in address(page), "the material stays"
    shown(page)
    (x, y), printed = pixel(page)
    assert x > column
    assert y < row
    expected = read_hdr(site.reports / "materials/pvc", "grove", "toy_02")[y, x]
    assert printed == pytest.approx(expected.tolist(), rel=1e-3)
    assert serious_faults(page) == []


def test_compare_side_by_side_swipe_and_error_map(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&a=toy_00&b=toy_04&v=side")
    shown(page)
    assert page.locator("#tags .tag").first.inner_text().startswith("Toy <b>0</b>")
    assert page.locator("#tags .tag").last.inner_text().startswith("Toy 4")
    page.locator("#view").select_option("four")
    shown(page)
    assert page.locator("#tags .tag").count() == 4
    page.locator("#view").select_option("flipmap")
    page.wait_for_function("document.getElementById('canvas').dataset.ready === 'true'")
    assert page.locator("#map-bar").is_visible()
    page.locator("#view").select_option("signed")
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
    with page.expect_request("**/toy_04/diff.webp"):  # the run's own map of a difference to the reference
        page.locator("#a").select_option("reference")
    shown(page)
    page.locator("#view").select_option("swipe")
    assert shown(page) == ""
    assert tab.faults == []


def test_compare_saves_exr_and_magnifies(tab, site, tmp_path):
    """The file holds the radiance to the last bit; both insets show the pixel under the pointer."""
    import OpenEXR

    page = tab.open(site.reports / "compare.html", "#m=pvc&s=grove&b=toy_02")
    shown(page)
    with page.expect_download() as waiting:
        page.locator("#exr").click()
    assert waiting.value.suggested_filename == "pvc-grove-toy_02.exr"
    waiting.value.save_as(tmp_path / "saved.exr")
    channels = OpenEXR.File(str(tmp_path / "saved.exr")).channels()
    expected = read_hdr(site.reports / "materials/pvc", "grove", "toy_02")
    assert np.array_equal(channels["RGB"].pixels, expected)
    box = page.locator("#canvas").bounding_box()
    page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + box["height"] * 0.4)
    (x, y), _values = pixel(page)
    for side in "ab":
        assert page.locator(f"#inset-{side}").get_attribute("data-at") == f"{x},{y}"
    middle = """(id) => {
      const c = document.getElementById(id), d = c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data;
      return [d[0], d[1], d[2]];
    }"""
    tone = 255 * (1 - np.exp2(-expected[y, x])) ** (1 / 2.2)
    assert page.evaluate(middle, "inset-b") == pytest.approx(tone.tolist(), abs=1.5)
    assert page.locator("#inset-b-title").inner_text() == "Toy 2"
    assert tab.faults == []


def test_compare_saves_what_it_shows(tab, site):
    """As PNG where a page from a file may read its canvas; else it leads to the file of the map."""
    page = tab.open(site.reports / "compare.html", "#m=pvc&s=grove&a=toy_01&b=toy_02&v=signed")
    shown(page)
    with page.expect_download() as waiting:
        page.locator("#save").click()
    assert waiting.value.suggested_filename == "pvc-grove-toy_02-signed.png"
    page.locator("#a").select_option("reference")
    shown(page)
    page.locator("#save").click()
    assert page.locator("#status a").get_attribute("href").endswith("materials/pvc/renders/grove/toy_02/diff.webp")


def test_compare_says_why_a_picture_is_missing(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=chrome&b=toy_03")
    page.wait_for_function("document.getElementById('message').textContent.includes('no finite fit')")


def test_compare_asks_for_no_picture_that_is_not_there(tab, site):
    tab.open(site.reports / "compare.html", "#m=chrome").wait_for_load_state("networkidle")
    assert not [fault for fault in tab.faults if "render.webp" in fault]


def test_first_bytes_are_few(tab, tmp_path):
    """100 materials x 30 models x 4 scenes: at most 2 MB and 1 s of work before a reader can use the index."""
    from synthetic import make_run, toy_models

    models = toy_models(tmp_path / "toys", 30)
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
        for model in ("reference", *models):
            render = folder / "renders" / "one" / model / "render.webp"
            render.parent.mkdir(parents=True)
            noise.save(render, quality=82)
    index = run.write_index()
    sizes: dict[str, int] = {}
    # Time of the page's own thread, so that a busy machine takes no longer.
    session = tab.page.context.new_cdp_session(tab.page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    tab.page.on("requestfinished", lambda request: sizes.setdefault(request.url, local_size(request.url)))
    page = tab.open(index)
    page.wait_for_function("document.querySelectorAll('#heat tbody tr').length === 100")
    page.wait_for_timeout(300)
    total = sum(sizes.values())
    assert 100_000 < total <= 2_000_000, sizes
    spent = {metric["name"]: metric["value"] for metric in session.send("Performance.getMetrics")["metrics"]}
    assert 0.01 < spent["TaskDuration"] <= 1, spent
    assert tab.faults == []
    took = page.evaluate("""(() => {
      const start = performance.now(), query = document.getElementById('query');
      query.value = '7';
      query.dispatchEvent(new Event('input'));
      return performance.now() - start;
    })()""")
    assert took < 3000, "a search over 3,000 cells answers at once, even on a slow machine"


def local_size(url: str) -> int:
    from urllib.parse import unquote, urlparse

    return Path(unquote(urlparse(url).path)).stat().st_size


def test_ticks_are_told_apart_and_say_where_they_stand(tab, site):
    """On a narrow axis three digits are too few: 45.01 and 45.02 were both 45, and 1.5e-4 was 2e-4."""
    page = tab.open(site.reports / "index.html")
    for low, high, kind in ((45.01, 45.05, ""), (0.9991, 0.9999, ""), (1.2e-4, 1.21e-4, "log"), (1.2e5, 1.2004e5, "")):
        words = page.evaluate(
            """([low, high, kind]) => {
              const node = document.createElement("div");
              document.body.append(node);
              const series = [{ name: "a", title: "a", index: 0, values: [[1, low], [2, high]] }];
              AtlasCharts.lines(node, { series, ykind: kind, label: "a" });
              return [...node.querySelectorAll("text[text-anchor=end]")].map((t) => t.textContent);
            }""",
            [low, high, kind],
        )
        ticks = [float(text.replace("−", "-").replace("k", "e3")) for text in words]
        assert len(set(ticks)) == len(words) > 2
        gaps = np.diff(ticks)
        assert np.allclose(gaps, gaps[0], rtol=1e-3), "evenly spaced, as they are drawn"


def test_a_chart_without_lines_stays_empty(tab, site):
    page = tab.open(site.reports / "index.html")
    page.locator("#query").fill("nothing of that name")
    assert "Nothing to draw" in page.locator("#pareto").inner_text()
    page.set_viewport_size({"width": 900, "height": 900})
    page.wait_for_function("innerWidth === 900 && new Promise((done) => setTimeout(() => done(true), 200))")
    assert "Nothing to draw" in page.locator("#pareto").inner_text()
    assert "Nothing to draw" in page.locator("#curves").inner_text()


def test_all_columns_off_stay_off(tab, site):
    page = tab.open(site.reports / "index.html")
    page.locator("#columns summary").click()
    while page.locator("#columns input:checked").count():
        page.locator("#columns input:checked").first.click()
    page.reload()
    assert page.locator("#leaderboard thead th:visible").count() == 1


def test_a_printed_table_keeps_its_columns(tab, site):
    page = tab.open(site.reports / "materials/pvc.html")
    page.emulate_media(media="print")
    cells = page.locator("#numbers-table [data-scene]")
    assert set(cells.evaluate_all("cells => cells.map((c) => getComputedStyle(c).display)")) == {"table-cell", "none"}


def test_compare_names_the_saved_picture_after_what_is_in_front(tab, site):
    page = tab.open(site.reports / "compare.html", "#m=pvc&b=toy_04&v=flip")
    page.wait_for_selector("#canvas[data-ready=true]")
    page.keyboard.press("`")
    page.wait_for_selector("#canvas[data-ready=true][data-shown=reference]")
    with page.expect_download() as download:
        page.locator("#save").click()
    assert download.value.suggested_filename == "pvc-studio-reference-flip.png"


def test_compare_shows_a_state_that_there_is(tab, site):
    """A divider within the picture; no exposure of a map, which has the run's."""
    page = tab.open(site.reports / "compare.html", "#m=pvc&b=toy_04&v=swipe&w=5")
    assert page.locator("#divided").inner_text() == "100 %"
    page.locator("#view").select_option("de00")
    page.keyboard.press("e")
    assert page.locator("#stops").inner_text() == "0 stops"


def test_a_picture_without_light_leaves_the_numbers_of_the_others(tab, tmp_path):
    """The reference is black in one of two scenes: the other is the mean, for charts as for the tables of the run."""
    from synthetic import blacken, make_run, toy_models

    with MODELS.restored():
        run = make_run(tmp_path, ["pvc", "chrome"], toy_models(tmp_path / "toys", 2), size=48)
        blacken(run, "pvc", "grove")
        run.write_site()
    errors = pd.read_csv(run.reports / "data/errors.tsv", sep="\t").query("material == 'pvc' and scene == 'studio'")
    value = errors.set_index("model")["de00_mean"]
    page = tab.open(run.reports / "index.html")
    cells = page.locator("#recommended tr[data-material=pvc] td[data-model] .numbers").all_inner_texts()
    assert cells
    assert all(re.match(r"ΔE00 \d", text) for text in cells)
    row = page.locator("#heat tr[data-material=pvc]").inner_text()
    assert all(f"{value[model]:.2f}" in row for model in run.models)
    page.locator("#scene").select_option("grove")
    assert page.locator("#heat tr[data-material=pvc] td.fail").first.text_content() == "black there"
    page = tab.open(run.reports / "materials/pvc.html")
    tile = page.locator("#tiles [data-model=toy_01]")
    assert tile.locator("img").is_visible()
    assert page.locator("#snippet-model option").count() == 2
    page.get_by_role("button", name="grove").click()
    assert not tile.locator("img").is_visible()
    assert "black there" in tile.inner_text()
    page = tab.open(run.reports / "compare.html", "#m=pvc&s=grove&b=toy_01")
    assert "not judged" in page.locator("#list").inner_text()
    assert "failed" not in page.locator("main").inner_text()
    assert [fault for fault in tab.faults if "toy_01" not in fault] == []


def test_what_cannot_be_judged_says_why_and_hides_nothing_else(tab, tmp_path):
    """One scene of a fit that failed there: its tile says why and the other scene's is shown; the page of the model
    has the reason in its table and no mean over fewer scenes; views of several pictures leave it out."""
    from synthetic import make_run, toy_models

    with MODELS.restored():
        models = toy_models(tmp_path / "toys", 2)
        run = make_run(tmp_path, ["pvc", "chrome"], models, size=48, failed=("chrome", "toy_01"))
        path = tmp_path / "results/errors/pvc.tsv"
        table = pd.read_csv(path, sep="\t")
        lost = (table["model"] == "toy_01") & (table["scene"] == "grove")
        table.loc[lost, table.columns[4:]] = np.nan
        table.loc[lost, "status"] = "failed"
        table.assign(reason=np.where(lost, "black there", "")).to_csv(path, sep="\t", index=False, na_rep="nan")
        run.write_site()
    page = tab.open(run.reports / "materials/pvc.html")
    tile = page.locator("#tiles [data-model=toy_01]")
    assert (tile.locator("img").is_visible(), tile.locator(".missing").is_visible()) == (True, False)
    page.get_by_role("button", name="grove").click()
    assert (tile.locator("img").is_visible(), "black there" in tile.inner_text()) == (False, True)
    assert "ΔE00" not in tile.inner_text()
    page = tab.open(run.reports / "models/toy_01.html")
    row = page.locator("#materials tbody tr").first
    assert "black there" in row.inner_text()
    assert row.locator("td").count() == page.locator("#materials thead th").count() - 1
    assert tab.faults == []
    page = tab.open(run.reports / "compare.html", "#m=chrome&s=studio&b=toy_00&v=three")
    page.wait_for_selector("#canvas[data-ready=true]")
    assert page.locator("#tags .tag").count() == 2
