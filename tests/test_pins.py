"""The pinned packages: all of them, with hashes, and nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "constraints.txt").read_text(encoding="utf-8")
BLOCK = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)((?: \\\n    --hash=sha256:[0-9a-f]{64})+)$", re.MULTILINE)
NOT_PINNED = {"pip", "tissueid"}
"""What makes the environment, and what is built."""


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


PINS = {plain(name): version for name, version, _ in BLOCK.findall(TEXT)}


def test_every_line_belongs_to_a_pin_with_hashes_and_no_address_is_in_it():
    left = BLOCK.sub("", TEXT)
    assert [line for line in left.splitlines() if line and not line.startswith("#")] == []
    assert "://" not in TEXT
    assert len(PINS) == len(BLOCK.findall(TEXT))


def test_every_package_of_the_environment_is_pinned():
    """setuptools comes with virtual environments of Python 3.11, in a version of its own until it is replaced."""
    installed = {plain(found.name): found.version for found in distributions()}
    others = {name: version for name, version in installed.items() if name not in NOT_PINNED | {"setuptools"}}
    assert {name: version for name, version in others.items() if PINS.get(name) != version} == {}


def test_what_builds_the_project_is_pinned_as_the_project_asks():
    asked = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    assert [f"{name}=={PINS[name]}" for name in ("hatchling", "babel")] == asked


@pytest.mark.skipif(sys.platform == "win32", reason="the environment is built by a shell script")
def test_what_builds_packages_is_taken_out_of_the_pins_with_its_hashes(tmp_path):
    script = (ROOT / "tools" / "build_env.sh").read_text(encoding="utf-8")
    pick = re.search(r"awk '([^']+)'", script)[1]
    picked = subprocess.run(["awk", pick, str(ROOT / "constraints.txt")], capture_output=True, text=True, check=True)
    blocks = BLOCK.findall(picked.stdout)
    assert {plain(name) for name, _, _ in blocks} >= {"babel", "hatchling", "setuptools", "pathspec", "tomlkit"}
    assert BLOCK.sub("", picked.stdout).strip() == ""
