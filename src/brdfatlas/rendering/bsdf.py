"""The Mitsuba plugin ``brdfatlas``: a tabulated BRDF, usable in any Mitsuba scene.

``{"type": "brdfatlas", "filename": "chrome.binary"}`` where the file is a MERL ``.binary`` or a fit (``.npz``). With
``"reference": "chrome.binary"`` the mask of measured cells and the sampling density come from that file: a reference
and its fits then render with the same random paths. Values are trilinear between cell centres, as
:func:`brdfatlas.measured.look_up`. In Mitsuba wi points to the viewer and wo to the light, so a value here is that of
``look_up(table, wo, wi)``.
"""

import os
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from brdfatlas.angles import N_PHI_D, N_THETA_D, N_THETA_H, above_horizon
from brdfatlas.compiled import njit
from brdfatlas.formats.reader import read
from brdfatlas.measured import TABLE_SHAPES, Measured, MeasuredError, extend, extension_index
from brdfatlas.rendering.arrays import aligned, upload
from brdfatlas.rendering.density import LIST_LENGTH, N_ELEVATIONS, Density, sampling_density

#: How many tables one kernel takes; a group is filled up with zeros to the next of these sizes.
GROUP_SIZES = (1, 4, 8, 16, 24, 32)
_ROWS = 512


def load_table(filename: str | os.PathLike) -> tuple[np.ndarray, np.ndarray]:
    """The table (90, 90, 180 or 360, 3) of a ``.binary`` or of a fit ``.npz``, and its mask of valid cells.

    Raises ValueError (MeasuredError) with one line that names the file.
    """
    from brdfatlas.fits import is_fit_file, load_fit

    if is_fit_file(filename):
        return load_fit(filename).table(), above_horizon()
    measured = read(filename)
    return measured.table, measured.valid


