"""Fixtures that several files of tests share."""

from app.views.gap_pages import diagnosed, friction, gap_page, made
from app.views.research_hosts import host, opened, year
from app.views.research_panels import _analysed_once, held, history, open_panel, pair, panel, strip, two
from app.views.technician_pages import page

__all__ = [
    "_analysed_once",
    "diagnosed",
    "friction",
    "gap_page",
    "held",
    "history",
    "host",
    "made",
    "open_panel",
    "opened",
    "page",
    "pair",
    "panel",
    "strip",
    "two",
    "year",
]
