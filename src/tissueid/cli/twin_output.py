"""Output of ``tissueid twin``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.formatting import number
from tissueid.instrument.twin_file import TwinFile
from tissueid.messages import MISSING
from tissueid.procedures.saved_twins import TwinFolderPlan, TwinPlan, saved_twin, saved_twins

_PLAY = "simulated://"


def show_twin(plan: TwinPlan, json_file: Path | None) -> None:
    """Print a twin.

    Raises:
        UnusableInputError: the file is not a twin.
    """
    check_json(json_file)
    print_twin(plan.file, saved_twin(plan), json_file)


def list_twins(plan: TwinFolderPlan, json_file: Path | None) -> None:
    """Print the twins in a folder.

    Raises:
        UnusableInputError: the folder does not exist.
    """
    check_json(json_file)
    rows = table(str(plan.folder), "file", "name", "version", "effects", "closed", "made")
    answers = []
    for path, content in saved_twins(plan).items():
        effects = ", ".join(item.name for item in content.effects)
        share = MISSING if content.source.closed is None else f"{content.source.closed:.0%}"
        rows.add_row(path.name, content.name, str(content.version), effects, share, content.created)
        answers.append({"file": str(path), **_answer(content)})
    out = human_output(json_file)
    out.print(rows if answers else f"there are no twins in {plan.folder}", markup=False)
    if json_file is not None:
        write_json(json_file, {"twins": answers})


def print_twin(path: Path, content: TwinFile, json_file: Path | None) -> None:
    """Print a twin, and write it as JSON if requested."""
    out = human_output(json_file)
    source = content.source
    share = "" if source.closed is None else f", closes {source.closed:.0%} of the gap"
    out.print(f"{path}: {content.name}, version {content.version}{share}", markup=False)
    if source.improves:
        out.print(f"based on {source.improves}", markup=False)
    rows = table("Values, SI", "part", "quantity", "value", "std")
    for part, figures, prefix in (
        ("instrument", content.instrument, ""),
        ("tissue", content.tissue, "tissue_"),
        *((item.name, item.parameters, "") for item in content.effects),
    ):
        stds: dict[str, float] = next((item.stds for item in content.effects if item.name == part), content.stds)
        for figure, value in figures.items():
            std = stds.get(f"{prefix}{figure}")
            rows.add_row(part, figure, number(value), MISSING if std is None else number(std))
            part = ""
    out.print(rows)
    out.print(f"to play it: tissueid test --device {_PLAY}{path.absolute()} --site TEXT --out SESSION", markup=False)
    if json_file is not None:
        write_json(json_file, {"file": str(path), **_answer(content)})


def _answer(content: TwinFile) -> dict[str, Any]:
    return content.model_dump(mode="json")
