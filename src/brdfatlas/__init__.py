"""Measured reflectance in, a complete comparison of reflectance models out.

The public interface is small and stable::

    import brdfatlas
    measured = brdfatlas.read("chrome.binary")  # or RGL's .bsdf, a table ...
    fit = brdfatlas.fit("ggx", measured, seed=0)
    rgb = fit.evaluate(wi, wo)
    fit.save("chrome-ggx.npz"); fit = brdfatlas.load_fit("chrome-ggx.npz")
    brdfatlas.recommend("chrome.binary", budget=64).save("chrome-recommended")

``brdfatlas.MODELS`` maps names to models. ``brdfatlas.rendering.register()`` adds the Mitsuba plugin.
"""

from brdfatlas import interrupts  # noqa: F401  first: it counts for the imports below
from brdfatlas.fits import Fit, fit, load_fit
from brdfatlas.formats.merl import read as read_merl
from brdfatlas.formats.merl import write_merl
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured
from brdfatlas.models import MODELS
from brdfatlas.recommend import recommend

__version__ = "0.2.0"
__all__ = [
    "MODELS",
    "Fit",
    "Measured",
    "__version__",
    "fit",
    "load_fit",
    "read",
    "read_merl",
    "recommend",
    "write_merl",
]
