"""Texts for engines with their changed options."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.app.views.researcher.engine_outcome import EngineOutcome
from tissueid.formatting import plain_text
from tissueid.identification import engine_label, engine_names, get_engine
from tissueid.language import _


def changed_options(engine: str, options: Mapping[str, object]) -> dict[str, object]:
    """Return the options that differ from the defaults; all of them, where the engine is not installed any more."""
    if engine not in engine_names():
        return dict(options)
    defaults = get_engine(engine)().options()
    return {name: value for name, value in options.items() if value != defaults.get(name, object())}


def variant_of(outcome: EngineOutcome) -> str:
    """Return the engine of a fit and its options that differ from the defaults."""
    changed = changed_options(outcome.engine, outcome.options)
    options = plain_text(changed) if changed else _("default options")
    return f"{engine_label(outcome.engine)}, {options}"


__all__ = ["changed_options", "variant_of"]
