"""Saved state of the panel of analyses: engine, options, and the selected tabs."""

from __future__ import annotations

import json

from PySide6.QtWidgets import QComboBox, QTabWidget

from tissueid.app.views.researcher.analysis_task import Preparation
from tissueid.app.views.researcher.engine_form import EngineForm
from tissueid.app.views.researcher.recommendation_view import RecommendationView
from tissueid.errors import TissueIDError

STATE = "research/analysis"
_LONGEST = 100_000


def saved_state(form: EngineForm, verdicts: RecommendationView, picture: QComboBox, tabs: QTabWidget) -> str:
    """Return the state as one line of JSON."""
    state = {
        "engine": form.name,
        "options": form.all_options(),
        "signals": form.signals,
        "together": form.together.isChecked(),
        "preparation": form.preparation.value().model_dump(),
        "compared": verdicts.compared,
        "picture": picture.currentData(),
        "tab": tabs.currentIndex(),
    }
    return json.dumps(state)


def restore_state(
    saved: object, form: EngineForm, verdicts: RecommendationView, picture: QComboBox, tabs: QTabWidget
) -> None:
    """Restore the saved state; invalid content is ignored."""
    try:
        state = json.loads(saved) if isinstance(saved, str) and len(saved) <= _LONGEST else {}
        form.restore(dict(state.get("options", {})))
        form.choose(str(state.get("engine", form.name)))
        into, out = map(str, state.get("signals", form.signals))
        form.take_signals(into, out, state.get("together") is True)
        form.preparation.set_value(Preparation.model_validate(state.get("preparation", {})))
        verdicts.take_compared([str(name) for name in state.get("compared", ())])
        picture.setCurrentIndex(max(0, picture.findData(str(state.get("picture", "")))))
        tabs.setCurrentIndex(int(state.get("tab", 0)))
    except (TissueIDError, ValueError, TypeError, AttributeError, RecursionError):
        form.restore({})
