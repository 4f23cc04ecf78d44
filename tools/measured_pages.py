"""Pages of measured figures from their data, docs/measured/NAME.json.

``python tools/measured_pages.py NAME ...`` prints pages as Markdown; the documentation site contains all of them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from tissueid_lab.thesis.recipe import as_markdown

FOLDER = Path(__file__).parents[1] / "docs" / "measured"
_DIGEST = re.compile(r"^([0-9a-f]{12})[0-9a-f]{52}$")
_TITLES = {"reproduction": "Reproduction of the thesis: numbers", "benchmarks": "Benchmarks of the field: numbers"}


def as_page(path: Path) -> str:
    """Return a data file as a page: results of ``tissueid reproduce``, or sections with a text or a table.

    A SHA-256 alone in a cell is shortened to 12 digits.
    """
    data = json.loads(path.read_text(encoding="utf-8"))
    source = f"Generated from [{path.name}]({path.name}) by `tools/measured_pages.py`.\n"
    if "figures" in data:
        return f"# {_TITLES[path.stem]}\n\n{source}\n{as_markdown(data).replace('### ', '## ')}"
    lines = [f"# {data['title']}", "", source + data["introduction"]]
    for section in data["sections"]:
        lines += ["", f"## {section['title']}", *_content(section)]
    return "\n".join([*lines, ""])


def _content(section: dict[str, Any]) -> list[str]:
    lines = ["", section["text"]] if "text" in section else []
    if "rows" in section:
        rows = [section["columns"], ["---"] * len(section["columns"]), *section["rows"]]
        lines += ["", *("| " + " | ".join(_DIGEST.sub(r"`\1`", cell) for cell in row) + " |" for row in rows)]
    return lines


if __name__ == "__main__":
    for name in sys.argv[1:]:
        print(as_page(FOLDER / f"{name}.json"))
