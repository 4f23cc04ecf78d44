"""What one engine made of one test, without the record: light enough that a year of tests can be held."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from tissueid.analysis import Analysis
from tissueid.app.language import _
from tissueid.app.views.researcher.chosen import Chosen
from tissueid.app.views.researcher.curves import drawn
from tissueid.app.views.researcher.drawn import Drawn
from tissueid.identification import FitReport
from tissueid.wording import clean, engine_label

_NOTHING = Drawn({}, {}, (), {})


@dataclass(frozen=True, eq=False)
class Outcome:
    """An engine on a test, or on several that were fitted together; ``refused`` says why where nothing came of it.

    ``signals`` names input and output.
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

    @classmethod
    def of(
        cls, analysis: Analysis, options: dict[str, Any], tests: Sequence[Chosen], signals: tuple[str, str]
    ) -> Outcome:
        """Keep of an analysis what is shown."""
        pictures, findings = drawn(analysis)
        report = analysis.model.report
        return cls(report.engine, options, tuple(tests), signals, report, analysis.validated_on, pictures, findings)

    def bare(self) -> Outcome:
        """The same without its curves, where there are too many to keep."""
        without = _("The curves of so many tests are not kept: run this one by itself.")
        pictures = Drawn({}, self.drawn.units, (), dict.fromkeys((*self.drawn.lines, *self.drawn.missing), without))
        return replace(self, drawn=pictures)

    @property
    def key(self) -> tuple[Any, ...]:
        """What a later run of the same takes the place of."""
        return self.engine, repr(self.options), tuple((test.path, test.number) for test in self.tests), self.signals

    @property
    def test_label(self) -> str:
        """The tests, as the browser calls them."""
        first = clean(self.tests[0].label)
        return (
            first
            if len(self.tests) == 1
            else _("{first} and {count} more").format(first=first, count=len(self.tests) - 1)
        )

    @property
    def label(self) -> str:
        """Engine and tests, for a key."""
        return f"{engine_label(self.engine)}, {self.test_label}"
