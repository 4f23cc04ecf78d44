"""Further amplitude distributions, one file each with a ``Distribution`` under the decorator ``distribution``."""
