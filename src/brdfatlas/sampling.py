"""Importance sampling of analytic fits: each model's own procedure, with its pdf.

Bilgili et al. 2011, supplement, section 3 (Eqs. 18–42), with these corrections of the print:

- phi_h = 2 pi xi. Eq. 23's pi xi / 2 covers one quadrant.
- Edwards: p(wi | wo) = D(H) (n·wi). Eq. 34 lacks the factor n·wi: D is a density on the unit disk, and
  dwi = dx dy / (n·wi).
- A sampled half vector may send wi below the horizon, and a point of Edwards' disk (any with R > 2, some with less) may
  lie outside the unit disk about wo: no direction belongs to it. Such samples are rejected, ``sample`` returns
  (0, 0, -1) for them, where the pdf and the BRDF are 0: weight zero, no bias. So the pdf integrates over the hemisphere
  to 1 minus the rejected share, which :meth:`Sampler.sample` therefore never renormalises.

Cook–Torrance, Ngan's model and Ward–Duer are sampled by Ward's procedure, as the supplement does. ABC: Löw et al. 2012.
The microfacet models of Dupuy et al. 2015 and SGD are sampled by the density D cos theta_h of their half vectors
(Walter et al. 2007), SGD with one lobe a channel. The lobes of one fit are mixed with the weights of Eqs. 40–42.

    sampler = fit.sampler()
    wi = sampler.sample(u, wo)           # u (..., 3) uniform in [0, 1): one to choose the lobe, two for the direction
    p = sampler.pdf(wi, wo)              # 1/sr

A model builds its sampler of these lobes (``Model.sampler``). Written as data, kinds, weights and numbers of the lobes,
it can be made in any renderer. The project's own renders do not use it: they sample the reference and all fits by one
common density.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from brdfatlas.files import read_record, shown
from brdfatlas.microfacet import ggx_ndf

FORMAT = "brdfatlas-sampler-1"
REJECTED = np.array([0.0, 0.0, -1.0])


class Sampler(ABC):
    """A density of incident directions for a given outgoing one, both unit vectors with n = z."""

    @abstractmethod
    def sample(self, u: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """wi (..., 3) from uniform numbers u (..., 3) in [0, 1); (0, 0, -1) where the sample is rejected."""

    @abstractmethod
    def pdf(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """p(wi | wo) in 1/sr, (...); 0 where a direction is below the surface."""


@dataclass(frozen=True)
class Lobe(Sampler):
    """One lobe; the first of its three uniform numbers is left to the mixture."""

    kind: ClassVar[str]

    def pdf(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        wi, wo = np.broadcast_arrays(np.asarray(wi, float), np.asarray(wo, float))
        with np.errstate(all="ignore"):
            p = self._density(wi, wo)
        return np.where((wi[..., 2] > 0) & (wo[..., 2] > 0), p, 0.0)

    @abstractmethod
    def _density(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        """The pdf where both directions are above the surface."""


@dataclass(frozen=True)
class Diffuse(Lobe):
    """Proportional to the cosine (Eqs. 18–21). Integrates to 1."""

    kind = "diffuse"

    def sample(self, u: np.ndarray, wo: np.ndarray) -> np.ndarray:
        u, wo = _broadcast(u, wo)
        sine, phi = np.sqrt(u[..., 1]), 2 * np.pi * u[..., 2]
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.sqrt(1 - u[..., 1])], -1)

    def _density(self, wi, wo):
        return wi[..., 2] / np.pi


class HalfVectorLobe(Lobe):
    """Samples theta_h from a density of half vectors, phi_h uniformly, and reflects wo (Eqs. 24, 25)."""

    @abstractmethod
    def _tan_theta_h(self, xi: np.ndarray) -> np.ndarray:
        """Inverse of the distribution of theta_h."""

    @abstractmethod
    def _half_density(self, cos_h: np.ndarray, sin_h: np.ndarray) -> np.ndarray:
        """Density of half vectors in 1/sr; its integral over the hemisphere is 1."""

    def sample(self, u: np.ndarray, wo: np.ndarray) -> np.ndarray:
        u, wo = _broadcast(u, wo)
        with np.errstate(all="ignore"):
            tan, phi = self._tan_theta_h(u[..., 1]), 2 * np.pi * u[..., 2]
            cos = 1 / np.sqrt(1 + tan**2)
            sin = np.where(np.isfinite(tan), tan * cos, 1.0)
        h = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], -1)
        wi = 2 * np.sum(wo * h, -1, keepdims=True) * h - wo
        return np.where(wi[..., 2:] > 0, wi, REJECTED)

    def _density(self, wi, wo):
        total = wi + wo
        length = np.linalg.norm(total, axis=-1)
        cos_h, sin_h = total[..., 2] / length, np.hypot(total[..., 0], total[..., 1]) / length
        return self._half_density(cos_h, sin_h) / (4 * 0.5 * length)  # wo·h = ||wi + wo|| / 2


@dataclass(frozen=True)
class AshikhminShirleyLobe(HalfVectorLobe):
    """Eqs. 22–26, with phi_h = 2 pi xi."""

    n: float
    kind = "ashikhmin_shirley"

    def _tan_theta_h(self, xi):
        log_cos = np.log(np.maximum(xi, 1e-300)) / (self.n + 1)
        return np.sqrt(np.expm1(-2 * log_cos))

    def _half_density(self, cos_h, sin_h):
        log_cos = 0.5 * np.log1p(-np.minimum(sin_h**2, 1 - 1e-16))
        return (self.n + 1) / (2 * np.pi) * np.exp(self.n * log_cos)


@dataclass(frozen=True)
class WardLobe(HalfVectorLobe):
    """Eqs. 35–39; used for Cook–Torrance with alpha = m, and for Ward–Duer."""

    alpha: float
    kind = "ward"

    def _tan_theta_h(self, xi):
        return self.alpha * np.sqrt(-np.log(np.maximum(xi, 1e-300)))

    def _half_density(self, cos_h, sin_h):
        return np.exp(-((sin_h / (cos_h * self.alpha)) ** 2)) / (np.pi * self.alpha**2 * cos_h**3)


@dataclass(frozen=True)
class AbcLobe(HalfVectorLobe):
    """Löw et al. 2012: density of half vectors proportional to (1 + B (1 - cos theta_h))^(-C)."""

    B: float
    C: float
    kind = "abc"

    def integral(self) -> float:
        """int S dh over the hemisphere, sr."""
        span, power = np.log1p(self.B), 1 - self.C
        return float(2 * np.pi / self.B * (span if abs(power * span) < 1e-9 else np.expm1(power * span) / power))

    def _one_minus_cos(self, xi):
        span, power = np.log1p(self.B), 1 - self.C
        log_x = xi * span if abs(power * span) < 1e-9 else np.log1p(xi * np.expm1(power * span)) / power
        return np.expm1(log_x) / self.B

    def _tan_theta_h(self, xi):
        v = self._one_minus_cos(xi)
        return np.sqrt(v * (2 - v)) / np.maximum(1 - v, 1e-300)

    def _half_density(self, cos_h, sin_h):
        one_minus_cos = sin_h**2 / (1 + cos_h)
        return np.exp(-self.C * np.log1p(self.B * one_minus_cos)) / self.integral()


@dataclass(frozen=True)
class GgxLobe(HalfVectorLobe):
    """D cos theta_h of GGX (Walter et al. 2007, Eqs. 33, 35)."""

    alpha: float
    kind = "ggx"

    def _tan_theta_h(self, xi):
        return self.alpha * np.sqrt(xi / (1 - xi))

    def _half_density(self, cos_h, sin_h):
        return ggx_ndf(cos_h, self.alpha) * cos_h


@dataclass(frozen=True)
class Gtr1Lobe(HalfVectorLobe):
    """D cos theta_h of Burley's GTR of exponent 1 (Burley 2012, appendix B.2, Eqs. 4, 5)."""

    alpha: float
    kind = "gtr1"

    def _tan_theta_h(self, xi):
        squared = self.alpha**2
        sin2 = np.expm1(xi * -np.log(squared)) * squared / (1 - squared)
        return np.sqrt(sin2 / np.maximum(1 - sin2, 1e-300))

    def _half_density(self, cos_h, sin_h):
        squared = self.alpha**2
        return (squared - 1) * cos_h / (np.pi * np.log(squared) * (squared + (1 - squared) * sin_h**2))


