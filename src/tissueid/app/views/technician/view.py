"""The page ``instrument``."""

from __future__ import annotations

from tissueid.app.views.view import View


class InstrumentView(View):
    """The page ``instrument``."""

    name = "instrument"
    title = "Instrument"
