"""How far an image or a BRDF is from its reference.

Image measures take linear radiance and the pixels that the material covers. Two of them look at linear light (PSNR,
RMSE, relative MSE), the others at what a viewer sees, by the tone map of Bagher et al. 2016 (section 5).

**Noise.** An image is the average of n independent batches. Reference R and fit F share the random numbers of a
batch, so D_a = F_a - R_a has little noise; but (mean D)^2 still exceeds the squared error of the noise-free images by
Var(D)/n. Products of *different* batches have no such bias:

    U = 1 / (n (n - 1)) sum_{a != b} <D_a, D_b>,    <x, y> = mean over pixels and channels of x y

is the U-statistic with E[U] = ||E[D]||^2. Everything follows from the n x n matrix K_ab = <D_a, D_b>: U = (sum K -
trace K) / (n (n - 1)), and leaving a batch out drops a row and a column. U may be negative where the model is closer to
the reference than the noise can tell; :func:`linear_errors` says what is then reported.

dE00, FLIP and SSIM are not linear and cost far more to evaluate. Their standard errors are a delete-half jackknife,
block by block: they are evaluated for either half of the batches, and the halves' differences, summed over blocks of
pixels, are independent from block to block, because every pixel has random numbers of its own. So two evaluations
give as many degrees of freedom as there are blocks.

Models of one picture share random numbers: their measures err together, and a difference has a standard error of its
own, from the differences of what makes the single ones (:class:`Spread`).
"""

import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from brdfatlas.constants import ABSENT, REFERENCE, REFERENCE_AGAIN
from brdfatlas.files import read_record
from brdfatlas.fits import load_reported
from brdfatlas.formats.reader import read
from brdfatlas.measured import Measured, fold
from brdfatlas.measures.flip import SCALE, Seen, flip, see
from brdfatlas.measures.ranking import RANKED
from brdfatlas.measures.tsv import write_tsv
from brdfatlas.objectives import compressive_weights, cosine_weighted, loew_e2, log_deviation, relative_objective
from brdfatlas.rendering.images import Render, load_render, tone_map

IMAGE_MEASURES = (
    "de00_mean",
    "de00_se",
    "de00_p95",
    "flip_mean",
    "flip_se",
    "ssim",
    "ssim_se",
    "psnr_db",
    "psnr_se_db",
    "psnr_tonemapped_db",
    "rmse",
    "rel_mse",
)
#: Standard errors among them: of a measure of one image, and in the tables of pairs of a difference.
PAIR_ERRORS = tuple(measure.error for measure in RANKED.values())
BRDF_MEASURES = ("objective_compressive", "loew_e2", "cosine_weighted", "log_deviation")
#: An estimate of the MSE below this many standard errors is indistinguishable from zero; PSNR is then a lower bound.
DETECTION = 2.0
#: Pixels around the mask that its measures look at: FLIP's widest filter reaches 10, SSIM's window 5.
MARGIN = 12
#: Side of a block of pixels in the estimate of noise: wider than those filters, so that blocks are independent.
BLOCK = 32

log = logging.getLogger(__name__)


class Tone(NamedTuple):
    """Exposure and gamma of a scene's tone map."""

    exposure: float
    gamma: float


def expose(linear: np.ndarray, exposure: float) -> np.ndarray:
    """Linear light of a display in [0, 1], of any shape: ln 2 exposure x, the tone map's own slope in the dark."""
    return np.clip(np.log(2.0) * exposure * linear, 0.0, 1.0)


def to_8_bit(display: np.ndarray) -> np.ndarray:
    """Display values in [0, 1] of any shape to bytes, rounded."""
    return np.rint(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)


def psnr(peak: float, mean_squared: float) -> float:
    """10 log10(peak^2 / MSE) in dB; +inf for MSE = 0."""
    return float("inf") if mean_squared == 0 else float(10 * np.log10(peak**2 / mean_squared))


def batch_products(reference: np.ndarray, image: np.ndarray) -> np.ndarray:
    """K_ab = <F_a - R_a, F_b - R_b> of batches (n, pixels, 3): an n x n matrix, radiance squared."""
    return _products(image.astype(np.float64) - reference)


def _products(difference: np.ndarray) -> np.ndarray:
    flat = difference.reshape(len(difference), -1)
    return flat @ flat.T / flat.shape[1]


