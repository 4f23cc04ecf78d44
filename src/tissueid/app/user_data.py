"""Files of the user's analyses, results and diagnoses."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_data_path

ENVIRONMENT = "TISSUEID_ANALYSES"
"""Environment variable with the file of analyses; results and diagnoses are in the same folder."""


def default_path() -> Path:
    """Return the file of analyses: ``TISSUEID_ANALYSES``, or a file in the user's data folder."""
    named = os.environ.get(ENVIRONMENT)
    return Path(named) if named else user_data_path("tissueid", appauthor=False) / "analyses.jsonl"