@dataclass(frozen=True)
class TabulatedLobe(HalfVectorLobe):
    """Steps: each of the theta_h rows of a MERL table, edges (k / n)^2 90 degrees, has its share of half vectors,
    spread evenly over the row's solid angle."""

    shares: tuple[float, ...]
    kind = "tabulated"

    def _edges(self) -> np.ndarray:
        """1 - cos theta_h of the rows' edges, from 0 to 1."""
        return 2 * np.sin(np.linspace(0, 1, len(self.shares) + 1) ** 2 * (np.pi / 4)) ** 2

    def _tan_theta_h(self, xi):
        reached = np.concatenate([[0.0], np.cumsum(self.shares)])
        v = np.interp(xi, reached / reached[-1], self._edges())
        return np.sqrt(v * (2 - v)) / np.maximum(1 - v, 1e-300)

    def _half_density(self, cos_h, sin_h):
        edges = self._edges()
        density = np.array(self.shares) / (sum(self.shares) * 2 * np.pi * np.diff(edges))
        row = np.searchsorted(edges, sin_h**2 / (1 + cos_h), side="right") - 1
        return density[np.clip(row, 0, len(self.shares) - 1)]


@dataclass(frozen=True)
class SgdLobe(HalfVectorLobe):
    """D cos theta_h of the shifted gamma distribution (Bagher et al. 2012): exp(-t) t^-p in t = alpha + tan^2 / alpha.

    Its distribution function has no inverse: it is tabulated in ln t and taken linear between nodes, and the pdf is
    the density of just that.
    """

    alpha: float
    p: float
    kind = "sgd"

    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """v = ln(t / alpha) and the distribution function there."""
        v = np.linspace(0, np.log1p(60 / self.alpha), 1025)
        t = self.alpha * np.exp(v)
        log_density = -t - (self.p - 1) * np.log(t)
        density = np.exp(log_density - log_density.max())
        reached = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
        return v, reached / reached[-1]

    def _tan_theta_h(self, xi):
        v, reached = self._table()
        return self.alpha * np.sqrt(np.expm1(np.interp(xi, reached, v)))

    def _half_density(self, cos_h, sin_h):
        v, reached = self._table()
        squared = (sin_h / cos_h) ** 2
        step = np.searchsorted(v, np.log1p(squared / self.alpha**2), side="right") - 1
        density = np.append(np.diff(reached) / np.diff(v), 0.0)[np.minimum(step, v.size - 1)]
        return density / (np.pi * (self.alpha**2 + squared) * cos_h**3)  # dv = 2 tan dtheta / (cos^2 (alpha^2 + tan^2))


