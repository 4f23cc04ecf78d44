"""Calibrations of the instrument: where its figures come from."""

from tissueid.calibration.electrical import ElectricalCheck, check_coil

__all__ = ["ElectricalCheck", "check_coil"]
