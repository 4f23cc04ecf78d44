"""The page ``start``."""
