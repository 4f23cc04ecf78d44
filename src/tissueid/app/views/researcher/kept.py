"""Short lists of texts that are kept from one start to the next."""

from __future__ import annotations

import json
from collections.abc import Sequence

from PySide6.QtCore import QSettings

_MOST = 200
_LONGEST = 5000


def keep_texts(settings: QSettings, name: str, texts: Sequence[str]) -> None:
    """Write texts under a name. As JSON, since a list of one text comes back from some settings as that text."""
    settings.setValue(name, json.dumps(list(texts)))


def kept_texts(settings: QSettings, name: str) -> list[str]:
    """What was kept under a name; nothing where that is not what :func:`keep_texts` writes."""
    try:
        texts = json.loads(str(settings.value(name, "[]")))
    except (ValueError, RecursionError):
        return []
    if not isinstance(texts, list) or len(texts) > _MOST:
        return []
    return [text for text in texts if isinstance(text, str) and len(text) <= _LONGEST]


__all__ = ["keep_texts", "kept_texts"]