def interleave(tables: Sequence[np.ndarray], valid: np.ndarray) -> tuple[np.ndarray, int, int]:
    """A group of tables with their values beside each other: cell by cell, rgb of the first, of the second ..., filled
    up with zeros; also how many numbers a cell has and how many cells phi_d.

    Every table is extended beyond the mask ``valid``. If one is on the full circle, or the mask is, all are put there.
    MeasuredError for a table of another shape, and for one that is not finite where there was a measurement.
    """
    for table in tables:  # compiled code would read beyond its end
        if np.shape(table) not in TABLE_SHAPES:
            raise MeasuredError(f"a table of shape {np.shape(table)}; {' or '.join(map(str, TABLE_SHAPES))} is needed")
    n_phi = max(shape[2] for shape in (valid.shape, *(table.shape for table in tables)))
    if valid.shape[2] < n_phi:
        valid = np.concatenate([valid, valid], 2)
    index = extension_index(valid).ravel()
    places = {n_phi: index, N_PHI_D: index // n_phi * N_PHI_D + index % n_phi % N_PHI_D}
    size = next(size for size in GROUP_SIZES if size >= len(tables))
    stride = max(4, 3 * size)
    packed = aligned(valid.size * stride)
    rows = packed.reshape(-1, stride)
    for first in range(0, len(rows), _ROWS):  # parts that stay in the cache
        part = slice(first, first + _ROWS)
        for number, table in enumerate(tables):
            _gather(table.reshape(-1, 3), places[table.shape[2]][part], rows[part, 3 * number : 3 * number + 3])
    if not np.isfinite(packed).all():
        raise MeasuredError("the table holds NaN or Inf in cells that its reference measured")
    return packed, stride, n_phi


@njit(cache=True, nogil=True)
def _gather(source, places, target):
    """target[n] = source[places[n]] for colours, without NumPy's copy."""
    for n in range(len(places)):
        for channel in range(3):
            target[n, channel] = source[places[n], channel]


def _index(place: Any, last: Any) -> Any:
    """The whole part of a place from 0 to ``last``, 0 for what is not a number: an index must be within its table."""
    import drjit as dr
    import mitsuba as mi

    return mi.UInt32(dr.select(place > 0, dr.minimum(place, last), 0.0))


class Reflectance:
    """A group of tables and a density in the form that one Mitsuba variant computes with; directions are local, n = z.

    All tables are looked up at once: angles, weights and the fetch of a corner serve the whole group.
    """

    def __init__(
        self, tables: np.ndarray | Sequence[np.ndarray], valid: np.ndarray, density: Density | None = None
    ) -> None:
        """``tables``: one (90, 90, 180 or 360, 3), or up to 32 of them, extended beyond ``valid``; ``density`` defaults
        to that of the first."""
        import drjit as dr
        import mitsuba as mi

        tables = [tables] if isinstance(tables, np.ndarray) else list(tables)
        self.count, self.valid = len(tables), valid
        packed, self._stride, n_phi = interleave(tables, valid)
        #: With the zeros that fill up the group.
        self.size = max(1, self._stride // 3)
        self.density = density or sampling_density(extend(tables[0], valid))
        self._scalar = not dr.is_jit_v(mi.Float)
        if self._scalar:
            self._table, self._cells = packed.reshape(-1, self._stride), self.density.cells.reshape(-1, 4)
            self._runs = self.density.runs.reshape(-1, 2)
            self._weight, self._entries = self.density.cosine_weight, self.density.entries.ravel()
            self._n_phi = n_phi
        else:
            self._table, self._cells = mi.Float(packed), upload(mi.Float, self.density.cells)
            self._runs = upload(mi.Float, self.density.runs)
            self._weight = upload(mi.Float, self.density.cosine_weight)
            self._entries = upload(mi.UInt32, self.density.entries)
            self._n_phi = mi.UInt32(n_phi)
            dr.make_opaque(self._n_phi)

    def with_tables(self, tables: np.ndarray | Sequence[np.ndarray]) -> "Reflectance":
        """Other tables under the same mask and density: fits beside their reference."""
        return Reflectance(tables, self.valid, self.density)

    # One look-up; scalar variants have no gathers, so they index NumPy arrays.
    def _four(self, source: Any, index: Any, active: Any) -> Any:
        import drjit as dr
        import mitsuba as mi

        if self._scalar:
            return mi.Vector4f(*source[int(index)].tolist())
        return dr.gather(mi.Vector4f, source, index, active)

    def _two(self, source: Any, index: Any, active: Any) -> Any:
        import drjit as dr
        import mitsuba as mi

        if self._scalar:
            return mi.Vector2f(*source[int(index)].tolist())
        return dr.gather(mi.Vector2f, source, index, active)

    def _one(self, source: Any, index: Any, active: Any) -> Any:
        import drjit as dr

        if self._scalar:
            return source[int(index)].item()
        return dr.gather(type(source), source, index, active)

    @staticmethod
    def angles(wi: Any, wo: Any) -> tuple[Any, Any, Any]:
        """theta_h, theta_d and phi_d of the full circle, as :func:`brdfatlas.angles.half_difference` of (wo, wi), the
        light before the viewer, without its double precision."""
        import drjit as dr

        total, difference = wi + wo, wi - wo
        norm = dr.norm(total)
        h = total * dr.rcp(dr.maximum(norm, 1e-20))
        rho = dr.sqrt(h.x * h.x + h.y * h.y)
        theta_h = dr.atan2(rho, h.z)
        theta_d = dr.atan2(dr.norm(difference), norm)
        inverse = dr.rcp(dr.maximum(rho, 1e-20))
        tilted = rho > 1e-12
        cos_p, sin_p = dr.select(tilted, h.x * inverse, 1.0), dr.select(tilted, h.y * inverse, 0.0)
        along = h.z * (wo.x * cos_p + wo.y * sin_p) - rho * wo.z
        phi_d = dr.atan2(wo.y * cos_p - wo.x * sin_p, along)
        return theta_h, theta_d, dr.select(phi_d < 0, phi_d + 2 * np.pi, phi_d)

    def _theta_h_place(self, theta_h: Any) -> Any:
        import drjit as dr

        return dr.sqrt(theta_h * (2 / np.pi)) * N_THETA_H

    def _row(self, wi: Any) -> Any:
        import drjit as dr

        place = dr.safe_acos(wi.z) * (2 / np.pi * N_ELEVATIONS)
        return _index(place, N_ELEVATIONS - 1.0)

    def values(self, angles: tuple[Any, Any, Any], active: Any, chance: Any = None) -> list[Any]:
        """The BRDF of every table of the group, 1/sr: trilinear, or with ``chance``, 32 random bits, an estimate of it.

        The estimate takes one neighbour in theta_d and one in phi_d with a probability equal to its weight (Fajardo et
        al. 2023, Stochastic Texture Filtering), so 2 cells are read in place of 8: memory is what limits a render. It
        interpolates along theta_h, where highlights are steep.
        """
        import drjit as dr
        import mitsuba as mi

        theta_h, theta_d, phi_d = angles
        n_phi = self._n_phi
        cells = mi.Float(n_phi)
        x = dr.clip(self._theta_h_place(theta_h) - 0.5, 0.0, N_THETA_H - 1.0)
        y = dr.clip(theta_d * (2 / np.pi * N_THETA_D) - 0.5, 0.0, N_THETA_D - 1.0)
        z = phi_d * (N_PHI_D / np.pi) - 0.5
        z = dr.select(z < 0, z + cells, dr.select(z >= cells, z - cells, z))
        i, j, k = _index(x, N_THETA_H - 2.0), _index(y, N_THETA_D - 2.0), _index(z, cells - 1)
        u, v, w = x - mi.Float(i), y - mi.Float(j), z - mi.Float(k)
        k1 = dr.select(k + 1 == n_phi, mi.UInt32(0), k + 1)
        columns, places = [(j, 1 - v), (j + 1, v)], [(k, 1 - w), (k1, w)]
        if chance is not None:
            columns = [(dr.select(mi.Float(chance >> 16) < v * 2**16, j + 1, j), 1.0)]
            places = [(dr.select(mi.Float(chance & 0xFFFF) < w * 2**16, k1, k), 1.0)]
        total = None
        for row, weight_h in ((i, 1 - u), (i + 1, u)):
            for column, weight_d in columns:
                for place, weight_p in places:
                    found = self._cell((row * N_THETA_D + column) * n_phi + place, active)
                    share = weight_h * weight_d * weight_p
                    total = [dr.fma(f, share, t) for f, t in zip(found, total or [0.0] * len(found))]
        return [mi.Color3f(*total[3 * n : 3 * n + 3]) for n in range(self.size)]

    def _cell(self, cell: Any, active: Any) -> list[Any]:
        """The numbers of one cell, by packets of the width of a vector."""
        import drjit as dr
        import mitsuba as mi

        if self._scalar:
            return self._table[int(cell)].tolist()
        if self._stride % 8:
            packets = self._stride // 4
            found = [dr.gather(mi.Vector4f, self._table, cell * packets + n, active) for n in range(packets)]
        else:
            packets, shape = self._stride // 8, (8, dr.width(cell))
            found = [
                dr.gather(mi.ArrayXf, self._table, cell * packets + n, active, shape=shape) for n in range(packets)
            ]
        return [number for packet in found for number in packet]

    def pdf_at(self, wi: Any, wo: Any, theta_h: Any, incidence: tuple[Any, Any], active: Any) -> Any:
        """Density of ``wo`` in 1/sr for directions above the surface, whose theta_h is known."""
        import drjit as dr

        row, weight = incidence
        cell = _index(self._theta_h_place(theta_h), N_THETA_H - 1.0)
        cell = self._four(self._cells, row * N_THETA_H + cell, active)
        sine = dr.sin(0.5 * theta_h)
        t = dr.clip((2 * sine * sine - cell.x) / cell.y, 0.0, 1.0)
        half = cell.z * (1 + cell.w * (2 * t - 1))
        # wi . h = |wi + wo| / 2
        return weight * wo.z * (1 / np.pi) + (1 - weight) * half * dr.rcp(dr.maximum(2 * dr.norm(wi + wo), 1e-6))

    def incidence(self, wi: Any, active: Any = True) -> tuple[Any, Any]:
        """What the density needs to know of ``wi``: its row, and the weight of the cosine lobe."""
        row = self._row(wi)
        return row, self._one(self._weight, row, active)

    def eval_pdf(self, wi: Any, wo: Any, incidence: tuple[Any, Any], active: Any = True) -> tuple[Any, Any]:
        """BRDF of the first table times cos(theta_o), and density of ``wo`` in 1/sr, above the surface."""
        angles = self.angles(wi, wo)
        value = self.values(angles, active)[0] * wo.z
        return value, self.pdf_at(wi, wo, angles[0], incidence, active)

    def eval(self, wi: Any, wo: Any, active: Any = True) -> Any:
        """BRDF of the first table times cos(theta_o) for directions above the surface."""
        return self.values(self.angles(wi, wo), active)[0] * wo.z

    def pdf(self, wi: Any, wo: Any, active: Any = True) -> Any:
        """Density of ``wo`` in 1/sr for directions above the surface."""
        return self.pdf_at(wi, wo, self.angles(wi, wo)[0], self.incidence(wi, active), active)

    def sample(self, wi: Any, choice: Any, sample: Any, incidence: tuple[Any, Any], active: Any = True) -> Any:
        """``wo`` from three numbers in [0, 1); it may lie below the surface, where it counts for nothing."""
        import drjit as dr
        import mitsuba as mi

        row, weight = incidence
        place = mi.UInt32(dr.minimum(sample.x * LIST_LENGTH, LIST_LENGTH - 1.0))
        cell = self._one(self._entries, row * LIST_LENGTH + place, active)
        index = row * N_THETA_H + mi.UInt32(cell)
        cell, run = self._four(self._cells, index, active), self._two(self._runs, index, active)
        # Where in its cell: entries of one cell stand together, so the rest of the number is uniform again; then
        # inverted for a density that is linear in the cell.
        rest = dr.clip((sample.x - run.x) / dr.maximum(run.y, 1 / LIST_LENGTH), 0.0, 1.0)
        start = 1 - cell.w
        t = 2 * rest / (start + dr.sqrt(start * start + 4 * cell.w * rest))
        versine = dr.fma(cell.y, t, cell.x)
        sin_h = dr.sqrt(dr.maximum(versine * (2 - versine), 0.0))
        sin_p, cos_p = dr.sincos(2 * np.pi * sample.y)
        h = mi.Vector3f(sin_h * cos_p, sin_h * sin_p, 1 - versine)
        reflected = 2 * dr.dot(wi, h) * h - wi
        radius = dr.sqrt(sample.x)
        cosine = mi.Vector3f(radius * cos_p, radius * sin_p, dr.sqrt(dr.maximum(1 - sample.x, 0.0)))
        return dr.select(choice < weight, cosine, reflected)


def _from_files(filename: str, reference: str) -> Reflectance:
    """What the plugin's properties name, searched for as Mitsuba does."""
    import mitsuba as mi

    if not filename:
        raise ValueError("brdfatlas: the plugin needs `filename`, a measured file or a fit (.npz)")
    resolve = mi.file_resolver().resolve
    table, valid = load_table(str(resolve(filename)))
    density = None
    if reference:
        reflectance, valid = load_table(str(resolve(reference)))
        density = sampling_density(extend(reflectance, valid))
    return Reflectance(table, valid, density)


@cache
def bsdf_class(variant: str) -> type:
    """The plugin's class for a variant, which must be the current one."""
    import drjit as dr
    import mitsuba as mi

    class BrdfAtlas(mi.BSDF):
        """A tabulated isotropic BRDF, one-sided."""

        def __init__(self, props: mi.Properties, reflectance: Reflectance | None = None):
            # Before the base class, which makes the object known to renders.
            self.filename = props.get("filename", "")
            self.reference = props.get("reference", "")
            self.reflectance = reflectance or _from_files(self.filename, self.reference)
            mi.BSDF.__init__(self, props)
            flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components = [flags]
            self.m_flags = flags

        def _above(self, si: Any, wo: Any, active: Any) -> Any:
            return active & (si.wi.z > 0) & (wo.z > 0)

        def sample(self, ctx, si, sample1, sample2, active=True):
            incidence = self.reflectance.incidence(si.wi, active)
            wo = self.reflectance.sample(si.wi, sample1, sample2, incidence, active)
            active = self._above(si, wo, active)
            value, pdf = self.reflectance.eval_pdf(si.wi, wo, incidence, active)
            bs = mi.BSDFSample3f()
            bs.wo, bs.pdf, bs.eta = wo, dr.select(active, pdf, 0.0), 1.0
            bs.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
            bs.sampled_component = mi.UInt32(0)
            return bs, dr.select(active & (pdf > 0), value / dr.maximum(pdf, 1e-20), mi.Color3f(0))

        def eval(self, ctx, si, wo, active=True):
            active = self._above(si, wo, active)
            return dr.select(active, self.reflectance.eval(si.wi, wo, active), mi.Color3f(0))

        def pdf(self, ctx, si, wo, active=True):
            active = self._above(si, wo, active)
            return dr.select(active, self.reflectance.pdf(si.wi, wo, active), 0.0)

        def eval_pdf(self, ctx, si, wo, active=True):
            active = self._above(si, wo, active)
            incidence = self.reflectance.incidence(si.wi, active)
            value, pdf = self.reflectance.eval_pdf(si.wi, wo, incidence, active)
            return dr.select(active, value, mi.Color3f(0)), dr.select(active, pdf, 0.0)

        def to_string(self):
            return f"BrdfAtlas[filename={self.filename!r}, reference={self.reference!r}]"

    return BrdfAtlas


def bsdf_of(reflectance: Reflectance) -> Any:
    """A Mitsuba BSDF of the current variant that computes with ``reflectance``."""
    import mitsuba as mi

    return bsdf_class(mi.variant())(mi.Properties(), reflectance)


def reflectance_of(measured: Measured, table: np.ndarray | None = None) -> Reflectance:
    """The :class:`Reflectance` of a reference, or of a fit's ``table`` under the reference's mask and density."""
    reference = Reflectance(measured.table, measured.valid)
    return reference if table is None else reference.with_tables(table)
