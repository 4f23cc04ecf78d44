"""The page ``research``."""

from __future__ import annotations

from tissueid.app.views.view import View


class ResearchView(View):
    """The page ``research``."""

    name = "research"
    title = "Research"
