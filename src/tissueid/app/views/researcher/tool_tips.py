"""Tool tips with plain text."""

from __future__ import annotations

import html

from tissueid.formatting import clean


def plain_tip(text: str) -> str:
    """Return a tool tip that shows the lines as plain text, because Qt renders texts that look like HTML."""
    lines = "<br>".join(html.escape(clean(line)) for line in text.split("\n"))
    return f"<qt>{lines}</qt>" if text else ""


__all__ = ["plain_tip"]
