from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[2] / "examples" / "quickstart.ipynb"


def test_the_quick_start_runs_from_top_to_bottom(tmp_path):
    """Every cell, in a folder of its own; a cell that raises fails the test."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed (pip install brdfatlas[dev])")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed (pip install brdfatlas[dev])")
    import nbformat

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.get("outputs") for cell in notebook.cells), "the notebook is stored without outputs"
    nbclient.NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert (tmp_path / "yellow-plastic.gltf").is_file()
    assert (tmp_path / "yellow-plastic-recommended" / "side-by-side.png").is_file()
    pictures = [
        output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in output.get("data", {})
    ]
    assert len(pictures) == 2
