"""Volterra kernels: exact, regularised, in a Laguerre basis, and without ever being formed."""
