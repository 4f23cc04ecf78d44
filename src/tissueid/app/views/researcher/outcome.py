"""What one engine made of one test, without the record: light enough that a year of tests can be held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tissueid.analysis import Analysis
from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.curves import drawn
from tissueid.app.views.researcher.drawn import Drawn
from tissueid.app.views.researcher.labels import labels_apart, short_label
from tissueid.identification import FitReport
from tissueid.language import _
from tissueid.wording import engine_label

_NOTHING = Drawn({}, {}, (), {})
Stamp = tuple[int, int]
"""When a file was last changed, ns, and its size."""


def stamp_of(path: Path) -> Stamp | None:
    """Return the stamp of a file, None where it is not there."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size


@dataclass(frozen=True, eq=False)
class Outcome:
    """An engine on a test, or on several that were fitted together; ``refused`` says why where nothing came of it.

    ``signals`` names input and output. ``stamp`` is that of the file when it was fitted; ``changed`` says that the file
    is another one now. ``recommended`` marks the engine that a comparison recommends.
    """

    engine: str
    options: dict[str, Any]
    tests: tuple[Chosen, ...]
    signals: tuple[str, str]
    report: FitReport | None = None
    validated_on: str = ""
    drawn: Drawn = field(default=_NOTHING)
    findings: tuple[str, ...] = ()
    refused: str = ""
    stamp: Stamp | None = None
    recommended: bool = False
    changed: bool = False

    @classmethod
    def of(
        cls, analysis: Analysis, options: dict[str, Any], tests: Sequence[Chosen], signals: tuple[str, str]
    ) -> Outcome:
        """Keep of an analysis what is shown."""
        pictures, findings = drawn(analysis)
        report = analysis.model.report
        validated_on = analysis.validated_on
        return cls(report.engine, options, tuple(tests), signals, report, validated_on, pictures, findings)

    def bare(self) -> Outcome:
        """The same without its curves, where there are too many to keep."""
        without = _("The curves of so many tests are not kept: run this one by itself.")
        pictures = Drawn({}, self.drawn.units, (), dict.fromkeys((*self.drawn.lines, *self.drawn.missing), without))
        return replace(self, drawn=pictures)

    @property
    def without_curves(self) -> bool:
        """Whether it was fitted and has nothing to draw: it was kept without its curves."""
        return self.report is not None and not self.drawn.lines and not self.drawn.images

    @property
    def key(self) -> tuple[Any, ...]:
        """What a later run of the same takes the place of."""
        return self.engine, repr(self.options), tuple((test.path, test.number) for test in self.tests), self.signals

    @property
    def test_label(self) -> str:
        """Date, time and number of the test, or the name that the list gives it; of several the first."""
        first = short_label(self.tests[0])
        return (
            first
            if len(self.tests) == 1
            else _("{first} and {count} more").format(first=first, count=len(self.tests) - 1)
        )

    @property
    def label(self) -> str:
        """Engine and tests, for a list of results."""
        return f"{engine_label(self.engine)}, {labels_apart([self.tests])[1][0]}"


def keys_of(outcomes: Sequence[Outcome]) -> tuple[str, list[str]]:
    """Return what outcomes have in common and the name of each in a legend: engine, and what tells its test apart."""
    common, labels = labels_apart([outcome.tests for outcome in outcomes])
    engines = [engine_label(outcome.engine) for outcome in outcomes]
    if len(outcomes) > 1 and len(set(labels)) == 1:
        return labels[0], engines
    if len(outcomes) > 1 and len(set(engines)) == 1:
        return ", ".join(filter(None, [engines[0], common])), labels
    return common, [", ".join(filter(None, pair)) for pair in zip(engines, labels, strict=True)]
