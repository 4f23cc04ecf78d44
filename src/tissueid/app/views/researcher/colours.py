"""Colours of overlaid tests."""

from __future__ import annotations

from tissueid.app.theme import DARK, Theme

_LIGHT_SERIES = ("#1f6f9f", "#c25400", "#1c7a4d", "#8e44ad", "#9a6200", "#b3266b", "#4a5a64", "#0f7f86")
_DARK_SERIES = ("#62b3e4", "#f2a155", "#58c491", "#c39bea", "#e0cf4a", "#f07ab0", "#b4c0c7", "#4fd0d6")
"""In the order of selection; each stands out from its theme's panel by 3 to 1 or more."""


def series(theme: Theme) -> tuple[str, ...]:
    """Return the colours of overlaid tests for a theme."""
    return _DARK_SERIES if theme is DARK else _LIGHT_SERIES
