"""Locations of stored data, all of them on this computer."""

from __future__ import annotations

from platformdirs import user_log_path
from PySide6.QtCore import QSettings

from tissueid.app.services import AppServices
from tissueid.app.words import in_words
from tissueid.calibration.store import calibration_folder, user_calibration_folder
from tissueid.errors import TissueIDError
from tissueid.language import _


def storage_locations(services: AppServices, settings: QSettings) -> list[tuple[str, str]]:
    """Return the label and location of each kind of stored data."""
    try:
        calibrations = str(services.calibrations or calibration_folder() or user_calibration_folder())
    except TissueIDError as error:
        calibrations = in_words(error)
    return [
        (_("Sessions"), str(services.folder)),
        (_("Calibrations"), calibrations),
        (_("Audit log"), str(services.audit.path)),
        (_("Settings of this window"), settings.fileName()),
        (_("Details of defects"), str(user_log_path("tissueid", appauthor=False) / "last-defect.txt")),
    ]
