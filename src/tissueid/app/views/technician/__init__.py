"""The page ``technician``."""
