"""Bilgili et al. 2011: five analytic models with a diffuse and three specular lobes."""
