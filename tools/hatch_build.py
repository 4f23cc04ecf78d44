"""Compile the translations when a package is built or installed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledTranslations(BuildHookInterface):
    """Build hook of hatchling: compiles the catalogues and adds the compiled files to the package."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile catalogues whose compiled form is missing or out of date."""
        del version
        sys.path.insert(0, str(Path(self.root) / "tools"))
        from translations import compile_stale

        compile_stale()
        build_data["artifacts"].append("*.mo")
