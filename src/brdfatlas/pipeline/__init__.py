"""What the Snakefile needs: the configuration, the materials of a run, source dependencies, the body of each job."""
