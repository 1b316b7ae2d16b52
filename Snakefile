# The whole experiment on one screen.
#
#   .binary --> fits (material x model) --> renders (material x model, all scenes) --+
#      |                 +--> figures (material) --+                                  |
#      +--> reference renders (material) ----------+--> errors (material) --> page (material) --> index, tables, PDF
#
# `snakemake --cores 2` makes the report of config/config.yaml; --configfile config/full.yaml is the papers' scale.


configfile: "config/config.yaml"


# Used only with --software-deployment-method apptainer; built from Containerfile (docs/full-run.md).
container: "brdfatlas.sif"


include: "workflow/rules/common.smk"


rule all:
    default_target: True
    input:
        report="reports/index.html",
        standings="reports/standings.html",
        pdf=["reports/supplement.pdf"] if config["pdf"] else [],
        verdict="results/verdict.txt",
    message:
        "the report is complete"


include: "workflow/rules/data.smk"
include: "workflow/rules/materials.smk"
include: "workflow/rules/fits.smk"
include: "workflow/rules/renders.smk"
include: "workflow/rules/errors.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/reports.smk"
include: "workflow/rules/standings.smk"
