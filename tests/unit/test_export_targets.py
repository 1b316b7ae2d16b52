import json
import shutil
import subprocess
from dataclasses import replace
from xml.dom import minidom
from xml.etree import ElementTree

import numpy as np
import pytest
from test_engine_models import NAMES, drawn

import brdfatlas
from brdfatlas.cli import main
from brdfatlas.export.facts import ExportError, facts, with_report
from brdfatlas.export.gltf import gltf_of, read_gltf_material, sphere
from brdfatlas.export.materialx import materialx_of
from brdfatlas.export.mitsuba import mitsuba_dict
from brdfatlas.export.targets import ENDINGS, STANDARD, export, models_for, targets_of
from brdfatlas.fits import Fit, load_fit
from brdfatlas.models import MODELS


def fit_of(name, seed=1, low=0.3, high=0.7):
    parameters = {key: np.asarray(value, np.float32) for key, value in drawn(name, seed, low, high).items()}
    options = MODELS[name].check_options({})
    report = {"objective": 0.0123, "objective_name": "compressive", "message": "at a bound: metallic = 1"}
    return Fit(name, "two--layer gold", parameters, options, report=report)


@pytest.mark.parametrize("name", NAMES)
def test_every_target_either_holds_a_fit_or_names_those_that_it_holds(name, tmp_path):
    fit = fit_of(name)
    for target, ending in ENDINGS.items():
        path = tmp_path / f"material{ending}"
        if target in targets_of(fit):
            files = export(fit, target, path)
            assert path in files
            assert all(file.stat().st_size > 0 for file in files)
        else:
            with pytest.raises(
                ExportError, match=f"cannot be expressed exactly in {target}; models that can: "
            ) as told:
                export(fit, target, path)
            assert all(able in str(told.value) for able in models_for(target))
            assert not path.exists()


@pytest.mark.parametrize("target", STANDARD)
def test_models_say_themselves_what_they_can_be(target):
    """The hook and the list of targets agree, for every entry."""
    for name in NAMES:
        material = MODELS[name].material(fit_of(name).parameters, target)
        assert (material is not None) == (target in MODELS[name].targets)


@pytest.mark.parametrize("target", STANDARD)
def test_files_say_what_they_are(target, tmp_path):
    for name in models_for(target):
        path = tmp_path / f"{name}{ENDINGS[target]}"
        export(fit_of(name), target, path, {"dE00 after rendering": "1.25"})
        text = path.read_text()
        for told in ("linear Rec. 709", "1/sr", "layer gold", MODELS[name].title, "0.0123", brdfatlas.__version__):
            assert told in text
        for told in ("roughness", "dE00 after rendering", "1.25", "at a bound: metallic = 1"):
            assert told in text


@pytest.mark.parametrize("material", ["a---b", "-----", "a--", "-", "a-->b", "a\x01\nb\udcff\ufffe"])
@pytest.mark.parametrize(
    ("target", "model"), [("mitsuba", "ggx_diffuse"), ("mitsuba", "lambert"), ("materialx", "lambert")]
)
def test_xml_is_well_formed_whatever_the_material_is_called(target, model, material, tmp_path):
    path = tmp_path / f"material{ENDINGS[target]}"
    export(replace(fit_of(model), material=material), target, path, {"note": material})
    assert minidom.parse(str(path)).documentElement.tagName in ("scene", "materialx")


# Numbers survive ---------------------------------------------------------------------------------------------------


def test_gltf_gives_the_numbers_back(tmp_path):
    fit = fit_of("gltf")
    export(fit, "gltf", tmp_path / "a.gltf")
    found = read_gltf_material(tmp_path / "a.gltf")
    np.testing.assert_array_equal(np.float32(found["baseColorFactor"][:3]), fit.parameters["base_color"])
    assert np.float32(found["metallicFactor"]) == fit.parameters["metallic"][0]
    assert np.float32(found["roughnessFactor"]) == fit.parameters["roughness"][0]


