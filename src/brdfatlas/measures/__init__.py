"""How far a fit is from its material: images, BRDFs, ranking, physics, tables of a run."""
