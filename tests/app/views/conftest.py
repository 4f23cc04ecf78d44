"""Fixtures that several files of tests share."""

from app.views.research_hosts import host, opened, year
from app.views.research_panels import held, history, open_panel, panel, strip, two
from app.views.technician_pages import page

__all__ = ["held", "history", "host", "open_panel", "opened", "page", "panel", "strip", "two", "year"]