def test_materialx_gives_the_numbers_back():
    fit = fit_of("openpbr")
    surface = ElementTree.fromstring(materialx_of(fit)).find("open_pbr_surface")
    found = {item.get("name"): item.get("value") for item in surface.findall("input")}
    assert found.keys() == fit.parameters.keys()
    for name, text in found.items():
        np.testing.assert_array_equal(np.float32(text.split(",")), fit.parameters[name])


@pytest.mark.parametrize("name", ["lambert", "principled"])
def test_mitsuba_gives_the_numbers_back(name, tmp_path):
    """From XML and dict alike, by Mitsuba's own reader."""
    from brdfatlas.rendering import use_variant

    mi = use_variant("llvm_ad_rgb")
    fit = fit_of(name)
    export(fit, "mitsuba", tmp_path / "a.xml")
    outer = tmp_path / "scene.xml"
    outer.write_text(
        '<scene version="3.0.0"><include filename="a.xml"/><shape type="sphere"><ref id="material"/></shape></scene>'
    )
    from_xml = mi.traverse(mi.load_file(str(outer)))
    from_dict = mi.traverse(mi.load_dict(mitsuba_dict(fit)))
    colour = fit.parameters["kd" if name == "lambert" else "base_color"]
    for scene in (from_xml, from_dict):
        values = {key.removeprefix("material.").removesuffix(".value"): scene[key] for key in scene.keys()}  # noqa: SIM118
        found = values["reflectance" if name == "lambert" else "base_color"]
        np.testing.assert_allclose(np.array(found).ravel(), colour, rtol=1e-6)
        for key, value in fit.parameters.items():
            if key in values and value.size == 1:
                assert float(np.array(values[key]).ravel()[0]) == pytest.approx(float(value[0]), rel=1e-6)


def test_a_fit_without_a_stock_plugin_lies_beside_its_scene(tmp_path):
    from brdfatlas.rendering import use_variant

    mi = use_variant("llvm_ad_rgb")
    fit = fit_of("ggx_diffuse")
    files = export(fit, "mitsuba", tmp_path / "rough.xml")
    assert files == [tmp_path / "rough.xml", tmp_path / "rough.npz"]
    assert load_fit(tmp_path / "rough.npz") == fit
    scene = mi.load_file(str(tmp_path / "rough.xml"))
    assert scene is not None


# Proofs by others --------------------------------------------------------------------------------------------------


def renders(scene, count, spp):
    import mitsuba as mi

    return np.stack([np.array(mi.render(scene, spp=spp, seed=seed)) for seed in range(count)])


@pytest.mark.parametrize("form", ["xml", "dict"])
@pytest.mark.parametrize("name", ["lambert", "principled"])
def test_stock_mitsuba_renders_what_our_plugin_renders(name, form, tmp_path):
    """A z-test per pixel of two sets of renders with their own random numbers: the share of pixels beyond 3 standard
    errors is that of chance, and the mean has no bias. Our plugin interpolates a table: 0.5 per cent."""
    from brdfatlas.rendering import use_variant

    mi = use_variant("llvm_ad_rgb")
    fit = fit_of(name, 2)
    fit.parameters.update({k: np.zeros(1, np.float32) for k in ("clearcoat", "sheen") if k in fit.parameters})
    export(fit, "mitsuba", tmp_path / "a.xml")
    fit.save(tmp_path / "a.npz")

    def scene(material):
        return mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct"},
                "sensor": {
                    "type": "perspective",
                    "fov": 30,
                    "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                    "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
                },
                "light": {"type": "constant", "radiance": 0.3},
                "lamp": {"type": "point", "position": [3, 3, 4], "intensity": 20.0},
                "ball": {"type": "sphere", "material": material},
            }
        )

    if form == "dict":
        material = mitsuba_dict(fit)
    else:
        holder = tmp_path / "ball.xml"
        holder.write_text(
            '<scene version="3.0.0"><include filename="a.xml"/>'
            '<shape type="sphere"><ref id="material"/></shape></scene>'
        )
        material = mi.load_file(str(holder)).shapes()[0].bsdf()
    theirs = renders(scene(material), 12, 64)
    ours = renders(scene({"type": "brdfatlas", "filename": str(tmp_path / "a.npz")}), 12, 64)
    difference = theirs.mean(0) - ours.mean(0)
    error = np.sqrt((theirs.var(0, ddof=1) + ours.var(0, ddof=1)) / 12) + 0.005 * theirs.mean(0) / 3
    z = difference / np.maximum(error, 1e-6)
    assert (np.abs(z) > 3).mean() < 0.03
    assert abs(difference.mean()) < 0.005 * theirs.mean()


