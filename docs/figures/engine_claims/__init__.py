"""What docs/engines.md claims, measured: one module a topic, each with ``claims()``."""
