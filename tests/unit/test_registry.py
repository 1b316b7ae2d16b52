"""Models of your own reach every process of a run."""

import json
from pathlib import Path

from brdfatlas.models import VARIABLE, Registry

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "lambertian.py"


def test_a_run_tells_its_jobs_of_its_own_models(monkeypatch):
    monkeypatch.setenv(VARIABLE, json.dumps({"lambertian": str(EXAMPLE)}))
    registry = Registry()
    assert registry["lambertian"].name == "lambertian"
    assert list(registry)[-1] == "lambertian"
    monkeypatch.setenv(VARIABLE, "")
    assert "lambertian" not in list(Registry())