@pytest.mark.parametrize("name", ["lambert", "gltf", "openpbr"])
def test_materialx_validates_and_generates_shaders(name):
    mx = pytest.importorskip("MaterialX", reason="MaterialX is not installed (pip install brdfatlas[materialx])")
    import MaterialX.PyMaterialXGenGlsl as glsl
    import MaterialX.PyMaterialXGenOsl as osl
    import MaterialX.PyMaterialXGenShader as generators

    from brdfatlas.export.materialx import validate

    text = materialx_of(fit_of(name))
    assert validate(text) == ""
    assert validate(text.replace('type="float"', 'type="matrix44"', 1)) != ""
    document, libraries = mx.createDocument(), mx.createDocument()
    search = mx.getDefaultDataSearchPath()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, libraries)
    mx.readFromXmlString(document, text)
    document.setDataLibrary(libraries)
    (material,) = generators.findRenderableElements(document)
    for generator in (glsl.GlslShaderGenerator.create(), osl.OslShaderGenerator.create()):
        context = generators.GenContext(generator)
        context.registerSourceCodeSearchPath(search)
        generator.registerTypeDefs(document)
        shader = generator.generate(material.getName(), material, context)
        assert len(shader.getSourceCode("pixel")) > 1000


VALIDATOR = """
const fs = require('fs'), validator = require('gltf-validator');
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])))
  .then(report => console.log(JSON.stringify(report.issues)));
"""


@pytest.fixture(scope="module")
def khronos(tmp_path_factory):
    """A function path -> issues, by the Khronos validator."""
    if not (shutil.which("npm") and shutil.which("node")):
        pytest.skip("npm is not installed: the Khronos validator is an npm package")
    folder = tmp_path_factory.mktemp("validator")
    (folder / "package.json").write_text("{}")
    run = subprocess.run(["npm", "install", "gltf-validator"], cwd=folder, capture_output=True, text=True, timeout=300)
    if run.returncode:
        pytest.skip(f"npm cannot install gltf-validator: {run.stderr.strip().splitlines()[-1:]}")
    (folder / "validate.js").write_text(VALIDATOR)

    def issues(path):
        run = subprocess.run(["node", "validate.js", path], cwd=folder, capture_output=True, text=True, check=True)
        return json.loads(run.stdout)

    return issues


@pytest.mark.parametrize("name", ["lambert", "gltf"])
def test_gltf_is_valid_for_khronos(name, khronos, tmp_path):
    export(fit_of(name), "gltf", tmp_path / "a.gltf")
    issues = khronos(tmp_path / "a.gltf")
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_the_sphere_is_closed_and_faces_outwards():
    points, triangles = sphere()
    a, b, c = (points[triangles[:, k]].astype(float) for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (np.sum(normal * (a + b + c), -1) > 0).all()
    volume = np.sum(a * np.cross(b, c)) / 6
    assert volume == pytest.approx(4 / 3 * np.pi, rel=0.01)


# Faults ------------------------------------------------------------------------------------------------------------


def test_faults_are_one_line_and_leave_no_file(tmp_path, capsys):
    fit = fit_of("gltf")
    fit.save(tmp_path / "fit.npz")
    hand = fit_of("gltf")
    hand.parameters["metallic"][:] = 1.5
    hand.save(tmp_path / "hand.npz")
    with pytest.raises(ExportError, match=r"metallic = \[1\.5\] is outside its range 0 to 1"):
        export(hand, "gltf", tmp_path / "hand.gltf")
    assert not (tmp_path / "hand.gltf").exists()
    (tmp_path / "file").write_text("no folder")
    for arguments, told in (
        (["hand.npz", "--to", "gltf", "-o", "out/a.gltf"], "metallic is not within 0 to 1"),
        (["none.npz", "--to", "gltf", "-o", "out/a.gltf"], "none.npz"),
        (["fit.npz", "--to", "gltf", "-o", "file/a.gltf"], "file"),
    ):
        where = [str(tmp_path / a) if "." in a or "/" in a else a for a in arguments]
        assert main(["export", *where]) == 1
        captured = capsys.readouterr()
        assert told in captured.err
        assert len(captured.err.strip().splitlines()) == 1
        assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())


