"""Pages and PDF from the files of a made-up run: numbers, order, escaping, honesty, weight."""

import hashlib
import io
import itertools
import json
import math
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader

from brdfatlas.figures.pareto import pareto_figure, spread
from brdfatlas.figures.pictures import read_hdr
from brdfatlas.files import write_json
from brdfatlas.measures.ranking import best_rows
from brdfatlas.measures.summary import BUDGETS, LEADING, MEASURES, Summary, best_of, median, pareto_front, score_models
from brdfatlas.models import MODELS, Entry
from brdfatlas.reports import formats, mathml, pdf
from brdfatlas.reports.data import model_facts, physics_of, published_row, read_tsv, summarise_run, write_tsv
from brdfatlas.reports.fit_files import files_of, fit_files_job
from brdfatlas.reports.index_page import atlas_script, findings, list_failures, run_tables, switch_settings
from brdfatlas.reports.material_page import make_entries
from brdfatlas.reports.model_page import model_lede, rank_of, strip
from brdfatlas.reports.pdf import CAPTION, HEIGHT, WIDTH, tile_columns, write_material_pdf, write_supplement
from brdfatlas.reports.viewer import write_viewer

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "browser"))
from synthetic import HOSTILE, blacken, make_run, toy_models  # noqa: E402


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    root = tmp_path_factory.mktemp("run")
    models = toy_models(root / "toys", 4)
    made = make_run(root, ["alum-bronze", "pvc", "null"], models, failed=("pvc", "toy_03"), title=HOSTILE, size=24)
    made.published = ROOT / "config" / "published" / "bilgili2011"
    made.write_site()
    return made


class Tags(HTMLParser):
    """Tags and text of a page, as a browser would see them."""

    def __init__(self, path: Path):
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.text = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


# --- numbers --------------------------------------------------------------------------------------------------------


def errors_table(rows) -> pd.DataFrame:
    columns = ["material", "model", "scene", "status", "psnr_db", "psnr_se_db"]
    return pd.DataFrame(rows, columns=columns)


def test_scores_are_means_with_the_error_of_the_mean():
    table = errors_table(
        [
            ("a", "x", "s", "ok", 30.0, 0.3),
            ("a", "x", "t", "ok", 40.0, 0.4),
            ("a", "y", "s", "failed", math.nan, math.nan),
            ("a", "z", "s", "ok", 60.0, math.inf),
        ]
    )
    scores = score_models(table)
    assert scores["x"]["psnr_db"].mean == 35
    assert scores["x"]["psnr_db"].error == pytest.approx(0.25), "independent errors add in squares"
    assert "y" not in scores
    assert math.isinf(scores["z"]["psnr_db"].error), "a lower bound stays one"
    assert formats.with_error(60.0, math.inf) == "≥ 60.0"


def test_a_perfect_fit_stands_in_the_pareto_figure():
    """An error of 0 has no place on a logarithmic axis: it stands at the end of it."""
    models = ("lambert", "ward")
    rows = [("a", model, "s", "ok", 40.0, 0.1, error) for model, error in zip(models, (0.0, 2.0), strict=True)]
    errors = pd.DataFrame(rows, columns=["material", "model", "scene", "status", "psnr_db", "psnr_se_db", "de00_mean"])
    fits = pd.DataFrame([("a", model, "ok", 12 * i, i) for i, model in enumerate(models, 1)])
    fits.columns = ["material", "model", "status", "bytes", "seconds"]
    figure = pareto_figure(Summary({name: model_facts(name) for name in models}, errors, fits, {"a": "diffuse"}))
    assert b">Lambert<" in figure
    errors["de00_mean"] = 0.0
    assert b">Lambert<" in pareto_figure(Summary({"lambert": model_facts("lambert")}, errors, fits, {"a": ""}))


def test_a_paper_is_called_by_last_names_and_an_organisation_by_all_of_its_own():
    shorts = {name: model_facts(name).paper for name in ("ggx", "gltf", "principled")}
    assert shorts == {"ggx": "Dupuy et al. 2015", "gltf": "Khronos 2022", "principled": "Burley 2012"}


