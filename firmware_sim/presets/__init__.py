"""Tissue presets: one TOML file each, found by scanning this folder.

Every parameter is an inline table with ``value`` and ``source``. A source begins with ``thesis`` and the table, figure
or section, or with ``chosen:`` and the reason.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any, TypeVar

from firmware_sim.layers import Layer
from firmware_sim.tissue import Branch, Exponential, Extension, Friction, Pulled, Tissue

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
    "external_spring_n_per_m": ("external_spring", "n_per_m"),
}
_LAYER = {
    "thickness_m": "thickness_m",
    "stiffness_n_per_m": "n_per_m",
    "damping_n_s_per_m": "n_s_per_m",
    "mass_kg": "kg",
}
Part = TypeVar("Part")
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
    layers = reader.layers()
    pulled = reader.part("pulled", Pulled, ("stiffness_rate_per_m", "damping_rate_per_m"))
    extension = reader.part("extension", Extension, ("fibre_deg", "across_rate_per_m", "reference_length_m"))
    friction = reader.part("friction", Friction, ("coefficient", "damping_n_s_per_m"))
    figures: dict[str, Any] = {
        item: reader.figure(path) for item, path in _FIELDS.items() if reader.has(path) or item == "surface_m"
    }
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
        layers=layers,
        pulled=pulled,
        extension=extension,
        friction=friction,
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

    def part(self, name: str, kind: Callable[..., Part], keys: tuple[str, ...]) -> Part | None:
        if name not in self._tree:
            return None
        return kind(**{key: self.figure((name, key)) for key in keys})

    def branches(self) -> tuple[Branch, ...]:
        return tuple(
            Branch(self._take(item, "fraction", f"{where}.fraction"), self._take(item, "time_s", f"{where}.time_s"))
            for where, item in self._items("relaxation")
        )

    def layers(self) -> tuple[Layer, ...]:
        found = []
        for where, item in self._items("layers"):
            values = {name: self._take(item, key, f"{where}.{key}") for name, key in _LAYER.items() if key in item}
            if "stiffness_n_per_m" not in values:
                raise self._fail(f"{where}.n_per_m is missing")
            found.append(Layer(**values))
        return tuple(found)

    def _items(self, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the tables of a list with their places; each must be used up before the next one."""
        items = self._tree.pop(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self._fail(f"{name} must be a list of tables, [[{name}]]")
        for k, item in enumerate(items):
            where = f"{name}.{k}"
            yield where, item
            if item:
                raise self._fail(f"unknown key {where}.{next(iter(item))}")

    def finish(self) -> None:
        for key, value in self._tree.items():
            if value != {}:
                left = f"{key}.{next(iter(value))}" if isinstance(value, dict) else key
                raise self._fail(f"unknown key {left}")
