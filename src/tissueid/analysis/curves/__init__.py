"""Plots as data: what a curve shows is computed here once, and drawn by reports and by the window."""

from tissueid.analysis.curves.plot import CONFIDENCE, Axis, Bars, Curve, Kind, Mark, Plot, Surface, plot_or_reason, thin

__all__ = ["CONFIDENCE", "Axis", "Bars", "Curve", "Kind", "Mark", "Plot", "Surface", "plot_or_reason", "thin"]
