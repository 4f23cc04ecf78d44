"""Figures of models, each engine's in a file of its own, found by the class of the model that they draw.

A module here declares a figure by :func:`~tissueid.reports.figures.registry.figure`. Another package adds its own by
an entry point in the group ``tissueid.figures`` that names the module that declares them.
"""
