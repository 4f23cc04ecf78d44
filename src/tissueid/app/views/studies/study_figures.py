"""Figures of a study, computed once and kept in the user's data folder. Independent of Qt."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.analysis.curves.plot import Axis, Bars, Curve, Mark, Plot, Surface
from tissueid.app.user_files import default_path, stamp_of
from tissueid.atomic_write import private_folder, write_private
from tissueid.formatting import label_and_unit, principal_first
from tissueid.language import _, current_language
from tissueid.messages import Message, Verbatim, message_from, translated
from tissueid.procedures.study_plans import RESULTS

if TYPE_CHECKING:
    from tissueid.studies.study_statistics import StudyStatistics

TABLE = "table.csv"
_LARGEST = 50_000_000
"""Largest file of figures that is read, bytes."""
_MOST_STUDIES = 8
_KINDS: Mapping[str, Callable[..., Any]] = {kind.__name__: kind for kind in (Axis, Bars, Curve, Mark, Plot, Surface)}


@dataclass(frozen=True)
class StudyFigures:
    """Figures by heading, each with the label of its parameter, in the language in which they were made; remarks."""

    groups: tuple[tuple[str, tuple[tuple[str, Plot], ...]], ...] = ()
    remarks: tuple[str, ...] = ()


def figures_of(found: StudyStatistics) -> StudyFigures:
    """Compute the figures of the statistics."""
    from tissueid.reports.study_page import OF_SEVERAL, simulated_line, study_plots

    groups = []
    for _key, heading, plots in study_plots(found):
        names = principal_first(plots)
        labels = [
            _("all parameters")
            if name in OF_SEVERAL
            else str(name)
            if isinstance(name, Verbatim)
            else _(label_and_unit(name)[0])
            for name in names
        ]
        groups.append((heading, tuple((label, plots[name]()) for label, name in zip(labels, names, strict=True))))
    simulated = simulated_line(found)
    remarks = (*([simulated] if simulated else []), *(translated(remark) for remark in found.remarks))
    return StudyFigures(tuple(group for group in groups if group[1]), remarks)


def keep_figures(folder: Path, figures: StudyFigures) -> None:
    """Keep the figures of the table of a study; errors of the disk only cost the next start its figures."""
    content = {"of": _state(folder), "groups": _plain(figures.groups), "remarks": list(figures.remarks)}
    place = _place(folder)
    try:
        write_private(private_folder(place.parent) / place.name, json.dumps(content))
        kept = sorted(place.parent.iterdir(), key=lambda path: path.stat().st_mtime)
        for path in kept[:-_MOST_STUDIES]:
            path.unlink()
    except OSError:
        return


def kept_figures(folder: Path) -> StudyFigures | None:
    """Return the kept figures of the table of a study; None where there are none, or the table has changed."""
    try:
        path = _place(folder)
        if path.stat().st_size > _LARGEST:
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["of"] != _state(folder):
            return None
        return StudyFigures(_restored(content["groups"]), tuple(map(str, content["remarks"])))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _place(folder: Path) -> Path:
    name = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:16]
    return default_path().with_name("study-figures") / f"{name}.json"


def _state(folder: Path) -> list[Any]:
    return [str(folder.resolve()), list(stamp_of(folder / RESULTS / TABLE) or ()), current_language()]


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"array": value.tolist()}
    if isinstance(value, Message):
        return {"text": str(value), "message": value.as_dict()}
    if isinstance(value, Verbatim):
        return {"verbatim": str(value)}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {"type": type(value).__name__} | {
            field.name: _plain(getattr(value, field.name)) for field in fields(value)
        }
    return value.item() if isinstance(value, np.generic) else value


def _restored(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_restored, value))
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return np.asarray(value["array"], np.float64)
    if "message" in value:
        return message_from(value["message"], value["text"])
    if "verbatim" in value:
        return Verbatim(value["verbatim"])
    return _KINDS[value.pop("type")](**{name: _restored(item) for name, item in value.items()})
