"""What docs/stimuli.md claims, measured: one module a topic, each with ``claims()``."""
