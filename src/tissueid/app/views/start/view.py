"""The page ``start``."""

from __future__ import annotations

from tissueid.app.views.view import View


class StartView(View):
    """The page ``start``."""

    name = "start"
    title = "Start"
