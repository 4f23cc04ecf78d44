"""Where everything stands in the panel of analyses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from tissueid.app.small_window import FoldingSplitter
from tissueid.language import _

if TYPE_CHECKING:
    from tissueid.app.views.researcher.analysis import AnalysisPanel

_FORM_WIDTH = 232
_FORM_HEIGHT = 170
"""Of the form above the results in a narrow window, pixels."""
_HEIGHTS = (104, 400)
"""Of the table and of the plots below it, before anybody moves what is between them."""


def arrange(panel: AnalysisPanel) -> None:
    """Put the form at the left; buttons, progress and results beside it."""
    panel.form.setMinimumWidth(_FORM_WIDTH)
    top = QHBoxLayout()
    top.setSpacing(6)
    for widget in (panel.run, panel.compare, panel.folder):
        top.addWidget(widget)
    top.addStretch(1)
    below = QHBoxLayout()
    below.setSpacing(6)
    below.addWidget(panel.step, 2)
    below.addWidget(panel.bar, 1)
    for button in (panel.cancelling, panel.refit, panel.undo):
        below.addWidget(button)
    for widget in (panel.save_figure, panel.save_table, panel.clear):
        panel.pictures.tools.addWidget(widget)
    panel.pictures.tools.addStretch(1)
    results = panel.fits
    results.setChildrenCollapsible(False)
    results.addWidget(panel.results)
    results.addWidget(panel.pictures)
    results.setSizes(list(_HEIGHTS))
    results.setStretchFactor(0, 1)
    results.setStretchFactor(1, 3)
    panel.tabs.setDocumentMode(True)
    panel.tabs.tabBar().setDrawBase(False)
    panel.tabs.addTab(results, _("Results"))
    panel.tabs.addTab(panel.population, _("Population"))
    panel.tabs.addTab(panel.verdicts, _("Recommendation"))
    panel.tabs.addTab(panel.past, _("History"))
    right = QWidget()
    column = QVBoxLayout(right)
    column.setContentsMargins(6, 0, 0, 0)
    column.setSpacing(6)
    column.addLayout(top)
    column.addLayout(below)
    column.addWidget(panel.tabs, 1)
    parts = FoldingSplitter(_FORM_HEIGHT)
    parts.addWidget(panel.form)
    parts.addWidget(right)
    parts.setChildrenCollapsible(False)
    parts.setStretchFactor(1, 1)
    parts.setSizes([_FORM_WIDTH, 4 * _FORM_WIDTH])
    layout = QVBoxLayout(panel)
    layout.setContentsMargins(0, 6, 0, 0)
    layout.addWidget(parts)
