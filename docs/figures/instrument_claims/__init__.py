"""What docs/instrument.md claims, measured: one module a topic, each with ``claims()``."""
