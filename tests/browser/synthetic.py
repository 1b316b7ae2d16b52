"""A run made up for tests of the report: the files that a run leaves, with numbers and small pictures of our own.

Spheres are shaded by a Phong-like formula, so that pages look like pages; nothing here is a fit or a measurement.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from brdfatlas.figures.pictures import apply_colours, hdr_levels, picture_file, write_bars, write_hdr, write_webp
from brdfatlas.files import write_text
from brdfatlas.fits import Fit
from brdfatlas.models import MODELS
from brdfatlas.reports.data import Material, SceneFacts, read_material
from brdfatlas.reports.fit_files import fit_files_job
from brdfatlas.reports.site import write_assets, write_compare, write_index, write_material_page, write_model_page

TOY_MODEL = """
from brdfatlas.models.base import Model, Option, Paper, Parameter, Result
import numpy as np


class Toy(Model):
    name = {name!r}
    title = {title!r}
    paper = Paper("Ada Toy, Bob Toy", "A Toy Model", "Journal of Toys", 2020)
    equations = "Eq. 1"
    formula = "rho = kd/pi; pi = 3.14"
    parameters = (Parameter("kd", (3,), "albedo", low=0, high=1), Parameter("n", ({count},), "exponents", low=1))
    options = {{"quirk": Option("no", "reproduces a misprint", ("no", "yes"))}}
    status = {status!r}
    reciprocal = {reciprocal!r}

    def fit(self, measured, *, seed=0, **options):
        return Result({{"kd": np.ones(3), "n": np.ones({count})}}, 0.0, "toy", 1, True)

    def evaluate(self, parameters, wi, wo):
        return np.ones((*wi.shape[:-1], 3)) * parameters["kd"] / np.pi
