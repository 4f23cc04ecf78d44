"""Write the golden pages again: ``python tests/golden/renew.py``. Read ``git diff tests/golden`` before you commit."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
ENVIRONMENT = {"TISSUEID_RENEW_GOLDEN": "1", "QT_QPA_PLATFORM": "offscreen"}


def main() -> int:
    """Run the tests that compare golden pages, and let them write the pages instead."""
    files = [str(path) for path in sorted(TESTS.rglob("test_*.py")) if "check_golden_page(" in path.read_text("utf-8")]
    command = [sys.executable, "-m", "pytest", *files, "-k", "golden_page", *sys.argv[1:]]
    return subprocess.run(command, check=False, cwd=TESTS.parent, env=os.environ | ENVIRONMENT).returncode


if __name__ == "__main__":
    raise SystemExit(main())
