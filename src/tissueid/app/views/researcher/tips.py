"""Tool tips that show a text as it is."""

from __future__ import annotations

import html

from tissueid.wording import clean


def plain_tip(text: str) -> str:
    """A tool tip of these lines. Qt takes a tip for HTML where it looks like it, and texts of files may."""
    lines = "<br>".join(html.escape(clean(line)) for line in text.split("\n"))
    return f"<qt>{lines}</qt>" if text else ""


__all__ = ["plain_tip"]
