"""Tissue presets: one TOML file each, found by scanning this folder.

Every parameter is an inline table with ``value`` and ``source``. A source begins with ``thesis`` and the table, figure
or section, or with ``chosen:`` and the reason.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from firmware_sim.tissue import Branch, Exponential, Tissue

_LAWS = ("mass", "damping", "stiffness")
_UNITS = {"mass": "kg", "damping": "n_s_per_m", "stiffness": "n_per_m"}
_FIELDS = {
    "surface_m": ("surface_m",),
    "curve_scale": ("curve", "scale"),
    "curve_rate": ("curve", "rate"),
    "direction_ratio": ("directional_damping", "ratio"),
    "direction_speed_m_per_s": ("directional_damping", "speed_m_per_s"),
    "recruited_mass_kg": ("recruited_mass", "mass_kg"),
    "recruitment_depth_m": ("recruited_mass", "depth_m"),
}
DEFAULT = "left-posterior-forearm"


def preset_names() -> tuple[str, ...]:
    """Return the names of all presets, sorted."""
    return tuple(sorted(_files()))


def load_preset(name: str) -> Tissue:
    """Return the tissue of a preset.

    Raises:
        ValueError: there is no such preset (the message lists those that exist), or its file is invalid.
    """
    found = _files().get(name)
    if found is None:
        raise ValueError(f"unknown tissue preset {name!r}; known: {', '.join(preset_names())}")
    return parse_preset(name, found.read_text(encoding="utf-8"))


def read_preset(path: Path) -> Tissue:
    """Return the tissue of a preset file outside this folder, named by its stem.

    Raises:
        ValueError: the file cannot be read or is invalid.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ValueError(f"cannot read tissue preset {path}: {error.strerror}") from error
    return parse_preset(path.stem, text)


def parse_preset(name: str, text: str) -> Tissue:
    """Return the tissue that a preset's text describes.

    Raises:
        ValueError: invalid TOML, an unknown key, a parameter without value or source, or inconsistent values.
    """
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"tissue preset {name}: {error}") from error
    reader = _Reader(name, tree)
    kind = reader.text("kind")
    title = reader.text("title")
    extras = reader.names("extras")
    laws = {law: reader.exponential(law) for law in _LAWS}
    branches = reader.branches()
    figures = {item: reader.figure(path) for item, path in _FIELDS.items() if reader.has(path) or item == "surface_m"}
    reader.finish()
    return Tissue(
        name=name,
        kind=kind,
        title=title,
        extras=frozenset(extras),
        mass=laws["mass"],
        damping=laws["damping"],
        stiffness=laws["stiffness"],
        branches=branches,
        sources=reader.sources,
        **figures,
    )


@cache
def _files() -> dict[str, Traversable]:
    return {
        entry.name.removesuffix(".toml"): entry for entry in files(__name__).iterdir() if entry.name.endswith(".toml")
    }


class _Reader:
    """Reader of the fields of a preset that reports unknown fields."""

    def __init__(self, name: str, tree: dict[str, Any]) -> None:
        self._name = name
        self._tree = tree
        self.sources: dict[str, str] = {}

    def _fail(self, problem: str) -> ValueError:
        return ValueError(f"tissue preset {self._name}: {problem}")

    def text(self, key: str) -> str:
        value = self._tree.pop(key, None)
        if not isinstance(value, str) or not value:
            raise self._fail(f"{key} must be a text")
        return value

    def names(self, key: str) -> list[str]:
        value = self._tree.pop(key, [])
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self._fail(f"{key} must be a list of names")
        return value

    def has(self, path: tuple[str, ...]) -> bool:
        table: Any = self._tree
        for key in path:
            if not isinstance(table, dict) or key not in table:
                return False
            table = table[key]
        return True

    def figure(self, path: tuple[str, ...]) -> float:
        table: Any = self._tree
        for key in path[:-1]:
            table = table.get(key)
            if not isinstance(table, dict):
                raise self._fail(f"{'.'.join(path)} is missing")
        return self._take(table, path[-1], ".".join(path))

    def _take(self, table: dict[str, Any], key: str, where: str) -> float:
        item = table.pop(key, None)
        if not isinstance(item, dict) or set(item) != {"value", "source"}:
            raise self._fail(f"{where} must be {{ value = ..., source = ... }}")
        value, source = item["value"], item["source"]
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._fail(f"the value of {where} must be a number, not {value!r}")
        if not isinstance(source, str) or not source.startswith(("thesis ", "chosen: ")):
            raise self._fail(f"the source of {where} must begin with 'thesis ' or 'chosen: '")
        self.sources[where] = source
        return float(value)

    def exponential(self, law: str) -> Exponential:
        coefficient = self.figure((law, _UNITS[law]))
        rate = self.figure((law, "rate_per_m")) if self.has((law, "rate_per_m")) else 0.0
        offset = self.figure((law, "offset")) if self.has((law, "offset")) else 0.0
        return Exponential(coefficient, rate, offset)

    def branches(self) -> tuple[Branch, ...]:
        items = self._tree.pop("relaxation", [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self._fail("relaxation must be a list of tables, [[relaxation]]")
        found = []
        for k, item in enumerate(items):
            fraction = self._take(item, "fraction", f"relaxation.{k}.fraction")
            time = self._take(item, "time_s", f"relaxation.{k}.time_s")
            if item:
                raise self._fail(f"unknown key relaxation.{k}.{next(iter(item))}")
            found.append(Branch(fraction, time))
        return tuple(found)

    def finish(self) -> None:
        for key, value in self._tree.items():
            if value != {}:
                left = f"{key}.{next(iter(value))}" if isinstance(value, dict) else key
                raise self._fail(f"unknown key {left}")
