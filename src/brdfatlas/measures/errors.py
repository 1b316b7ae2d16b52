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
"""

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from brdfatlas.constants import REFERENCE, REFERENCE_AGAIN
from brdfatlas.files import read_json
from brdfatlas.fits import load_fit
from brdfatlas.measured import Measured, read_merl
from brdfatlas.measures.tsv import write_tsv
from brdfatlas.objectives import compressive_weights, cosine_weighted, loew_e2, log_deviation, relative_objective
from brdfatlas.rendering.images import Render, load_render, tone_map

IMAGE_MEASURES = (
    "psnr_db",
    "psnr_se_db",
    "psnr_tonemapped_db",
    "de00_mean",
    "de00_p95",
    "flip_mean",
    "ssim",
    "rmse",
    "rel_mse",
)
BRDF_MEASURES = ("objective_compressive", "loew_e2", "cosine_weighted", "log_deviation")
#: An estimate of the MSE below this many standard errors is not told apart from zero; PSNR is then a lower bound.
DETECTION = 2.0

log = logging.getLogger(__name__)


class Tone(NamedTuple):
    """Exposure and gamma of a scene's tone map."""

    exposure: float
    gamma: float


def expose(linear: np.ndarray, exposure: float) -> np.ndarray:
    """Linear light of a display, clipped to [0, 1]: ln 2 exposure x, the tone map's own slope in the dark."""
    return np.clip(np.log(2.0) * exposure * linear, 0.0, 1.0)


def to_8_bit(display: np.ndarray) -> np.ndarray:
    """Display values in [0, 1] to bytes, rounded."""
    return np.rint(np.clip(display, 0.0, 1.0) * 255.0).astype(np.uint8)


