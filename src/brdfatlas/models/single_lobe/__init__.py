"""A diffuse term and one lobe: Ngan et al. 2005, Löw et al. 2012."""
