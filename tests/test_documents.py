"""The documents: every link between them leads somewhere."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from tissueid.cli.commands import app

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\(([^)#\s]+)", document.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (document.parent / target).exists(), target


def test_every_row_of_the_thesis_says_where_it_is():
    """No row is empty, and every file and command that one names exists."""
    commands = {name for name, _command in get_command(app).commands.items()}
    rows = [line for line in (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").splitlines() if line[:2] == "| "]
    places = [row.split(" | ")[2] for row in rows if not row.startswith(("| thesis", "| ---"))]
    assert len(places) > 90
    assert all(place.strip() for place in places)
    for place in places:
        for name in re.findall(r"`((?:docs|firmware_sim|tests)/[^`]+)`", place):
            assert (ROOT / name).exists(), name
        for name in re.findall(r"`tissueid ([a-z]+)", place):
            assert name in commands, name
