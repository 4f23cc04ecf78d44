"""Calibrations of the instrument: where its figures come from, and which are in force."""

from tissueid.calibration.electrical import ElectricalCheck, check_coil
from tissueid.calibration.file import Calibration, Quantity, keep_calibration, read_calibration, write_calibration
from tissueid.calibration.in_force import InForce, calibrated, in_words, put_in_force, warnings_of
from tissueid.calibration.procedure import StaticPlan
from tissueid.calibration.static import StaticCalibration, calibrate_static
from tissueid.calibration.store import Stored, calibration_folder, stored_calibrations

__all__ = [
    "Calibration",
    "ElectricalCheck",
    "InForce",
    "Quantity",
    "StaticCalibration",
    "StaticPlan",
    "Stored",
    "calibrate_static",
    "calibrated",
    "calibration_folder",
    "check_coil",
    "in_words",
    "keep_calibration",
    "put_in_force",
    "read_calibration",
    "stored_calibrations",
    "warnings_of",
    "write_calibration",
]
