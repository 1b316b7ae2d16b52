"""Dupuy et al. 2015: microfacet distributions by power iterations."""
