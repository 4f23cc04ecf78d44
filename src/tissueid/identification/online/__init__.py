"""Identification while a test runs."""
