"""Volterra kernels: exact, regularised, in a Laguerre basis, and by kernel regression."""