def test_pareto_front_is_what_brute_force_finds():
    rng = np.random.default_rng(1)
    for higher in (True, False):
        points = {str(i): (float(x), float(y)) for i, (x, y) in enumerate(rng.integers(0, 12, (40, 2)))}
        points["twin"] = points[pareto_front(points, higher)[0]]
        sign = 1 if higher else -1
        front = pareto_front(points | {"no": (math.nan, 1.0)}, higher)
        brute = {
            name
            for name, p in points.items()
            if not any(q != p and q[0] <= p[0] and sign * q[1] >= sign * p[1] for q in points.values())
        }
        assert set(front) == brute
        assert "twin" in brute


@pytest.mark.parametrize(
    ("value", "shown"),
    [(None, "–"), (math.nan, "–"), (math.inf, "∞"), (0, "0"), (0.00123456, "0.001235"), (123456.7, "123457")],
)
def test_numbers_for_people(value, shown):
    assert formats.number(value) == shown
    assert formats.digits(-1.26, 1) == "−1.3"
    assert formats.digits(3.2e-6, None) == "3.20 · 10⁻⁶", "an error that is not 0 never reads as 0"
    assert formats.error(1e-5) == "< 0.001"
    assert formats.storage(3264) == "3.26 kB"


def test_formulas_read_like_formulas():
    assert str(formats.formula("rho_d + cos^4 theta_h; D = a^(-C)")) == (
        "ρ<sub>d</sub> + cos<sup>4</sup> θ<sub>h</sub>\nD = a<sup>-C</sup>"
    )
    assert str(formats.formula(r"\frac{D(\theta_h)}{4}")) == "(D(θ<sub>h</sub>)) / (4)"
    assert "<script>" not in str(formats.formula("a < b; <script>"))


def test_formulas_of_all_models_are_mathml():
    """Well-formed, with every name and number of the statement; a statement in words stays text."""
    for name in MODELS:
        for statement in re.split(r";\s+", MODELS[name].formula):
            root = ElementTree.fromstring(f"<body>{mathml.mathml(statement)}</body>")
            told = "".join(root.itertext())
            for word in re.findall(r"[A-Za-z]+|\d+", re.sub(r"sqrt|sum|frac|\\[a-z]+|[,;!]", "", statement)):
                assert formats.SIGNS.get(word, word) in told, (name, statement, word)
            assert ("<math" in mathml.mathml(statement)) == (not mathml.WORDS.search(statement)), statement


def test_formulas_are_read_as_they_are_written():
    def shown(text: str) -> str:
        return re.sub(r"<mspace[^>]*></mspace>|</?mrow>", "", mathml.statement_as_mathml(text))

    assert shown("kd/pi + A B / (2 C)") == (
        "<mfrac><mi>kd</mi><mi>π</mi></mfrac><mo>+</mo><mfrac><mi>A</mi><mi>B</mi><mn>2</mn><mi>C</mi></mfrac>"
    )
    assert shown("t^-p") == "<msup><mi>t</mi><mo>−</mo><mi>p</mi></msup>"
    assert shown("sum_j D_j") == "<munder><mo>∑</mo><mi>j</mi></munder><msub><mi>D</mi><mi>j</mi></msub>"
    assert "&lt;script" in mathml.mathml("<script>alert(1)</script>")
    assert "<p" in mathml.mathml("(" * 5000), "what cannot be parsed is shown as it is"
    for broken in ("a +", "(a", "a)", "/ b", "a ? b"):
        with pytest.raises(mathml.FormulaError):
            mathml.statement_as_mathml(broken)


def test_tables_survive_writing_and_reading(tmp_path):
    """Also a material called null and the three kinds of numbers that are none."""
    table = errors_table([("null", "NA", "1", "ok", math.inf, 0.0), ("nan", "m", "s", "ok", 1 / 3, math.nan)])
    write_tsv(tmp_path / "t.tsv", table)
    again = read_tsv(tmp_path / "t.tsv")
    assert list(again["material"]) == ["null", "nan"]
    assert list(again["model"]) == ["NA", "m"]
    assert again["psnr_db"][0] == math.inf
    assert again["psnr_db"][1] == pytest.approx(1 / 3, rel=1e-8)
    assert math.isnan(again["psnr_se_db"][1])


