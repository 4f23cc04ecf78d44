"""Procedures: what the command line and the window both run. Each has one plan and one function."""
