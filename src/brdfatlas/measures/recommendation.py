"""Which model to take for a material: the best picture among those that meet the reader's conditions.

Pure functions of numbers that exist already, so the command line and the report recommend alike.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

#: dE00 by which two renders must differ to be ranked by it; below, the smaller fit is taken. A hundredth of what an eye
#: just sees between neighbouring patches (about 1).
SAME_DE00 = 0.01
#: Largest albedo of a fit that counts as energy-conserving: the quadrature of ``physics.directional_albedo`` is good to
#: 1e-4, a stored fit is rounded to float32.
MAX_ALBEDO = 1.001


@dataclass(frozen=True)
class Candidate:
    """One fit of one material, as the choice sees it.

    ``model``: the entry's name. ``de00``: mean CIEDE2000 after rendering, of one scene or the mean of several; NaN
    where the fit or its render failed. ``bytes``: storage of the fit. ``seconds``: time of the fit. ``max_albedo``:
    the largest directional albedo (:func:`.physics.physics_checks`) of any channel, NaN if unknown. ``status``: the
    model's (``Model.status``). ``targets``: what the fit can be exported to, exactly.
    """

    model: str
    de00: float
    bytes: int
    seconds: float = float("nan")
    reciprocal: bool = True
    max_albedo: float = float("nan")
    status: str = ""
    targets: tuple[str, ...] = ()


def allowed(
    item: Any,
    *,
    budget: int | None = None,
    target: str | None = None,
    reciprocal: bool = False,
    published: bool = False,
) -> bool:
    """Whether a candidate, or a model that is not fitted yet, meets these conditions; see :func:`choose`."""
    return (
        (budget is None or item.bytes <= budget)
        and (target is None or target in item.targets)
        and (item.reciprocal or not reciprocal)
        and not (published and item.status.startswith("ours"))
    )


def choose(
    rows: Iterable[Candidate],
    *,
    budget: int | None = None,
    target: str | None = None,
    reciprocal: bool = False,
    published: bool = False,
    energy: bool = False,
) -> Candidate | None:
    """The candidate with the least dE00 that meets all conditions; None if none does.

    ``budget``: at most so many bytes. ``target``: exportable to it, exactly. ``reciprocal``: reciprocal models only.
    ``published``: no model of ours (a reconstruction of a published one counts as published). ``energy``: albedo known
    and at most :data:`MAX_ALBEDO`. Of candidates within :data:`SAME_DE00` of the best the smallest is taken, then
    the first by name: neither the order of ``rows`` nor the seconds, which no run repeats, decide.
    """
    conditions = {"budget": budget, "target": target, "reciprocal": reciprocal, "published": published}
    kept = [row for row in rows if np.isfinite(row.de00) and allowed(row, **conditions)]  # type: ignore[arg-type]
    kept = [row for row in kept if row.max_albedo <= MAX_ALBEDO or not energy]
    if not kept:
        return None
    best = min(row.de00 for row in kept)
    close = [row for row in kept if row.de00 <= best + SAME_DE00]
    return min(close, key=lambda row: (row.bytes, row.model))