def test_published_figures_are_found():
    folder = ROOT / "config" / "published" / "bilgili2011"
    row = published_row(folder, "ward", "alum-bronze")
    assert row["alpha_3"] == 0.017165
    assert row["psnr_db"] == 25.47534
    assert published_row(folder, "tucker", "alum-bronze") == {"psnr_db": 37.8664}
    assert published_row(folder, "ward", "no such") == {}


def test_strips_keep_order_and_extremes():
    made = strip("n", [1.0, 10.0, 100.0, 1000.0])
    assert made["log"]
    xs = [x for x, _ in made["dots"]]
    assert (xs[0], xs[-1]) == (6.0, 294.0)
    assert np.allclose(np.diff(xs), 96)


# --- pages ----------------------------------------------------------------------------------------------------------


def test_names_are_text_everywhere(run):
    for path in run.reports.rglob("*.html"):
        page = Tags(path)
        scripts = [a for tag, a in page.tags if tag == "script"]
        assert all("src" in a or a.get("type") == "application/json" for a in scripts), path.name
        assert not any(tag == "b" and "class" not in a for tag, a in page.tags if "models" in path.parts), path.name
    assert HOSTILE in Tags(run.reports / "materials/alum-bronze.html").text


def test_standins_carry_their_mark(run):
    """Every row and every title of a stand-in; never a measured material."""
    standin, measured = (Tags(run.reports / f"materials/{name}.html") for name in ("alum-bronze", "null"))
    assert "not a measurement" in standin.text
    assert "stand-in" not in measured.text.lower()
    index = Tags(run.reports / "index.html")
    assert "2 of 3 materials are stand-ins" in index.text
    marks = [a for tag, a in index.tags if tag == "span" and "standin" in a.get("class", "")]
    assert len(marks) >= 3
    table = pd.read_csv(run.reports / "data/materials.tsv", sep="\t", keep_default_na=False)
    table = table.set_index("material")["standin"]
    assert dict(table) == {"alum-bronze": 1, "pvc": 1, "null": 0}


def test_bounds_that_a_fit_has_reached_stand_beside_its_parameters(run):
    page = run.reports / "materials/null.html"
    assert "At a bound: kd (red) = 1." in Tags(page).text
    told = (
        f"{formats.integer(1204)} of {formats.integer(2700)} values of D lie at the lower bound, {formats.number(1e-6)}"
    )
    assert f"{told} of the largest value." in Tags(page).text
    assert page.read_text().count('class="note small bounds"') == 2, "and beside no other"


def test_a_rows_option_is_not_called_the_default_and_given_parameters_are_not_called_fitted():
    with MODELS.restored():
        rows = {
            "ggx-quirk": {"model": "ggx", "fresnel": "egsr2015"},
            "ggx_diffuse-given": {"model": "ggx_diffuse", "parameters": "config/published/bilgili2011/ward.csv"},
        }
        MODELS.use(Entry.of(name, row) for name, row in rows.items())
        quirk, given = (model_facts(name) for name in rows)
    plain = model_facts("ggx")
    assert [option["default"] for option in quirk.options] == [option["default"] for option in plain.options]
    assert given.options == ()
    numbers = {measure.key: 1.0 for measure in MEASURES}
    errors = pd.DataFrame([{"material": "a", "model": given.name, "scene": "s", "status": "ok", **numbers}])
    fits = pd.DataFrame({"material": ["a"], "model": [given.name], "status": ["ok"], "bytes": [28], "seconds": [0.01]})
    for facts, words in ((given, "given, not fitted"), (replace(given, given=False), "fitted in")):
        summary = Summary({given.name: facts}, errors, fits, {"a": ""})
        assert words in model_lede(facts, summary, [{"rank": 1, "reason": ""}])


def test_failures_quirks_and_left_out_files_show(run):
    page = Tags(run.reports / "materials/pvc.html").text
    assert "no finite fit for" in page
    assert "did not converge (cap reached)" in page
    assert "option quirk = yes: reproduces a misprint" in page
    index = Tags(run.reports / "index.html").text
    assert "12 bytes" in index
    assert "ours" in index
    assert "not reciprocal" in index
    assert "reference, other seed" in index


