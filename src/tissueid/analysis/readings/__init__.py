"""Readings of commercial probes, computed from a step or from an identified model (docs/readings.md)."""
