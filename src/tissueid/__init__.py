"""TissueID: measure living tissue with a voice coil and nonlinear stochastic system identification."""

import logging

__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())
