"""``tissueid engines``: the identification engines with their options."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.formatting import plain_text
from tissueid.identification import Engine
from tissueid.procedures.identification import EnginesPlan, listed_engines


def list_engines(plan: EnginesPlan, json_file: Path | None) -> None:
    """List all engines, or the options of one; write their declarations as JSON.

    Raises:
        UnusableInputError: there is no engine of that name, or the file cannot be written.
    """
    check_json(json_file)
    kinds = listed_engines(plan)
    out = human_output(json_file)
    if plan.engine is None:
        rows = table("Engines", "Engine", "Family", "Description")
        for kind in kinds:
            rows.add_row(kind.name, str(kind.family), kind.title)
    else:
        out.print(f"{kinds[0].label}: {kinds[0].title}", markup=False)
        rows = table("Options", "Option", "Default", "Description")
        for option, declared in _options(kinds[0]).items():
            rows.add_row(option, plain_text(declared["default"]), declared["description"])
    out.print(rows)
    if json_file is not None:
        write_json(json_file, [_declaration(kind) for kind in kinds])


def _declaration(kind: type[Engine]) -> dict[str, Any]:
    return {
        "engine": kind.name,
        "label": kind.label,
        "title": kind.title,
        "family": str(kind.family),
        "interpretability": kind.family.interpretability,
        "options": _options(kind),
    }


def _options(kind: type[Engine]) -> dict[str, dict[str, Any]]:
    defaults = kind().options()
    return {
        name: {
            "default": defaults[name],
            "title": info.title or "",
            "description": info.description or "",
            "choices": [item for item in get_args(info.annotation) if isinstance(item, str)],
        }
        for name, info in kind.model_fields.items()
    }
