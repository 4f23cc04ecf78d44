"""``tissueid gap effects``: the effects that a diagnosis can name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.twin.catalogue import all_effects
from tissueid.twin.effect import STAGE_NAMES, Effect


def list_effects(json_file: Path | None) -> None:
    """List the effects of the library, with their declarations as JSON.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    check_json(json_file)
    rows = table("Effects", "Effect", "Stage", "Title")
    for one in all_effects().values():
        rows.add_row(one.name, STAGE_NAMES[one.stage], one.title)
    human_output(json_file).print(rows)
    if json_file is not None:
        write_json(json_file, [declared(one) for one in all_effects().values()])


def declared(one: Effect) -> dict[str, Any]:
    """Return the declaration of an effect as plain values, SI.

    ``scales_with`` is the property of the instrument with which a parameter's bounds scale, and its exponent.
    """
    return {
        "effect": one.name,
        "stage": one.stage,
        "title": one.title,
        "equation": one.equation,
        "signature": one.signature,
        "remedy": one.remedy,
        "source": one.source,
        "mistaken_for": list(one.mistaken_for),
        "needs": sorted(one.needs),
        "parameters": [
            {
                "name": item.name,
                "unit": item.unit,
                "meaning": str(item.meaning),
                "low": item.low,
                "high": item.high,
                "scales_with": item.scales_with and dict([item.scales_with]),
            }
            for item in one.parameters
        ],
    }