def srgb_encode(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve (IEC 61966-2-1) on values in [0, 1]."""
    low = linear <= 0.0031308
    return np.where(low, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def psnr(peak: float, mean_squared: float) -> float:
    """10 log10(peak^2 / MSE) in dB; +inf for MSE = 0."""
    return float("inf") if mean_squared == 0 else float(10 * np.log10(peak**2 / mean_squared))


def batch_products(reference: np.ndarray, image: np.ndarray) -> np.ndarray:
    """K_ab = <F_a - R_a, F_b - R_b> of batches (n, pixels, 3): an n x n matrix, radiance squared."""
    difference = (image.astype(np.float64) - reference).reshape(len(image), -1)
    return difference @ difference.T / difference.shape[1]


def mean_squared_error(products: np.ndarray, *, unbiased: bool = True) -> tuple[float, np.ndarray]:
    """MSE from the matrix of :func:`batch_products`, and the n values that leaving one batch out gives.

    ``unbiased``: the U-statistic of the module's text, for images with common random numbers; it needs two batches,
    three for its jackknife. Otherwise the plain MSE of the two averages, with their noise.
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
    """Standard error of a statistic from its n leave-one-out values: sqrt((n - 1)/n sum (t_b - mean t)^2)."""
    n = len(without)
    return float(np.sqrt((n - 1) / n * np.sum((without - without.mean()) ** 2)))


def above_noise(value: float, spread: float) -> tuple[float, bool]:
    """An estimate of an MSE and True; where it is below DETECTION standard errors, so that zero explains it as well,
    the upper bound max(value, 0) + DETECTION spread and False."""
    if value > DETECTION * spread:
        return value, True
    return max(value, 0.0) + DETECTION * spread, False


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
    mask = reference.mask
    a, b = reference.batches[:, mask], image.batches[:, mask]
    covered = reference.mean[mask].astype(np.float64)
    peak, n = float(covered.max()), len(a)
    unbiased = unbiased and n > 1
    products = batch_products(a, b)
    if not products.any():
        return {"psnr_db": float("inf"), "psnr_se_db": 0.0, "rmse": 0.0, "rel_mse": 0.0}
    value, without = mean_squared_error(products, unbiased=unbiased)
    scale = 1 / np.sqrt(covered**2 + 0.01 * max(float(covered.mean()) ** 2, 1e-30))
    relative, relative_without = mean_squared_error(batch_products(a * scale, b * scale), unbiased=unbiased)
    seen = True
    if unbiased and n > 2:
        value, seen = above_noise(value, jackknife_error(without))
        relative, _ = above_noise(relative, jackknife_error(relative_without))
    elif value <= 0:
        raise ValueError("two batches are too few to bound an error below the noise; render at least three")
    peaks = np.array([(covered * n - batch).max() / (n - 1) for batch in a]) if n > 1 else np.array([peak])
    in_db = 20 * np.log10(peaks) - 10 / np.log(10) * without / value
    return {
        "psnr_db": psnr(peak, value),
        "psnr_se_db": jackknife_error(in_db) if seen else float("inf"),
        "rmse": float(np.sqrt(value)),
        "rel_mse": max(relative, 0.0),
    }


def displayed_lab(linear: np.ndarray, exposure: float) -> np.ndarray:
    """CIE Lab (D65, 2 degrees) of linear radiance (..., 3): fixed exposure, clip, sRGB, Lab; float32."""
    from skimage.color import rgb2lab

    return rgb2lab(srgb_encode(expose(linear, exposure)).astype(np.float32))


def delta_e(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """CIEDE2000 between Lab colours (..., 3), by scikit-image."""
    from skimage.color import deltaE_ciede2000

    return deltaE_ciede2000(a, b)


def delta_e_map(reference: np.ndarray, image: np.ndarray, exposure: float) -> np.ndarray:
    """CIEDE2000 per pixel between images of linear radiance (..., 3) at one exposure; (...) float32."""
    return delta_e(displayed_lab(reference, exposure), displayed_lab(image, exposure)).astype(np.float32)


def flip_map(reference: np.ndarray, image: np.ndarray) -> np.ndarray:
    """FLIP (Andersson et al. 2020) per pixel of two display images (h, w, 3) in [0, 1]; (h, w) float32, 67 pixels per
    degree."""
    from flip_evaluator import evaluate

    a, b = (np.ascontiguousarray(x, dtype=np.float32) for x in (reference, image))
    return np.asarray(evaluate(a, b, "LDR", applyMagma=False, computeMeanError=False)[0]).reshape(a.shape[:2])


def ssim_map(reference: np.ndarray, image: np.ndarray) -> np.ndarray:
    """SSIM (Wang et al. 2004: Gaussian window, sigma 1.5) per pixel of two display images (h, w, 3); channels
    averaged, (h, w)."""
    from skimage.metrics import structural_similarity

    _, values = structural_similarity(
        np.asarray(reference, np.float32),
        np.asarray(image, np.float32),
        channel_axis=2,
        data_range=1.0,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return values.mean(-1)


def displayed(reference: Render, image: Render, tone: Tone) -> tuple[np.ndarray, np.ndarray]:
    """Both images tone-mapped, (h, w, 3); outside the mask both show the reference, so that windows that reach over the
    edge of the material see no noise."""
    shown = tone_map(reference.mean, *tone)
    return shown, np.where(reference.mask[..., None], tone_map(image.mean, *tone), shown)


def check_pair(reference: Render, image: Render) -> None:
    """ValueError unless both have one size, equally many batches, a covered pixel and finite covered pixels."""
    if reference.mean.shape != image.mean.shape:
        raise ValueError(f"images of different sizes: {reference.mean.shape[:2]} and {image.mean.shape[:2]}")
    if reference.batches.shape != image.batches.shape:
        raise ValueError(f"different numbers of batches: {len(reference.batches)} and {len(image.batches)}")
    if not reference.mask.any():
        raise ValueError("no pixel of the reference is covered by the material")
    for name, render in (("reference", reference), ("image", image)):
        if not np.isfinite(render.mean[reference.mask]).all():
            raise ValueError(f"the {name} holds NaN or Inf where the material is")
        if not np.isfinite(render.batches[:, reference.mask]).all():
            raise ValueError(f"a batch of the {name} holds NaN or Inf where the material is")
    if not reference.mean[reference.mask].max() > 0:
        raise ValueError("the reference is black where the material is: PSNR has no peak")


def image_errors(reference: Render, image: Render, tone: Tone, *, common_numbers: bool = True) -> dict[str, float]:
    """All IMAGE_MEASURES of one pair, over the pixels of the reference's mask.

    ``common_numbers``: the pair shares random numbers batch by batch, and the noise's bias is taken out of the linear
    measures. False for two references of different seeds (the noise floor), where the noise itself is what is
    measured, and the plain MSE of the two averages is reported. Tone-mapped PSNR, dE00, FLIP and SSIM are not linear
    and always are those of the averages; the row of the noise floor says how much of them is noise. Raises ValueError
    as :func:`check_pair`.
    """
    check_pair(reference, image)
    mask = reference.mask
    shown, compared = displayed(reference, image, tone)
    a, b = (to_8_bit(x[mask]).astype(np.float64) for x in (shown, compared))
    delta = delta_e_map(reference.mean[mask], image.mean[mask], tone.exposure)
    values = linear_errors(reference, image, unbiased=common_numbers) | {
        "psnr_tonemapped_db": psnr(255.0, float(np.mean((a - b) ** 2))),
        "de00_mean": float(delta.mean(dtype=np.float64)),
        "de00_p95": float(np.percentile(delta, 95)),
        "flip_mean": float(flip_map(shown, compared)[mask].mean(dtype=np.float64)),
        "ssim": float(ssim_map(shown, compared)[mask].mean(dtype=np.float64)),
    }
    return {name: values[name] for name in IMAGE_MEASURES}


def material_errors(
    material: str, models: Sequence[str], tones: Mapping[str, Tone], folder: str | os.PathLike
) -> pd.DataFrame:
    """Image measures of one material, tidy: material, model, scene, status, then IMAGE_MEASURES.

    ``folder`` holds {model}/{scene}.exr with "reference" and, as the noise floor, "reference_again" beside the
    ``models``; ``tones`` has an entry a scene. A render that says it failed, and one with NaN or Inf, give a row with
    status "failed" and NaN measures. Raises ValueError, naming the scene, if a reference cannot be used.
    """
    rows = []
    for scene, tone in tones.items():
        reference = load_render(Path(folder) / REFERENCE / f"{scene}.exr")
        try:
            check_pair(reference, reference)
        except ValueError as error:
            raise ValueError(f"{material}, {scene}: {error}") from None
        for model in dict.fromkeys([*models, REFERENCE_AGAIN]):
            row: dict[str, object] = {"material": material, "model": model, "scene": scene, "status": "failed"}
            image = load_render(Path(folder) / model / f"{scene}.exr")
            if image.meta.get("status", "ok") == "ok":
                try:
                    row |= image_errors(reference, image, tone, common_numbers=model != REFERENCE_AGAIN)
                    row["status"] = "ok"
                except ValueError as error:
                    log.warning("%s, %s, %s: %s", material, model, scene, error)
            rows.append(row)
    table = pd.DataFrame(rows, columns=["material", "model", "scene", "status", *IMAGE_MEASURES])
    order = {name: i for i, name in enumerate(dict.fromkeys([*models, REFERENCE_AGAIN]))}
    return table.sort_values("model", key=lambda names: names.map(order), kind="stable", ignore_index=True)


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
        if read_json(Path(folder) / f"{model}.json")["status"] == "ok":
            row |= brdf_errors(load_fit(Path(folder) / f"{model}.npz").table(), measured.table, weights)
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
) -> None:
    """Write the two tables of one material, of :func:`material_errors` and :func:`material_brdf_errors`.

    ``tones``: scene -> (exposure, gamma).
    """
    images = material_errors(material, models, {scene: Tone(*tone) for scene, tone in tones.items()}, renders)
    brdf = material_brdf_errors(read_merl(binary), models, fits)
    write_tsv(images_path, images)
    write_tsv(brdf_path, brdf.assign(material=material))
