"""Bagher et al. 2016: non-parametric factor models, and ours that extend them."""
