"""The page ``studies``."""
