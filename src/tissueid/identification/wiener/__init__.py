"""The Wiener cascade: iteration, refinement, parameters."""
