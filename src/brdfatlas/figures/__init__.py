"""Drawn figures of materials, fits and runs."""