def test_pages_show_the_numbers_of_their_tables(run):
    """Whatever number stands in a material's table of errors is the one in the TSV that the page links."""
    page = run.reports / "materials/null.html"
    table = read_tsv(run.reports / "data/materials/null/errors.tsv")
    source = read_tsv(run.root / "results/errors/null.tsv")
    pd.testing.assert_frame_equal(table, source, rtol=1e-8)
    links = [a["href"] for tag, a in Tags(page).tags if tag == "a" and "href" in a]
    assert "../data/materials/null/errors.tsv" in links
    values = [float(a["data-value"]) for tag, a in Tags(page).tags if tag == "td" and a.get("data-value")]
    for measure in MEASURES:
        for value in table[measure.key]:
            assert any(math.isclose(value, shown, rel_tol=1e-8) for shown in values), measure.key


def test_published_stand_beside_ours(tmp_path):
    models = ["ward", "cook_torrance"]
    made = make_run(tmp_path, ["chrome"], models, ("studio",), size=16)
    path = tmp_path / "results/fits/chrome/ward.json"
    ours = {"kd": [0.1, 0.2, 0.3], "ks": [0.4, 0.5, 0.6], "alpha": [0.7, 0.8, 0.9]}
    path.write_text(json.dumps(json.loads(path.read_text()) | {"parameters": ours}))
    made.published = ROOT / "config" / "published" / "bilgili2011"
    text = Tags(made.write_material("chrome")).text
    assert "published" in text
    table = pd.read_csv(made.reports / "data/materials/chrome/published.tsv", sep="\t")
    ward = table[table["model"] == "ward"].set_index("parameter")
    assert ward.loc["alpha_2", "ours"] == 0.8
    published = pd.read_csv(made.published / "ward.csv").set_index("material").loc["chrome"]
    assert ward.loc["kd_g", "published"] == published["kd_g"]
    assert ward.loc["psnr_db", "published"] == published["psnr_db"]


def test_a_page_needs_its_own_material_only(tmp_path):
    """The first page is out before another material has any file."""
    models = toy_models(tmp_path / "toys", 2)
    made = make_run(tmp_path, ["first"], models, ("studio",), size=16)
    made.materials = ["first", "second"]
    assert "second" in Tags(made.write_material("first")).text


def summary_of(run, materials=None):
    return summarise_run(materials or run.read(), {name: model_facts(name) for name in run.models})


def test_findings_name_the_best_model_of_those_that_have_every_picture(run):
    """toy_03 has the lowest colour difference, over the easier pictures: it lost a material."""
    materials, summary = run.read(), summary_of(run)
    rows, tables = run_tables({}, materials, summary)
    errors = tables["errors"].query("status == 'ok' and model != 'reference_again'")
    middles = errors.groupby(["model", "material"])["de00_mean"].mean().groupby("model").median()
    assert middles.idxmin() == "toy_03"
    middles = middles.drop("toy_03")
    text = findings(materials, summary)
    assert text.startswith(
        f"{MODELS[middles.idxmin()].title} comes closest to the references (ΔE00 {middles.min():.2f}"
    )
    assert text.endswith("failed fits or renders: Toy 3.")
    best = [row["name"] for row in rows if LEADING.key in row["best"]]
    assert best == [middles.idxmin()]
    order = [row["name"] for row in rows]
    assert order == [*middles.sort_values().index, "toy_03", "reference_again"], "best first, what lacks pictures last"
    assert {row["name"]: row["missing"] for row in rows}["toy_03"] == len(run.scenes)


def test_equal_errors_have_one_rank():
    values = {"a": 0.5, "b": 0.0, "c": 0.0, "d": 0.7}
    assert [rank_of(name, values) for name in "abcde"] == [3, 1, 1, 4, None]


