"""The documents: links, anchors and commands are right, and every technique and page has its place."""

from __future__ import annotations

import re
import shlex

import pytest
from pages import ROOT, anchors, blocks, links
from typer.main import get_command

from tissueid.cli.command_reference import all_commands
from tissueid.cli.commands import loaded_app
from tissueid.identification import engine_names
from tools.measured_pages import FOLDER, as_page

DOCUMENTS = [
    *sorted(ROOT.glob("*.md")),
    ROOT / "calibration_data" / "README.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "_build" not in path.parts),
]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_anchors_lead_somewhere(document):
    folder = ROOT if document.parent.name == "site" else document.parent  # the front page of the site is moved there
    for target, anchor in links(document):
        page = (folder / target).resolve() if target else document
        assert page.exists(), target
        assert not anchor or anchor in anchors(page), f"{target}#{anchor}"


def test_the_examples_name_commands_and_options_that_exist():
    """Every line of a shell example that calls the program, on every page."""
    known = {command.path: command for command in all_commands()}
    checked = 0
    for document in DOCUMENTS:
        for line in "\n".join([*blocks(document, "sh"), *blocks(document, "")]).replace("\\\n", " ").splitlines():
            words = shlex.split(line.split(" # ")[0].split("   # ")[0], comments=True) if "tissueid " in line else []
            if words[:1] != ["tissueid"] or "|" in words or ">" in words:
                continue
            command: tuple[str, ...] = ()
            while len(words) > len(command) + 1 and (*command, words[len(command) + 1]) in known:
                command = (*command, words[len(command) + 1])
            options = {name for option in known[command].options for name in option.names}
            given = {word.partition("=")[0] for word in words if word.startswith("--")}
            assert given <= options, f"{document.name}: {line}"
            assert command or len(words) == 1 or given, f"{document.name}: {line}"
            checked += 1
    assert checked > 60


@pytest.mark.parametrize("name", engine_names())
def test_every_engine_has_equations_limits_and_when_not_to_use_it(name):
    page = (ROOT / "docs" / "engines" / "techniques.md").read_text(encoding="utf-8")
    (section,) = re.findall(rf"^## `{name}`$(.*?)(?=^## )", page, re.MULTILINE | re.DOTALL)
    assert all(f"**{part}**" in section for part in ("Equations.", "Valid", "Not for"))
    assert "```math" in section


def test_the_navigation_of_the_site_names_pages_that_exist():
    """Other pages are added by the build, under "Further pages"."""
    text = (ROOT / "docs" / "site" / "index.md").read_text(encoding="utf-8")
    trees = re.findall(r"^```\{toctree\}\n(?::[^\n]*\n)*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    entries = re.findall(r"^(?:.* <)?([\w./-]+)>?$", "\n".join(trees), re.MULTILINE)
    pages = {str(path.relative_to(ROOT).with_suffix("")) for path in DOCUMENTS}
    generated = {f"reference/{name}" for name in ("commands", "python", "engines", "stimuli", "effects")}
    assert len(trees) == 4
    assert len(entries) == len(set(entries)) > 50
    assert set(entries) - pages == generated


@pytest.mark.parametrize("data", sorted(FOLDER.glob("*.json")), ids=lambda path: path.stem)
def test_measured_figures_make_a_page_with_complete_rows(data):
    page = as_page(data)
    assert page.startswith("# ")
    tables = re.findall(r"(?:^\|[^\n]*\n)+", page, re.MULTILINE)
    assert tables
    for table in tables:
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}) == 1, table


def test_every_row_of_the_thesis_says_where_it_is():
    """No row is empty, and every file and command that one names exists."""
    commands = {name for name, _command in get_command(loaded_app()).commands.items()}
    rows = [line for line in (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8").splitlines() if line[:2] == "| "]
    places = [row.split(" | ")[2] for row in rows if not row.startswith(("| thesis", "| ---"))]
    assert len(places) > 90
    assert all(place.strip() for place in places)
    for place in places:
        for name in re.findall(r"`((?:docs|firmware_sim|tests)/[^`]+)`", place):
            assert (ROOT / name).exists(), name
        for name in re.findall(r"`tissueid ([a-z]+)", place):
            assert name in commands, name
