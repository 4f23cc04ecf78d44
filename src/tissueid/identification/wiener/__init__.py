"""Wiener cascade: iteration, refinement, parameters."""
