"""The cluster profile asks for memory for every rule that runs on a node."""

import re
from pathlib import Path

import yaml

WORKFLOW = Path(__file__).resolve().parents[2] / "workflow"


def test_every_rule_has_its_memory_in_the_slurm_profile():
    text = "\n".join(path.read_text() for path in sorted((WORKFLOW / "rules").glob("*.smk")))
    rules = set(re.findall(r"^rule (\w+):|^use rule \w+ as (\w+) with:", text, re.MULTILINE))
    rules = {name for pair in rules for name in pair if name}
    blocks = [part.partition("\n\n")[0] for part in text.split("localrules:")[1:]]
    local = set(re.findall(r"^    (\w+),$", "\n".join(blocks), re.MULTILINE))
    assert local == {
        "merl",
        "rgl",
        "animations",
        "assets",
        "published_fits",
        "download_merl",
        "record_checks",
        "record_run",
        "record_reports",
    }
    profile = yaml.safe_load((WORKFLOW / "profiles" / "slurm" / "config.yaml").read_text())
    stated = {rule: resources for rule, resources in profile["set-resources"].items() if "mem_mb" in resources}
    # Those that depend on the size of pictures, by the rule itself; the profile would override it.
    by_size = set(re.findall(r"^rule (\w+):(?:\n(?!rule).*)*?\n        mem_mb=growing\(", text, re.MULTILINE))
    assert by_size == {"prepare_scene", "render_material", "measure_errors", "draw_pictures", "draw_animation"}
    assert set(stated) == rules - local - by_size
    for rule, resources in stated.items():
        base, _, rest = str(resources["mem_mb"]).partition(" * ")
        assert int(base) >= 1000, rule
        assert rest == "attempt", rule
