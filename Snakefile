# The whole experiment on one screen.
#
#   .binary --> fits (material x paper) --> renders (material x scene: reference and all fits) --> errors (material) --+
#      |                  +--> figures (material)                                                                       |
#      +-------------------------------------------------------------> page (material) --> index, standings, PDF <------+
#
# `snakemake --cores 2` makes the report of config/config.yaml; --configfile config/full.yaml is the papers' scale.
from snakemake.utils import min_version

min_version("9.27")


configfile: "config/config.yaml"


# Used only with --software-deployment-method apptainer; built from Containerfile (docs/full-run.md).
container: "brdfatlas.sif"


include: "workflow/rules/run.smk"
include: "workflow/rules/common.smk"
include: "workflow/rules/existing.smk"
include: "workflow/rules/data.smk"
include: "workflow/rules/materials.smk"
include: "workflow/rules/fits.smk"
include: "workflow/rules/renders.smk"
include: "workflow/rules/errors.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/animations.smk"
include: "workflow/rules/reports.smk"
include: "workflow/rules/standings.smk"


# Everything that a person may open: what is missing of it is made again. Intermediates that nobody asks for are not.
rule all:
    default_target: True
    input:
        scenes=lambda wildcards: scene_files(SCENES),
        materials=made_by(rules.describe_material, material=MATERIALS),
        errors=made_by(rules.measure_errors, material=MATERIALS),
        lost=lost,
        tables=made_by(rules.tabulate_errors),
        report=[*REPORT, *made_by(rules.write_standings)],
        lost_listed=lost_listed,
        verdict=[*made_by(rules.check_failures), *made_by(rules.record_run), *made_by(rules.record_reports)],
    message:
        "the report is complete"
