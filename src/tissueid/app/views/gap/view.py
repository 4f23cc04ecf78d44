"""The page ``gap``."""

from __future__ import annotations

from tissueid.app.views.view import View


class GapView(View):
    """The page ``gap``."""

    name = "gap"
    title = "Gap"
