"""Write the numbers of a reproduction into docs/reproduction.md, between its marks.

``python tools/reproduction_page.py DIR/results.json [OTHER/results.json]`` takes the results of ``tissueid reproduce``
and those of the benchmarks of the field; a file replaces the part of its own kind only.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from tissueid.reports.reproduction import as_markdown

PAGE = Path(__file__).parents[1] / "docs" / "reproduction.md"


def main(arguments: list[str]) -> int:
    """Replace the parts of the page that the results belong to."""
    if not arguments:
        print(__doc__)
        return 2
    text = PAGE.read_text(encoding="utf-8")
    for name in arguments:
        results = json.loads(Path(name).read_text(encoding="utf-8"))
        part = "figures" if results["figures"][0]["number"][-1].isdigit() else "benchmarks"
        mark = re.compile(f"<!-- {part} -->.*?<!-- end of {part} -->", re.DOTALL)
        if not mark.search(text):
            raise SystemExit(f"{PAGE.name} has no marks for {part}")
        made = f"<!-- {part} -->\n{as_markdown(results)}\n<!-- end of {part} -->"
        text = mark.sub(lambda _, made=made: made, text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
