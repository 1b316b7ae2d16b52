"""Solvers that know nothing of any model."""
