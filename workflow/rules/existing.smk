# What earlier runs left: whether a run can build on it, and what of it is gone.

import functools
import os

from snakemake.io import IOFile

from brdfatlas.pipeline.configuration import check_writable, time_fault
from brdfatlas.pipeline.leftovers import missing_files


@functools.cache
def check_results():
    """While a run is planned, once: that results are not of the future, where Snakemake fails what is made of them, that
    they can be written, and that it is known what they were made of. Where Snakemake's records are gone (.snakemake
    deleted), it takes whatever exists for today's; all jobs run then, and keep fits and renders that are still right.
    """
    if not workflow.is_main_process:
        return
    made = ["results/run.json", *made_by(rules.prepare_scene, scene=SCENES), *expand(MADE, material=MATERIALS)]
    if workflow.executor_plugin and not workflow.dryrun:  # not for who only looks
        if workflow.resource_settings.cores == 0:
            raise SystemExit("--cores 0: no job can begin, and Snakemake would wait without end; give 1 or more")
        if ahead := [file for file in made if time_fault(file)]:
            raise SystemExit(
                f"results: of a time to come ({ahead[0]}); correct the clock, or "
                "`find results reports -newermt now -exec touch {} +`, then run with --forceall"
            )
        try:
            check_writable(
                folder
                for top in map(Path, ("results", "reports"))
                for folder in [top, *top.glob("*/"), *top.glob("*/*/")]
            )
        except ValueError as error:
            raise SystemExit(str(error)) from None
    if any(os.path.exists(file) and not workflow.persistence.metadata(IOFile(file)) for file in made):
        print(
            "results: no record in .snakemake of what they were made of; every job looks at them again", file=sys.stderr
        )
        workflow.dag.forcerules.update(workflow.dag.rules)


# Files whose number depends on the fits: a list, {kind: {name: checksum}}, stands for them. Kind -> their folder.
LISTED = {
    "pictures": "reports/materials/{material}",
    "figures": "reports/materials/{material}",
    "fit_files": "reports/materials/{material}/fits",
}
LISTINGS = {
    f"results/{kind}/{material}.json": folder.format(material=material)
    for kind, folder in LISTED.items()
    for material in MATERIALS
}


def lost_listed(wildcards):
    """Lists of files some of which are gone: the rule that makes them runs again, before pages and PDF that show them."""
    lists = [name for name, folder in LISTINGS.items() if missing_files(name, folder)]
    workflow.dag.forcefiles.update(lists)
    return lists


def lost(wildcards):
    """What fits and renders wrote and is gone, or never came, although the material was begun. Where it was not, what is
    made of them asks for them, and naming tens of thousands of files once more would double the time of a plan."""
    begun = [
        name
        for name in MATERIALS
        if any(os.path.exists(f"results/{kind}/{name}") for kind in ("fits", "renders", "errors"))
    ]
    files = expand("results/fits/{material}/{model}.{kind}", material=begun, model=MODELS, kind=("npz", "json"))
    files += expand(MADE, material=begun) + made_by(rules.render_material, material=begun, scene=SCENES)
    return [file for file in files if not os.path.exists(file)]
