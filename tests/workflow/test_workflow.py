"""The pipeline as a whole: lint, plan, run, nothing left to do, and exactly what each kind of change reruns."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml


def change(path, text):
    """Append ``text`` to a file and return a function that puts the old content back with its time stamp."""
    old, status = path.read_bytes(), path.stat()
    path.write_bytes(old + text.encode())

    def restore():
        path.write_bytes(old)
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))

    return restore


def test_lint_is_clean(project):
    assert "Congratulations" in project.snakemake("--lint").stdout


def test_dry_run_plans_a_job_a_material_and_paper_and_all_renders_of_a_scene_at_once(project):
    project.configure(models=["ggx", "gaussian", "ward"])
    planned = project.planned()
    assert planned["make_standin"] == 2
    assert planned["fit_dupuy2015"] == planned["fit_three_lobe"] == 2
    assert planned["render_material"] == 2


def test_the_index_alone_waits_for_the_fits_that_it_links(project):
    """Else it has no link to them, and the next run would leave it so."""
    assert project.planned("reports/index.html")["write_fits"] == 2


def test_the_main_process_looks_for_work_when_a_job_ends_and_at_no_other_time(project):
    """Snakemake's limit of jobs a second would let it look once a second more with every job that has ended."""
    said = project.snakemake("--verbose", "--until", "fit_dupuy2015").stdout
    ended = said.count("Finished jobid")
    assert ended == 4  # two stand-ins, two fits
    assert said.count("Ready jobs: ") <= ended + 2


def test_no_job_of_a_report_waits_for_two_cores_to_be_free(project):
    """One core becomes free at a time: jobs of one core, of later materials too, would always come first."""
    rules = "\n".join(path.read_text() for path in (project.root / "workflow" / "rules").glob("*.smk"))
    assert re.findall(r"^rule (\w+):(?:\n(?!rule).*)*?\n    threads:", rules, re.MULTILINE) == ["draw_animation"]


def test_bad_configuration_stops_before_any_work(project):
    project.configure(render={"sizes": 3})
    done = project.snakemake(check=False)
    assert done.returncode != 0
    assert "render" in done.stdout
    assert "known keys" in done.stdout
    assert not (project.root / "results").exists()


def test_a_bad_file_of_given_parameters_stops_before_any_work(project):
    (project.root / "mine.csv").write_text("hello\n")
    models = project.root / "config" / "models.yaml"
    models.write_text(models.read_text() + "mine: {model: ngan, parameters: mine.csv}\n")
    project.configure(models=["ggx", "mine"])
    done = project.snakemake(check=False)
    assert done.returncode != 0
    assert "mine.csv: " in done.stdout
    assert "brdfatlas/models" not in done.stdout, "the way through our code is not for users"
    assert not (project.root / "results").exists()


@pytest.mark.parametrize("key", ["measured_folder", "models_file", "scenes_file"])
def test_a_path_that_the_system_refuses_is_told_in_a_line(project, key):
    project.configure(**{key: "x" * 300})
    done = project.snakemake("--dry-run", check=False)
    assert done.returncode != 0
    assert "xxx: File name too long" in done.stdout
    assert "pathlib" not in done.stdout, "no way through the code"


def test_a_run_without_a_row_stops_before_any_work(project):
    header = "material,kd_r,kd_g,kd_b,ks_r,ks_g,ks_b,f0,m\n"
    (project.root / "mine.csv").write_text(f"{header}gold,1,1,1,1,1,1,0.5,0.1\n")
    (project.root / "mine.yaml").write_text("mine: {model: ngan, parameters: mine.csv}\n")
    project.configure(models="all", models_file="mine.yaml")
    done = project.snakemake("--dry-run", check=False)
    assert done.returncode != 0
    assert "models: no row is left to compare: mine.csv has no parameters for it" in done.stdout


@pytest.mark.parametrize(
    ("text", "words"),
    [("render: {samples: 010}\n", "010 would be read as 8"), ("seed: 3\nseed: 4\n", "'seed' stands twice")],
)
def test_what_snakemake_reads_otherwise_than_it_looks_stops_before_any_work(project, text, words):
    (project.root / "mine.yaml").write_text(text)
    done = project.snakemake("--configfile", "mine.yaml", check=False)
    assert done.returncode != 0
    assert re.search(rf"mine\.yaml: line \d: .*{words}", done.stdout)
    assert not (project.root / "results").exists()