def test_a_picture_without_light_is_no_fault_of_a_model(tmp_path):
    """The reference of one material is black in one of two scenes, of another in both: no model has failed, means say
    over what they are, and the place of each number has it, or the reason."""
    names = toy_models(tmp_path / "toys", 2)
    run = make_run(tmp_path, ["half", "black", "whole"], names, size=16)
    blacken(run, "half", "grove")
    blacken(run, "black", "studio", "grove")
    materials = run.read()
    summary = summary_of(run, materials)
    text = findings(materials, summary)
    assert "the median over 2 materials" in text
    assert "failed" not in text
    found = list_failures(materials, summary.models)
    assert [(item["material"], item["model"]) for item in found] == [("half", ""), ("black", "")]
    atlas = atlas_script(materials, summary, run.scenes, [*map(run.listing, run.materials)])
    assert atlas["unjudged"] == dict.fromkeys(["half/grove", "black/studio", "black/grove"], "black there")

    page = Tags(run.write_material("half")).text
    lede = page[: page.index("Get the fit")]
    assert "mean over" not in lede
    assert "Cannot be judged: grove (black there)." in lede
    assert "Cannot be judged: studio (black there), grove (black there)." in Tags(run.write_material("black")).text
    assert (
        "failed"
        not in pdf._material_table(
            materials[0],
            summary_of(run, materials[:1]),
            make_entries(materials[0], summary, run.scenes, None),
            run.scenes,
        )["rows"][0]["cells"][0]
    )
    for name in names:
        page = Tags(run.write_model(name)).text
        assert "the median over 2 materials" in page
        assert "It failed" not in page
        mean = summary.value(name, LEADING, "half")
        assert f"{mean:.2f}" in page[page.index("half", page.index("Materials")) :]
        assert page.count("black there") == 2  # the material of which nothing can be judged, both scenes


def test_a_row_without_parameters_for_a_material_has_not_failed(run, tmp_path):
    def without(material, model):
        fits = {name: record for name, record in material.fits.items() if name != model}
        errors = material.errors[material.errors["model"] != model]
        return replace(material, fits=fits, errors=errors, absent={model: "a.csv has no parameters for it"})

    first, *rest = run.read()
    materials = [without(first, "toy_02"), *rest]
    summary = summary_of(run, materials)
    text = findings(materials, summary)
    assert "failed fits or renders: Toy 3." in text
    assert text.endswith("some materials have no parameters for them: Toy 2.")
    atlas = atlas_script(materials, summary, run.scenes, [*map(run.listing, run.materials)])
    assert atlas["absent"] == [f"{first.name}/toy_02"]
    assert atlas["reasons"][f"{first.name}/toy_02"] == "a.csv has no parameters for it"
    assert f"{first.name}/toy_02" not in {
        f"{f['material']}/{f['model']}" for f in list_failures(materials, summary.models)
    }

    for status in ("absent", "failed"):
        (tmp_path / f"{status}.npz").write_bytes(b"")
        write_json(tmp_path / f"{status}.json", {"status": status, "reason": "why"})
    fits = [("a", "toy_01", tmp_path / "absent.npz"), ("a", "toy_02", tmp_path / "failed.npz")]
    write_json(tmp_path / "a.json", {"name": "a"})
    counts = write_viewer(
        tmp_path / "viewer.html", data=tmp_path, fits=fits, materials={"a": tmp_path / "a.json"}, scenes=[]
    )
    assert counts["failed"] == 1


def test_an_infinite_psnr_is_never_printed_as_a_word(run):
    materials = run.read()
    for material in materials:
        at = material.errors.index[material.errors["model"] == "toy_00"]
        material.errors.loc[at, ["psnr_db", "psnr_se_db"]] = (math.inf, 0.0)
    summary = summary_of(run, materials)
    assert not re.search(r"\b(inf|nan)\b", findings(materials, summary))
    assert formats.digits(summary.scores["toy_00"]["psnr_db"].median, 1) == "∞"


def test_a_colour_difference_leads_and_psnr_does_not(run):
    """A model with the highest PSNR everywhere and the largest colour difference is last."""
    materials = run.read()
    for material in materials:
        at = material.errors.index[material.errors["model"] == "toy_00"]
        material.errors.loc[at, ["psnr_db", "de00_mean"]] = (300.0, 50.0)
    summary = summary_of(run, materials)
    assert summary.order()[-2:] == ["toy_00", "toy_03"]
    assert summary.best() != ["toy_00"]
    anything = [budget.key for budget in BUDGETS].index("any")
    assert all(summary.recommend([material.name])[anything] != "toy_00" for material in materials)


def test_values_that_print_alike_are_best_together():
    assert best_of({"a": 0.001, "b": 0.004, "c": 0.01, "d": math.nan}, LEADING) == ["a", "b"]
    assert best_of({}, LEADING) == []
    assert median([3.0, None, 1.0, math.nan, 2.0, 9.0]) == 2.5, "of the known values, the mean of the middle two"