"""
HOSTILE = "<script>alert(1)</script> & \"co\" 'quoted'"
MEASURES = ["psnr_db", "psnr_se_db", "psnr_tonemapped_db", "de00_mean", "de00_p95", "flip_mean"]
MEASURES += ["ssim", "rmse", "rel_mse"]
BRDF_MEASURES = ["objective_compressive", "loew_e2", "cosine_weighted", "log_deviation"]


def toy_models(folder: Path, count: int) -> list[str]:
    """Register ``count`` toy models for this process; the second has a status, the third is not reciprocal."""
    names = []
    for i in range(count):
        name = f"toy_{i:02d}"
        title = f"Toy <b>{i}</b>" if i == 0 else f"Toy {i}"
        status = {1: "ours: an extension <i>of our own</i>"}.get(i, "")
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(TOY_MODEL.format(name=name, title=title, status=status, reciprocal=i != 2, count=4 + 40 * i))
        MODELS.register_file(name, path)
        names.append(name)
    return names


@dataclass
class Run:
    """Where the files of a made-up run lie, and how to make its pages."""

    root: Path
    materials: list[str]
    models: list[str]
    scenes: list[SceneFacts]
    failed: tuple[str, str] | None = None
    published: Path | None = None
    written: list[Path] = field(default_factory=list)

    @property
    def reports(self) -> Path:
        return self.root / "reports"

    def of(self, material: str) -> dict[str, object]:
        results = self.root / "results"
        return {
            "material_file": results / f"materials/{material}.json",
            "fit_files": [results / f"fits/{material}/{model}.json" for model in self.models],
            "errors_file": results / f"errors/{material}.tsv",
            "brdf_errors_file": results / f"errors/{material}.brdf.tsv",
            "pictures": self.reports / f"materials/{material}",
        }

    def listing(self, material: str) -> Path:
        return self.root / f"results/fit_files/{material}.json"

    def write_material(self, material: str) -> Path:
        page = self.reports / f"materials/{material}.html"
        write_material_page(
            page,
            **self.of(material),
            listing=self.listing(material),
            data=self.reports / "data",
            materials=self.materials,
            models=self.models,
            scenes=self.scenes,
            published=self.published,
        )
        return page

    def write_model(self, model: str) -> Path:
        page = self.reports / f"models/{model}.html"
        write_model_page(
            page,
            model=model,
            run=self.read(),
            pictures=self.reports / "materials",
            data=self.reports / "data",
            models=self.models,
            scenes=self.scenes,
        )
        return page

    def read(self) -> list[Material]:
        files = [self.of(material) for material in self.materials]
        return [
            read_material(f["material_file"], f["fit_files"], f["errors_file"], f["brdf_errors_file"]) for f in files
        ]

    def write_index(self) -> Path:
        write_index(
            self.reports / "index.html",
            run_file=self.root / "results/run.json",
            materials=self.read(),
            listings=[self.listing(material) for material in self.materials],
            data=self.reports / "data",
            models=self.models,
            scenes=self.scenes,
        )
        return self.reports / "index.html"

    def write_site(self) -> Path:
        """Every page of the report; returns the index."""
        write_assets(self.reports / "assets")
        write_bars(self.reports / "assets")
        for material in self.materials:
            fit_files_job(
                [self.root / f"results/fits/{material}/{model}.npz" for model in self.models],
                self.reports / f"materials/{material}/fits",
                self.listing(material),
            )
        for material in self.materials:
            self.write_material(material)
        for model in self.models:
            self.write_model(model)
        write_compare(self.reports / "compare.html")
        return self.write_index()


def sphere(size: int, colour: Sequence[float], exponent: float, gloss: float) -> np.ndarray:
    """Linear radiance of a shaded sphere before a dim gradient, (size, size, 3)."""
    y, x = np.mgrid[0:size, 0:size] / (size - 1) * 2.2 - 1.1
    inside = x**2 + y**2 < 1
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    light = np.array([-0.5, -0.6, 0.62])
    diffuse = np.maximum(x * light[0] + y * light[1] + z * light[2], 0)
    half = light + [0, 0, 1]
    half /= np.linalg.norm(half)
    spot = np.maximum(x * half[0] + y * half[1] + z * half[2], 0) ** exponent
    shaded = (0.08 + diffuse)[..., None] * np.asarray(colour) + (gloss * spot)[..., None]
    background = np.repeat((0.12 + 0.05 * y)[..., None], 3, -1)
    return np.where(inside[..., None], shaded, background)


def make_run(
    root: Path,
    materials: Sequence[str],
    models: Sequence[str],
    scenes: Sequence[str] = ("studio", "grove"),
    *,
    pictures: bool = True,
    size: int = 96,
    failed: tuple[str, str] | None = None,
    title: str = "",
    seed: int = 0,
) -> Run:
    """Write the results of a made-up run below ``root``; the last material is measured, all others stand-ins."""
    rng = np.random.default_rng(seed)
    results, reports = root / "results", root / "reports"
    for folder in ("materials", "errors", "renders", "fit_files"):
        (results / folder).mkdir(parents=True, exist_ok=True)
    facts = [SceneFacts(name, "a sphere under a made-up light", 1.0, 2.2) for name in scenes]
    for number, material in enumerate(materials):
        standin = number < len(materials) - 1
        colour = rng.uniform(0.05, 0.8, 3)
        record = {
            "name": material,
            "title": title if title and number == 0 else material.replace("-", " "),
            "standin": standin,
            "source": "built-in stand-in" if standin else "data/merl/x.binary",
            "valid_cells": 1_100_000 + number,
            "range": [0.001, float(10 ** rng.uniform(0, 4))],
            "albedo": colour.tolist(),
            "albedo_angle_degrees": 30.0,
            "diffuseness": float(rng.uniform(0, 1)),
            "class": ("diffuse", "glossy", "specular")[number % 3],
            "sha256": f"{number:064x}",
        }
        (results / f"materials/{material}.json").write_text(json.dumps(record))
        (results / f"fit_files/{material}.json").write_text('{"files": {}}')
        rows, brdf = [], []
        base = rng.uniform(25, 50)
        for place, model in enumerate([*models, "reference_again"]):
            is_floor = model == "reference_again"
            quality = base + 2.5 * place + rng.normal() + (25 if is_floor else 0)
            bad = failed == (material, model)
            for scene in scenes:
                psnr = quality + rng.normal()
                values = [
                    psnr,
                    rng.uniform(0.02, 0.4),
                    psnr - 4,
                    40 / psnr,
                    90 / psnr,
                    4 / psnr,
                    1 - 1 / psnr,
                    10 ** (-psnr / 20),
                    10 ** (-psnr / 10),
                ]
                values = [float("nan")] * 9 if bad else values
                rows.append([material, model, scene, "failed" if bad else "ok", *values])
            if not is_floor:
                brdf.append(
                    [material, model, *([float("nan")] * 4 if bad else (10 ** rng.uniform(-4, -1, 4)).tolist())]
                )
                folder = results / f"fits/{material}"
                folder.mkdir(parents=True, exist_ok=True)
                fit = {
                    "status": "failed",
                    "reason": f"FitError: no finite fit for {HOSTILE}",
                    "model": model,
                    "material": material,
                    "standin": standin,
                    "options": {},
                    "seed": 0,
                    "seconds": 0.1,
                    "bytes": MODELS[model].bytes,
                }
                if not bad:
                    fit |= {
                        "status": "ok",
                        "reason": "",
                        "objective": 0.01,
                        "objective_name": "toy",
                        "iterations": 12,
                        "converged": place != 1,
                        "message": "cap reached" if place == 1 else "",
                        "seconds": float(10 ** rng.uniform(-2, 1.5)),
                        "details": {
                            2: {"bounds": ["kd (red) = 1"]},
                            3: {"bound": {"factor": "D", "value": 1e-6, "held": 1204, "count": 2700}},
                        }.get(place, {"bound": {"factor": "D", "value": 1e-6, "held": 0, "count": 2700}}),
                        "options": {"quirk": "yes"} if place == 0 else {},
                        "physics": {"reciprocity_error": 1e-7, "max_albedo": [0.9, 0.7, 0.4], "bad_cells": 0.0},
                        "parameters": {"kd": rng.uniform(0, 1, 3).tolist(), "n": (10 ** rng.uniform(0, 4, 4)).tolist()},
                    }
                (folder / f"{model}.json").write_text(json.dumps(fit))
                if pictures and model.startswith("toy"):
                    save_fit(folder / f"{model}.npz", model, material, {} if bad else fit["parameters"], standin)
        write_table(results / f"errors/{material}.tsv", ["material", "model", "scene", "status", *MEASURES], rows)
        write_table(results / f"errors/{material}.brdf.tsv", ["material", "model", *BRDF_MEASURES], brdf)
        if pictures:
            make_pictures(
                reports / f"materials/{material}",
                models,
                scenes,
                colour,
                size,
                failed[1] if failed and failed[0] == material else "",
                rng,
            )
    run = {
        "revision": "0123456789ab",
        "versions": {"python": "3.11", "numpy": "2"},
        "machine": "Linux x86_64",
        "config": {"materials": "all", "render": {"size": size}},
        "models": {model: {} for model in models},
        "inputs": [{"name": m, "source": "made up", "sha256": "0" * 64, "standin": True} for m in materials],
        "left_out": [
            {"name": "broken", "path": "data/merl/broken.binary", "reason": f"data/merl/{HOSTILE}.binary: 12 bytes"}
        ],
    }
    (results / "run.json").write_text(json.dumps(run))
    return Run(root, list(materials), list(models), facts, failed)


def blacken(run: Run, material: str, *scenes: str) -> None:
    """Make the reference of pictures black: nothing is judged there, the reference rendered again neither."""
    path = run.root / f"results/errors/{material}.tsv"
    head, *rows = (line.split("\t") for line in path.read_text().splitlines())
    head.insert(4, "reason")
    for row in rows:
        black = row[2] in scenes
        row[3:] = ["failed", "black there", *["nan"] * len(MEASURES)] if black else [row[3], "", *row[4:]]
    write_table(path, head, rows)


def save_fit(path: Path, model: str, material: str, parameters: dict, standin: bool) -> None:
    """The fit's file; an empty one for a fit that failed."""
    if parameters:
        arrays = {p.name: np.resize(parameters[p.name], p.shape).astype(p.dtype) for p in MODELS[model].parameters}
        Fit(model, material, arrays, standin=standin).save(path)
    else:
        path.write_bytes(b"")


