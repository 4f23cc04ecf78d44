"""Recursive and adaptive identifiers, updated sample by sample."""