def test_every_recommendation_meets_its_conditions_and_none_is_better(run):
    """Brute force over the fits of each material."""
    materials, summary = run.read(), summary_of(run)
    script = atlas_script(materials, summary, run.scenes, [*map(run.listing, run.materials)])
    for bits, switches in enumerate(switch_settings()):
        assert [bool(bits & 2**i) for i in range(3)] == list(switches.values())
        for j, material in enumerate(materials):
            for b, budget in enumerate(BUDGETS):
                fit = {
                    name: summary.candidate(name, material.name)
                    for name in run.models
                    if summary.candidate(name, material.name) is not None
                }
                kept = [
                    c.de00
                    for c in fit.values()
                    if (budget.bytes is None or c.bytes <= budget.bytes)
                    and (c.targets or not budget.engine)
                    and (c.reciprocal or not switches["reciprocal"])
                    and not (switches["published"] and c.status.startswith("ours"))
                    and (c.max_albedo <= 1.001 or not switches["energy"])
                ]
                place = script["recommended"][bits][j][b]
                assert (place >= 0) == bool(kept)
                if kept:
                    assert fit[run.models[place]].de00 <= min(kept) + 0.01


def test_fits_are_copied_with_their_parameters(tmp_path):
    """Every good fit below reports/, readable again, tables not as text. What somebody has put beside them stays, a
    table as text too, and no page takes it for the run's."""
    values = {"kd": np.full(3, 0.25, np.float32), "ks": np.full(3, 0.5, np.float32)}
    values["alpha"] = np.full(3, 0.1, np.float32)
    from brdfatlas import Fit, load_fit
    from brdfatlas.export.fit_json import import_json

    Fit("ward", "chrome", values).save(tmp_path / "ward.npz")
    Fit("bivariate", "chrome", {"b": np.ones((3, 90, 90), np.float32)}).save(tmp_path / "bivariate.npz")
    (tmp_path / "ggx.npz").write_bytes(b"")
    out = tmp_path / "chrome/fits"
    (out / "textures").mkdir(parents=True)
    own = ("chrome-bivariate.json", "ward.blend", "textures/a.png")
    for name in own:
        (out / name).write_bytes(b"left")
    models = ["ward", "bivariate", "ggx"]
    fit_files_job([tmp_path / f"{name}.npz" for name in models], out, tmp_path / "listing.json")
    assert {(out / name).read_bytes() for name in own} == {b"left"}
    assert files_of(tmp_path / "listing.json", "chrome", models) == [[".npz", ".json"], [".npz"], []]
    assert (out / "chrome-bivariate.npz").exists()
    assert load_fit(out / "chrome-ward.npz") == import_json(out / "chrome-ward.json")


def test_no_link_is_escaped_twice(run):
    for path in run.reports.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        assert "&amp;amp;" not in text, path.name
        for tag, attributes in Tags(path).tags:
            if tag == "a" and "compare.html#" in attributes.get("href", ""):
                assert re.search(r"#m=[^&;]+(&[a-z]=[^&;]+)*$", attributes["href"]), attributes["href"]


def test_storage_is_what_the_fits_store(tmp_path):
    """A model of variable size: the median of the run, each material's own on the charts, failed fits left out."""
    made = make_run(tmp_path, ["chrome", "nylon", "pvc", "felt"], ["lawrence"], ("studio",), pictures=False)
    for material, stored in (("chrome", 3072), ("nylon", 1536), ("pvc", 2304)):
        path = tmp_path / f"results/fits/{material}/lawrence.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"bytes": stored}))
    path = tmp_path / "results/fits/felt/lawrence.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"status": "failed", "bytes": 9999}))
    materials, summary = made.read(), summary_of(made)
    rows, tables = run_tables({}, materials, summary)
    assert rows[0]["bytes"] == tables["models"]["bytes"][0] == 2304
    assert math.isnan(tables["models"]["free_parameters"].astype(float)[0]), "the material decides"
    atlas = atlas_script(materials, summary, made.scenes, [*map(made.listing, made.materials)])
    assert atlas["bytes"] == [[3072], [1536], [2304], [None]]
    assert "1 536 to 3 072 bytes in this run" in Tags(made.write_model("lawrence")).text