def mean_squared_error(products: np.ndarray, *, unbiased: bool = True) -> tuple[float, np.ndarray]:
    """MSE from the matrix (n, n) of :func:`batch_products`, and the n values that leaving one batch out gives.

    ``unbiased``: the U-statistic of the module's text, for images with common random numbers; it needs two batches,
    three for its jackknife. Otherwise the plain MSE of the two averages, with their noise.
    Raises ValueError for an unbiased estimate from one batch.
    """
    n = len(products)
    rows, diagonal, total = products.sum(1), np.diag(products), float(products.sum())
    trace = float(diagonal.sum())
    if not unbiased:
        without = (total - 2 * rows + diagonal) / (n - 1) ** 2 if n > 1 else np.full(n, np.nan)
        # An average of n - 1 batches has n / (n - 1) times the noise: scaled back, so only the spread remains.
        return total / n**2, without * (n - 1) / n
    if n < 2:
        raise ValueError("an estimate without the noise's bias needs at least two batches")
    if n == 2:
        return (total - trace) / 2, np.full(n, np.nan)
    without = ((total - 2 * rows + diagonal) - (trace - diagonal)) / ((n - 1) * (n - 2))
    return (total - trace) / (n * (n - 1)), without


def jackknife_error(without: np.ndarray) -> float:
    """Standard error of a statistic from its leave-one-out values (n,): sqrt((n - 1)/n sum (t_b - mean t)^2)."""
    n = len(without)
    return float(np.sqrt((n - 1) / n * np.sum((without - without.mean()) ** 2)))


def above_noise(value: float, spread: float) -> tuple[float, bool]:
    """An estimate of an MSE and True; where it is below DETECTION standard errors, so that zero explains it as well,
    the upper bound max(value, 0) + DETECTION spread and False."""
    if value > DETECTION * spread:
        return value, True
    return max(value, 0.0) + DETECTION * spread, False


class Linear(NamedTuple):
    """The linear measures of a pair, and its PSNR with each batch left out (n,), dB; NaN where it has no error."""

    values: dict[str, float]
    without: np.ndarray


def linear_errors(reference: Render, image: Render, *, unbiased: bool = True) -> dict[str, float]:
    """PSNR in dB with its standard error, RMSE (radiance) and relative MSE over the mask, in linear rgb.

    PSNR is seed C's: the peak is the largest channel of any covered pixel of the reference. The standard error is a
    jackknife over batches, to first order in dB, and includes the noise of the peak. Relative MSE divides the squared
    error by R^2 + 0.01 mean(R)^2 per channel and pixel.

    With ``unbiased`` (reference and fit share random numbers), three cases: no difference at all scores +inf with
    error 0; an MSE below 2 standard errors cannot be told from 0, psnr_db is then a lower bound, that of max(U, 0) + 2
    standard errors, marked by psnr_se_db = inf (and rmse, rel_mse are upper bounds by the same rule); else psnr_db and
    its error. One batch alone gives the plain MSE and no standard error (NaN). ValueError for two batches whose
    estimate is not positive: nothing bounds it.
    """
    return _linear(LinearReference(reference), image, unbiased).values


class LinearReference:
    """What the linear measures need of a reference: its covered pixels, its peak with each batch left out."""

    def __init__(self, reference: Render) -> None:
        self.covered = np.flatnonzero(reference.mask)
        self.batches = self.of(reference)
        covered = reference.mean[reference.mask].astype(np.float64)
        n = len(self.batches)
        self.peak = float(covered.max())
        self.peaks = np.array([(covered * n - b).max() / (n - 1) for b in self.batches] if n > 1 else [self.peak])
        self.scale = 1 / np.sqrt(covered**2 + 0.01 * max(float(covered.mean()) ** 2, 1e-30))

    def of(self, render: Render) -> np.ndarray:
        """The batches (n, pixels, 3) of a render where the material is."""
        return np.take(render.batches.reshape(len(render.batches), -1, 3), self.covered, axis=1)