def test_a_scene_file_does_not_replace_the_fit_that_lies_beside_it(tmp_path):
    fit = fit_of("ggx_diffuse")
    fit.save(tmp_path / "fit.npz")
    with pytest.raises(ExportError, match=r"fit\.npz: .*name it \.xml"):
        export(fit, "mitsuba", tmp_path / "fit.npz")
    assert load_fit(tmp_path / "fit.npz") == fit


def test_the_file_that_a_fit_was_read_from_stays_as_it_is(tmp_path):
    """Beside its scene file a fit has its own name: it may be what the user exported it from."""
    file = tmp_path / "fit.npz"
    fit_of("ggx_diffuse").save(file)
    before = file.stat()
    assert file in export(load_fit(file), "mitsuba", tmp_path / "fit.xml")
    assert (file.stat().st_ino, file.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)
    export(fit_of("gltf"), "mitsuba", tmp_path / "fit.xml")
    assert load_fit(file) == fit_of("gltf")


def test_an_unknown_target_names_the_known_ones(tmp_path):
    with pytest.raises(ExportError, match="unknown target 'unreal'; known targets: mitsuba, materialx, gltf, json"):
        export(fit_of("gltf"), "unreal", tmp_path / "a")
    assert not (tmp_path / "a").exists()


def test_the_report_beside_a_fit_says_how_good_it_is(tmp_path):
    fit = fit_of("gltf")
    fit.save(tmp_path / "fit.npz")
    report = report_of(fit) | {"objective": 0.5, "objective_name": "E2 (Löw 2012)"}
    (tmp_path / "fit.json").write_text(json.dumps(report))
    assert main(["export", str(tmp_path / "fit.npz"), "--to", "gltf", "-o", str(tmp_path / "a.gltf")]) == 0
    assert json.loads((tmp_path / "a.gltf").read_text())["asset"]["extras"]["error"] == "0.5 (E2 (Löw 2012))"


def report_of(fit):
    return {"material": fit.material, "entry": fit.entry, "model": fit.model}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"objective": None}, ""),  # of given parameters
        ({"objective": "abc"}, "its objective is of another type"),
        ({"objective": True}, "its objective is of another type"),
        ({"objective": 0.5, "objective_name": 5}, "its objective_name is of another type"),
        ({"objective": [0.5]}, "its objective is of another type"),
        ({"objective": 0.5, "material": "another"}, "its material is another"),
        ({"objective": 0.5, "entry": "another"}, "its entry is another"),
        ({"objective": 0.5, "model": "ggx"}, "its model is another"),
        ({"objective": 0.5, "model": None}, "its model is another"),
        ({"objective": 0.5, "sha256": "0" * 64}, "it is about another file"),  # fitted again, with other options
    ],
)
def test_a_report_of_another_fit_is_not_believed(tmp_path, capsys, changes, told):
    fit = replace(fit_of("gltf"), report={})
    fit.save(tmp_path / "fit.npz")
    (tmp_path / "fit.json").write_text(json.dumps(report_of(fit) | {"objective_name": "x"} | changes))
    assert facts(with_report(fit, tmp_path / "fit.npz"))["error"] == "not stored with the fit"
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == bool(told)


def test_gltf_refuses_what_it_cannot_hold():
    with pytest.raises(ExportError, match=r"no material of glTF 2\.0 is exactly this model"):
        gltf_of(fit_of("ggx_diffuse"))
