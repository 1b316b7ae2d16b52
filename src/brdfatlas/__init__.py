"""Measured reflectance in, a complete comparison of reflectance models out.

The public interface is small and stable::

    import brdfatlas
    measured = brdfatlas.read_merl("chrome.binary")
    fit = brdfatlas.fit("ggx", measured, seed=0)
    rgb = fit.evaluate(wi, wo)
    fit.save("chrome-ggx.npz"); fit = brdfatlas.load_fit("chrome-ggx.npz")

``brdfatlas.MODELS`` maps names to models. ``brdfatlas.rendering.register()`` adds the Mitsuba plugin.
"""

from brdfatlas.fits import Fit, fit, load_fit
from brdfatlas.measured import Measured, read_merl, write_merl
from brdfatlas.models import MODELS

__version__ = "0.1.0"
__all__ = ["MODELS", "Fit", "Measured", "__version__", "fit", "load_fit", "read_merl", "write_merl"]