def test_script_of_the_index_holds_every_number(run):
    materials = run.read()
    script = (run.reports / "data/atlas.js").read_text()
    atlas = json.loads(script.removeprefix("window.ATLAS=").rstrip(";\n"))
    count = len(run.models) + 1
    for s, scene in enumerate(run.scenes):
        for j, material in enumerate(materials):
            rows = material.errors.set_index(["scene", "model"])
            for k, model in enumerate([*run.models, "reference_again"]):
                for measure in MEASURES:
                    value = atlas["values"][measure.key][(s * len(materials) + j) * count + k]
                    expected = rows.loc[(scene.name, model), measure.key]
                    assert value == pytest.approx(expected, rel=1e-3) if value is not None else math.isnan(expected)
    assert "<" not in script
    best = best_rows(pd.concat(material.errors for material in materials), run.models, measure="psnr_db")
    assert len(atlas["best"]) == len(best) >= len(run.scenes) * len(materials)


def test_linear_light_travels_as_a_script(run):
    folder = run.reports / "materials/pvc"
    path = folder / "renders/grove/toy_01/hdr.js"
    assert path.read_text("utf-16").startswith('window.ATLAS_HDR("pvc/grove/toy_01",')
    radiance = read_hdr(folder, "grove", "toy_01")
    assert radiance.shape == (24, 24, 3)
    assert radiance.max() > 1
    assert not (folder / "renders/grove/toy_03/hdr.js").exists(), "a failed fit has no picture"


# --- PDF --------------------------------------------------------------------------------------------------------------


def build_pdf(run, folder: Path) -> Path:
    parts = []
    for material in run.materials:
        part = folder / f"{material}.pdf"
        write_material_pdf(
            part, **run.of(material), assets=run.reports / "assets", models=run.models, scenes=run.scenes
        )
        parts.append(part)
    record = run.root / "results/run.json"
    write_supplement(
        folder / "all.pdf", run_file=record, materials=run.read(), parts=parts, models=run.models, scenes=run.scenes
    )
    return folder / "all.pdf"


def test_pdf_has_its_pages_and_is_reproducible(run):
    """Overview and models; then fits, the reference in every slot, curves and numbers, parameters of each material."""
    first = build_pdf(run, run.root / "pdf1")
    assert first.read_bytes() == build_pdf(run, run.root / "pdf2").read_bytes(), "no clock, no chance"
    parts = sum(path.stat().st_size for path in first.parent.glob("*.pdf") if path != first)
    assert first.stat().st_size < parts + 100_000, "joining adds overview and numbers, nothing unpacked"
    reader = PdfReader(first)
    assert len(reader.pages) == 2 + 4 * len(run.materials)
    texts = [" ".join(page.extract_text().split()) for page in reader.pages]
    assert "Recommended model per budget" in texts[0]
    assert "Contents" not in " ".join(texts), "no contents page for few materials"
    assert HOSTILE.split("&")[0].strip() in texts[2]
    assert "stand-in, not a measurement" in texts[2]
    assert "stand-in, not a measurement" not in texts[2 + 4 * 2]
    assert "no finite fit" in texts[2 + 4]
    assert texts[3].endswith("4"), "pages are numbered"
    assert "albedo" in texts[5], "parameters with their meaning"
    assert next(item.title for item in reader.outline) == "Overview"
    assert len(reader.outline) == 1 + len(run.materials)


def test_paging_flips_between_fits_and_the_reference(run):
    """The second page of a material has the same words at the same places, and one picture in every slot."""
    made = build_pdf(run, run.root / "pdf3")
    fits, flipped = PdfReader(made).pages[2:4]

    def placed(page):
        found = []
        page.extract_text(visitor_text=lambda text, _cm, tm, _f, _s: found.append((text.strip(), tm[4], tm[5])))
        return [item for item in found if item[0]]

    first, second = placed(fits)[4:-4], placed(flipped)[4:-4]
    titles = {MODELS[name].title for name in run.models}
    assert {item for item in first if item[0] in titles} == {item for item in second if item[0] in titles}
    pictures = [{hashlib.sha256(image.data).hexdigest() for image in page.images} for page in (fits, flipped)]
    maps = len(run.models)
    assert len(pictures[0]) == 1 + 2 * maps, "reference, renders, maps"
    assert len(pictures[1]) == 1 + maps, "reference, maps"


