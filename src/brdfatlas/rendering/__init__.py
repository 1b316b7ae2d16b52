"""Rendering with Mitsuba 3: the BSDF plugin, the scenes, the integrator.

Nothing here imports Mitsuba until it is needed, so that a usable libLLVM can be chosen first.
"""

import threading
from types import ModuleType

from brdfatlas import interrupts

__all__ = ["register", "use_variant"]


def use_variant(variant: str = "llvm_ad_rgb", threads: int | None = None) -> ModuleType:
    """Choose a usable libLLVM, set Mitsuba's variant, register the plugin; returns the module ``mitsuba``.

    ``threads``: how many threads may compute, default all cores. Raises LlvmError where an llvm variant has no
    usable libLLVM, ValueError for a variant that Mitsuba or the plugin does not have.
    """
    _check(variant)
    with RENDERING, interrupts.held():  # two threads that import Mitsuba see parts of it
        return _use_variant(variant, threads)


def _use_variant(variant: str, threads: int | None) -> ModuleType:
    if variant.startswith("llvm"):
        from brdfatlas.rendering.llvm import use_libllvm

        use_libllvm()
    import drjit as dr
    import mitsuba as mi

    if variant not in mi.variants():
        raise ValueError(f"render.variant: Mitsuba has no variant {variant!r}; it has {', '.join(mi.variants())}")
    if variant.startswith("cuda") and not dr.has_backend(dr.JitBackend.CUDA):
        raise ValueError(
            f"render.variant: {variant} needs an NVIDIA GPU with its driver, and there is none here; "
            "choose llvm_ad_rgb or scalar_rgb"
        )
    if mi.variant() != variant:
        mi.set_variant(variant)
    if threads is not None:
        dr.set_thread_count(max(1, threads))
    register()
    return mi


def register() -> None:
    """Make ``{"type": "brdfatlas", ...}`` known to Mitsuba's current variant; call again after a change of variant.

    Raises RuntimeError if no variant is set, ValueError for one whose colours are not rgb.
    """
    import mitsuba as mi

    from brdfatlas.rendering.bsdf import bsdf_class

    variant = mi.variant()
    if variant is None:
        raise RuntimeError("no Mitsuba variant is set: call mitsuba.set_variant() or brdfatlas.rendering.use_variant()")
    _check(variant)
    with _lock:
        if variant not in _registered:
            mi.register_bsdf("brdfatlas", bsdf_class(variant))
            _registered.add(variant)


def _check(variant: str) -> None:
    """Measured values are rgb: a spectral, monochrome or polarized variant has no use for them."""
    if not str(variant).endswith("_rgb"):
        raise ValueError(
            f"render.variant: {variant}: brdfatlas renders in rgb; choose llvm_ad_rgb, cuda_ad_rgb or scalar_rgb"
        )


_registered: set[str] = set()
_lock = threading.Lock()
#: Mitsuba crashes where two threads render at once, or one frees a BSDF that the render of another calls: turns here.
RENDERING = threading.RLock()
