"""The page ``gap``."""
