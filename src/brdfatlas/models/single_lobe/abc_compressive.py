"""The ABC microfacet model of Löw et al. 2012, fitted with the compressive metric of Bagher et al. 2016."""

from collections.abc import Mapping
from typing import ClassVar

from brdfatlas.models.base import Option
from brdfatlas.models.single_lobe.abc import ABC
from brdfatlas.models.single_lobe.base import objective_option


class ABCCompressive(ABC):
    """The second row that Bagher et al. 2016 give for this model: the same formula, their metric."""

    name = "abc_compressive"
    title = "ABC microfacet, compressive metric"
    options: ClassVar[Mapping[str, Option]] = {"objective": objective_option("compressive")}
