"""TissueID: measure living tissue with a voice coil and nonlinear stochastic system identification."""

__version__ = "0.1.0"