def test_end_to_end_makes_the_report(finished_run):
    index = (finished_run.root / "reports" / "index.html").read_text()
    for name in ("pink-felt", "chrome"):
        assert name in index
        assert (finished_run.root / "reports" / "materials" / f"{name}.html").is_file()
    assert "stand-in" in index


def test_second_run_has_nothing_to_do(finished_run):
    assert finished_run.planned() == {}
    assert "Nothing to be done" in finished_run.snakemake().stdout


def test_a_models_source_refits_that_model_only(finished_run):
    restore = change(finished_run.root / "src" / "brdfatlas" / "models" / "dupuy2015" / "ggx.py", "\nCHANGED = 1\n")
    try:
        planned = finished_run.planned()
    finally:
        restore()
    assert planned["fit_dupuy2015"] == 2
    assert planned["render_material"] == 2
    assert not {"make_standin", "describe_material", "prepare_scene"} & planned.keys()
    assert finished_run.planned() == {}


def test_words_rerun_nothing(finished_run):
    """Comments in a model, in the renderer and in a page's code."""
    source = finished_run.root / "src" / "brdfatlas"
    names = ("models/dupuy2015/ggx.py", "rendering/integrator.py", "reports/site.py")
    restores = [change(source / name, "\n# only words\n") for name in names]
    try:
        assert finished_run.planned() == {}
    finally:
        for restore in restores:
            restore()


def test_a_shared_solver_refits_what_uses_it(finished_run):
    restore = change(
        finished_run.root / "src" / "brdfatlas" / "models" / "dupuy2015" / "power_iteration.py", "\nCHANGED = 1\n"
    )
    try:
        planned = finished_run.planned()
    finally:
        restore()
    assert planned["fit_dupuy2015"] == 2


def test_the_error_measures_rerun_errors_but_no_fit_and_no_render(finished_run):
    restore = change(finished_run.root / "src" / "brdfatlas" / "measures" / "errors.py", "\nCHANGED = 1\n")
    try:
        planned = finished_run.planned()
    finally:
        restore()
    assert not any(name.startswith("fit_") for name in planned)
    assert "render_material" not in planned
    assert any(name.startswith("measure") for name in planned)


def with_config(run, **changes):
    """Jobs planned under a changed configuration, which is put back."""
    path = run.root / "config" / "config.yaml"
    old = path.read_text()
    try:
        run.configure(**changes)
        return run.planned()
    finally:
        path.write_text(old)


def test_a_new_model_costs_that_model_only(finished_run):
    planned = with_config(finished_run, models=["ggx", "gaussian", "tabulated"])
    assert planned["fit_dupuy2015"] == 2
    assert planned["render_material"] == 2


def test_a_new_material_costs_that_material_only(finished_run):
    planned = with_config(finished_run, materials=["pink-felt", "chrome", "nylon"])
    assert planned["make_standin"] == 1
    assert planned["fit_dupuy2015"] == 1
    assert planned["render_material"] == 1
    assert planned["write_material_page"] == 2, "its own, and that of chrome, which links to it"
    assert planned["draw_pictures"] == planned["draw_figures"] == 1


def test_a_template_reruns_what_is_made_of_it(finished_run):
    """Pages and PDF have templates of their own."""
    templates = finished_run.root / "src" / "brdfatlas" / "reports" / "templates"
    targets = ["--", "reports/materials/chrome.html", "results/pdf/chrome.pdf"]
    finished_run.snakemake(*targets)
    for name, page, pdf in (("material.html.j2", True, False), ("supplement.typ", False, True)):
        restore = change(templates / name, "\n")
        try:
            planned = finished_run.planned(*targets)
        finally:
            restore()
        assert ("write_material_page" in planned, "typeset_material" in planned) == (page, pdf), name


def test_a_new_scene_fits_nothing(finished_run):
    scenes = list(yaml.safe_load((finished_run.root / "config" / "scenes.yaml").read_text()))
    other = next(name for name in scenes if name != "studio_sphere")
    planned = with_config(finished_run, scenes=["studio_sphere", other])
    assert not any(name.startswith("fit_") for name in planned)
    assert planned["prepare_scene"] == 1
    assert planned["render_material"] == 2


def test_an_option_of_a_model_refits_that_model_only(finished_run):
    path = finished_run.root / "config" / "models.yaml"
    old = path.read_text()
    models = yaml.safe_load(old)
    models["ggx"] = {"fresnel": "egsr2015"}
    try:
        path.write_text(yaml.safe_dump(models, sort_keys=False))
        planned = finished_run.planned()
    finally:
        path.write_text(old)
    assert planned["fit_dupuy2015"] == 2


