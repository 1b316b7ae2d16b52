"""The importance sampler of a fit as JSON, for any renderer."""

import os
from typing import Any

from brdfatlas.files import write_json
from brdfatlas.fits import Fit
from brdfatlas.sampling import sampler_as_data


def describe_sampler(fit: Fit) -> dict[str, Any]:
    """The sampler of a fit as plain data: format, model, material, and kind, weight and numbers of every lobe.

    ValueError for a model without a sampling procedure.
    """
    sampler = fit.sampler()
    if sampler is None:
        raise ValueError(f"model {fit.model} has no sampling procedure")
    return sampler_as_data(sampler) | {"model": fit.model, "material": fit.material, "standin": fit.standin}


def export_sampler(fit: Fit, path: str | os.PathLike) -> dict[str, Any]:
    """Write :func:`describe_sampler` as JSON and return it. ValueError for a model without a sampling procedure."""
    description = describe_sampler(fit)
    write_json(path, description)
    return description
