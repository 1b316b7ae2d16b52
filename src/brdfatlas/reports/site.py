"""The HTML site: one function a kind of page, each from explicit files, so that each can be a rule of its own.

Pages open from the file system: no server, no network; what scripts need travels as scripts (``data/*.js``).
Templates escape everything that comes from a run; names of materials may be anything.
"""

from brdfatlas.reports.data import read_run, scene_facts
from brdfatlas.reports.index_page import write_index
from brdfatlas.reports.material_page import write_material_page
from brdfatlas.reports.model_page import write_model_page, write_model_pages
from brdfatlas.reports.pages import write_assets, write_compare

__all__ = [
    "read_run",
    "scene_facts",
    "write_assets",
    "write_compare",
    "write_index",
    "write_material_page",
    "write_model_page",
    "write_model_pages",
]
