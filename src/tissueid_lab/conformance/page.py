"""Report of the conformance of a device: the table of clauses, passed or not, with the reason."""

from __future__ import annotations

from tissueid.formatting import fixed
from tissueid.language import _, marked
from tissueid.messages import translated
from tissueid.reports.stimulus_page import StimulusReport
from tissueid.reports.tables import Table
from tissueid_lab.conformance.suite import Conformance

OUTCOMES = {"passed": marked("passed"), "failed": marked("FAILED"), "not tested": marked("not tested")}
"""Words of the outcomes."""


def conformance_report(tested: Conformance) -> StimulusReport:
    """Return the report of a device: verdict, the table of clauses, the measured figures."""
    failed = [item for item in tested.results if item.outcome == "failed"]
    rows = tuple(
        (item.id, _(item.title), _(OUTCOMES[item.outcome]), translated(item.reason)) for item in tested.results
    )
    figures = tuple(
        (f"{item.id} {name}", f"{value:.6g}") for item in tested.results for name, value in item.measured.items()
    )
    complete = all(item.outcome == "passed" for item in tested.results)
    return StimulusReport(
        title=_("Conformance of {device}").format(device=tested.device or tested.url),
        facts=(
            (_("Port"), tested.url),
            (_("Firmware"), tested.firmware),
            (_("Attached"), tested.attached),
            (_("Largest force"), f"{fixed(tested.force_n, 2)} N"),
        ),
        headline=translated(tested.headline),
        level="good" if complete else "check" if tested.passed else "poor",
        concerns=tuple(f"{item.id} {_(item.title)}: {translated(item.reason)}" for item in failed),
        summary=(_("Each clause is tested without the limits of the host. Clause numbers: docs/protocol.md, 7."),),
        tables=(
            Table(_("Clauses"), (_("Clause"), _("What the device does"), _("Result"), _("Reason")), rows),
            *([Table(_("Measured (SI)"), (), figures)] if figures else []),
        ),
        panels=(),
    )