@dataclass(frozen=True)
class EdwardsLobe(Lobe):
    """The halfway vector disk, orthogonal projection (Eqs. 27–34, with n·wi in the pdf)."""

    R: float
    n: float
    kind = "edwards"

    def sample(self, u: np.ndarray, wo: np.ndarray) -> np.ndarray:
        u, wo = _broadcast(u, wo)
        phi = 2 * np.pi * u[..., 1]
        r = self.R * np.sqrt(-np.expm1(np.log(np.maximum(u[..., 2], 1e-300)) / (self.n + 1)))
        x, y = r * np.cos(phi) - wo[..., 0], r * np.sin(phi) - wo[..., 1]
        squared = x * x + y * y
        wi = np.stack([x, y, np.sqrt(np.maximum(1 - squared, 0))], -1)
        return np.where(squared[..., None] < 1, wi, REJECTED)

    def _density(self, wi, wo):
        H = wi + wo
        squared = (H[..., 0] ** 2 + H[..., 1] ** 2) / self.R**2
        inside = squared < 1
        D = (self.n + 1) / (np.pi * self.R**2) * np.exp(self.n * np.log1p(np.where(inside, -squared, 0.0)))
        return np.where(inside, D, 0.0) * wi[..., 2]


KINDS: dict[str, type[Lobe]] = {
    lobe.kind: lobe
    for lobe in (
        Diffuse,
        AshikhminShirleyLobe,
        WardLobe,
        AbcLobe,
        EdwardsLobe,
        GgxLobe,
        Gtr1Lobe,
        TabulatedLobe,
        SgdLobe,
    )
}


