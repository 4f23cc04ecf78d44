"""Button that draws a dynamic sweep below the results against depth."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from PySide6.QtWidgets import QPushButton

from tissueid.analysis.curves.overlay_plots import calibration_curves
from tissueid.app import build
from tissueid.app.context import AppContext
from tissueid.app.views.researcher.pictures import Pictures
from tissueid.app.words import in_words
from tissueid.calibration.status import calibration_folder
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.language import _
from tissueid.procedures.overlay import sweep_columns


class CalibrationButton(QPushButton):
    """Checked while a sweep lies below the results; asks for its file, or takes it away."""

    def __init__(self, context: AppContext, pictures: Pictures) -> None:
        super().__init__(_("Calibration…"))
        self._context, self._pictures = context, pictures
        build.styled(
            self,
            checkable=True,
            name=_("Draw a calibration below the results"),
            tip=_("Draw mass, damping and stiffness of a dynamic sweep below the results against depth"),
        )
        self.clicked.connect(self._choose)

    def draw_sweep(self, path: Path) -> None:
        """Draw a dynamic sweep (Chen 2010, Figs. 3.13 and 5.9)."""
        try:
            self._pictures.show_calibration(calibration_curves(sweep_columns(path)))
        except TissueIDError as error:
            self._context.say(in_words(error), problem=True)
        self._check()

    def _choose(self, wanted: bool) -> None:
        if not wanted:
            self._pictures.show_calibration({})
            return
        folder = None
        with suppress(UnusableInputError):
            folder = calibration_folder()
        dialog = build.ask_path(self, _("Dynamic sweep"), folder, self.draw_sweep, "TOML (*.toml)")
        dialog.finished.connect(self._check)

    def _check(self) -> None:
        self.setChecked(self._pictures.calibrated)
