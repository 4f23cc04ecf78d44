"""The page ``researcher``."""