def _linear(reference: LinearReference, image: Render, unbiased: bool) -> Linear:
    difference = np.subtract(reference.of(image), reference.batches, dtype=np.float64)
    n = len(difference)
    unbiased = unbiased and n > 1
    products = _products(difference)
    if not products.any():
        perfect = {"psnr_db": float("inf"), "psnr_se_db": 0.0, "rmse": 0.0, "rel_mse": 0.0}
        return Linear(perfect, np.full(n, np.nan))
    value, without = mean_squared_error(products, unbiased=unbiased)
    difference *= reference.scale
    relative, relative_without = mean_squared_error(_products(difference), unbiased=unbiased)
    seen = True
    if unbiased and n > 2:
        value, seen = above_noise(value, jackknife_error(without))
        relative, _ = above_noise(relative, jackknife_error(relative_without))
    elif value <= 0:
        raise ValueError("two batches are too few to bound an error below the noise; render at least three")
    in_db = 20 * np.log10(reference.peaks) - 10 / np.log(10) * without / value
    values = {
        "psnr_db": psnr(reference.peak, value),
        "psnr_se_db": jackknife_error(in_db) if seen else float("inf"),
        "rmse": float(np.sqrt(value)),
        "rel_mse": max(relative, 0.0),
    }
    return Linear(values, in_db if seen else np.full(n, np.nan))


def displayed_lab(linear: np.ndarray, exposure: float) -> np.ndarray:
    """CIE Lab (D65, 2 degrees) of linear radiance (..., 3) on an sRGB display: fixed exposure, clip, Lab; float32.

    The display decodes what sRGB encodes: Lab is that of the clipped linear light.
    """
    from skimage.color import xyz2lab
    from skimage.color.colorconv import xyz_from_rgb

    return xyz2lab(expose(linear, exposure).astype(np.float32) @ xyz_from_rgb.T.astype(np.float32))


