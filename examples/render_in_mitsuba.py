"""A measured material, or a fit of it, in an ordinary Mitsuba scene: XML and dict.

python examples/render_in_mitsuba.py chrome.binary chrome.exr [llvm_ad_rgb | scalar_rgb]
"""

import sys
from pathlib import Path

from brdfatlas.rendering import use_variant


def from_xml(material: str, size: int = 128):
    """The scene of mitsuba_scene.xml with ``material``, a MERL .binary or a fit (.npz)."""
    import mitsuba as mi

    return mi.load_file(str(Path(__file__).with_name("mitsuba_scene.xml")), material=material, size=str(size))


def from_dict(material: str, size: int = 128):
    """A sphere under a constant sky, as a dictionary."""
    import mitsuba as mi

    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path"},
            "sensor": {
                "type": "perspective",
                "fov": 30,
                "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": size, "height": size},
            },
            "light": {"type": "constant"},
            "ball": {"type": "sphere", "bsdf": {"type": "brdfatlas", "filename": material}},
        }
    )


def main(material: str, output: str, variant: str = "llvm_ad_rgb") -> None:
    """Render the XML scene."""
    mi = use_variant(variant)  # chooses a usable libLLVM, sets the variant, registers the plugin
    mi.Bitmap(mi.render(from_xml(material), spp=64)).write(output)


if __name__ == "__main__":
    main(*sys.argv[1:])
