"""Data-driven factorisations: Lawrence et al. 2004, Bilgili et al. 2011."""
