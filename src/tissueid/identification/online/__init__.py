"""Recursive identifiers: samples in, the model so far out."""