@dataclass(frozen=True)
class Mixture(Sampler):
    """Lobes chosen by their weights; the pdf is the weighted sum (Eq. 42)."""

    lobes: Sequence[Lobe]
    weights: np.ndarray

    def sample(self, u: np.ndarray, wo: np.ndarray) -> np.ndarray:
        u, wo = _broadcast(u, wo)
        edges = np.cumsum(self.weights)[:-1]
        chosen = np.searchsorted(edges, u[..., 0], side="right")
        wi = np.empty(wo.shape)
        for index, lobe in enumerate(self.lobes):
            mask = chosen == index
            wi[mask] = lobe.sample(u[mask], wo[mask])
        return wi

    def pdf(self, wi: np.ndarray, wo: np.ndarray) -> np.ndarray:
        return sum(float(w) * lobe.pdf(wi, wo) for w, lobe in zip(self.weights, self.lobes))  # type: ignore[return-value]


def _broadcast(u: np.ndarray, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    u, wo = np.broadcast_arrays(np.asarray(u, float), np.asarray(wo, float))
    return u, wo


def mixture(diffuse: float, lobes: Sequence[Lobe], specular: Sequence[float] | np.ndarray) -> Mixture:
    """A diffuse lobe and others, weighted by how much each reflects (sums over rgb, Eqs. 40, 41); diffuse alone where
    nothing is reflected."""
    weights = np.array([diffuse, *specular], float)
    total = weights.sum()
    weights = weights / total if total > 0 else np.array([1.0, *np.zeros(len(lobes))])
    return Mixture([Diffuse(), *lobes], weights)


def sampler_as_data(sampler: Sampler) -> dict[str, Any]:
    """A mixture as plain data: format, and kind, weight and numbers of every lobe. ValueError for lobes of another
    kind, which no reader would know."""
    if not isinstance(sampler, Mixture) or any(KINDS.get(lobe.kind) is not type(lobe) for lobe in sampler.lobes):
        raise ValueError(f"the sampler is no mixture of lobes of these kinds: {', '.join(KINDS)}")
    lobes = [
        {"kind": lobe.kind, "weight": float(weight)} | asdict(lobe)
        for weight, lobe in zip(sampler.weights, sampler.lobes)
    ]
    return {"format": FORMAT, "lobes": lobes}


def sampler_from(description: Mapping[str, Any]) -> Mixture:
    """The sampler of a description. ValueError says what is wrong with it."""
    if description.get("format") != FORMAT:
        raise ValueError(f"not a sampler description: format {description.get('format')!r}, expected {FORMAT!r}")
    lobes, weights = [], []
    try:
        for entry in description["lobes"]:
            numbers = {
                key: tuple(float(v) for v in value) if isinstance(value, list | tuple) else float(value)
                for key, value in entry.items()
                if key not in ("kind", "weight")
            }
            if entry["kind"] not in KINDS:
                raise ValueError(f"unknown lobe kind {entry['kind']!r}; known: {', '.join(KINDS)}")
            lobes.append(KINDS[entry["kind"]](**numbers))
            weights.append(float(entry["weight"]))
    except (KeyError, TypeError, AttributeError):
        raise ValueError("not a sampler description: each lobe has a kind, a weight and its own numbers") from None
    found = np.array(weights)
    if not (found >= 0).all() or not abs(found.sum() - 1) < 1e-6:
        raise ValueError(f"not a sampler description: weights {weights}, numbers from 0 with sum 1 are wanted")
    return Mixture(lobes, found)


def load_sampler(path: str | os.PathLike) -> Mixture:
    """The sampler of a JSON file that holds :func:`sampler_as_data`. ValueError names the file and what is wrong."""
    try:
        return sampler_from(read_record(path))
    except ValueError as error:
        told = str(error)
        raise ValueError(told if told.startswith(shown(path)) else f"{shown(path)}: {told}") from None