def write_table(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    lines = ["\t".join(columns)] + ["\t".join(str(value) for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_made_up_curves(folder: Path, models: Sequence[str]) -> None:
    """Numbers of the page's charts: functions of the first three models, lobes of all, a narrow peak among them."""
    angle, out = np.linspace(0.5, 89.5, 40), np.linspace(-89, 89, 90)
    ndf = {name: {"x": angle.tolist(), "y": (10 ** (5 - angle / 8 - i)).tolist()} for i, name in enumerate(models[:3])}
    fresnel = {name: {"x": angle.tolist(), "y": (0.05 + (angle / 90) ** 5).tolist()} for name in models[:3]}
    functions = [
        {"title": "Fresnel F", "axis": "θd", "unit": "", "log": False, "models": fresnel},
        {"title": "Normal distribution D", "axis": "θh", "unit": "1/sr", "log": True, "models": ndf},
    ]
    peak = [(0.05 + 1e4 * np.exp(-(((out - a) / 3) ** 2))).tolist() for a in (15, 40, 65)]
    lobes = {"incidence": [15, 40, 65], "x": [out.tolist()] * 3, "reference": peak}
    lobes["models"] = {name: peak for name in models}
    write_text(folder / "curves.js", f"window.ATLAS_CURVES({json.dumps({'functions': functions, 'lobes': lobes})});\n")


def make_pictures(
    folder: Path, models: Sequence[str], scenes: Sequence[str], colour, size: int, failed: str, rng
) -> None:
    """Pictures as brdfatlas.figures.pictures names them, and curves as SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    mask = np.hypot(*(np.mgrid[0:size, 0:size] / (size - 1) * 2.2 - 1.1)) < 1
    ramp = np.stack([np.arange(256)] * 3, -1).astype(np.uint8)
    for number, scene in enumerate(scenes):
        reference = sphere(size, colour, 60 + 40 * number, 2.0)
        base = hdr_levels(reference)
        for model in ["reference", *models]:
            if model == failed:
                continue
            wrong = 0 if model == "reference" else 0.3 * rng.uniform(0.1, 1)
            image = sphere(size, np.asarray(colour) * (1 + 0.3 * wrong), 60 + 40 * number, 2.0 * (1 - wrong))
            shown = (255 * np.clip(1 - np.exp2(-image), 0, 1) ** (1 / 2.2)).astype(np.uint8)
            write_webp(picture_file(folder, scene, model), shown)
            own = None if model == "reference" else base
            write_hdr(folder, scene, model, hdr_levels(image, own), own)
            if model != "reference":
                for kind in ("de00", "flip", "diff"):
                    write_webp(
                        picture_file(folder, scene, model, kind),
                        apply_colours(np.abs(image - reference).mean(-1), ramp, mask),
                    )
    write_made_up_curves(folder, [model for model in models if model != failed])
    curve = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 600 260">'
    curve += '<path d="M10 250C90 10 200 240 590 250" stroke="#333" fill="none"/></svg>'
    (folder / "lobes.svg").write_text(curve)
    for model in models[:2]:
        write_text(folder / "functions" / f"{model}.svg", curve)
    write_text(folder / "factors" / f"{models[-1]}.svg", curve)
    Image.fromarray(np.tile(np.arange(256, dtype=np.uint8), (90, 2))).save(folder / "slices.webp")
