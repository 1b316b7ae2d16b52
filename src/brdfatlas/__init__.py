"""Measured reflectance in, a complete comparison of reflectance models out.

The public interface is small and stable::

    import brdfatlas
    measured = brdfatlas.read("chrome.binary")  # or RGL's .bsdf, a table ...
    fit = brdfatlas.fit("ggx", measured, seed=0)
    rgb = fit.evaluate(wi, wo)
    fit.save("chrome-ggx.npz"); fit = brdfatlas.load_fit("chrome-ggx.npz")

``brdfatlas.MODELS`` maps names to models. ``brdfatlas.rendering.register()`` adds the Mitsuba plugin.
"""

import os

# A fit uses one core. Idle BLAS threads spin, which costs small matrices many times their work; effective if NumPy
# is imported after this package.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from brdfatlas.fits import Fit, fit, load_fit  # noqa: E402
from brdfatlas.formats import read  # noqa: E402
from brdfatlas.formats.merl import read as read_merl  # noqa: E402
from brdfatlas.formats.merl import write_merl  # noqa: E402
from brdfatlas.measured import Measured  # noqa: E402
from brdfatlas.models import MODELS  # noqa: E402

__version__ = "0.1.0"
__all__ = ["MODELS", "Fit", "Measured", "__version__", "fit", "load_fit", "read", "read_merl", "write_merl"]
