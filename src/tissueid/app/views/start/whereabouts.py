"""What is kept, and where: all of it on this computer."""

from __future__ import annotations

from platformdirs import user_log_path
from PySide6.QtCore import QSettings

from tissueid.app.surroundings import Surroundings
from tissueid.app.words import in_words
from tissueid.calibration.store import calibration_folder, own_folder
from tissueid.errors import TissueIDError
from tissueid.language import _


def whereabouts(around: Surroundings, settings: QSettings) -> list[tuple[str, str]]:
    """What is kept, in a word or two, and its place."""
    try:
        calibrations = str(around.calibrations or calibration_folder() or own_folder())
    except TissueIDError as error:
        calibrations = in_words(error)
    return [
        (_("Sessions"), str(around.folder)),
        (_("Calibrations"), calibrations),
        (_("Audit log"), str(around.audit.path)),
        (_("Settings of this window"), settings.fileName()),
        (_("Details of defects"), str(user_log_path("tissueid", appauthor=False) / "last-defect.txt")),
    ]
