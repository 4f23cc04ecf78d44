"""Short lists of texts in the settings."""

from __future__ import annotations

import json
from collections.abc import Sequence

from PySide6.QtCore import QSettings

_MOST = 200
_LONGEST = 5000


def save_texts(settings: QSettings, name: str, texts: Sequence[str]) -> None:
    """Save texts as JSON, because QSettings may return a list of one text as a plain text."""
    settings.setValue(name, json.dumps(list(texts)))


def load_texts(settings: QSettings, name: str) -> list[str]:
    """Return texts saved by :func:`save_texts`; an empty list if the content is invalid."""
    try:
        texts = json.loads(str(settings.value(name, "[]")))
    except (ValueError, RecursionError):
        return []
    if not isinstance(texts, list) or len(texts) > _MOST:
        return []
    return [text for text in texts if isinstance(text, str) and len(text) <= _LONGEST]


__all__ = ["load_texts", "save_texts"]
