"""Write the pages of measured figures from their data: docs/measured/NAME.md from NAME.json.

``python tools/measured_pages.py`` replaces the pages. A section has a title, and a text or a table (columns and rows).
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "docs" / "measured"
_DIGEST = re.compile(r"^([0-9a-f]{12})[0-9a-f]{52}$")


def as_page(data: dict[str, Any], name: str) -> str:
    """Return the page of a data file. A SHA-256 alone in a cell is shortened to 12 digits."""
    lines = [f"# {data['title']}", "", f"Generated from [{name}]({name}) by `tools/measured_pages.py`."]
    lines += [data["introduction"]]
    for section in data["sections"]:
        lines += ["", f"## {section['title']}"]
        lines += ["", section["text"]] if "text" in section else []
        if "rows" in section:
            rows = [section["columns"], ["---"] * len(section["columns"]), *section["rows"]]
            lines += ["", *("| " + " | ".join(_DIGEST.sub(r"`\1`", cell) for cell in row) + " |" for row in rows)]
    return "\n".join([*lines, ""])


def main() -> None:
    """Replace every page."""
    for path in sorted(FOLDER.glob("*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        path.with_suffix(".md").write_text(as_page(data, path.name), encoding="utf-8")


if __name__ == "__main__":
    main()
