"""The example for Mitsuba users runs as documented: XML and dict, llvm and scalar, a .binary and a fit."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from rendering_materials import material, variant

from brdfatlas.fits import fit
from brdfatlas.formats.merl import write_merl

EXAMPLE = Path(__file__).parents[2] / "examples" / "render_in_mitsuba.py"


@pytest.mark.parametrize("name", ["llvm_ad_rgb", "scalar_rgb"])
def test_the_example(name, tmp_path):
    spec = importlib.util.spec_from_file_location("render_in_mitsuba", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    mi = variant(name)
    write_merl(tmp_path / "m.binary", material(0.3).table)
    fit("ggx", material(0.3)).save(tmp_path / "fit.npz")
    size, samples = (24, 64) if name.startswith("llvm") else (3, 16)
    pictures = [
        np.array(mi.render(load(str(tmp_path / file), size), spp=samples))
        for load in (example.from_xml, example.from_dict)
        for file in ("m.binary", "fit.npz")
    ]
    for picture in pictures:
        assert np.isfinite(picture).all()
        assert picture[size // 2, size // 2].min() > 0
    # Under a constant sky of radiance 1 the middle of the sphere shows its directional albedo at normal incidence.
    from brdfatlas.measures.physics import directional_albedo

    expected = directional_albedo(material(0.3).evaluate, 0.0)
    middle = pictures[2][size // 2 - 1 : size // 2 + 2, size // 2 - 1 : size // 2 + 2].mean((0, 1))
    np.testing.assert_allclose(middle, expected, rtol=0.05 if name.startswith("llvm") else 0.4)
