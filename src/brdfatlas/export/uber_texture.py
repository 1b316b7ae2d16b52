"""The factors of many materials in one picture of 512 x 128 texels (Bagher et al. 2016, Fig. 16), for shaders.

Layout: row y (0 at the top) is one material, in the order given. In texels, rgb = the three channels' fits:

    x =   0 ..  89   D at the theta_h cells (x = 0 is the highlight; theta_h = ((x + 0.5) / 90)^2 pi / 2)
    x =  90 .. 179   F at the theta_d cells (theta_d = (x - 90 + 0.5) / 90 pi / 2)
    x = 180 .. 269   G at its nodes         (theta = (x - 180) / 89 pi / 2)
    x = 270, 271     rho_d, rho_s
    x = 272 .. 511   0

Between texels values are linear in theta, for D in the root of theta_h. Above 89 degrees G and its cosine are those of
89 degrees.

Rows without a material are 0. The file is an EXR with float32 channels R, G, B and the string attributes
``brdfatlas:materials`` (names, one a line), ``brdfatlas:model`` and ``brdfatlas:standins`` (names of the stand-ins).
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from brdfatlas.files import atomic_path, read_record
from brdfatlas.fits import Fit, load_fit
from brdfatlas.models import MODELS, own_faults
from brdfatlas.models.base import Factors, FitError, Model
from brdfatlas.models.loading import BUILTIN

WIDTH, HEIGHT = 512, 128
D_AT, F_AT, G_AT, RHO_D_AT, RHO_S_AT = 0, 90, 180, 270, 271
_COLUMNS = {"d": slice(D_AT, F_AT), "f": slice(F_AT, G_AT), "g": slice(G_AT, RHO_D_AT)}
_PREFIX = "brdfatlas:"


class UberTextureError(ValueError):
    """Fits or a file that make no uber-texture; the message is one line."""


@dataclass(frozen=True)
class UberTexture:
    """``texels`` (128, 512, 3) float32, ``materials`` in the order of the rows, the ``model``, names of stand-ins."""

    texels: np.ndarray
    materials: tuple[str, ...]
    model: str
    standins: tuple[str, ...] = ()

    def parameters(self, material: str) -> dict[str, np.ndarray]:
        """rho_d, rho_s (3,), d, f, g (3, 90) of a material. KeyError for a material that is not there."""
        if material not in self.materials:
            raise KeyError(f"no material {material!r} in this uber-texture")
        row = self.texels[self.materials.index(material)]
        factors = {name: np.ascontiguousarray(row[where].T) for name, where in _COLUMNS.items()}
        return {"rho_d": row[RHO_D_AT].copy(), "rho_s": row[RHO_S_AT].copy()} | factors

    def fit(self, material: str) -> Fit:
        """The material's fit, for a model whose parameters have these names."""
        return Fit(self.model, material, self.parameters(material), standin=material in self.standins)


def one_product(factors: Factors | None) -> bool:
    """Whether factors are rho_d + rho_s D F G G / (cos cos), which a row of the texture holds."""
    return factors is not None and factors.d.shape[1] == 1 and factors.g is not None and factors.h is None


def has_row(model: Model) -> bool:
    """Whether fits of a model have a row in an uber-texture; False for a model from outside that cannot say."""
    parameters = {p.name: np.ones(p.shape, p.dtype) for p in model.parameters}
    with suppress(FitError), own_faults(model, "any material"):
        return one_product(model.factors(parameters))
    return False


def build_uber_texture(fits: Sequence[Fit]) -> UberTexture:
    """From fits of one model with one product D F G, one a material, at most 128."""
    models = {fit.model for fit in fits}
    factors = [fit.factors() for fit in fits]
    if len(models) != 1 or not all(map(one_product, factors)):
        found = ", ".join(sorted(models)) or "no fit"
        able = ", ".join(name for name in BUILTIN if has_row(MODELS[name]))
        wanted = "an uber-texture holds fits of one model with one product D F G"
        raise UberTextureError(f"{wanted}, not {found}; those are {able}")
    names = tuple(fit.material for fit in fits)
    if len(names) > HEIGHT:
        raise UberTextureError(f"an uber-texture holds {HEIGHT} materials, not {len(names)}; leave some out")
    if len(set(names)) != len(names):
        raise UberTextureError("an uber-texture holds a material once; a name comes twice")
    if any("\n" in name for name in names):
        raise UberTextureError("a material's name has a line break")
    texels = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for row, found in zip(texels, factors):
        row[D_AT:F_AT], row[F_AT:G_AT], row[G_AT:RHO_D_AT] = found.d[:, 0].T, found.f[:, 0].T, found.g.T
        row[RHO_D_AT], row[RHO_S_AT] = found.rho_d, 1 if found.rho_s is None else found.rho_s
    return UberTexture(texels, names, models.pop(), tuple(fit.material for fit in fits if fit.standin))


def save_uber_texture(path: str | os.PathLike, texture: UberTexture) -> None:
    """Write the EXR, whole or not at all."""
    import OpenEXR

    channels = {name: np.ascontiguousarray(texture.texels[..., c], np.float32) for c, name in enumerate("RGB")}
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        _PREFIX + "materials": "\n".join(texture.materials),
        _PREFIX + "model": texture.model,
        _PREFIX + "standins": "\n".join(texture.standins),
    }
    with atomic_path(path) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))


def load_uber_texture(path: str | os.PathLike) -> UberTexture:
    """Read an EXR of :func:`save_uber_texture`. UberTextureError names the file and what is wrong with it."""
    import OpenEXR

    path = Path(path)
    if not path.is_file():
        raise UberTextureError(f"{path}: no such file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            header = dict(file.header())
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:
        raise UberTextureError(f"{path}: not an EXR ({error})") from None
    if any(channels.get(name, np.empty(0)).shape != (HEIGHT, WIDTH) for name in "RGB"):
        raise UberTextureError(f"{path}: not {WIDTH} x {HEIGHT} texels with R, G, B")
    if _PREFIX + "materials" not in header or _PREFIX + "model" not in header:
        raise UberTextureError(f"{path}: no attributes {_PREFIX}materials and {_PREFIX}model, not an uber-texture")
    texels = np.stack([channels[name] for name in "RGB"], -1).astype(np.float32)
    lines = {
        key: tuple(filter(None, str(header.get(_PREFIX + key, "")).split("\n"))) for key in ("materials", "standins")
    }
    if len(lines["materials"]) > HEIGHT:
        raise UberTextureError(f"{path}: names {len(lines['materials'])} materials in {HEIGHT} rows, it is damaged")
    return UberTexture(texels, lines["materials"], str(header[_PREFIX + "model"]), lines["standins"])


def uber_texture_job(model: str, fits: Sequence[str | os.PathLike], output: str | os.PathLike) -> None:
    """Write the texture of one model from fits, each with its report (.json) beside it; a failed fit has no row."""
    good = [load_fit(path) for path in fits if read_record(Path(path).with_suffix(".json"), "status")["status"] == "ok"]
    empty = UberTexture(np.zeros((HEIGHT, WIDTH, 3), np.float32), (), model)
    save_uber_texture(output, build_uber_texture(good) if good else empty)