def test_materials_are_finished_one_after_another(finished_run):
    """The first page is begun before the second material's errors are: what it needs comes first."""
    log = min((finished_run.root / ".snakemake" / "log").glob("*.log"))
    begun = [line.split(": ", 1)[1] for line in log.read_text().splitlines() if re.match(r"Job \d+: ", line)]
    assert len(begun) > 20, "the log of the whole run"
    assert begun.index("page of pink-felt") < begun.index("measuring the errors of chrome")


def test_snakemakes_own_report_has_the_main_results(finished_run, tmp_path):
    """With captions, categories and labels; the pictures and tables are in the file."""
    finished_run.snakemake("--report", str(tmp_path / "report.html"))
    text = (tmp_path / "report.html").read_text()
    labels = ["models, medians over the materials", "sorted errors of every model", "lobes of every model"]
    labels += ["image errors of every model", "wins and ties between models"]
    for words in [
        *labels,
        "Cubic root of the BRDF of chrome",
        "the reference against itself with other random numbers",
    ]:
        assert words in text


def test_manifest_says_what_is_needed_to_repeat_the_run(finished_run):
    run = json.loads((finished_run.root / "results" / "run.json").read_text())
    assert run["config"]["render"]["seed"] == 1
    assert run["versions"]["mitsuba"]
    assert all(len(item["sha256"]) == 64 and item["standin"] for item in run["inputs"])


def test_the_record_follows_a_commit(finished_run):
    """A commit costs the record and the pages that show it, nothing else."""
    root, record = finished_run.root, finished_run.root / "results" / "run.json"

    def git(*arguments: str) -> str:
        command = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c", *arguments]
        return subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout.strip()

    def recorded() -> str:
        finished_run.snakemake("--", "results/run.json")
        return json.loads(record.read_text())["revision"]

    assert recorded() == "unknown"
    git("init", "--quiet")
    try:
        git("add", "Snakefile")
        for _ in range(2):
            git("commit", "--quiet", "--allow-empty", "--message", "one more")
            planned = finished_run.planned()
            assert planned.keys() - {"all"} == {"record_run", "write_index", "check_failures", "record_reports"}
            assert recorded() == git("rev-parse", "--short=12", "HEAD")
    finally:
        shutil.rmtree(root / ".git")
        finished_run.snakemake()
    assert recorded() == "unknown"


@pytest.mark.slow
def test_a_model_of_an_installed_package_is_a_part_of_it_in_every_job(finished_run, tmp_path):
    """Its imports may be relative to its package."""
    package, project = tmp_path / "site" / "outside", type(finished_run)(tmp_path / "project")
    shutil.copytree(finished_run.root, project.root)
    package.mkdir(parents=True)
    text = (Path(__file__).resolve().parents[2] / "examples" / "lambertian.py").read_text()
    (package / "__init__.py").write_text("")
    (package / "bound.py").write_text("import numpy as np\n")
    (package / "lambertian.py").write_text(text.replace("import numpy as np", "from .bound import np"))
    info = package.parent / "outside-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: outside\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[brdfatlas.models]\nlambertian = outside.lambertian:Lambertian\n")
    with open(project.root / "config" / "models.yaml", "a", encoding="utf-8") as models:
        models.write("lambertian: {}\n")
    project.configure(models=["ggx", "lambertian"])
    path = os.pathsep.join([str(project.root / "src"), str(package.parent)])
    project.snakemake("--", "results/figures/chrome.json", PYTHONPATH=path)
    assert json.loads((project.root / "results/fits/chrome/lambertian.json").read_text())["status"] == "ok"
    assert "Lambertian" in (project.root / "reports/materials/chrome/lobes.svg").read_text()


@pytest.mark.slow
def test_a_model_of_ones_own_joins_with_one_line(finished_run, tmp_path):
    toy = Path(__file__).resolve().parents[2] / "examples" / "lambertian.py"
    path = finished_run.root / "config" / "models.yaml"
    old = path.read_text()
    name = next(line.split("=")[1].strip().strip("\"'") for line in toy.read_text().splitlines() if "name =" in line)
    try:
        path.write_text(old + f"{name}: {{source: {toy}}}\n")
        finished_run.configure(models=["ggx", "gaussian", name])
        target = f"results/fits/pink-felt/{name}.json"
        finished_run.snakemake("--", target)
        assert json.loads((finished_run.root / target).read_text())["status"] == "ok"
    finally:
        path.write_text(old)
        finished_run.configure(models=["ggx", "gaussian"])
