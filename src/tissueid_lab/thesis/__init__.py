"""Figures and tables of the thesis (Chen 2010) and benchmarks of the field, next to what the engines find."""