def test_a_long_pdf_has_contents_that_lead_to_its_materials(tmp_path):
    models = toy_models(tmp_path / "toys", 2)
    made = make_run(tmp_path, [f"m-{i:02d}" for i in range(13)], models, ("studio",), size=16)
    reader = PdfReader(build_pdf(made, tmp_path / "pdf"))
    assert "Contents" in reader.pages[2].extract_text()
    links = [a.get_object() for a in reader.pages[2].get("/Annots", [])]
    assert len(links) == len(made.materials)
    heights = [float(link["/Rect"][1]) for link in links]
    assert heights == sorted(heights, reverse=True), "a link over each line, from the top"
    assert min(heights) > 0


def test_contents_lead_to_materials_whose_names_end_in_numbers(tmp_path):
    """A title "sample 40" is no page number."""
    models = toy_models(tmp_path / "toys", 2)
    made = make_run(tmp_path, [f"sample-{i}" for i in range(40, 53)], models, ("studio",), size=16)
    reader = PdfReader(build_pdf(made, tmp_path / "pdf"))
    links = [a.get_object() for a in reader.pages[2]["/Annots"]]
    places = {page.indirect_reference.idnum: number for number, page in enumerate(reader.pages)}
    found = [places[list.__getitem__(link["/Dest"], 0).idnum] for link in links]
    assert found == [3 + 4 * i for i in range(len(made.materials))]


def test_a_long_paragraph_of_the_pdf_is_not_cut_off(monkeypatch, run):
    """It is as high as two lines of the usual size; what is longer is set smaller."""
    found = {}
    monkeypatch.setattr(pdf, "_write", lambda path, content: found.update({path: content}))
    monkeypatch.setattr(pdf, "material_lede", lambda *_: "Many words of a lede, " * 40 + "andtheend")
    name = run.materials[0]
    write_material_pdf("out", **run.of(name), assets=run.reports / "assets", models=run.models, scenes=run.scenes)
    heights = {}

    def visit(text, cm, tm, _font, _size):
        for word in ("andtheend", "Renderings"):
            if word in text:
                heights[word] = tm[4] * cm[1] + tm[5] * cm[3] + cm[5]

    PdfReader(io.BytesIO(found["out"])).pages[0].extract_text(visitor_text=visit)
    assert heights["andtheend"] > heights["Renderings"] + 10


def test_labels_are_moved_apart_and_no_further():
    """Order kept, gap kept, mean kept; labels with room stay where they are."""
    heights = [0.9, 0.52, 0.51, 0.5, 0.1]
    placed = spread(heights, 0.05)
    assert all(a - b >= 0.05 - 1e-12 for a, b in itertools.pairwise(placed))
    assert sum(placed) == pytest.approx(sum(heights))
    assert spread([0.9, 0.5, 0.1], 0.05) == [0.9, 0.5, 0.1]
    assert spread([], 0.05) == []


@pytest.mark.parametrize("models", [1, 4, 12, 22, 40])
def test_all_tiles_fit_one_page(models):
    columns = tile_columns(models + 1, models)
    rows = math.ceil((models + 1) / columns) + math.ceil(models / columns)
    assert rows * (WIDTH / columns + CAPTION) <= HEIGHT, "A4 less margins, title and headings"


def test_physics_of_a_fit_is_the_largest_albedo_and_none_where_it_was_not_checked():
    checks = {"reciprocity_error": 0.0, "max_albedo": [0.2, 1.1, 0.3], "bad_cells": 0.25}
    assert physics_of({"physics": checks}) == checks | {"max_albedo": 1.1}
    nothing = dict.fromkeys(checks)
    assert physics_of(None) == physics_of({"status": "failed"}) == nothing
    assert physics_of({"physics": checks | {"max_albedo": [0.2, None, 0.1]}})["max_albedo"] is None, "NaN in JSON"


def test_bounds_of_parameters_are_typeset():
    texts = [item["range"] for item in model_facts("sgd").parameters]
    assert "−100 … 100" in texts
    assert not any("-" in text for text in texts), "a minus is no hyphen"
