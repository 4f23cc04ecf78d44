"""Compile the translations when a package is built or installed; add icon, desktop entry and manual to a wheel."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CompiledTranslations(BuildHookInterface):
    """Build hook of hatchling: compiles the catalogues and adds the compiled files to the package."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile catalogues whose compiled form is missing or out of date."""
        sys.path.insert(0, str(Path(self.root) / "tools"))
        from translations import compile_stale

        compile_stale()
        build_data["artifacts"].append("*.mo")
        if self.target_name == "wheel" and version == "standard":
            build_data["shared_data"].update(shared_files(Path(self.root)))


def shared_files(root: Path) -> dict[str, str]:
    """Return the files below ``share`` of an environment; manual page and completions if ``make package`` made them."""
    found = {
        str(root / "packaging" / "tissueid.desktop"): "share/applications/tissueid.desktop",
        str(root / "src/tissueid/app/tissueid.svg"): "share/icons/hicolor/scalable/apps/tissueid.svg",
    }
    generated = root / "build" / "share"
    for path in sorted(path for path in generated.rglob("*") if path.is_file()):
        found[str(path)] = f"share/{path.relative_to(generated).as_posix()}"
    return found