def delta_e(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """CIEDE2000 between Lab colours (..., 3), by scikit-image."""
    from skimage.color import deltaE_ciede2000

    return deltaE_ciede2000(a, b)


@dataclass(frozen=True)
class Structure:
    """A display image (h, w, 3) with its local means and mean squares, for :func:`ssim_map`."""

    values: np.ndarray
    mean: np.ndarray
    square: np.ndarray


def structure(display: np.ndarray) -> Structure:
    """What SSIM needs of one display image (h, w, 3) in [0, 1] alone."""
    display = np.asarray(display, np.float32)
    return Structure(display, _window(display), _window(display * display))


def _window(values: np.ndarray) -> np.ndarray:
    """Means over SSIM's window: a Gaussian of sigma 1.5, 11 pixels wide."""
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(values, 1.5, radius=5, axes=(0, 1))


def ssim_map(a: Structure, b: Structure) -> np.ndarray:
    """SSIM (Wang et al. 2004: Gaussian window, sigma 1.5) per pixel of two images; channels averaged, (h, w)."""
    c1, c2 = np.float32(0.01**2), np.float32(0.03**2)
    products, squares = a.mean * b.mean, a.mean**2 + b.mean**2
    covariance = _window(a.values * b.values) - products
    variances = a.square + b.square - squares
    return ((2 * products + c1) * (2 * covariance + c2) / ((squares + c1) * (variances + c2))).mean(-1)


def box_around(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of a mask (h, w) with the margin that FLIP and SSIM look at; all, if it covers nothing."""
    if not mask.any():
        return slice(None), slice(None)
    rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
    rows, columns = (slice(max(int(i[0]) - MARGIN, 0), int(i[-1]) + MARGIN + 1) for i in (rows, columns))
    return rows, columns


def check_reference(reference: Render) -> None:
    """ValueError unless the material covers a pixel, and its pixels are finite and not all black."""
    if not reference.mask.any():
        raise ValueError("no pixel of the reference is covered by the material")
    _check_finite("reference", reference, reference.mask)
    if not reference.mean[reference.mask].max() > 0:
        raise ValueError("the reference is black where the material is: PSNR has no peak")


def check_image(reference: Render, image: Render) -> None:
    """ValueError unless an image has the size and the number of batches of its reference, and finite covered pixels."""
    if reference.mean.shape != image.mean.shape:
        raise ValueError(f"images of different sizes: {reference.mean.shape[:2]} and {image.mean.shape[:2]}")
    if reference.batches.shape != image.batches.shape:
        raise ValueError(f"different numbers of batches: {len(reference.batches)} and {len(image.batches)}")
    _check_finite("image", image, reference.mask)


def _check_finite(name: str, render: Render, mask: np.ndarray) -> None:
    if not np.isfinite(render.mean[mask]).all():
        raise ValueError(f"the {name} holds NaN or Inf where the material is")
    # To pick the covered pixels costs ten times as much as to look at all.
    if not np.isfinite(render.batches).all() and not np.isfinite(render.batches[:, mask]).all():
        raise ValueError(f"a batch of the {name} holds NaN or Inf where the material is")


class View:
    """A picture as a viewer sees it, in the box around its mask (h, w): ``linear`` radiance (h, w, 3), and what each
    measure needs of it alone, made when first asked for. ``half``: FLIP sees it at half the resolution."""

    def __init__(self, linear: np.ndarray, mask: np.ndarray, tone: Tone, *, half: bool = False) -> None:
        self.linear, self.mask, self.tone, self.half = linear, mask, tone, half

    def beside(self, linear: np.ndarray) -> "View":
        """Another picture (h, w, 3) to be compared with this one. Outside the mask both show the same, so that filters
        that reach over the material's edge see no noise."""
        seen = np.where(self.mask[..., None], linear, self.linear)
        return View(seen, self.mask, self.tone, half=self.half)

    @cached_property
    def lab(self) -> np.ndarray:
        """Of the covered pixels, (n, 3)."""
        return displayed_lab(self.linear[self.mask], self.tone.exposure)

    @cached_property
    def shown(self) -> np.ndarray:
        """Tone-mapped, (h, w, 3)."""
        return tone_map(self.linear, *self.tone)

    @cached_property
    def structure(self) -> Structure:
        """What SSIM compares."""
        return structure(self.shown)

    @cached_property
    def seen(self) -> Seen:
        """What FLIP compares."""
        return see(tone_map(_halved(self.linear), *self.tone), SCALE / 2) if self.half else see(self.shown)


class Picture:
    """A reference in a scene, with all that the measures need of it alone.

    dE00, FLIP and SSIM are judged in the box around the mask, with a margin wider than any of their filters: what lies
    further off is the same in both pictures and counts in none of them.
    """

    def __init__(self, reference: Render, tone: Tone) -> None:
        check_reference(reference)
        if not all(0 < value < np.inf for value in tone):
            raise ValueError(f"exposure {tone.exposure!r} and gamma {tone.gamma!r}: numbers above 0 are needed")
        self.reference = reference
        self.box = box_around(reference.mask)
        self.mask = reference.mask[self.box]
        self.count = int(self.mask.sum())
        self.linear = LinearReference(reference)
        self.view = View(reference.mean[self.box], self.mask, tone)
        half = len(reference.batches) // 2
        self.halves = [slice(0, half), slice(half, 2 * half)] if half else []
        self.half_views = [View(self._mean(reference, part), self.mask, tone, half=True) for part in self.halves]

    def _mean(self, render: Render, part: slice) -> np.ndarray:
        return render.batches[(part, *self.box)].mean(0)

    def errors(self, image: Render, *, common_numbers: bool = True) -> tuple[dict[str, float], "Spread"]:
        """All IMAGE_MEASURES of an image, and how they scatter; see :func:`image_errors`."""
        check_image(self.reference, image)
        linear = _linear(self.linear, image, common_numbers)
        view, other = self.view, self.view.beside(image.mean[self.box])
        a, b = (to_8_bit(x.shown[self.mask]).astype(np.float64) for x in (view, other))
        delta = delta_e(view.lab, other.lab)
        blocks = self._blocks(image)
        values = linear.values | {
            "psnr_tonemapped_db": psnr(255.0, float(np.mean((a - b) ** 2))),
            "de00_mean": float(delta.mean(dtype=np.float64)),
            "de00_p95": float(np.percentile(delta, 95)),
            "flip_mean": float(flip(view.seen, other.seen)[self.mask].mean(dtype=np.float64)),
            "ssim": float(ssim_map(view.structure, other.structure)[self.mask].mean(dtype=np.float64)),
        }
        values |= {RANKED[key].error: _root(part) for key, part in blocks.items()}
        return {name: values[name] for name in IMAGE_MEASURES}, Spread(linear.without, blocks)

    def _blocks(self, image: Render) -> dict[str, np.ndarray]:
        """Half the difference between the two halves of the batches, summed over each block of the picture, as a share
        of the mean: (blocks,) for dE00, FLIP, SSIM."""
        if not self.halves:
            return {key: np.array([np.nan]) for key in ("de00_mean", "flip_mean", "ssim")}
        maps = []
        for part, view in zip(self.halves, self.half_views, strict=True):
            other = view.beside(self._mean(image, part))
            delta = np.zeros(self.mask.shape, np.float32)
            delta[self.mask] = delta_e(view.lab, other.lab)
            maps.append((delta, flip(view.seen, other.seen), ssim_map(view.structure, other.structure)))
        # two halves of n // 2 batches: the variance of their mean is a quarter of that of their difference
        share = np.sqrt(2 * (len(image.batches) // 2) / len(image.batches)) / (2 * self.count)
        # FLIP at half the resolution is as noisy as at the full one, because its filters are wider than a pixel: a
        # fourth of the cost
        weights = self.mask, 4 * _halved(self.mask.astype(np.float32)), self.mask
        return {
            key: share * block_sums((first - second) * weight, size)
            for key, first, second, weight, size in zip(
                ("de00_mean", "flip_mean", "ssim"), *maps, weights, (BLOCK, BLOCK // 2, BLOCK), strict=True
            )
        }


@dataclass(frozen=True)
class Spread:
    """How the measures of one image scatter with the random numbers that all images of a picture share.

    ``psnr``: PSNR with each batch left out (n,), dB; ``blocks``: measure -> :meth:`Picture._blocks`.
    """

    psnr: np.ndarray
    blocks: Mapping[str, np.ndarray]

    def joint(self, other: "Spread") -> dict[str, float]:
        """Standard errors of the differences between two images' measures, by the names of IMAGE_MEASURES."""
        found = {RANKED[key].error: _root(part - other.blocks[key]) for key, part in self.blocks.items()}
        return found | {RANKED["psnr_db"].error: jackknife_error(self.psnr - other.psnr)}


def _root(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).sum()))


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of 2 x 2 pixels; a last odd row or column is doubled."""
    image = np.pad(image, [(0, image.shape[0] % 2), (0, image.shape[1] % 2), *[(0, 0)] * (image.ndim - 2)], "edge")
    return 0.25 * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def block_sums(values: np.ndarray, size: int) -> np.ndarray:
    """Sums over blocks of ``size`` x ``size`` pixels of (h, w), the last ones smaller; flat, float64."""
    rows = np.add.reduceat(values, np.arange(0, values.shape[0], size), axis=0, dtype=np.float64)
    return np.add.reduceat(rows, np.arange(0, values.shape[1], size), axis=1).ravel()


def image_errors(reference: Render, image: Render, tone: Tone, *, common_numbers: bool = True) -> dict[str, float]:
    """All IMAGE_MEASURES of one pair, over the pixels of the reference's mask.

    ``common_numbers``: the pair shares random numbers batch by batch, and the noise's bias is taken out of the linear
    measures. False for two references of different seeds, where the noise itself is what is measured, and the plain
    MSE of the two averages is reported. Tone-mapped PSNR, dE00, FLIP and SSIM are not linear and always are those of
    the averages; the row "reference, other seed" says how much of them is noise. Raises ValueError as
    :func:`check_reference` and :func:`check_image`, and for a tone map that is none.
    """
    return Picture(reference, tone).errors(image, common_numbers=common_numbers)[0]


def material_errors(
    material: str, models: Sequence[str], tones: Mapping[str, Tone], folder: str | os.PathLike
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Image measures of one material, tidy: material, model, scene, status, reason, then IMAGE_MEASURES; and the
    standard errors of the differences between models of a picture: material, scene, model, other, then PAIR_ERRORS.

    ``folder`` holds {model}/{scene}.exr with "reference" and "reference_again", the same with another seed, beside the
    ``models``; ``tones`` has an entry a scene. A render that says it failed, one with NaN or Inf, and every render of a
    scene whose reference cannot be used (black, say), give a row with status "failed", its reason and NaN measures.
    """
    rows, pairs = [], []
    names = list(dict.fromkeys([*models, REFERENCE_AGAIN]))
    for scene, tone in tones.items():
        picture, fault = None, ""
        reference = load_render(Path(folder) / REFERENCE / f"{scene}.exr")
        try:
            picture = Picture(reference, tone)
        except ValueError as error:
            fault = str(error)
            log.warning("%s, %s: %s", material, scene, fault)
        spreads: dict[str, Spread] = {}
        for model in names:
            row: dict[str, object] = {"material": material, "model": model, "scene": scene, "status": "failed"}
            row["reason"] = fault
            image = load_render(Path(folder) / model / f"{scene}.exr")
            if image.meta.get("status", "ok") != "ok":
                row["reason"] = "the fit failed"
            elif picture is not None:
                try:
                    values, spreads[model] = picture.errors(image, common_numbers=model != REFERENCE_AGAIN)
                    row |= values | {"status": "ok"}
                except ValueError as error:
                    log.warning("%s, %s, %s: %s", material, model, scene, error)
                    row["reason"] = str(error)
            rows.append(row)
        spreads.pop(REFERENCE_AGAIN, None)
        for model, other in combinations(spreads, 2):
            joint = spreads[model].joint(spreads[other])
            pairs.append({"material": material, "scene": scene, "model": model, "other": other} | joint)
    table = pd.DataFrame(rows, columns=["material", "model", "scene", "status", "reason", *IMAGE_MEASURES])
    order = {name: i for i, name in enumerate(names)}
    table = table.sort_values("model", key=lambda column: column.map(order), kind="stable", ignore_index=True)
    return table, pd.DataFrame(pairs, columns=["material", "scene", "model", "other", *PAIR_ERRORS])


def brdf_errors(fitted: np.ndarray, table: np.ndarray, weights: np.ndarray | None = None) -> dict[str, float]:
    """BRDF_MEASURES of a fit's table against a measured one, both (90, 90, 180, 3), 1/sr, NaN for what is not there.

    The compressive objective (Bagher et al. 2016, Eq. 7, relative to sum w rho^2; ``weights`` saves computing them
    again), Löw's E2, Ngan's cosine-weighted root mean square, and mean |log1p(f cos) - log1p(g cos)| for cosines
    above 0.1.
    """
    weights = compressive_weights(table) if weights is None else weights
    return {
        "objective_compressive": relative_objective(fitted, table, weights),
        "loew_e2": loew_e2(fitted, table),
        "cosine_weighted": cosine_weighted(fitted, table),
        "log_deviation": log_deviation(fitted, table),
    }


def material_brdf_errors(measured: Measured, models: Sequence[str], folder: str | os.PathLike) -> pd.DataFrame:
    """BRDF-space measures of one material's fits, tidy: material, model, BRDF_MEASURES; NaN for a failed fit.

    ``folder`` holds {model}.npz and {model}.json with "status".
    """
    weights = compressive_weights(measured.table)
    rows = []
    for model in models:
        row: dict[str, object] = {"material": measured.name, "model": model}
        report = read_record(Path(folder) / f"{model}.json", "status")
        if report["status"] == "ok":
            fitted = load_reported(Path(folder) / f"{model}.npz", report, model, measured.name)
            row |= brdf_errors(fold(fitted.table()), measured.table, weights)
        rows.append(row)
    return pd.DataFrame(rows, columns=["material", "model", *BRDF_MEASURES])


def errors_job(
    material: str,
    binary: str | os.PathLike,
    models: Sequence[str],
    tones: Mapping[str, Sequence[float]],
    renders: str | os.PathLike,
    fits: str | os.PathLike,
    images_path: str | os.PathLike,
    brdf_path: str | os.PathLike,
    pairs_path: str | os.PathLike | None = None,
) -> None:
    """Write the tables of one material: those of :func:`material_errors`, the second if ``pairs_path`` is given, and
    that of :func:`material_brdf_errors`.

    ``tones``: scene -> (exposure, gamma). Entries without a row for the material ("absent") have none here either.
    """
    models = [name for name in models if read_record(Path(fits) / f"{name}.json", "status")["status"] != ABSENT]
    images, pairs = material_errors(material, models, {name: Tone(*tone) for name, tone in tones.items()}, renders)
    brdf = material_brdf_errors(read(binary), models, fits)
    write_tsv(images_path, images)
    if pairs_path:
        write_tsv(pairs_path, pairs)
    write_tsv(brdf_path, brdf.assign(material=material))
